"""The table of scenes by engines: what must come out, and how far off each engine is."""

import math
from collections.abc import Callable, Iterator
from typing import Any

from validity import peers, points, raft, robot
from validity.reference import converged
from validity.scenes import LONG, SCENES, Scene, error

STEPS = {"mjx": {"fused": True}, "mjx by XLA": {}, "mjx, double": {"double": True, "fused": True}}


def law() -> dict[tuple[str, str], float]:
    """What the contact law gives, by scene and figure."""
    found = zip(SCENES, converged(SCENES), strict=True)
    return {(scene.name, figure.name): figure.of(h) for scene, h in found for figure in scene.figures}


def jobs() -> Iterator[tuple[str, Callable[[], list[dict[str, Any]]]]]:
    """Every figure of every scene: its answer, and by engine its value and its error."""
    yield "bodies", lambda: [*_points(SCENES, law())]
    yield "flight", lambda: [*_points(LONG, {})]
    yield "robot", lambda: [*_stands()]
    yield "raft", lambda: [*_rafts()]


def short(x: float) -> float | None:
    """Four digits; None where it is no number."""
    return float(f"{x:.4g}") if math.isfinite(x) else None


def _points(of: tuple[Scene, ...], laws: dict[tuple[str, str], float]) -> Iterator[dict[str, Any]]:
    ours = {name: points.by_step(of, **given) for name, given in STEPS.items()}
    for k, scene in enumerate(of):
        histories = {name: found[k] for name, found in ours.items()}
        histories |= peers.histories(scene)
        for figure in scene.figures:
            gives = laws.get((scene.name, figure.name), float("nan"))
            values = {name: figure.of(h) for name, h in histories.items()}
            yield _row(scene.name, figure.name, figure.unit, figure.exact, gives,
                       {name: error(figure, value, gives) for name, value in values.items()}, values)  # fmt: skip


def _stands() -> Iterator[dict[str, Any]]:
    case, rows = robot.rows()
    ours = {name: robot.by_step(case, rows, **given) for name, given in STEPS.items()}
    for k, row in enumerate(rows):
        forces = {name: found[k] for name, found in ours.items()} | {"native": robot.by_native(case, row)}
        errors = {name: robot.error(case, row, force) for name, force in forces.items()}
        least = robot.error(case, row, robot.least_squares(case, row))
        yield _row(f"robot, {row.name}", "forces on its feet", "of its weight", None, float("nan"), errors, {}) | {
            "least squares": least
        }


def _rafts() -> Iterator[dict[str, Any]]:
    motions = {name: raft.by_step(**given) for name, given in STEPS.items()}
    motions["native"] = raft.by_mujoco(peers.NATIVE.time_step)
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
