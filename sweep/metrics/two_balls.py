"""Metrics of riding from one ball to another: meeting, contact, and the second ball's final state: monograph 3.5.2."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sweep.controllers.plan import is_guided_by_law
from sweep.core.metric import Metric
from sweep.manoeuvres.balancing.ball_to_ball import OVER
from sweep.metrics.tick import (
    REST_DURATION_S,
    FinalIntervalStart,
    MetricContext,
    RolloutEnd,
    RolloutStart,
    make_goal_cause,
)
from sweep.models.obstacles.two_balls import TwoBalls

TOUCHING_GAP_M = 4e-3  # m, between balls that touch


class BallMeeting(NamedTuple):
    """State of the two-ball metrics: whether and how fast (m/s) the balls met, gaps and second ball's places (m)."""

    have_met: Bool[Array, ""]
    meeting_speed: Float[Array, ""]
    largest_gap: Float[Array, ""]
    second_ball_position: Float[Array, " 3"]
    second_ball_at_plan_end: FinalIntervalStart


def begin(start: RolloutStart) -> BallMeeting:
    """Return the state of the two-ball metrics before the balls meet."""
    place = start.free.position[1]
    zero = jnp.zeros((), place.dtype)
    return BallMeeting(jnp.zeros((), bool), zero, zero, place, FinalIntervalStart(place, zero))


def update(state: BallMeeting, ctx: MetricContext) -> BallMeeting:
    """Update gaps (m) and speeds (m/s) of the two balls, and record their first contact."""
    balls, free = ctx.world.obstacle, ctx.report.actual.free
    assert isinstance(balls, TwoBalls)
    apart = jnp.linalg.norm(free.position[1] - free.position[0]) - 2 * balls.radius
    speed = free.velocity[0, 0] - free.velocity[1, 0]
    both = is_guided_by_law(ctx.plan, ctx.stage, OVER)
    return BallMeeting(
        have_met=state.have_met | (apart < TOUCHING_GAP_M),
        meeting_speed=jnp.where(state.have_met | (apart >= TOUCHING_GAP_M), state.meeting_speed, speed),
        largest_gap=jnp.maximum(state.largest_gap, jnp.where(both, apart, 0.0)),
        second_ball_position=free.position[1],
        second_ball_at_plan_end=jax.tree.map(
            lambda a, b: jnp.where(ctx.finished, a, b),
            state.second_ball_at_plan_end,
            FinalIntervalStart(free.position[1], ctx.time),
        ),
    )


def compute(state: BallMeeting, rollout: RolloutEnd) -> dict[str, Array]:
    """Return by column: speed at which the balls met, largest gap during the transfer, end state of the second ball."""
    return {
        "meeting_speed_mps": state.meeting_speed,
        "balls_apart_max_m": state.largest_gap,
        "second_ball_x_m": state.second_ball_position[0],
        "second_ball_y_m": state.second_ball_position[1],
        "second_ball_speed_mps": jnp.linalg.norm(
            state.second_ball_at_plan_end.mean_velocity(state.second_ball_position, rollout.time)[:2]
        ),
    }


METRIC = Metric(
    begin,
    update,
    compute,
    {
        "meeting_speed_mps": f"relative speed of the balls when they first were within {1e3 * TOUCHING_GAP_M:g} mm",
        "balls_apart_max_m": "largest distance between the balls during the transfer",
        "second_ball_x_m": "final x coordinate of the second ball, world axes",
        "second_ball_y_m": "final y coordinate of the second ball, world axes",
        "second_ball_speed_mps": f"mean speed of the second ball in the {REST_DURATION_S:g} s after the plan",
    },
    (make_goal_cause("the second ball ended faster than second_ball_speed_max_mps", "second_ball_speed_mps"),),
    applies=lambda case: isinstance(case.obstacle, TwoBalls),
)
