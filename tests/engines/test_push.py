"""A push gives the robot the impulse that is asked for, whatever its duration, on every engine."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from sweep.config.experiment import compose
from sweep.engines import make_engine
from sweep.metrics.outcome import classify

IMPULSE = 15.0  # N s
DURATIONS = np.array([0.0001, 0.001, 0.0021, 0.0051, 0.05])  # s, of which the last alone is whole steps of both engines
BEGIN = 0.1003  # s, within a step
SLIPPERY = 1e-3  # friction, so that the ground takes less than 1 % of the impulse


def horizontal_momentum(model, trace, sample: int) -> float:
    """Momentum (N s) along the world's x axis at a sample of a trace."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = trace.qpos[sample], trace.qvel[sample]
    mujoco.mj_forward(model, data)
    mujoco.mj_subtreeVel(model, data)
    return float(model.body_mass.sum() * data.subtree_linvel[0, 0])


def pushed(*overrides):
    """A rollout for each duration, on one engine, recorded at every control tick."""
    trial = compose(["scenario=stand_push", *overrides])
    execution = replace(
        trial.case.execution, push_impulse=IMPULSE, push_time=BEGIN, push_duration=DURATIONS, push_direction=0.0
    )
    world = replace(trial.case, execution=execution, contact=replace(trial.case.contact, friction=SLIPPERY))
    simulation = make_engine(replace(trial.settings, width=len(DURATIONS)), trial.case, trial.case, trial.thresholds)
    return simulation.traces(world, trial.case, np.zeros(len(DURATIONS), int), 1), trial.thresholds


def momentum_after(trace, duration: float) -> float:
    """Horizontal momentum (N s) one tick after the push."""
    return horizontal_momentum(trace.model, trace, int(np.searchsorted(trace.time, BEGIN + duration + 1e-9)) + 1)


@pytest.mark.parametrize(
    "overrides",
    [
        ["engine=mjx", "engine.iterations=4"],
        ["engine=native"],
        pytest.param(["engine=mjx", "engine.iterations=4", "engine.compiler=xla"], marks=pytest.mark.slow),
    ],
    ids=" ".join,
)
def test_momentum_after_a_push_is_its_impulse(overrides):
    traces, _ = pushed(*overrides)
    momenta = [momentum_after(trace, duration) for trace, duration in zip(traces, DURATIONS, strict=True)]
    assert momenta == pytest.approx([IMPULSE] * len(DURATIONS), rel=0.01)


def test_an_impulse_that_the_solver_loses_makes_the_rollout_invalid():
    """15 N s within one step of 2 ms are 48 times the weight: two iterations of the solver do not settle that."""
    traces, limits = pushed("engine=mjx", "engine.iterations=2")
    for trace, duration in zip(traces, DURATIONS, strict=True):
        row = {name: np.asarray([value]) for name, value in trace.metrics.items()}
        lost = momentum_after(trace, duration) != pytest.approx(IMPULSE, rel=0.01)
        assert lost == (classify(row, limits, trace.stages)["cause"][0] == "solver"), duration
