"""Reach of the legs: shortfall of foot targets, and remaining length to stretch or fold."""

from collections.abc import Iterator

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.core.metric import Cause, make_extremes_metric
from sweep.metrics.tick import MetricContext


def reach_shortfall_and_reserve(ctx: MetricContext) -> Iterator[Float[Array, ""]]:
    """Yield how far (m) a foot target is out of reach at most, and how far a leg can still stretch or fold at least."""
    robot, leg = ctx.world.robot, ctx.report.joints
    stretch = jnp.linalg.norm(leg[:, -1] - leg[:, -3], axis=-1)
    left = jnp.minimum(robot.thigh + robot.shin - stretch, stretch - jnp.abs(robot.thigh - robot.shin))
    yield ctx.shortfall
    yield jnp.min(left) - ctx.shortfall


METRIC = make_extremes_metric(
    reach_shortfall_and_reserve,
    {
        "reach_shortfall_max_m": "largest distance of a foot target beyond its leg's reach",
        "reach_reserve_min_m": "smallest distance of a foot target to the limits of a leg's reach, less shortfall",
    },
    (
        Cause(
            "unreachable",
            "a foot target was out of the leg's reach by more than reach_shortfall_max_m",
            "reach_shortfall_max_m",
            5e-3,
        ),
    ),
)
