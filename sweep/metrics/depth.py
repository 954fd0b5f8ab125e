"""Penetration depth of the feet in the obstacle."""

from collections.abc import Iterator

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.core.metric import Cause, make_extremes_metric
from sweep.metrics.tick import MetricContext
from sweep.models.obstacles.surface import surface_at


def largest_penetration(ctx: MetricContext) -> Iterator[Float[Array, ""]]:
    """Return the largest penetration depth (m) of a foot into the obstacle in this tick."""
    yield jnp.max(surface_at(ctx.world.obstacle, ctx.report.joints[:, -1], ctx.report.bodies).depth)


METRIC = make_extremes_metric(
    largest_penetration,
    {"depth_max_m": "largest penetration of a foot into its support"},
    (
        Cause(
            "sunk",
            "a foot penetrated its support by more than depth_max_m, where the contact model is not valid",
            "depth_max_m",
            5e-3,
            invalid=True,
        ),
    ),
)
