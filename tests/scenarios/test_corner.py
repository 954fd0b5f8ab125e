"""The climb up the corner of a house, at the book's friction and torque limit."""

import numpy as np
import pytest

from sweep.config.experiment import compose
from sweep.runs.runner import run_single_batch


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["mjx", "native"])
def test_the_corner_is_climbed_as_planned(engine):
    """At friction 1.1 and 380 N m no foot slips, and the base is where the plan has it; the cone is all but used up."""
    row = run_single_batch(compose(["scenario=corner_climb", f"engine={engine}", "manoeuvre.cycles=1"])).iloc[0]
    assert row["outcome"] == "success"
    assert row["slip_max_m"] < 0.01
    assert row["position_error_max_m"] < 0.005
    assert row["friction_demand_max"] > 1.0  # no easy corner
    assert np.isfinite(row["energy_j"])


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["mjx", "native"])
@pytest.mark.parametrize("scenario", ["corner_full", "corner_descend"])
def test_the_roof_is_reached_and_walked_on_and_left_again(scenario, engine):
    """From the floor up a house of 2.3 m and over its edge, with links clear of the edge, at the book's friction."""
    row = run_single_batch(compose([f"scenario={scenario}", f"engine={engine}"])).iloc[0]
    assert row["outcome"] == "success"
    assert row["slip_max_m"] < 0.01
    assert row["position_error_max_m"] < 0.005
    assert row["leg_gap_min_m"] > 0
