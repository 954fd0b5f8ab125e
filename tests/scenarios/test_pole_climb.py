"""Climbing a pole in simulation: nominal on both engines, and robots and poles near the nominal ones."""

from dataclasses import replace

import numpy as np
import pytest

from sweep.config import compose
from sweep.engines import make
from sweep.metrics.outcome import classify

pytestmark = pytest.mark.slow

SIZES = ("body_length", "body_width", "body_height", "thigh", "shin")
MASSES = ("body_mass", "thigh_mass", "shin_mass")
WIDTH, SPREAD = 16, 0.02


def outcomes(engine: str, width: int, scenario: str = "pole_climb", *changes: str) -> dict[str, np.ndarray]:
    """Figures and outcomes of `width` rollouts; more than one are up to `SPREAD` off in sizes, masses and friction."""
    trial = compose([f"scenario={scenario}", f"engine={engine}", *changes])
    case, random = trial.case, np.random.default_rng(0)

    def off(group, *names):
        return replace(group, **{k: getattr(group, k) * random.uniform(1 - SPREAD, 1 + SPREAD, width) for k in names})

    if width > 1:
        case = replace(case, robot=off(case.robot, *SIZES, *MASSES), obstacle=off(case.obstacle, "radius"),
                       contact=off(case.contact, "friction"))  # fmt: skip
    simulation = make(replace(trial.settings, width=width), trial.case, trial.case, trial.thresholds)
    figures = simulation.run(case, case, np.zeros(width, dtype=np.int64))
    return {**figures, **classify(figures, trial.thresholds, simulation.stages)}


def test_nominal_on_native():
    row = outcomes("native", 1)
    assert row["outcome"].tolist() == ["success"], row["cause"]
    assert row["position_error_max_m"].max() < 0.02


def test_robots_and_poles_near_the_nominal_ones_on_mjx():
    rows = outcomes("mjx", WIDTH)
    assert rows["outcome"].tolist() == ["success"] * WIDTH, rows["cause"]
    assert rows["slip_max_m"].max() < 0.012
    assert rows["position_error_max_m"].max() < 0.02
    assert rows["clearance_min_m"].min() > -0.005


@pytest.mark.parametrize("ratio", [0.35, 0.45, 0.5])
def test_the_plan_follows_the_poles_radius(ratio):
    row = outcomes("native", 1, "pole_climb", f"obstacle.radius={1.05 * ratio}")
    assert row["outcome"].tolist() == ["success"], row["cause"]


@pytest.mark.parametrize("scenario", ["pole_return", "pole_round", "pole_descent"])
def test_the_way_down_on_native(scenario):
    """On the side that it came from, on the other side, and from a ledge: attitude errors do not add up on the way."""
    row = outcomes("native", 1, scenario)
    assert row["outcome"].tolist() == ["success"], row["cause"]
    assert row["tilt_max_deg"].max() < 1
    assert row["slip_max_m"].max() < 0.015


def test_the_robot_gets_on_the_top_on_native():
    row = outcomes("native", 1, "pole_top")
    assert row["outcome"].tolist() == ["success"], row["cause"]
    assert row["clearance_min_m"].min() > 0
    assert row["tilt_max_deg"].max() < 5


@pytest.mark.parametrize("scenario", ["pole_ledge_level", "pole_ledge_above"])
def test_the_robot_gets_over_the_pole_on_to_the_ledge_on_native(scenario):
    row = outcomes("native", 1, scenario)
    assert row["outcome"].tolist() == ["success"], row["cause"]
    assert row["feet_on_target"].tolist() == [6]
    assert row["end_tilt_deg"].max() < 3
    assert row["clearance_min_m"].min() > 0
    assert row["distance_m"].min() > 3  # beyond the edge and 0.3 m on
