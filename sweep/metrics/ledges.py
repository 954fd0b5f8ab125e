"""Metrics of the crossing on a ball from ledge to ledge: monograph 3.2.2, 3.2.3."""

import math
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.controllers.plan import is_guided_by_law
from sweep.core.metric import Cause, Metric, make_begin_with_constants
from sweep.manoeuvres.balancing.ball_ledges import OFF, ON
from sweep.metrics.tick import MetricContext, RolloutEnd, make_goal_cause
from sweep.models.obstacles.ledges import Ledges

ARRIVAL_GAP_M = 4e-3  # m, of a ball that has come to the far wall


class LedgeCrossing(NamedTuple):
    """State of the metrics for a ball between ledges: distances to ball centre and wall (m), docking speed (m/s)."""

    mass_centre_past_ball: Float[Array, ""]
    wall_gap: Float[Array, ""]
    docking_speed: Float[Array, ""]  # m/s


def update(state: LedgeCrossing, ctx: MetricContext) -> LedgeCrossing:
    """Update the distances to ball centre and far wall, and the speed at which the ball first reaches the wall."""
    ledges, tick = ctx.world.obstacle, ctx.report
    assert isinstance(ledges, Ledges)
    ball, speed = tick.actual.free.position[0], tick.actual.free.velocity[0, 0]
    ahead = tick.centre_of_mass[0] - ball[0]
    leaves = is_guided_by_law(ctx.plan, ctx.stage, OFF)
    past = jnp.where(is_guided_by_law(ctx.plan, ctx.stage, ON), ahead, jnp.where(leaves, -ahead, -jnp.inf))
    gap = jnp.minimum(state.wall_gap, jnp.where(leaves, jnp.inf, ledges.far_wall_x - ball[0]))
    return LedgeCrossing(
        mass_centre_past_ball=jnp.maximum(state.mass_centre_past_ball, past),
        wall_gap=gap,
        docking_speed=jnp.where((state.wall_gap >= ARRIVAL_GAP_M) & (gap < ARRIVAL_GAP_M), speed, state.docking_speed),
    )


def compute(state: LedgeCrossing, rollout: RolloutEnd) -> dict[str, Array]:
    """Return by column: distance of the mass centre past the ball's centre, gap to the wall, and docking speed."""
    return {
        "past_centre_max_m": state.mass_centre_past_ball,
        "docking_gap_m": state.wall_gap,
        "docking_speed_mps": state.docking_speed,
    }


METRIC = Metric(
    make_begin_with_constants(LedgeCrossing, -math.inf, math.inf, 0.0),
    update,
    compute,
    {
        "past_centre_max_m": "largest distance of the robot's centre of mass beyond the ball's, away from the ledge "
        "that it leaves or reaches",
        "docking_gap_m": "smallest distance of the ball from the far wall before the robot began to leave the ball",
        "docking_speed_mps": f"speed of the ball when it first was within {1e3 * ARRIVAL_GAP_M:g} mm of the far wall",
    },
    (
        Cause(
            "rolled_off",
            "the mass centre went farther beyond the ball's than past_centre_max_m: the ball may roll off its wall",
            "past_centre_max_m",
            None,
        ),
        make_goal_cause(
            "the ball stayed farther from the far wall than docking_gap_max_m when the robot left it", "docking_gap_m"
        ),
        make_goal_cause("the ball reached the far wall faster than docking_speed_max_mps", "docking_speed_mps"),
    ),
    applies=lambda case: isinstance(case.obstacle, Ledges),
)
