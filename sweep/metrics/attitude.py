"""How far the base turns away from where it should point."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.core.rotations import conjugate, multiply
from sweep.metrics.metric import Cause, Elapsed, Metric, Moment, missed, still


class Attitude(NamedTuple):
    """Largest errors so far (deg), and the base as it is."""

    tilt: Float[Array, ""]
    heading: Float[Array, ""]
    quat: Float[Array, " 4"]


def update(so_far: Attitude, now: Moment) -> Attitude:
    """Tilt of the base from its commanded vertical, and the turn about it."""
    off = multiply(conjugate(now.reference.quat), now.tick.truth.quat)
    w, _, _, z = off
    heading = jnp.degrees(jnp.abs(2 * jnp.arctan2(z * jnp.sign(w), jnp.abs(w))))
    tilt = jnp.maximum(so_far.tilt, from_level(off))
    return Attitude(tilt, jnp.maximum(so_far.heading, heading), now.tick.truth.quat)


def from_level(quat: Float[Array, " 4"]) -> Float[Array, ""]:
    """Angle between the vertical and what `quat` makes of it (deg)."""
    w, x, y, z = quat
    return jnp.degrees(jnp.arctan2(jnp.sqrt(x**2 + y**2 + 1e-14), jnp.sqrt(w**2 + z**2 + 1e-14)) * 2)


def figures(found: Attitude, at: Elapsed) -> dict[str, Array]:
    """Errors so far, and the tilt as it is."""
    return {
        "tilt_max_deg": found.tilt,
        "end_tilt_deg": from_level(found.quat),
        "heading_error_max_deg": found.heading,
    }


METRIC = Metric(
    still(Attitude, 0.0, 0.0, np.zeros(4)),
    update,
    figures,
    {
        "tilt_max_deg": "largest tilt of the base from its commanded vertical",
        "end_tilt_deg": "tilt of the base from the vertical at the end",
        "heading_error_max_deg": "largest turn of the base about its commanded vertical",
    },
    (
        Cause("fell", "the base tilted beyond tilt_max_deg", "tilt_max_deg", 20.0),
        Cause("off_course", "the heading was off by more than heading_error_max_deg", "heading_error_max_deg", 5.0),
        missed("the base ended tilted by more than end_tilt_max_deg", "end_tilt_deg"),
    ),
)
