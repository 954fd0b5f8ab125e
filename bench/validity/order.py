"""Errors of scenes over the time step, MuJoCo's beside, and over the contact step's iterations, in double precision."""

from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

from validity import peers, points
from validity.scenes import SCENES, History, Scene, error
from validity.tables import law, short

STEPS, ITERATIONS = (4e-3, 2e-3, 1e-3, 5e-4, 2.5e-4), (1, 2, 4, 8, 16)  # s
STEP, TAKEN = 2e-3, 4  # the step at which iterations are varied, and the iterations at which steps are


def jobs() -> Iterator[tuple[str, Callable[[], list[dict[str, Any]]]]]:
    """One for each program."""
    laws = cache(law)
    for h, count in [*((h, TAKEN) for h in STEPS), *((STEP, count) for count in ITERATIONS if count != TAKEN)]:
        yield f"{1e3 * h:g} ms, {count} iterations", lambda h=h, count=count: _ours(laws(), h, count)


def peer_jobs() -> Iterator[tuple[str, Callable[[], list[dict[str, Any]]]]]:
    """Yield one job for each cone of C MuJoCo, with only the cone and the time step set."""
    laws = cache(law)
    for cone in peers.CONES:
        yield f"C {cone}", lambda cone=cone: [row for h in STEPS for row in _peers(laws(), cone, h)]


def _ours(laws: dict[tuple[str, str], float], h: float, iterations: int) -> list[dict[str, Any]]:
    found = zip(SCENES, points.simulate_scenes(SCENES, h, iterations, double=True, fused=True), strict=True)
    more = {"time_step": h, "iterations": iterations}
    return [
        row | more | {"residual": short(history.residual)}
        for scene, history in found
        for row in _rows(laws, scene, history)
    ]


def _peers(laws: dict[tuple[str, str], float], cone: str, h: float) -> list[dict[str, Any]]:
    settings = peers.Settings(cone, h)
    return [
        row | {"engine": f"C {cone}", "time_step": h}
        for scene in SCENES
        for row in _rows(laws, scene, peers.by_mujoco(scene, settings))
    ]


def _rows(laws: dict[tuple[str, str], float], scene: Scene, history: History) -> Iterator[dict[str, Any]]:
    for figure in scene.figures:
        value = figure.of(history)
        row = {"scene": scene.name, "figure": figure.name}
        row |= {"error": short(error(figure, value, laws[scene.name, figure.name]))}
        yield row | ({"off": short(abs(value)), "unit": figure.unit} if figure.exact == 0 else {})
