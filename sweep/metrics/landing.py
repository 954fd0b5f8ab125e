"""How much of its patience a stage has left when its swinging feet have landed, and how far off others hang."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from sweep.metrics.footholds import AT_FACE
from sweep.metrics.metric import Metric, Moment, still
from sweep.models.obstacles.surface import surface_at


class Landing(NamedTuple):
    """The stage of the last tick, when it began (s), and what it had left then; the least of the stages before."""

    stage: Int[Array, ""]
    began: Float[Array, ""]
    left: Float[Array, ""]
    reserve: Float[Array, ""]


def update(so_far: Landing, now: Moment) -> Landing:
    """Where a stage begins, the one before is judged by what it had left, in the tick before; so is the plan's last."""
    plan, tick, new = now.plan, now.tick, now.stage != so_far.stage
    began = jnp.where(new, now.time - now.period, so_far.began)
    waited = jnp.maximum(now.time - began - plan.duration[now.stage], 0.0) / jnp.maximum(plan.patience, now.period)
    depth = surface_at(now.world.obstacle, tick.joints[:, -1], tick.bodies).depth
    hangs = jnp.max(jnp.where(plan.swing[now.stage] & ~tick.truth.loaded, -depth, 0.0))
    left = jnp.where(hangs > 0, -hangs / AT_FACE, 1 - jnp.minimum(waited, 1.0))
    over = new | now.finished
    return Landing(
        stage=now.stage,
        began=began,
        left=jnp.where(now.finished, so_far.left, jnp.where(jnp.any(plan.swing[now.stage]), left, 1.0)),
        reserve=jnp.where(over, jnp.minimum(so_far.reserve, so_far.left), so_far.reserve),
    )


METRIC = Metric(
    still(Landing, np.int32(0), 0.0, 1.0, 1.0),
    update,
    lambda found, at: {"landing_reserve_min": found.reserve},
    {
        "landing_reserve_min": "least of 1 minus the time that a stage waited for its swinging feet to touch down over "
        f"its patience; where one did not, minus its distance from its face over {1e3 * AT_FACE:g} mm"
    },
)
