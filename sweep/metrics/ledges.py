"""Metrics of the crossing on a ball from ledge to ledge: monograph 3.2.2, 3.2.3."""

import math
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.controllers.plan import is_under_law
from sweep.core.metric import Cause, Metric, initial_state
from sweep.manoeuvres.balancing.ball_ledges import OFF, ON
from sweep.metrics.tick import MetricTick, Rollout, goal_cause
from sweep.models.obstacles.ledges import Ledges

THERE = 4e-3  # m, of a ball that has come to the far wall


class LedgeCrossing(NamedTuple):
    """Distances (m) of the mass centre past the ball's centre, and of the ball from the far wall; docking speed."""

    past: Float[Array, ""]
    gap: Float[Array, ""]
    docking: Float[Array, ""]  # m/s


def update(state: LedgeCrossing, ctx: MetricTick) -> LedgeCrossing:
    """Update distances, and the docking speed when the ball first reaches the far wall."""
    ledges, tick = ctx.world.obstacle, ctx.tick
    assert isinstance(ledges, Ledges)
    ball, speed = tick.truth.free.position[0], tick.truth.free.velocity[0, 0]
    ahead = tick.centre_of_mass[0] - ball[0]
    leaves = is_under_law(ctx.plan, ctx.stage, OFF)
    past = jnp.where(is_under_law(ctx.plan, ctx.stage, ON), ahead, jnp.where(leaves, -ahead, -jnp.inf))
    gap = jnp.minimum(state.gap, jnp.where(leaves, jnp.inf, ledges.far_wall_x - ball[0]))
    return LedgeCrossing(
        past=jnp.maximum(state.past, past),
        gap=gap,
        docking=jnp.where((state.gap >= THERE) & (gap < THERE), speed, state.docking),
    )


def compute(state: LedgeCrossing, rollout: Rollout) -> dict[str, Array]:
    """Distance of the mass centre past the ball's centre, and docking gap and speed."""
    return {"past_centre_max_m": state.past, "docking_gap_m": state.gap, "docking_speed_mps": state.docking}


METRIC = Metric(
    initial_state(LedgeCrossing, -math.inf, math.inf, 0.0),
    update,
    compute,
    {
        "past_centre_max_m": "largest distance of the robot's centre of mass beyond the ball's, away from the ledge "
        "that it leaves or reaches",
        "docking_gap_m": "smallest distance of the ball from the far wall before the robot began to leave the ball",
        "docking_speed_mps": f"speed of the ball when it first was within {1e3 * THERE:g} mm of the far wall",
    },
    (
        Cause(
            "rolled_off",
            "the mass centre went farther beyond the ball's than past_centre_max_m: the ball may roll off its wall",
            "past_centre_max_m",
            None,
        ),
        goal_cause(
            "the ball stayed farther from the far wall than docking_gap_max_m when the robot left it", "docking_gap_m"
        ),
        goal_cause("the ball reached the far wall faster than docking_speed_max_mps", "docking_speed_mps"),
    ),
    applies=lambda case: isinstance(case.obstacle, Ledges),
)
