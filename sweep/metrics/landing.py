"""How much of its patience a stage has left when its swinging feet have landed, and how far off others hang."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from sweep.metrics.footholds import AT_FACE
from sweep.metrics.metric import Begin, Elapsed, Metric, Moment
from sweep.models.obstacles.surface import under


class Landing(NamedTuple):
    """The stage of the last tick, when it began (s), whether the plan had ended; how far feet hung from faces (m).

    And the least reserve of the stages before.
    """

    stage: Int[Array, ""]
    began: Float[Array, ""]
    finished: Bool[Array, ""]
    gap: Float[Array, " 6"]
    reserve: Float[Array, ""]


def begin(start: Begin) -> Landing:
    """The metric before the first stage."""
    zero = jnp.zeros((), start.feet.dtype)
    return Landing(jnp.int32(0), zero, jnp.asarray(False), jnp.zeros(6, start.feet.dtype), zero + 1)


def update(so_far: Landing, now: Moment) -> Landing:
    """Where a stage begins, the one before is judged by how it ended, in the tick before."""
    plan, tick, before = now.plan, now.tick, so_far.stage
    depth = under(now.world.obstacle, tick.joints[:, -1], tick.bodies).depth
    begins = now.time - now.period
    waited = jnp.maximum(begins - so_far.began - plan.duration[before], 0.0) / jnp.maximum(plan.patience, now.period)
    hangs = jnp.max(jnp.where(plan.swing[before], so_far.gap, 0.0))
    left = jnp.where(hangs > 0, -hangs / AT_FACE, 1 - jnp.minimum(waited, 1.0))
    new = now.stage != before
    judged = (new | (now.finished & ~so_far.finished)) & jnp.any(plan.swing[before])
    return Landing(
        stage=now.stage,
        began=jnp.where(new, begins, so_far.began),
        finished=now.finished,
        gap=jnp.where(tick.loaded, 0.0, jnp.maximum(-depth, 0.0)),
        reserve=jnp.where(judged, jnp.minimum(so_far.reserve, left), so_far.reserve),
    )


def figures(found: Landing, at: Elapsed) -> dict[str, Array]:
    """See `METRIC`."""
    return {"landing_reserve_min": found.reserve}


METRIC = Metric(
    begin,
    update,
    figures,
    {
        "landing_reserve_min": "least of 1 minus the time that a stage waited for its swinging feet to touch down over "
        f"its patience; where one did not, minus its distance from its face over {1e3 * AT_FACE:g} mm"
    },
)
