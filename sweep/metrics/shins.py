"""Angle between the shins of standing feet and the surface under them."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.core.metric import Cause, Metric, make_begin_with_constants
from sweep.metrics.tick import MetricContext
from sweep.models.geometry import shin_slope_sines
from sweep.models.obstacles.surface import surface_at


def update(state: Float[Array, ""], ctx: MetricContext) -> Float[Array, ""]:
    """Update the least sine of the angle between shin and surface, over feet that carry load."""
    tick = ctx.report
    normal = surface_at(ctx.world.obstacle, tick.joints[:, -1], tick.bodies).normal
    goes = ctx.plan.swing[ctx.stage] & ~ctx.finished & (ctx.phase <= 0.5)
    return jnp.minimum(
        state, jnp.min(jnp.where(tick.actual.loaded & ~goes, shin_slope_sines(tick.joints, normal), 1.0))
    )


METRIC = Metric(
    make_begin_with_constants(jnp.asarray, 1.0),  # upright
    update,
    lambda sine, rollout: {"shin_angle_min_rad": jnp.arcsin(sine)},
    {"shin_angle_min_rad": "smallest angle of a standing leg's shin above the face it stands on, negative below it"},
    (
        Cause(
            "shin_under_face",
            "a shin went under the face that its foot stands on: its angle over it fell below shin_angle_min",
            "shin_angle_min_rad",
            0.0,
            key="shin_angle_min",
            below=True,
            scale=0.1,
        ),
    ),
    interval=0.02,
)
