"""The table of scenes by engines: what must come out, and how far off each engine is."""

import math
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import jax

from validity import peers, points, raft, robot
from validity.reference import integrate
from validity.scenes import LONG, SCENES, History, Scene, error

Steps = dict[str, dict[str, Any]]  # ways of this package's step, and what `by_step` is told
STEPS: Steps = {"mjx": {"fused": True}, "mjx by XLA": {}, "mjx, double": {"double": True, "fused": True}}
ON_GPU: Steps = {"mjx on a GPU": {"fused": True}}  # by its kernel: what else is not Warp's is the same on any machine


def law() -> dict[tuple[str, str], float]:
    """What the contact law gives, by scene and figure."""
    found = zip(SCENES, integrate(SCENES), strict=True)
    return {(scene.name, figure.name): figure.of(h) for scene, h in found for figure in scene.figures}


def jobs() -> Iterator[tuple[str, Callable[[], list[dict[str, Any]]]]]:
    """Every figure of every scene: its answer, and by engine its value and its error."""
    if jax.default_backend() == "gpu":
        yield from _on_gpu()
        return
    yield "bodies", lambda: [*_points(SCENES, law(), _by_step(SCENES, STEPS), peers.histories)]
    yield "flight", lambda: [*_points(LONG, {}, _by_step(LONG, STEPS), peers.histories)]
    yield "robot", lambda: [*_stands(STEPS)]
    yield "raft", lambda: [*_rafts(STEPS)]


def _on_gpu() -> Iterator[tuple[str, Callable[[], list[dict[str, Any]]]]]:
    """Scenes one by one, as Warp compiles for minutes."""
    yield "robot", lambda: [*_stands(ON_GPU)]
    yield "raft", lambda: [*_rafts(ON_GPU)]
    laws, ours = cache(law), cache(lambda of: _by_step(of, ON_GPU))
    for of in (SCENES, LONG):
        for k, scene in enumerate(of):
            yield scene.name, lambda of=of, k=k: [*_points((of[k],), laws(), ours(of)[k : k + 1], peers.by_warp)]


def short(x: float) -> float | None:
    """Four digits; None where it is no number."""
    return float(f"{x:.4g}") if math.isfinite(x) else None


def _by_step(of: tuple[Scene, ...], steps: Steps) -> list[dict[str, History]]:
    """Each scene by this package's step in several ways."""
    ours = {name: points.simulate_scenes(of, **given) for name, given in steps.items()}
    return [{name: found[k] for name, found in ours.items()} for k in range(len(of))]


def _points(
    of: tuple[Scene, ...],
    laws: dict[tuple[str, str], float],
    ours: list[dict[str, History]],
    beside: Callable[[Scene], dict[str, History]],
) -> Iterator[dict[str, Any]]:
    for scene, own in zip(of, ours, strict=True):
        histories = own | beside(scene)
        for figure in scene.figures:
            gives = laws.get((scene.name, figure.name), float("nan"))
            values = {name: figure.of(h) for name, h in histories.items()}
            yield _row(scene.name, figure.name, figure.unit, figure.exact, gives,
                       {name: error(figure, value, gives) for name, value in values.items()}, values)  # fmt: skip


def _stands(steps: Steps) -> Iterator[dict[str, Any]]:
    case, rows = robot.rows()
    ours = {name: robot.by_step(case, rows, **given) for name, given in steps.items()}
    if peers.has_warp():
        ours["Warp as native"] = robot.by_mjx(case, rows, "warp")
    for k, row in enumerate(rows):
        forces = {name: found[k] for name, found in ours.items()} | {"native": robot.by_native(case, row)}
        errors = {name: robot.error(case, row, force) for name, force in forces.items()}
        least = robot.error(case, row, robot.least_squares(case, row))
        yield _row(f"robot, {row.name}", "forces on its feet", "of its weight", None, float("nan"), errors, {}) | {
            "least squares": least
        }


def _rafts(steps: Steps) -> Iterator[dict[str, Any]]:
    motions = {name: raft.by_step(**given) for name, given in steps.items()}
    motions["native"] = raft.by_mujoco(peers.NATIVE.time_step)
    if peers.has_warp():
        motions["Warp elliptic"] = raft.by_mjx(peers.ELLIPTIC.time_step, "warp")
    for figure in raft.figures():
        values = {name: figure.of(motion) for name, motion in motions.items()}
        errors = {name: error(figure, value, float("nan")) for name, value in values.items()}
        yield _row("raft", figure.name, figure.unit, figure.exact, float("nan"), errors, values)


def _row(
    scene: str, figure: str, unit: str, exact: float | None, law: float, errors: dict, values: dict
) -> dict[str, Any]:
    answers = {"exact": None if exact is None else short(exact), "law": short(law)}
    found = {"errors": errors, "values": values}
    found = {kind: {name: short(x) for name, x in of.items()} for kind, of in found.items()}
    return {"scene": scene, "figure": figure, "unit": unit, **answers, **found}
