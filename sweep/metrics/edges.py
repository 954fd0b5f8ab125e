"""How far standing feet keep from where what they stand on ends."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.metrics.geometry import AROUND, edge_distance
from sweep.metrics.metric import Begin, Elapsed, Metric, Moment
from sweep.models.obstacles.plane import Plane


def begin(start: Begin) -> Float[Array, ""]:
    """No edge is near."""
    return jnp.full((), AROUND, start.feet.dtype)


def update(so_far: Float[Array, ""], now: Moment) -> Float[Array, ""]:
    """Of feet that carry load (m)."""
    tick = now.tick
    left = edge_distance(now.world.obstacle, tick.joints[:, -1], tick.bodies)
    return jnp.minimum(so_far, jnp.min(jnp.where(tick.loaded, left, AROUND)))


def figures(found: Float[Array, ""], at: Elapsed) -> dict[str, Array]:
    """See `METRIC`."""
    return {"edge_reserve_min_m": found}


METRIC = Metric(
    begin,
    update,
    figures,
    {"edge_reserve_min_m": f"least distance of a loaded foot to an edge of its face, at most {AROUND:g} m"},
    applies=lambda case: not isinstance(case.obstacle, Plane),
    interval=0.02,
)
