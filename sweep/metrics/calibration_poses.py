"""Metrics of the poses of a simulated calibration; see `sweep.engines.calibration_rollout`."""

from sweep.metrics.metric import Cause, Metric

METRIC = Metric(
    lambda start: (),
    lambda state, ctx: state,
    lambda state, rollout: {},
    {
        "calibration_margin": "least distance of a figure of a simulated calibration to what fails it, as `margin`",
        "calibration_slip_max_m": "largest slip of a foot in its poses",
        "calibration_clearance_min_m": "least distance of base and links to the obstacle in them",
        "calibration_torque_peak_nm": "largest torque of a joint in them",
        "calibration_s": "simulated time that they took",
    },
    (
        Cause(
            "uncalibrated",
            "the robot failed as it went through the poses of its calibration, by anything that fails a rollout",
            "calibration_margin",
            0.0,
            below=True,
            scale=1.0,
        ),
    ),
    applies=lambda case: case.control.calibrate == "simulated",
)
