"""How deep feet go into what they stand on."""

from collections.abc import Iterator

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.metrics.metric import Cause, Moment, extremes
from sweep.models.obstacles.surface import surface_at


def deepest(now: Moment) -> Iterator[Float[Array, ""]]:
    """Largest depth of a foot, where it really is, in what is under it (m)."""
    yield jnp.max(surface_at(now.world.obstacle, now.tick.joints[:, -1], now.tick.bodies).depth)


METRIC = extremes(
    deepest,
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
