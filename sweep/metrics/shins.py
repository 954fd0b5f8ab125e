"""At what angle the shins of standing feet rise over what they stand on."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.metrics.geometry import shin_slopes
from sweep.metrics.metric import Begin, Cause, Elapsed, Metric, Moment
from sweep.models.obstacles.surface import under


def begin(start: Begin) -> Float[Array, ""]:
    """No foot has been loaded yet; upright."""
    return jnp.ones((), start.feet.dtype)


def update(so_far: Float[Array, ""], now: Moment) -> Float[Array, ""]:
    """Sine of the least angle, of feet that bear load but in the first half of their swing."""
    tick = now.tick
    normal = under(now.world.obstacle, tick.joints[:, -1], tick.bodies).normal
    goes = now.plan.swing[now.stage] & ~now.finished & (now.phase <= 0.5)
    return jnp.minimum(so_far, jnp.min(jnp.where(tick.truth.loaded & ~goes, shin_slopes(tick.joints, normal), 1.0)))


def figures(found: Float[Array, ""], at: Elapsed) -> dict[str, Array]:
    """The least angle, of its sine."""
    return {"shin_angle_min_rad": jnp.arcsin(found)}


METRIC = Metric(
    begin,
    update,
    figures,
    {"shin_angle_min_rad": "least angle of a standing foot's shin over the face that it stands on, negative under it"},
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
