"""What the crossing with a ball from ledge to ledge is checked for: monograph 3.2.2, 3.2.3."""

import math
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.controllers.manoeuvres.balancing.ball_ledges import OFF, ON
from sweep.controllers.plan import is_under_law
from sweep.metrics.metric import Cause, Elapsed, Metric, Moment, missed, still
from sweep.models.obstacles.ledges import Ledges

THERE = 4e-3  # m, of a ball that has come to the far wall


class LedgeCrossing(NamedTuple):
    """How far the mass centre was past the ball's centre, how near the ball came to the far wall (m), and how fast."""

    past: Float[Array, ""]
    gap: Float[Array, ""]
    docking: Float[Array, ""]  # m/s


def update(so_far: LedgeCrossing, now: Moment) -> LedgeCrossing:
    """The far wall is asked for once."""
    ledges, tick = now.world.obstacle, now.tick
    assert isinstance(ledges, Ledges)
    ball, speed = tick.truth.free.position[0], tick.truth.free.velocity[0, 0]
    ahead = tick.centre_of_mass[0] - ball[0]
    leaves = is_under_law(now.plan, now.stage, OFF)
    past = jnp.where(is_under_law(now.plan, now.stage, ON), ahead, jnp.where(leaves, -ahead, -jnp.inf))
    gap = jnp.minimum(so_far.gap, jnp.where(leaves, jnp.inf, ledges.far_wall_x - ball[0]))
    return LedgeCrossing(
        past=jnp.maximum(so_far.past, past),
        gap=gap,
        docking=jnp.where((so_far.gap >= THERE) & (gap < THERE), speed, so_far.docking),
    )


def figures(found: LedgeCrossing, at: Elapsed) -> dict[str, Array]:
    """Past the ball's centre, and the docking."""
    return {"past_centre_max_m": found.past, "docking_gap_m": found.gap, "docking_speed_mps": found.docking}


METRIC = Metric(
    still(LedgeCrossing, -math.inf, math.inf, 0.0),
    update,
    figures,
    {
        "past_centre_max_m": "farthest that the robot's mass centre was beyond the ball's, seen from the ledge that "
        "it leaves, or comes to",
        "docking_gap_m": "least distance of the ball from the far wall before the robot began to leave it",
        "docking_speed_mps": f"speed of the ball when it first was within {1e3 * THERE:g} mm of the far wall",
    },
    (
        Cause(
            "rolled_off",
            "the mass centre went farther beyond the ball's than past_centre_max_m: the ball may roll off its wall",
            "past_centre_max_m",
            None,
        ),
        missed(
            "the ball stayed farther from the far wall than docking_gap_max_m when the robot left it", "docking_gap_m"
        ),
        missed("the ball came to the far wall faster than docking_speed_max_mps", "docking_speed_mps"),
    ),
    applies=lambda case: isinstance(case.obstacle, Ledges),
)
