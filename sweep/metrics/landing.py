"""Remaining patience of a stage when its swinging feet have landed, and the height of feet that have not."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from sweep.core.metric import Metric, initial_state
from sweep.metrics.footholds import AT_FACE
from sweep.metrics.tick import MetricTick
from sweep.models.obstacles.surface import surface_at


class Landing(NamedTuple):
    """The last tick's stage, its start and remaining patience (s); the least patience of earlier stages."""

    stage: Int[Array, ""]
    began: Float[Array, ""]
    left: Float[Array, ""]
    reserve: Float[Array, ""]


def update(state: Landing, ctx: MetricTick) -> Landing:
    """When a stage begins, judge the one before it by its last tick; the plan's last stage is judged at its end."""
    plan, tick, new = ctx.plan, ctx.tick, ctx.stage != state.stage
    began = jnp.where(new, ctx.time - ctx.period, state.began)
    waited = jnp.maximum(ctx.time - began - plan.duration[ctx.stage], 0.0) / jnp.maximum(plan.patience, ctx.period)
    depth = surface_at(ctx.world.obstacle, tick.joints[:, -1], tick.bodies).depth
    hangs = jnp.max(jnp.where(plan.swing[ctx.stage] & ~tick.truth.loaded, -depth, 0.0))
    left = jnp.where(hangs > 0, -hangs / AT_FACE, 1 - jnp.minimum(waited, 1.0))
    over = new | ctx.finished
    return Landing(
        stage=ctx.stage,
        began=began,
        left=jnp.where(ctx.finished, state.left, jnp.where(jnp.any(plan.swing[ctx.stage]), left, 1.0)),
        reserve=jnp.where(over, jnp.minimum(state.reserve, state.left), state.reserve),
    )


METRIC = Metric(
    initial_state(Landing, np.int32(0), 0.0, 1.0, 1.0),
    update,
    lambda state, rollout: {"landing_reserve_min": state.reserve},
    {
        "landing_reserve_min": "least of 1 minus the time that a stage waited for its swinging feet to touch down over "
        f"its patience; where one did not, minus its distance from its face over {1e3 * AT_FACE:g} mm"
    },
)
