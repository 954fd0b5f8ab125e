"""Calibration in physics: the poses are gone through and judged, and the row goes on from what was learned."""

import dataclasses

import numpy as np
import pytest

from sweep.config.experiment import compose
from sweep.engines import make_engine
from sweep.estimation.calibration import learnable_sizes
from sweep.metrics.outcome import classify

STAND = ["scenario=walk_tripod", "manoeuvre=stand", "manoeuvre.duration=0.3", "control=calibrate_simulated"]


def simulated(*overrides: str):
    """Figures, labels, trace and true sizes of two robots that are 2 % larger and smaller than they believe."""
    exp = compose([*STAND, *overrides])
    off = {name: getattr(exp.case.robot, name) * np.array([0.98, 1.02]) for name in learnable_sizes(exp.case.robot)}
    world = dataclasses.replace(exp.case, robot=dataclasses.replace(exp.case.robot, **off))
    engine = make_engine(dataclasses.replace(exp.settings, width=2), exp.case, exp.case, exp.thresholds)
    traces = engine.traces(world, exp.case, np.arange(2), 1)
    figures = {name: np.array([trace.metrics[name] for trace in traces]) for name in traces[0].metrics}
    return figures, classify(figures, exp.thresholds, engine.stages), traces[0], off


@pytest.mark.parametrize("engine", [pytest.param("mjx", marks=pytest.mark.slow), "native"])
def test_sizes_are_found_by_going_through_the_poses(engine):
    figures, labels, trace, true = simulated(f"engine={engine}")
    assert list(labels["outcome"]) == ["success", "success"]
    for name, sizes in true.items():
        np.testing.assert_allclose(figures[f"learned_{name}_m"], sizes, rtol=1e-3)
    # the body really goes 0.1 m there and back in all three directions, then stands where the manoeuvre has it
    poses = trace.stage < trace.stages.index("stand")
    assert np.all(np.ptp(trace.qpos[poses, :3], axis=0) > 0.18)
    assert np.all(np.diff(trace.time) > 0)
    assert np.all(figures["duration_s"] > figures["calibration_s"] + 0.3)
    assert trace.stages[figures["end_stage"][0]] == "stand"


@pytest.mark.slow
def test_who_fails_in_the_poses_fails():
    """Drives too weak for them: the robot sinks, and that is the row's cause, in the stage and at the time of it."""
    figures, labels, _, _ = simulated("engine=native", "control.stiffness=100", "control.damping=20")
    assert list(labels["outcome"]) == ["failure", "failure"]
    assert list(labels["cause"]) == ["uncalibrated", "uncalibrated"]
    assert all(stage.startswith("calibrate.") for stage in labels["stage"])
    assert np.all(labels["t_cause_s"] < figures["calibration_s"])
