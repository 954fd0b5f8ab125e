"""Metrics of riding from one ball to another: meeting, contact, and the second ball's final state: monograph 3.5.2."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sweep.controllers.plan import is_under_law
from sweep.core.metric import Metric
from sweep.manoeuvres.balancing.ball_to_ball import OVER
from sweep.metrics.tick import REST, MetricTick, PlanTail, Rollout, RolloutStart, goal_cause
from sweep.models.obstacles.two_balls import TwoBalls

NEAR = 4e-3  # m, between balls that touch


class Balls(NamedTuple):
    """Whether they met, and how fast (m/s); how far apart they were (m); the second one's place (m), now and
    when the plan ended."""

    met: Bool[Array, ""]
    meeting: Float[Array, ""]
    apart: Float[Array, ""]
    place: Float[Array, " 3"]
    ended: PlanTail


def begin(start: RolloutStart) -> Balls:
    """Initial state, before the balls meet."""
    place = start.free.position[1]
    zero = jnp.zeros((), place.dtype)
    return Balls(jnp.zeros((), bool), zero, zero, place, PlanTail(place, zero))


def update(state: Balls, ctx: MetricTick) -> Balls:
    """Update gaps and speeds; the meeting is recorded once."""
    balls, free = ctx.world.obstacle, ctx.tick.truth.free
    assert isinstance(balls, TwoBalls)
    apart = jnp.linalg.norm(free.position[1] - free.position[0]) - 2 * balls.radius
    speed = free.velocity[0, 0] - free.velocity[1, 0]
    both = is_under_law(ctx.plan, ctx.stage, OVER)
    return Balls(
        met=state.met | (apart < NEAR),
        meeting=jnp.where(state.met | (apart >= NEAR), state.meeting, speed),
        apart=jnp.maximum(state.apart, jnp.where(both, apart, 0.0)),
        place=free.position[1],
        ended=jax.tree.map(
            lambda a, b: jnp.where(ctx.finished, a, b), state.ended, PlanTail(free.position[1], ctx.time)
        ),
    )


def compute(state: Balls, rollout: Rollout) -> dict[str, Array]:
    """Return the speed at which the balls met, their largest gap during the transfer, and the second ball's end state,
    by column."""
    return {
        "meeting_speed_mps": state.meeting,
        "balls_apart_max_m": state.apart,
        "second_ball_x_m": state.place[0],
        "second_ball_y_m": state.place[1],
        "second_ball_speed_mps": jnp.linalg.norm(state.ended.mean_velocity(state.place, rollout.time)[:2]),
    }


METRIC = Metric(
    begin,
    update,
    compute,
    {
        "meeting_speed_mps": f"relative speed of the balls when they first were within {1e3 * NEAR:g} mm",
        "balls_apart_max_m": "largest distance between the balls during the transfer",
        "second_ball_x_m": "final x coordinate of the second ball, world axes",
        "second_ball_y_m": "final y coordinate of the second ball, world axes",
        "second_ball_speed_mps": f"mean speed of the second ball in the {REST:g} s after the plan",
    },
    (goal_cause("the second ball ended faster than second_ball_speed_max_mps", "second_ball_speed_mps"),),
    applies=lambda case: isinstance(case.obstacle, TwoBalls),
)
