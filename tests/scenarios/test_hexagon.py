"""The hexagonal robot's walk in simulation: nominal on both engines, and robots near the nominal one."""

from dataclasses import replace

import numpy as np
import pytest

from sweep.config.experiment import compose
from sweep.engines import make_engine
from sweep.metrics.outcome import classify

pytestmark = pytest.mark.slow

SIZES = ("mount_radius", "coxa", "thigh", "shin")
MASSES = ("body_mass", "coxa_mass", "thigh_mass", "shin_mass")


def outcomes(engine: str, width: int, spread: float) -> dict[str, np.ndarray]:
    """Figures and outcomes of `width` robots whose lengths and masses are up to `spread` off, friction 0.7 to 1.2."""
    trial = compose(["scenario=hexagon_waypoints", f"engine={engine}"])
    random = np.random.default_rng(1)
    case = trial.case
    if width > 1:
        off = {k: getattr(case.robot, k) * random.uniform(1 - spread, 1 + spread, width) for k in SIZES + MASSES}
        friction = np.linspace(0.7, 1.2, width)
        case = replace(case, robot=replace(case.robot, **off), contact=replace(case.contact, friction=friction))
    simulation = make_engine(replace(trial.settings, width=width), trial.case, trial.case)
    figures = simulation.run(case, case, np.zeros(width, dtype=np.int64))
    return {**figures, **classify(figures, trial.thresholds, simulation.stages)}


def test_nominal_on_native():
    row = outcomes("native", 1, 0.0)
    assert row["outcome"].tolist() == ["success"], row["cause"]
    assert row["slip_max_m"] < 0.005
    assert row["position_error_max_m"] < 0.03


def test_robots_near_the_nominal_one_on_mjx():
    rows = outcomes("mjx", 8, 0.02)
    assert rows["outcome"].tolist() == ["success"] * 8, rows["cause"]
    assert rows["slip_max_m"].max() < 0.005
    assert rows["position_error_max_m"].max() < 0.03
    assert rows["tilt_max_deg"].max() < 0.1
