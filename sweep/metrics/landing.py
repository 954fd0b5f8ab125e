"""How much of its patience (waiting time) a stage has left when its swinging feet have landed, and the height of late
feet."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from sweep.core.metric import Metric, make_begin_with_constants
from sweep.metrics.footholds import FACE_TOLERANCE_M
from sweep.metrics.tick import MetricContext
from sweep.models.obstacles.surface import surface_at


class LandingPatience(NamedTuple):
    """State of the landing metric: share of the allowed wait for late feet that is left, now and at least so far."""

    stage: Int[Array, ""]
    stage_start_time: Float[Array, ""]
    remaining_patience: Float[Array, ""]
    least_patience: Float[Array, ""]


def update(state: LandingPatience, ctx: MetricContext) -> LandingPatience:
    """Update the least share left of the time for which the robot may wait for feet that touch down late."""
    plan, tick, new = ctx.plan, ctx.report, ctx.stage != state.stage
    began = jnp.where(new, ctx.time - ctx.period, state.stage_start_time)
    waited = jnp.maximum(ctx.time - began - plan.duration[ctx.stage], 0.0) / jnp.maximum(plan.patience, ctx.period)
    depth = surface_at(ctx.world.obstacle, tick.joints[:, -1], tick.bodies).depth
    hangs = jnp.max(jnp.where(plan.swing[ctx.stage] & ~tick.actual.loaded, -depth, 0.0))
    left = jnp.where(hangs > 0, -hangs / FACE_TOLERANCE_M, 1 - jnp.minimum(waited, 1.0))
    over = new | ctx.finished
    return LandingPatience(
        stage=ctx.stage,
        stage_start_time=began,
        remaining_patience=jnp.where(
            ctx.finished, state.remaining_patience, jnp.where(jnp.any(plan.swing[ctx.stage]), left, 1.0)
        ),
        least_patience=jnp.where(
            over, jnp.minimum(state.least_patience, state.remaining_patience), state.least_patience
        ),
    )


METRIC = Metric(
    make_begin_with_constants(LandingPatience, np.int32(0), 0.0, 1.0, 1.0),
    update,
    lambda state, rollout: {"landing_reserve_min": state.least_patience},
    {
        "landing_reserve_min": "least of 1 minus the time that a stage waited for its swinging feet to touch down over "
        f"its patience; where one did not, minus its distance from its face over {1e3 * FACE_TOLERANCE_M:g} mm"
    },
)
