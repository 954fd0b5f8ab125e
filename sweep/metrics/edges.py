"""Distance of loaded feet from the edges of the faces on which they stand."""

from collections.abc import Iterator

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.core.metric import make_extremes_metric
from sweep.metrics.tick import MetricContext
from sweep.models.geometry import EDGE_SEARCH_RADIUS_M, foot_edge_distance
from sweep.models.obstacles.plane import Plane


def least_edge_distance(ctx: MetricContext) -> Iterator[Float[Array, ""]]:
    """Return the least distance (m) of a loaded foot from the edges of the face on which it stands."""
    tick = ctx.report
    left = foot_edge_distance(ctx.world.obstacle, tick.joints[:, -1], tick.bodies)
    yield jnp.min(left, where=tick.actual.loaded, initial=EDGE_SEARCH_RADIUS_M)


METRIC = make_extremes_metric(
    least_edge_distance,
    {
        "edge_reserve_min_m": "least distance of a loaded foot to an edge of its face, at most "
        f"{EDGE_SEARCH_RADIUS_M:g} m or half the solid's thickness there"
    },
    applies=lambda case: not isinstance(case.obstacle, Plane),
    interval=0.02,
)
