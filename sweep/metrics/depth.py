"""How deep feet go into what they stand on."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.metrics.metric import Begin, Cause, Elapsed, Metric, Moment
from sweep.models.obstacles.surface import under


def begin(start: Begin) -> Float[Array, ""]:
    """The depth before any tick (m)."""
    return jnp.zeros((), start.feet.dtype)


def update(so_far: Float[Array, ""], now: Moment) -> Float[Array, ""]:
    """Of the feet as they are."""
    surface = under(now.world.obstacle, now.tick.joints[:, -1], now.tick.bodies)
    return jnp.maximum(so_far, jnp.max(surface.depth))


def figures(found: Float[Array, ""], at: Elapsed) -> dict[str, Array]:
    """See `METRIC`."""
    return {"depth_max_m": found}


METRIC = Metric(
    begin,
    update,
    figures,
    {"depth_max_m": "largest depth of a foot inside what it stands on"},
    (
        Cause(
            "sunk",
            "a foot was deeper than depth_max_m inside what it stands on: points and a linear law tell nothing there",
            "depth_max_m",
            5e-3,
            doubt=True,
        ),
    ),
)
