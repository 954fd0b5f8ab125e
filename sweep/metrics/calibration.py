"""Estimates of the robot's sizes from calibration, and their uncertainty."""

import jax.numpy as jnp
from jaxtyping import Array

from sweep.core.metric import Metric
from sweep.estimation.calibration import CalibrationResult, learnable_sizes
from sweep.metrics.tick import RolloutStart

SIZE_COLUMNS = {
    "body_length": "length of the body",
    "body_width": "width of the body",
    "mount_radius": "radius at which the legs are mounted",
    "coxa": "length of the coxae",
    "thigh": "length of the thighs",
    "shin": "length of the shins",
}


def begin(start: RolloutStart) -> CalibrationResult:
    """Return the metric's state: the robot sizes that calibration estimated, constant during the rollout."""
    assert start.learned.calibration is not None  # since it applies
    return start.learned.calibration


def learned_size_columns(state: CalibrationResult) -> dict[str, Array]:
    """Return the robot sizes that calibration estimated, and their standard deviations (m), by column."""
    sizes = learnable_sizes(state.robot)
    own = {f"learned_{name}_m": jnp.asarray(getattr(state.robot, name)) for name in sizes}
    deviations = {name: jnp.sqrt(state.covariance[k, k]) for k, name in enumerate(sizes)}
    return own | {f"learned_{name}_sd_m": own[f"learned_{name}_m"] * deviations[name] for name in sizes}


METRIC = Metric(
    begin,
    lambda state, ctx: state,
    lambda state, rollout: learned_size_columns(state),
    {f"learned_{name}_m": f"{what}, estimated by calibration" for name, what in SIZE_COLUMNS.items()}
    | {f"learned_{name}_sd_m": f"standard deviation of the estimate of {what}" for name, what in SIZE_COLUMNS.items()},
    applies=lambda case: case.control.calibrate == "sizes",
)
