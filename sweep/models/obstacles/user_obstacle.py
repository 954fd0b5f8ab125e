"""Checks of a user's own obstacle before anything is compiled."""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp

from sweep.core.errors import USER_CODE_ERRORS, InputError, format_user_exception
from sweep.models.obstacles.charts import Chart
from sweep.models.obstacles.surface import Obstacle, Surface, identity_poses

TEST_POINTS = 2
SURFACE_SHAPES = {
    "depth": (TEST_POINTS,),
    "normal": (TEST_POINTS, 3),
    "face": (TEST_POINTS,),
    "body": (TEST_POINTS,),
    "friction_scale": (TEST_POINTS,),
}


def check_user_obstacle(obstacle: Obstacle) -> None:
    """Raise `InputError` if a user's obstacle has members (solids, surface, charts) that fail or return wrong types."""
    bodies = identity_poses(len(obstacle.free_bodies))

    def call_checked(part: str, function: Callable[..., Any], *args: Any) -> Any:
        try:
            return function(*args)
        except USER_CODE_ERRORS as error:
            raise _input_error(obstacle, f"{part} fails: {format_user_exception(error)}") from None

    solids = call_checked("solids", obstacle.solids, bodies)
    if not isinstance(solids, tuple | list) or not all(hasattr(one, "segment_distance") for one in solids):
        raise _input_error(obstacle, f"solids gives {solids!r}: a tuple of solids is wanted")
    points, owner = jnp.zeros((TEST_POINTS, 3)), (-1,) * TEST_POINTS
    found = call_checked("surface", jax.eval_shape, lambda at: obstacle.surface(at, owner, bodies), points)
    if not isinstance(found, Surface):
        raise _input_error(obstacle, f"surface gives {type(found).__name__}: a Surface is wanted")
    for name, form in SURFACE_SHAPES.items():
        if (given := getattr(getattr(found, name), "shape", None)) != form:
            raise _input_error(obstacle, f"surface gives {name} {given} of {TEST_POINTS} points: {form} is wanted")
    if not isinstance(obstacle.charts, Mapping) or not all(isinstance(c, Chart) for c in obstacle.charts.values()):
        raise _input_error(obstacle, f"charts are {obstacle.charts}: a Chart by each name is wanted")
    for name, chart in obstacle.charts.items():
        numbers = jnp.zeros(3 + len(chart.names))  # the leg's side, the unit, how deep, the coordinates
        point = call_checked(f"chart {name}", jax.eval_shape, lambda x, at=chart.at: at(obstacle, *x), numbers)
        if getattr(point, "shape", None) != (3,):
            raise _input_error(obstacle, f"chart {name} gives {getattr(point, 'shape', point)}: (3,) is wanted")


def _input_error(obstacle: Obstacle, reason: str) -> InputError:
    return InputError(f"obstacle.kind = {obstacle.kind} is not allowed: {reason}")
