"""Attitude errors of the base: tilt and yaw against the reference."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.core.rotations import conjugate, multiply
from sweep.metrics.metric import Cause, Metric, MetricTick, Rollout, goal_cause, initial_state


class Attitude(NamedTuple):
    """Largest attitude errors so far (deg), and the base's last orientation."""

    tilt: Float[Array, ""]
    heading: Float[Array, ""]
    quat: Float[Array, " 4"]


def update(state: Attitude, ctx: MetricTick) -> Attitude:
    """Update the largest tilt from the commanded vertical, and the largest turn about it."""
    off = multiply(conjugate(ctx.reference.quat), ctx.tick.truth.quat)
    w, _, _, z = off
    heading = jnp.degrees(jnp.abs(2 * jnp.arctan2(z * jnp.sign(w), jnp.abs(w))))
    tilt = jnp.maximum(state.tilt, tilt_deg(off))
    return Attitude(tilt, jnp.maximum(state.heading, heading), ctx.tick.truth.quat)


def tilt_deg(quat: Float[Array, " 4"]) -> Float[Array, ""]:
    """Angle by which a rotation tilts the vertical (deg)."""
    w, x, y, z = quat
    return jnp.degrees(jnp.arctan2(jnp.sqrt(x**2 + y**2 + 1e-14), jnp.sqrt(w**2 + z**2 + 1e-14)) * 2)


def compute(state: Attitude, rollout: Rollout) -> dict[str, Array]:
    """Largest attitude errors, and the final tilt."""
    return {
        "tilt_max_deg": state.tilt,
        "end_tilt_deg": tilt_deg(state.quat),
        "heading_error_max_deg": state.heading,
    }


METRIC = Metric(
    initial_state(Attitude, 0.0, 0.0, np.zeros(4)),
    update,
    compute,
    {
        "tilt_max_deg": "largest tilt of the base from its commanded vertical",
        "end_tilt_deg": "tilt of the base from the vertical at the end",
        "heading_error_max_deg": "largest turn of the base about its commanded vertical",
    },
    (
        Cause("fell", "the base tilted beyond tilt_max_deg", "tilt_max_deg", 20.0),
        Cause("off_course", "the heading was off by more than heading_error_max_deg", "heading_error_max_deg", 5.0),
        goal_cause("the base ended tilted by more than end_tilt_max_deg", "end_tilt_deg"),
    ),
)
