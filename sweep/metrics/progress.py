"""How far the robot gets along its plan, and how fast."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sweep.controllers.plan import path_length
from sweep.core.metric import Cause, Metric, SmoothMarginMetric
from sweep.core.shared_metrics import travel
from sweep.core.shared_metrics.travel import TravelState
from sweep.metrics.tick import (
    MAX_DURATION_FACTOR,
    MetricContext,
    RolloutEnd,
    RolloutStart,
    make_goal_cause,
    remaining_plan_time,
)
from sweep.models.frames import WORLD_FRAME


class PlanProgress(NamedTuple):
    """State of the progress metrics: travel of the base, largest position error (m), and how much of the plan has run.

    The use is the time that the plan took over all that it is given, or 1 and a share for what it still lacks.
    """

    travel: TravelState
    largest_position_error: Float[Array, ""]
    finished: Bool[Array, ""]
    plan_time_use: Float[Array, ""]


def begin(start: RolloutStart) -> PlanProgress:
    """Return the state of the progress metrics before the first tick: nothing travelled."""
    zero = jnp.zeros((), start.position.dtype)
    return PlanProgress(travel.METRIC.begin(start), zero, jnp.asarray(False), zero + 2)


def update(state: PlanProgress, ctx: MetricContext) -> PlanProgress:
    """Update the travel along the planned direction, the position error, and the part of the plan that has run."""
    travelled = travel.METRIC.update(state.travel, ctx)
    given = MAX_DURATION_FACTOR * jnp.sum(ctx.plan.duration)
    ended = jnp.where(state.finished, state.plan_time_use, jnp.minimum(ctx.time / given, 1.0))
    lacks = 1 + jnp.maximum(remaining_plan_time(ctx) / given, 1e-6)
    return PlanProgress(
        travel=travelled,
        largest_position_error=jnp.maximum(
            state.largest_position_error, jnp.linalg.norm(ctx.report.actual.position - ctx.reference.position)
        ),
        finished=ctx.finished,
        plan_time_use=jnp.where(ctx.finished, ended, lacks),
    )


def compute(state: PlanProgress, rollout: RolloutEnd) -> dict[str, Array]:
    """Return the share of the planned path that the base has covered, and its mean speed, by column."""
    length = path_length(rollout.plan)
    left = jnp.linalg.norm(state.travel.position - rollout.plan.position[-1])
    goes = (length > 1e-6) & (
        rollout.plan.base_frame[-1] == WORLD_FRAME
    )  # on a free body the goal is a motion, not a place
    return {
        "finished": state.finished,
        "time_use": state.plan_time_use,
        "end_stage": rollout.stage,
        "progress": jnp.where(goes, 1 - left / jnp.maximum(length, 1e-6), 1.0),
        **travel.METRIC.compute(state.travel, rollout),
        "position_error_max_m": state.largest_position_error,
    }


METRIC = Metric(
    begin,
    update,
    compute,
    {
        "finished": "whether the plan was finished",
        "time_use": f"time to the plan's end over {MAX_DURATION_FACTOR:g} of its duration, all it is given; beyond "
        "1 what it lacked",
        "end_stage": "number of the last stage that began",
        "progress": "1 minus the remaining distance to the goal over the length of the planned path",
        **travel.METRIC.columns,
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
            twin=SmoothMarginMetric("time_use", 1.0, 1 - 1 / MAX_DURATION_FACTOR),
        ),
        make_goal_cause("progress to the goal stayed below progress_min", "progress", below=True, scale=0.1),
    ),
)
