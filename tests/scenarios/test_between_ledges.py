"""From ledge to ledge with a ball: the checks of monograph 3.2, and where the ball is in what."""

import jax.numpy as jnp
import numpy as np
import pytest
from test_on_ball import outcomes

from sweep.config.experiment import compose
from sweep.core.errors import InputError
from sweep.models.obstacles.ledges import Ledges
from sweep.models.obstacles.surface import body_poses


def test_ball_and_feet_feel_floor_ball_and_ledges():
    """A foot the nearest face of what it is deepest in; the ball's centre the floor, and a second time a wall."""
    ledges = Ledges(gap=0.01)
    centre, tops = ledges.radius + 0.01, ledges.height - 1e-3
    points = [(-0.5, 0, tops), (-1e-3, 0, 1.0), (4.0, 0, tops), (3.602, 0, 1.0), (centre, 0, 1.599), (2.5, 0, -1e-3)]
    points += [(centre, 0.0, ledges.radius)] * 2
    surface = ledges.surface(jnp.array(points), (-1,) * 6 + (0, 0), body_poses(ledges.start()))
    assert np.asarray(surface.depth) == pytest.approx([1e-3, 1e-3, 1e-3, 2e-3, 1e-3, 1e-3, 0.0, -0.01], abs=1e-6)
    wanted = [(0, 0, 1), (1, 0, 0), (0, 0, 1), (-1, 0, 0), (0, 0, 1), (0, 0, 1), (0, 0, 1), (1, 0, 0)]
    assert np.asarray(surface.normal) == pytest.approx(np.array(wanted), abs=1e-6)
    assert np.asarray(surface.body).tolist() == [-1, -1, -1, -1, 0, -1, -1, -1]
    assert len(set(np.asarray(surface.face)[[0, 1, 2, 3, 4, 5]].tolist())) == 6
    assert surface.damping is not None
    assert np.asarray(surface.damping)[:7].max() == 0 < surface.damping[7]


def test_a_ledge_out_of_reach_is_refused():
    exp = compose(["scenario=ball_ledges", "robot.thigh=0.3", "robot.shin=0.2"])
    with pytest.raises(InputError, match=r"foot \d is .* m out of reach at the start of manoeuvre = ball_ledges"):
        exp.case.manoeuvre.plan(exp.case)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["mjx", "native"])
def test_it_goes_from_ledge_to_ledge(engine):
    """The mass centre stays between edge and ball's centre; the ball comes to within 4 mm at less than 0.04 m/s."""
    rows = outcomes(["scenario=ball_ledges", f"engine={engine}"])
    assert rows["outcome"].tolist() == ["success"], rows["cause"]
    assert rows["docking_gap_m"][0] < 4e-3
    assert rows["docking_speed_mps"][0] < 0.04
    assert rows["past_centre_max_m"][0] < 0.01
    assert rows["leg_gap_min_m"][0] > 0.02
    assert rows["clearance_min_m"][0] > 0
    assert rows["slip_max_m"][0] < 0.03


@pytest.mark.slow
def test_a_ball_that_stays_short_of_the_far_wall_misses_the_goal():
    """500 kg do not come there within the steps there are; the robot gets over all the same, which does not count."""
    rows = outcomes(["scenario=ball_ledges", "obstacle.mass=500", "engine.iterations=8"])
    assert rows["cause"].tolist() == ["goal_missed"]
    assert 0.01 < rows["docking_gap_m"][0] < 0.1
    assert rows["docking_speed_mps"][0] == 0
