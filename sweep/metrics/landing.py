"""How much of its patience a stage has left when its swinging feet have landed, and how far off others hang."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from sweep.metrics.footholds import AT_FACE
from sweep.metrics.metric import Metric, MetricTick, initial_state
from sweep.models.obstacles.surface import surface_at


class Landing(NamedTuple):
    """The stage of the last tick, when it began (s), and what it had left then; the least of the stages before."""

    stage: Int[Array, ""]
    began: Float[Array, ""]
    left: Float[Array, ""]
    reserve: Float[Array, ""]


def update(state: Landing, ctx: MetricTick) -> Landing:
    """Where a stage begins, the one before is judged by what it had left, in the tick before; so is the plan's last."""
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
