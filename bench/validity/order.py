"""Errors of scenes over the time step, and over iterations of the contact step, in double precision."""

from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

from validity import points
from validity.scenes import SCENES, error
from validity.tables import law, short

STEPS, ITERATIONS = (4e-3, 2e-3, 1e-3, 5e-4, 2.5e-4), (1, 2, 4, 16)  # s
STEP, TAKEN = 2e-3, 4  # the step at which iterations are varied, and the iterations at which steps are


def jobs() -> Iterator[tuple[str, Callable[[], list[dict[str, Any]]]]]:
    """One for each program."""
    laws = cache(law)
    for h, count in [*((h, TAKEN) for h in STEPS), *((STEP, count) for count in ITERATIONS if count != TAKEN)]:
        yield f"{1e3 * h:g} ms, {count} iterations", lambda h=h, count=count: _rows(laws(), h, count)


def _rows(laws: dict[tuple[str, str], float], h: float, iterations: int) -> list[dict[str, Any]]:
    found = zip(SCENES, points.by_step(SCENES, h, iterations, double=True), strict=True)
    return [
        {"scene": scene.name, "figure": figure.name, "time_step": h, "iterations": iterations,
         "error": short(error(figure, figure.of(history), laws[scene.name, figure.name])),
         "residual": short(history.residual)}
        for scene, history in found for figure in scene.figures
    ]  # fmt: skip
