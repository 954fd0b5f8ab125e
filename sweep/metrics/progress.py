"""How far the robot gets along its plan, and how fast."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sweep.controllers.plan import path_length
from sweep.core.metric import Cause, ContinuousTwin, Metric
from sweep.core.shared_metrics import travel
from sweep.core.shared_metrics.travel import Travel
from sweep.metrics.tick import GRACE, MetricTick, Rollout, RolloutStart, goal_cause, time_left
from sweep.models.frames import WORLD


class Progress(NamedTuple):
    """Travel of the base, its largest position error (m), whether the plan has ended, and the use of its time.

    The use is the time that the plan took over all that it is given, or 1 and a share for what it still lacks.
    """

    travel: Travel
    error: Float[Array, ""]
    finished: Bool[Array, ""]
    use: Float[Array, ""]


def begin(start: RolloutStart) -> Progress:
    """Initial state, before the first tick."""
    zero = jnp.zeros((), start.position.dtype)
    return Progress(travel.METRIC.begin(start), zero, jnp.asarray(False), zero + 2)


def update(state: Progress, ctx: MetricTick) -> Progress:
    """Add the displacement along the planned direction."""
    travelled = travel.METRIC.update(state.travel, ctx)
    given = GRACE * jnp.sum(ctx.plan.duration)
    ended = jnp.where(state.finished, state.use, jnp.minimum(ctx.time / given, 1.0))
    lacks = 1 + jnp.maximum(time_left(ctx) / given, 1e-6)
    return Progress(
        travel=travelled,
        error=jnp.maximum(state.error, jnp.linalg.norm(ctx.tick.truth.position - ctx.reference.position)),
        finished=ctx.finished,
        use=jnp.where(ctx.finished, ended, lacks),
    )


def compute(state: Progress, rollout: Rollout) -> dict[str, Array]:
    """Share of the path that is covered, and the mean speed."""
    length = path_length(rollout.plan)
    left = jnp.linalg.norm(state.travel.position - rollout.plan.position[-1])
    goes = (length > 1e-6) & (rollout.plan.base_frame[-1] == WORLD)  # on a free body the goal is a motion, not a place
    return {
        "finished": state.finished,
        "time_use": state.use,
        "end_stage": rollout.stage,
        "progress": jnp.where(goes, 1 - left / jnp.maximum(length, 1e-6), 1.0),
        **travel.METRIC.compute(state.travel, rollout),
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
            twin=ContinuousTwin("time_use", 1.0, 1 - 1 / GRACE),
        ),
        goal_cause("progress to the goal stayed below progress_min", "progress", below=True, scale=0.1),
    ),
)
