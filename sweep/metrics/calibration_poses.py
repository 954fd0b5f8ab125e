"""Metrics of the poses in a simulated calibration."""

from sweep.core.metric import Cause, Metric

METRIC = Metric(
    lambda start: (),
    lambda state, ctx: state,
    lambda state, rollout: {},
    {
        "calibration_margin": "smallest margin of a simulated calibration, as for `margin`",
        "calibration_slip_max_m": "largest slip of a foot in the calibration poses",
        "calibration_clearance_min_m": "smallest distance of base and links to the obstacle in the calibration poses",
        "calibration_torque_peak_nm": "largest torque of a joint in the calibration poses",
        "calibration_s": "simulated duration of the calibration poses",
    },
    (
        Cause(
            "uncalibrated",
            "the robot failed in the calibration poses, by any cause of failure",
            "calibration_margin",
            0.0,
            below=True,
            scale=1.0,
        ),
    ),
    applies=lambda case: case.control.calibrate == "simulated",
)
