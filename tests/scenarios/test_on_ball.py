"""On a free ball in simulation: without control the robot falls, with it it stands; it drives and stops the ball."""

from dataclasses import replace

import numpy as np
import pytest

from sweep.config import compose
from sweep.engines import make
from sweep.metrics.outcome import classify

pytestmark = pytest.mark.slow


def outcomes(overrides: list[str], width: int = 1, **groups: dict) -> dict[str, np.ndarray]:
    """Figures and outcomes of `width` rollouts with some quantities of some groups changed."""
    trial = compose(overrides)
    case = replace(
        trial.case, **{name: replace(getattr(trial.case, name), **values) for name, values in groups.items()}
    )
    simulation = make(replace(trial.settings, width=width), trial.case, trial.case, trial.thresholds)
    figures = simulation.run(case, case, np.arange(width))
    return {**figures, **classify(figures, trial.thresholds, simulation.stages)}


def test_without_control_it_falls():
    rows = outcomes(["scenario=ball_balance", "engine=native", "manoeuvre.law=none"])
    assert rows["cause"].tolist() == ["unreachable"]
    assert rows["fell_time_s"][0] < 30


@pytest.mark.parametrize("engine", ["native", "mjx"])
def test_it_recovers_from_an_offset_and_from_speed(engine):
    """Brought to rest, but not back: robot and ball have gone the same way."""
    offset, speed = np.array([0.2, 0.0]), np.array([0.0, 0.1])
    overrides = ["scenario=ball_balance", f"engine={engine}", "manoeuvre.stages=12"]
    rows = outcomes(overrides, 2, manoeuvre={"offset": offset}, obstacle={"speed": speed})
    assert rows["outcome"].tolist() == ["success"] * 2, rows["cause"]
    assert rows["obstacle_speed_mps"].max() < 0.005
    assert rows["slip_max_m"].max() < 0.01


@pytest.mark.parametrize("engine", ["native", "mjx"])
def test_it_drives_and_stops_the_ball(engine):
    place = np.array([1e6, 1.5])
    rows = outcomes(["scenario=ball_drive", f"engine={engine}", "manoeuvre.steps=30"], 2, manoeuvre={"place": place})
    assert rows["outcome"].tolist() == ["success"] * 2, rows["cause"]
    assert rows["obstacle_speed_mps"][0] == pytest.approx(0.13, rel=0.05)
    assert rows["obstacle_x_m"][1] == pytest.approx(1.5, abs=0.1)
    assert rows["obstacle_aside_max_m"].max() < 0.02
