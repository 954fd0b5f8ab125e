"""Along and across the beam: balanced by the middle legs, also from a bad start; without them the robot falls."""

from dataclasses import replace

import numpy as np
import pytest

from sweep.config.experiment import compose
from sweep.engines import make_engine
from sweep.metrics.outcome import classify


def rollouts(*overrides: str, **execution: list[float]):
    """Figures and labels of rollouts that differ in their execution."""
    exp = compose(list(overrides))
    width = len(next(iter(execution.values()), [0]))
    world = replace(exp.case, execution=replace(exp.case.execution, **{k: np.array(v) for k, v in execution.items()}))
    engine = make_engine(replace(exp.settings, width=width), exp.case, exp.case, exp.thresholds)
    figures = engine.run(world, exp.case, np.zeros(width, int))
    return figures, classify(figures, exp.thresholds, engine.stages)


def test_the_flywheel_balances_a_walk_that_starts_aside():
    """Two swings from starts up to 5 mm and 0.3 deg off: after the first the robot is where it should be.

    At the end it rests: its middle legs, which come level by a law of 1.6 s, are held.
    """
    figures, labels = rollouts("scenario=beam_walk", "engine=native", "manoeuvre.steps=2",
                               start_x=[0.0, 0.005, -0.005], start_yaw=[0.0, 0.005, 0.005])  # fmt: skip
    assert list(labels["outcome"]) == ["success"] * 3
    assert figures["tilt_max_deg"][0] < 0.2
    assert np.all(figures["tilt_max_deg"] < 2.0)
    assert np.all(figures["end_drift_m"] < 3e-4)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["mjx", "native"])
def test_crossing_from_ledge_to_ledge(engine):
    figures, labels = rollouts("scenario=beam_cross", f"engine={engine}", start_x=[0.0, 0.01], start_yaw=[0.0, 0.0175])
    assert list(labels["outcome"]) == ["success"] * 2
    assert np.all(figures["tilt_max_deg"] < 2.0)


@pytest.mark.slow
def test_without_the_flywheel_slow_swings_end_in_a_fall():
    """At varpi = 3 the robot is on two feet for 1.2 s, five times the time in which a deviation grows e-fold."""
    _, labels = rollouts("scenario=beam_walk", "engine=native", "manoeuvre.rate=3", "manoeuvre.flywheel=off",
                         start_x=[0.0, 0.005])  # fmt: skip
    assert list(labels["outcome"]) == ["failure"] * 2
