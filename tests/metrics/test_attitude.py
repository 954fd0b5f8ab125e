"""Tilt and heading are those of the true base against the command that exact sensors give."""

from dataclasses import replace

import numpy as np
import pytest

from sweep.config.experiment import compose
from sweep.core.shared_metrics.attitude import tilt_deg
from sweep.engines import make_engine

OFFSETS = np.array([0.0, 0.36, -0.1])  # rad, of the measured orientation about the world's x axis
FELL = 20.0  # deg, default of outcome.tilt_max_deg
OFF_COURSE = 5.0  # deg, default of outcome.heading_error_max_deg


@pytest.mark.parametrize("engine", ["mjx", "native"])
def test_a_tilted_sensor_tilts_and_turns_no_robot(engine):
    trial = compose(["scenario=walk_tripod", "manoeuvre.steps=1", f"engine={engine}"])
    world = replace(trial.case, noise=replace(trial.case.noise, orientation_offset_x=OFFSETS))
    simulation = make_engine(
        replace(trial.settings, width=len(OFFSETS)),
        replace(trial.case, noise=replace(trial.case.noise, orientation_offset_x=OFFSETS[1])),
        trial.case,
        trial.thresholds,
    )
    for trace in simulation.traces(world, trial.case, np.zeros(len(OFFSETS), int), 1):
        true_tilt = tilt_deg(trace.qpos[:, 3:7].T, np)
        tilt, fell = float(trace.metrics["tilt_max_deg"]), float(trace.metrics["fell_time_s"])
        # the plan is level, and an error at a stage's start fades: the true command is never farther from the true pose
        assert tilt <= true_tilt.max() + 0.01
        if np.isfinite(fell):
            assert true_tilt[np.searchsorted(trace.time, fell - 1e-6)] > FELL
        w, z = trace.qpos[:, 3], trace.qpos[:, 6]
        true_turn = np.degrees(np.abs(2 * np.arctan2(z * np.sign(w), np.abs(w))))  # the commanded heading is 0
        assert true_turn.max() - 0.5 < trace.metrics["heading_error_max_deg"] <= true_turn.max() + 0.01
        if np.isfinite(off_course := float(trace.metrics["off_course_time_s"])):
            assert true_turn[np.searchsorted(trace.time, off_course - 1e-6)] == pytest.approx(OFF_COURSE, abs=0.2)
