"""Up a leaning ladder and down in simulation, on both engines."""

import pytest
from test_pole_climb import outcomes

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("scenario", ["ladder_climb", "ladder_descend"])
@pytest.mark.parametrize("engine", ["mjx", "native"])
def test_nominal(engine, scenario):
    """The ladder, a free body, stays where it has come to rest."""
    row = outcomes(engine, 1, scenario)
    assert row["outcome"].tolist() == ["success"], row["cause"]
    assert row["feet_on_target"].tolist() == [6]
    assert row["obstacle_shift_m"].max() < 1e-3
    assert row["slip_max_m"].max() < 0.02
    assert row["imbalance_max"].max() < 0.01
    assert row["clearance_min_m"].min() > -0.005
    assert row["leg_gap_min_m"].min() > 0.03
