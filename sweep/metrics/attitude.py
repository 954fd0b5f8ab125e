"""Attitude errors of the base: tilt and yaw against the reference."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.core.metric import Cause, Metric
from sweep.core.shared_metrics import attitude
from sweep.core.shared_metrics.attitude import TiltState
from sweep.metrics.tick import MetricContext, RolloutEnd, RolloutStart, make_goal_cause


class AttitudeErrors(NamedTuple):
    """State of the attitude metrics: largest tilt and yaw errors so far (deg), and the base's last orientation.

    The order is that of the kernels' text: another one makes `ptxas` spill other numbers.
    """

    tilt: Float[Array, ""]
    heading: Float[Array, ""]
    quat: Float[Array, " 4"]


def begin(start: RolloutStart) -> AttitudeErrors:
    """Return the state of the attitude metrics before the first tick: no error yet."""
    tilt = attitude.METRIC.begin(start)
    return AttitudeErrors(tilt.largest_tilt, start.constant_state(0.0), tilt.quat)


def update(state: AttitudeErrors, ctx: MetricContext) -> AttitudeErrors:
    """Update the base's largest tilt from the commanded vertical, and its largest rotation about it (deg)."""
    w, _, _, z = ctx.attitude_error
    heading = jnp.degrees(jnp.abs(2 * jnp.arctan2(z * jnp.sign(w), jnp.abs(w))))
    tilt = attitude.METRIC.update(TiltState(state.tilt, state.quat), ctx)
    return AttitudeErrors(tilt.largest_tilt, jnp.maximum(state.heading, heading), tilt.quat)


def compute(state: AttitudeErrors, rollout: RolloutEnd) -> dict[str, Array]:
    """Return the largest attitude errors and the final tilt (deg), by column."""
    tilt = attitude.METRIC.compute(TiltState(state.tilt, state.quat), rollout)
    return {**tilt, "heading_error_max_deg": state.heading}


METRIC = Metric(
    begin,
    update,
    compute,
    {
        **attitude.METRIC.columns,
        "heading_error_max_deg": "largest turn of the base about its commanded vertical",
    },
    (
        Cause("fell", "the base tilted beyond tilt_max_deg", "tilt_max_deg", 20.0),
        Cause("off_course", "the heading was off by more than heading_error_max_deg", "heading_error_max_deg", 5.0),
        make_goal_cause("the base ended tilted by more than end_tilt_max_deg", "end_tilt_deg"),
    ),
)
