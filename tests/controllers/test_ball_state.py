"""What a robot on a ball knows of itself: frames, footholds, mass centre, angular momentum."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from sweep.config.experiment import compose
from sweep.controllers.ball_state import (
    angular_momentum,
    ball_footholds,
    centre_of_mass,
    mass_centre_jacobian,
    rotate_footholds_backward,
    swing_foot_arc,
)
from sweep.controllers.frames import points_to_frame, points_to_world, stance_to_frame, stance_to_world
from sweep.controllers.observation import Observation
from sweep.core.rotations import exponential, multiply, rotate
from sweep.engines.closed_loop import free_body_state, start_state
from sweep.formulas.mass_centre import ball_jacobian
from sweep.manoeuvres.balancing.ball import stance_on_ball, stand_pose
from sweep.manoeuvres.balancing.ball_turn import BallTurn
from sweep.models import scene
from sweep.models.frames import WORLD_FRAME, body_frame_number, koenig_frame_number
from sweep.models.obstacles.surface import FreeBodyState
from sweep.models.posture import Stance

CASE = compose(["scenario=ball_balance"]).case
AHEAD = jnp.array([1.0, 0.0])


@pytest.fixture(scope="module")
def perched():
    return stand_pose(CASE, CASE.manoeuvre)


def test_frames_go_with_their_bodies():
    turn = exponential(jnp.array([[0.3, -0.2, 0.5], [0.1, 0.4, -0.3]]))
    still = jnp.zeros((2, 3))
    free = FreeBodyState(jnp.array([[1.0, 2.0, 0.8], [-3.0, 0.0, 0.5]]), turn, still, still)
    point, frames = (
        jnp.array([0.1, -0.2, 0.7]),
        jnp.array(
            [WORLD_FRAME, koenig_frame_number(0), body_frame_number(0), koenig_frame_number(1), body_frame_number(1)]
        ),
    )
    seen = points_to_world(jnp.stack([point] * 5), frames, free)
    np.testing.assert_allclose(seen[0], point, atol=1e-6)
    for k in range(2):
        np.testing.assert_allclose(seen[1 + 2 * k], point + free.position[k], atol=1e-6)
        np.testing.assert_allclose(seen[2 + 2 * k], rotate(turn[k], point) + free.position[k], atol=1e-6)
    np.testing.assert_allclose(points_to_frame(seen, frames, free), jnp.stack([point] * 5), atol=1e-6)
    quat = exponential(jnp.array([0.2, 0.1, 0.0]))
    for frame, wanted in ((koenig_frame_number(1), quat), (body_frame_number(1), multiply(turn[1], quat))):
        frames = jnp.full(6, WORLD_FRAME), jnp.asarray(frame)
        there = stance_to_world(Stance(jnp.zeros((6, 3)), point, quat), *frames, free)
        np.testing.assert_allclose(there.quat, wanted, atol=1e-6)
        np.testing.assert_allclose(stance_to_frame(there, *frames, free).quat, quat, atol=1e-6)


def test_mass_centre_is_over_the_ball(perched):
    off = centre_of_mass(CASE.robot, stance_on_ball(CASE, perched))
    np.testing.assert_allclose(off[:2], 0, atol=1e-5)


def test_mass_centre_follows_the_body_as_the_formula_says(perched):
    """D of (3.1.1), from the robot's own links, equals the closed form for feet on the surface."""
    robot, ball, plan = CASE.robot, CASE.obstacle, CASE.manoeuvre
    circle = plan.circle_ratio * ball.radius
    expected = ball_jacobian(
        ball.radius, circle, plan.chord_ratio * circle, perched.position[2], robot.body_length, robot.body_width,
        robot.thigh, robot.shin, robot.body_mass, robot.thigh_mass, robot.shin_mass,
    ).D  # fmt: skip
    got = mass_centre_jacobian(robot, stance_on_ball(CASE, perched))
    np.testing.assert_allclose(got, expected[:2, :2], atol=3e-3)
    assert 0.6 < float(got[0, 0]) < 0.75


def test_turned_footholds_roll_into_their_mirror_image():
    """On the ball, and as far behind the vertical at touchdown as ahead of it after a stance."""
    radius, turn, level = 0.84, 0.1, ball_footholds(0.84, 0.5, 0.35)
    landed = rotate_footholds_backward(level, turn, AHEAD)
    np.testing.assert_allclose(jnp.linalg.norm(landed, axis=-1), radius, atol=1e-6)
    lifted = rotate(exponential(jnp.array([[0.0, 2 * turn, 0.0]])), landed)  # as a ball that goes along x turns
    np.testing.assert_allclose(lifted, rotate_footholds_backward(level, -turn, AHEAD), atol=1e-6)
    assert float(jnp.mean(landed[:, 0])) < 0


def test_swinging_feet_stay_above_the_ball():
    start, goal = (rotate_footholds_backward(ball_footholds(0.84, 0.5, 0.35), turn, AHEAD) for turn in (0.1, -0.1))
    way = [swing_foot_arc(start, goal, u, u, 0.0) for u in jnp.linspace(0, 1, 11)]
    np.testing.assert_allclose(jnp.linalg.norm(jnp.stack(way), axis=-1), 0.84, atol=1e-6)
    np.testing.assert_allclose(way[-1], goal, atol=1e-6)


def test_angular_momentum_is_that_of_the_simulation():
    """Within 1 % of C MuJoCo's about the ball's lowest point, robot and ball rolling along at 0.2 m/s."""
    world = replace(CASE, obstacle=replace(CASE.obstacle, speed=0.2, course=1.0))
    start = jax.jit(lambda: start_state(world, CASE, CASE.manoeuvre.plan(CASE)))()
    model = scene.compile_model(world, geoms=False)
    data = mujoco.MjData(model)
    data.qpos, data.qvel = np.asarray(start.qpos, float), np.asarray(start.qvel, float)
    mujoco.mj_forward(model, data)
    mujoco.mj_subtreeVel(model, data)
    expected = np.zeros(3)  # about the world's origin, on which the ball lies
    for name in ("base", "ball"):
        body = model.body(name).id
        moment = np.cross(data.subtree_com[body], data.subtree_linvel[body])
        expected += data.subtree_angmom[body] + model.body_subtreemass[body] * moment
    free = free_body_state(start.qpos, start.qvel, 1)
    seen = Observation(start.qpos[:3], start.qpos[3:7], start.qvel[:3], jnp.zeros(3), start.qpos[7:25].reshape(6, 3),
                       jnp.zeros((6, 3)), jnp.zeros((6, 3)), jnp.ones(6, bool), free)  # fmt: skip
    got = np.asarray(jax.jit(lambda: angular_momentum(CASE.robot, CASE.obstacle, seen))())
    assert np.linalg.norm(got - expected) < 0.01 * np.linalg.norm(expected)


@pytest.mark.parametrize("radius", [4.0, -4.0])
def test_the_way_of_a_ball_goes_straight_on_and_round(radius):
    """To the left, to the right where the radius is negative."""
    turn, size = BallTurn(straight=1.5, radius=radius), abs(radius)
    straight, on = turn.path_point_at(jnp.array([1.0, 0.02, 0.84])), []
    for angle, out in ((0.5, 0.0), (2.0, 0.01)):
        ahead, aside = (size + out) * np.sin(angle), size - (size + out) * np.cos(angle)
        on.append(turn.path_point_at(jnp.array([1.5 + ahead, np.sign(radius) * aside, 0.84])))
    np.testing.assert_allclose(
        [straight.progress, straight.left_offset, straight.curvature], [1.0, 0.02, 0.0], atol=1e-6
    )
    np.testing.assert_allclose([track.progress for track in on], 1.5 + size * np.array([0.5, 2.0]), atol=1e-5)
    np.testing.assert_allclose([track.left_offset for track in on], [0.0, -np.sign(radius) * 0.01], atol=1e-5)
    np.testing.assert_allclose(on[0].along, [np.cos(0.5), np.sign(radius) * np.sin(0.5)], atol=1e-6)
    np.testing.assert_allclose(on[0].curvature, 1 / radius, rtol=1e-6)
