"""Deliberately wrong steps, and which scenes detect them: every fault must break a bound. None of this is in `sweep`.

All faults are in one program, in which each rollout has the number of its fault, if any.
"""

import dataclasses
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any, cast
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from sweep.core.parameters import parameters, quantity
from sweep.core.vectors import Vector
from sweep.dynamics import contacts, free_bodies, step, tree
from sweep.dynamics.spatial import SpatialVector
from sweep.models.case import Case
from sweep.models.contact import Contact
from sweep.models.obstacles.kerb import Kerb
from validity import points, robot, simulation
from validity.scenes import SCENES, History, error
from validity.tables import law, short

FAULTS = (
    "none", "a friction pyramid in place of the cone", "the cone 2 % too wide", "an impulse applied twice",
    "tangential damping with the wrong sign", "half the contact's stiffness", "half the gravity torque of the joints",
    "anchors forgotten at every step", "anchors left behind by what slips", "no Coriolis force of free bodies",
    "one iteration",
)  # fmt: skip
Laws = dict[tuple[str, str], float]
Errors = list[tuple[str, float, float]]  # names, errors and bounds


def errors(laws: Laws) -> Errors:
    """Return all errors that the step has to keep within bounds at its default settings.

    Args:
        laws: results of the contact law alone.
    """
    case, rows = robot.rows()
    return _errors(points.simulate_scenes(SCENES, fused=True), robot.by_step(case, rows, fused=True), laws)


def _errors(histories: list[History], forces: np.ndarray, laws: Laws) -> Errors:
    found, (case, rows) = [], robot.rows()
    for scene, history in zip(SCENES, histories, strict=True):
        for figure in scene.figures:
            if figure.bound is not None:
                gives = laws.get((scene.name, figure.name), np.nan)
                found.append((f"{scene.name}: {figure.name}", error(figure, figure.of(history), gives), figure.bound))
    for row, force in zip(rows, forces, strict=True):
        if row.bound is not None:
            found.append((f"{row.name}: forces", robot.error(case, row, force), row.bound))
    return found


def errors_with_faults(laws: Laws) -> dict[str, Errors]:
    """Return the same errors of steps with each fault."""
    scenes, (case, rows), n = SCENES * len(FAULTS), robot.rows(), len(FAULTS)
    begun = points.batch(scenes)
    with ExitStack() as stack:
        for patch in _patches():
            stack.enter_context(patch)
        nominal = _marked(begun.nominal, _Points, 0.0)
        begun = begun._replace(case=_marked(begun.case, _Points, _numbers(SCENES)), nominal=nominal)
        histories = points.simulate_batch(scenes, begun, 2e-3, 2, double=False, fused=True)
        nominal = _marked(case, _Kerb, 0.0)
        forces = robot.by_step(_marked(case, _Kerb, _numbers(rows)), rows * n, fused=True, nominal=nominal)
    parts = zip(np.split(np.arange(len(histories)), n), np.split(forces, n), strict=True)
    told = ((places.tolist(), own) for places, own in parts)
    return {name: _errors([histories[k] for k in at], own, laws) for name, (at, own) in zip(FAULTS, told, strict=True)}


def _numbers(of: Any) -> np.ndarray:
    return np.repeat(np.arange(float(len(FAULTS))), len(of))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class _Points(points.Points):
    fault: Array


@parameters
class _Kerb(Kerb):
    fault: float = quantity(0.0, "-")


def _marked(case: Case, kind: type, fault: Any) -> Case:
    """With an obstacle that says which fault a rollout has."""
    fields = {f.name: getattr(case.obstacle, f.name) for f in dataclasses.fields(cast(Any, case.obstacle))}
    return dataclasses.replace(case, obstacle=kind(**fields, fault=fault))


def broken_bounds(results: Errors) -> dict[str, float]:
    """Return the errors beyond their bounds over these, the largest first; not a number counts as infinite."""
    over = {name: error / bound if np.isfinite(error) else np.inf for name, error, bound in results}
    return dict(sorted(((name, by) for name, by in over.items() if by > 1), key=lambda one: -one[1]))


def _patches() -> Iterator[Any]:
    """Of what is traced, so that a step has the fault that its obstacle says."""
    now: dict[str, Any] = {}  # of the step that is being traced: its fault
    right = {
        name: getattr(owner, name)
        for owner, name in (
            (simulation, "step"), (step, "contact_forces"), (contacts, "update_anchors"),
            (contacts.ContactSet, "root_wrenches"), (tree, "robot_dynamics_terms"), (free_bodies, "bias_wrench"),
            (step._ImplicitStepProblem, "_improve"),
        )
    }  # fmt: skip

    def has(name: str) -> Array:
        return now["fault"] == FAULTS.index(name)

    def unless(name: str, otherwise: float) -> Array:
        """A factor."""
        return jnp.where(has(name), otherwise, 1.0)

    def told(smooth: Any, case: Case, *of: Any) -> Any:
        now.clear()
        now["fault"] = case.obstacle.fault  # pyright: ignore[reportAttributeAccessIssue]
        return right["step"](smooth, case, *of)

    def forces(law: Contact, geometry: contacts.ContactGeometry, velocity: Vector) -> contacts.ContactForces:
        along = velocity - velocity.dot(geometry.normal) * geometry.normal
        velocity = velocity - (1 - unless("tangential damping with the wrong sign", -1.0)) * along
        geometry = geometry._replace(
            friction=unless("the cone 2 % too wide", 1.02) * geometry.friction,
            depth=unless("half the contact's stiffness", 0.5) * geometry.depth,
        )
        found = right["contact_forces"](law, geometry, velocity)
        other = _pyramid(right["contact_forces"], law, geometry, velocity)
        return jax.tree.map(lambda a, b: jnp.where(has(FAULTS[1]), a, b), other, found)

    def onto(self: contacts.ContactSet, force: Vector, moment: Vector | None = None) -> list[tuple[int, SpatialVector]]:
        twice = unless("an impulse applied twice", 2.0)
        return right["root_wrenches"](self, twice * force, None if moment is None else twice * moment)

    def terms(*of: Any) -> Any:
        found = right["robot_dynamics_terms"](*of)
        half = unless("half the gravity torque of the joints", 0.5)
        return found._replace(bias=found.bias._replace(leg=tuple(half * part for part in found.bias.leg)))

    def anchors(law, surface, point, frames, place, forces, velocity, h) -> contacts.ContactAnchors:
        dragged = forces.slipping & ~has("anchors left behind by what slips")
        found = right["update_anchors"](
            law, surface, point, frames, place, forces._replace(slipping=dragged), velocity, h
        )
        return found._replace(loaded=found.loaded & ~has("anchors forgotten at every step"))

    def bias(*of: Any) -> SpatialVector:
        found = right["bias_wrench"](*of)
        return found._replace(angular=unless("no Coriolis force of free bodies", 0.0) * found.angular)

    def improve(self: Any, before: Any, enough: Array) -> Any:
        """Nothing after the first iteration but to count."""
        late = has("one iteration") & (before.number > 0)
        after = right["_improve"](self, before, enough)
        return jax.tree.map(lambda a, b: jnp.where(late, a, b), before._replace(number=after.number), after)

    wrong = (
        (simulation, "step", told), (step, "contact_forces", forces), (contacts, "update_anchors", anchors),
        (contacts.ContactSet, "root_wrenches", onto), (tree, "robot_dynamics_terms", terms),
        (free_bodies, "bias_wrench", bias),
        (step._ImplicitStepProblem, "_improve", improve),
    )  # fmt: skip
    for owner, name, function in wrong:
        yield mock.patch.object(owner, name, function)


def _pyramid(right: Callable[..., contacts.ContactForces], law, geometry, velocity) -> contacts.ContactForces:
    """Friction is limited along two axes each, not in size."""
    forces = right(law, geometry, velocity)
    free = right(law, geometry._replace(friction=1e6 * jnp.ones_like(geometry.friction)), velocity)
    n, x = geometry.normal, jnp.ones_like(geometry.friction)
    one = Vector(x, 0 * x, 0 * x)
    one = one - one.dot(n) * n
    one = (1 / jnp.sqrt(one.dot(one))) * one
    other, most = n.cross(one), geometry.friction * forces.normal
    parts = [jnp.clip(free.tangential.dot(axis), -most, most) * axis for axis in (one, other)]
    tangential = parts[0] + parts[1]
    return forces._replace(tangential=tangential, force=forces.normal * n + tangential)


def jobs() -> Iterator[tuple[str, Callable[[], list[dict[str, Any]]]]]:
    """Yield, for each fault, how many bounds it breaks, and the ones it breaks most."""
    yield "faults", lambda: [_row(name, found) for name, found in errors_with_faults(law()).items()]


def _row(name: str, found: Errors) -> dict[str, Any]:
    over = broken_bounds(found)
    worst = [[figure, short(by)] for figure, by in over.items()]
    return {"fault": name, "broken": len(over), "of": len(found), "worst": worst[:3]}
