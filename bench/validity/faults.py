"""Wrong steps, and which scenes tell: every fault must break a bound. Nothing of this is in `sweep`."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any
from unittest import mock

import jax.numpy as jnp
import numpy as np

from sweep.core.vectors import Vector
from sweep.dynamics import contacts, free_bodies, step, tree
from sweep.dynamics.spatial import Spatial
from validity import points, robot
from validity.scenes import SCENES, error
from validity.tables import law, short


def errors(
    iterations: int = 2, converged: dict[tuple[str, str], float] | None = None
) -> Iterator[tuple[str, float, float]]:
    """Names, errors and bounds of all that the step must keep; `converged` is of what the contact law alone gives."""
    for scene, history in zip(SCENES, points.by_step(SCENES, iterations=iterations), strict=True):
        for figure in scene.figures:
            if figure.bound is not None:
                law = (converged or {}).get((scene.name, figure.name), np.nan)
                yield f"{scene.name}: {figure.name}", error(figure, figure.of(history), law), figure.bound
    case, rows = robot.rows()
    for row, force in zip(rows, robot.by_step(case, rows, iterations=iterations), strict=True):
        if row.bound is not None:
            yield f"{row.name}: forces", robot.error(case, row, force), row.bound


def broken(found: Iterator[tuple[str, float, float]]) -> dict[str, float]:
    """What is beyond its bound, the farthest first, with how many times it is; what is no number is infinitely far."""
    over = {name: error / bound if np.isfinite(error) else np.inf for name, error, bound in found}
    return dict(sorted(((name, by) for name, by in over.items() if by > 1), key=lambda one: -one[1]))


def _forces(change: Callable[..., contacts.Forces]) -> mock._patch:
    right = contacts.contact_forces
    return mock.patch.object(
        step, "contact_forces", lambda law, geometry, velocity: change(right, law, geometry, velocity)
    )


def _pyramid(right, law, geometry, velocity) -> contacts.Forces:
    """Friction is limited along two axes each, not in size."""
    forces = right(law, geometry, velocity)
    free = right(law, geometry._replace(limit=1e6 * jnp.ones_like(geometry.limit)), velocity)
    n, x = geometry.normal, jnp.ones_like(geometry.limit)
    one = Vector(x, 0 * x, 0 * x)
    one = one - one.dot(n) * n
    one = (1 / jnp.sqrt(one.dot(one))) * one
    other, most = n.cross(one), geometry.limit * forces.normal
    parts = [jnp.clip(free.tangential.dot(axis), -most, most) * axis for axis in (one, other)]
    tangential = parts[0] + parts[1]
    return forces._replace(tangential=tangential, force=forces.normal * n + tangential)


def _wrong_sign(right, law, geometry, velocity) -> contacts.Forces:
    """Contacts drive what passes along them, where they should damp it."""
    rising = velocity.dot(geometry.normal) * geometry.normal
    return right(law, geometry, rising - (velocity - rising))


def _wide_cone(right, law, geometry, velocity) -> contacts.Forces:
    """The cone is 2 % too wide."""
    return right(law, geometry._replace(limit=1.02 * geometry.limit), velocity)


def _pulling(right, law, geometry, velocity) -> contacts.Forces:
    """Contacts are half as stiff as they say."""
    return right(law, geometry._replace(depth=0.5 * geometry.depth), velocity)


def _twice(self, force, moment=None):
    """Root bodies feel every force on a point twice."""
    found = _ONTO(self, force, moment)
    return [*found, *found]


_ONTO = contacts.Contacts.onto


def _half_gravity(*of):
    """Weight turns joints half as much as it should."""
    found = _TERMS(*of)
    return found._replace(bias=found.bias._replace(leg=tuple(0.5 * part for part in found.bias.leg)))


_TERMS = tree.tree_terms


def _forgotten(law, surface, point, frames, place, forces, velocity, h) -> contacts.Anchors:
    """A contact takes hold anew at every step."""
    found = _ANCHORS(law, surface, point, frames, place, forces, velocity, h)
    return found._replace(loaded=jnp.zeros_like(found.loaded))


def _undragged(law, surface, point, frames, place, forces, velocity, h) -> contacts.Anchors:
    """A contact that slips leaves its anchor where it is."""
    still = forces._replace(slipping=jnp.zeros_like(forces.slipping))
    return _ANCHORS(law, surface, point, frames, place, still, velocity, h)


_ANCHORS = contacts.update_anchors


def _no_gyroscope(inertia, motion, up) -> Spatial:
    """A body's own turning has no Coriolis force."""
    found = _BIAS(inertia, motion, up)
    return found._replace(angular=0.0 * found.angular)


_BIAS = free_bodies.bias


@contextmanager
def _one_iteration():
    yield 1


@contextmanager
def _nothing():
    yield 2


FAULTS = {
    "none": lambda: _nothing(),
    "a friction pyramid in place of the cone": lambda: _forces(_pyramid),
    "the cone 2 % too wide": lambda: _forces(_wide_cone),
    "an impulse applied twice": lambda: mock.patch.object(contacts.Contacts, "onto", _twice),
    "tangential damping with the wrong sign": lambda: _forces(_wrong_sign),
    "half the contact's stiffness": lambda: _forces(_pulling),
    "half the gravity torque of the joints": lambda: mock.patch.object(tree, "tree_terms", _half_gravity),
    "anchors forgotten at every step": lambda: mock.patch.object(step, "update_anchors", _forgotten),
    "anchors left behind by what slips": lambda: mock.patch.object(step, "update_anchors", _undragged),
    "no Coriolis force of free bodies": lambda: mock.patch.object(free_bodies, "bias", _no_gyroscope),
    "one iteration": lambda: _one_iteration(),
}


def jobs() -> Iterator[tuple[str, Callable[[], list[dict[str, Any]]]]]:
    """For each fault how many bounds it breaks, and the ones it breaks farthest."""
    laws = cache(law)
    for name in FAULTS:
        yield name, lambda name=name: [_row(name, laws())]


def _row(name: str, laws: dict[tuple[str, str], float]) -> dict[str, Any]:
    with FAULTS[name]() as given:
        found = list(errors(1 if given == 1 else 2, laws))
    over = broken(iter(found))
    worst = [[figure, short(by)] for figure, by in over.items()]
    return {"fault": name, "broken": len(over), "of": len(found), "worst": worst[:3]}
