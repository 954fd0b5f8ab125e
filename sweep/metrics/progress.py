"""How far the robot gets along its plan, and how fast."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sweep.controllers.plan import path_length
from sweep.metrics.metric import (
    GRACE,
    Cause,
    ContinuousTwin,
    Metric,
    MetricTick,
    Rollout,
    RolloutStart,
    goal_cause,
    time_left,
)
from sweep.models.frames import WORLD


class Progress(NamedTuple):
    """Base positions at the start and now (m), path length (m) and time (s) of planned motion, largest error (m).

    Whether the plan has ended, and how much of the time that it is given it took, with what it still lacks.
    """

    start: Float[Array, " 3"]
    position: Float[Array, " 3"]
    travel: Float[Array, ""]
    travel_time: Float[Array, ""]
    error: Float[Array, ""]
    finished: Bool[Array, ""]
    use: Float[Array, ""]


def begin(start: RolloutStart) -> Progress:
    """Initial state, before the first tick."""
    zero = jnp.zeros((), start.position.dtype)
    return Progress(start.position, start.position, zero, zero, zero, jnp.asarray(False), zero + 2)


def update(state: Progress, ctx: MetricTick) -> Progress:
    """Add the displacement along the planned direction."""
    way = ctx.plan.position[ctx.stage] - ctx.stage_start
    length = jnp.linalg.norm(way)
    moving = (length > 1e-6) & ~ctx.finished
    step = (ctx.tick.truth.position - state.position) @ (way / jnp.maximum(length, 1e-6))
    given = GRACE * jnp.sum(ctx.plan.duration)
    ended = jnp.where(state.finished, state.use, jnp.minimum(ctx.time / given, 1.0))
    lacks = 1 + jnp.maximum(time_left(ctx) / given, 1e-6)
    return state._replace(
        position=ctx.tick.truth.position,
        travel=state.travel + jnp.where(moving, step, 0.0),
        travel_time=state.travel_time + jnp.where(moving, ctx.period, 0.0),
        error=jnp.maximum(state.error, jnp.linalg.norm(ctx.tick.truth.position - ctx.reference.position)),
        finished=ctx.finished,
        use=jnp.where(ctx.finished, ended, lacks),
    )


def compute(state: Progress, rollout: Rollout) -> dict[str, Array]:
    """Share of the path that is covered, and the mean speed."""
    length = path_length(rollout.plan)
    left = jnp.linalg.norm(state.position - rollout.plan.position[-1])
    goes = (length > 1e-6) & (rollout.plan.base_frame[-1] == WORLD)  # on a free body the goal is a motion, not a place
    return {
        "finished": state.finished,
        "time_use": state.use,
        "end_stage": rollout.stage,
        "duration_s": rollout.time,
        "progress": jnp.where(goes, 1 - left / jnp.maximum(length, 1e-6), 1.0),
        "distance_m": jnp.linalg.norm((state.position - state.start)[:2]),
        "speed_mps": state.travel / jnp.maximum(state.travel_time, 1e-9),
        "position_error_max_m": state.error,
    }


METRIC = Metric(
    begin,
    update,
    compute,
    {
        "finished": "whether the plan was finished",
        "time_use": f"time to the plan's end over {GRACE:g} of its duration, all it is given; beyond 1 what it lacked",
        "end_stage": "number of the last stage that began",
        "duration_s": "simulated time",
        "progress": "1 minus the remaining distance to the goal over the length of the planned path",
        "distance_m": "horizontal distance between the first and last position of the base",
        "speed_mps": "mean speed along the planned direction while the plan moves the base",
        "position_error_max_m": "largest distance of the base from its reference",
    },
    (
        Cause(
            "stalled",
            "the plan was not finished",
            "finished",
            1.0,
            key="",
            below=True,
            known_at="end",
            is_count=True,
            twin=ContinuousTwin("time_use", 1.0, 1 - 1 / GRACE),
        ),
        goal_cause("progress to the goal stayed below progress_min", "progress", below=True, scale=0.1),
    ),
)
