"""From ball to ball: what is where, what plans are refused, and how feet on the second ball close the gap: (3.5.2)."""

import jax.numpy as jnp
import numpy as np
import pytest

from sweep.controllers import tracker
from sweep.controllers.manoeuvres.balancing.ball_to_ball import OVER, Closing
from sweep.controllers.observation import Observation
from sweep.core.errors import InputError
from sweep.models.obstacles.surface import poses
from sweep.models.obstacles.two_balls import TwoBalls
from sweep.study.config import compose


def test_balls_and_feet_feel_floor_and_balls():
    """A foot what it is deepest in; the second ball's centre the floor, and a second time the first ball."""
    balls = TwoBalls(gap=0.01)
    radius, second = balls.radius, 2 * balls.radius + 0.01
    points = [(0, 0, 2 * radius - 1e-3), (second, 0, 2 * radius - 1e-3), (second / 2, 0, -1e-3)] + [(0, 0, 9.0)] * 3
    points += [(0, 0, radius)] + [(second, 0, radius)] * 2
    surface = balls.surface(jnp.array(points), (-1,) * 6 + (0, 1, 1), poses(balls.start()))
    told = np.asarray(surface.depth)[[0, 1, 2, 6, 7, 8]]
    assert told == pytest.approx([1e-3, 1e-3, 1e-3, 0.0, 0.0, -0.01], abs=1e-6)
    assert np.asarray(surface.body)[[0, 1, 2, 6, 7, 8]].tolist() == [0, 1, -1, -1, -1, 0]
    assert np.asarray(surface.normal)[8] == pytest.approx([1, 0, 0], abs=1e-6)
    assert len(set(np.asarray(surface.face)[:3].tolist())) == 3


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("robot.thigh=0.4", r"ball_to_ball: foot \d is .* m out of reach at the end of stage over"),
        ("manoeuvre.spare=0.3", "ball_to_ball: the mass centre is .* between the feet that stand in stage over"),
    ],
)
def test_plans_that_cannot_be_are_refused(change, words):
    exp = compose(["scenario=ball_to_ball", change])
    with pytest.raises(InputError, match=words):
        exp.case.manoeuvre.plan(exp.case)


def test_feet_on_the_second_ball_close_the_gap():
    """(3.5.2), its eta against our x, with the angle by which a ball rolls."""
    gap, press = 0.004, 7e-4
    case = compose(["scenario=ball_to_ball", f"obstacle.gap={gap}"]).case
    plan, free = case.manoeuvre.plan(case), case.on(TwoBalls).start()
    stage = plan.names.index(OVER + "ahead")
    state = tracker.init(case, plan)
    feet = plan.foothold[stage]
    state = state._replace(
        stage=jnp.int32(stage), clock=plan.duration[stage], feet=feet, memory=Closing(press, 1.0).memory(case, plan)
    )
    still = jnp.zeros(3)
    stance = plan.start
    joints = jnp.zeros((6, 3))
    seen = Observation(stance.position, stance.quat, still, still, joints, joints, joints, jnp.ones(6, bool), free)
    told = Closing(press, 1.0).guide(case, plan, state, seen, jnp.asarray(True), 0.004)
    radius, way = case.on(TwoBalls).radius, gap + press
    eta, zeta = -np.asarray(feet)[4:, 0], np.asarray(feet)[4:, 2]
    round_, angle = np.hypot(eta, zeta), np.arctan2(zeta, eta)
    wanted = np.stack([-(way + round_ * np.cos(angle - way / radius)), round_ * np.sin(angle - way / radius)], axis=-1)
    assert np.asarray(told.stance.feet)[4:, ::2] == pytest.approx(wanted, abs=1e-6)
    assert np.asarray(told.stance.feet)[:4] == pytest.approx(np.asarray(feet)[:4], abs=1e-7)
