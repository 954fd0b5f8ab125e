"""The crossing's plan as the controller follows it: in reach, without jumps, even where legs become straight."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sweep.config.experiment import compose
from sweep.controllers import flywheel, tracker
from sweep.controllers.flywheel import MiddleLegFlywheel
from sweep.controllers.observation import Observation
from sweep.controllers.plan import BALANCE, LEVELLING, LOCKED
from sweep.core.rotations import rotate
from sweep.models.obstacles.surface import empty_free_body_state
from sweep.models.posture import foot_positions, joint_targets, mass_centre

PERIOD = 4e-3
CASE = compose(["scenario=beam_cross"]).case
PLAN = jax.jit(lambda: CASE.manoeuvre.plan(CASE))()
MIDDLE = [2, 3]


@pytest.fixture(scope="module")
def plan():
    return PLAN


@pytest.fixture(scope="module")
def followed(plan):
    """Every tick of a robot that does exactly as it is told, its middle legs level while they are a flywheel."""

    ticks = int(float(plan.duration.sum()) / PERIOD)

    @jax.jit
    def run(plan):
        def tick(carry, _):
            state, stance, joints = carry
            zero, nothing = jnp.zeros(3), jnp.zeros((6, 3))
            seen = Observation(
                stance.position,
                stance.quat,
                zero,
                zero,
                joints,
                nothing,
                nothing,
                jnp.ones(6, bool),
                empty_free_body_state(),
            )
            state, command = tracker.step(CASE, plan, state, seen, PERIOD)
            return (state, command.target, command.joints), (state.stage, command)

        first = (tracker.init(CASE, plan), plan.start, joint_targets(CASE.robot, plan.start)[0])
        return jax.lax.scan(tick, first, None, length=ticks)[1]

    stage, command = run(plan)
    return np.asarray(stage), jax.tree.map(np.asarray, command)


def test_joints_move_steadily(followed):
    """Also where feet pass below their hips, where alpha is not defined, and where the middle legs become straight."""
    stage, command = followed
    assert stage[-1] == len(PLAN.names) - 1
    rates = np.abs(np.diff(command.joints, axis=0)) / PERIOD
    assert rates.max() < 8.0  # rad/s; the fastest is beta of a regular swing, 5.6 at varpi = 6
    assert command.shortfall.max() == 0


def test_held_legs_reach_their_footholds(plan, followed):
    """A leg that comes down in joint space stands where the plan says."""
    stage, command = followed
    down = plan.names.index("wide.2-3-6.down")
    at = np.flatnonzero(stage == down)[-1]
    swinging = np.asarray(plan.swing[down])
    np.testing.assert_allclose(command.target.feet[at][swinging], plan.foothold[down][swinging], atol=2e-3)


def test_diagonal_steps_balance_over_the_standing_feet(plan):
    """While a pair swings, the line of the other two passes below the base's centre."""
    balancing = np.flatnonzero(np.asarray(plan.find_layer(MiddleLegFlywheel).mode) == BALANCE)
    assert len(balancing) == CASE.manoeuvre.steps + 1
    for stage in balancing:
        a, b = np.asarray(plan.foothold[stage])[~np.asarray(plan.swing[stage]) & ~np.isin(np.arange(6), MIDDLE), :2]
        np.testing.assert_allclose((a + b) / 2, np.asarray(plan.position[stage])[:2], atol=1e-5)
        assert abs(a[0] - b[0]) == pytest.approx(0.225, abs=1e-6)  # xi_b


def order(mode: int, **seen):
    """What the flywheel is told in a stage of `mode`, by a level robot at rest but for what is `seen`."""
    plan = PLAN
    stage = int(np.flatnonzero(np.asarray(plan.find_layer(MiddleLegFlywheel).mode) == mode)[0])
    joints = jnp.zeros((6, 3)).at[:, 1].set(jnp.pi / 2).at[3, 2].set(jnp.pi)
    level = plan.position[stage] - rotate(plan.quat[stage], mass_centre(CASE.robot, joints)) * jnp.array([1.0, 0, 0])
    zero, nothing = jnp.zeros(3), jnp.zeros((6, 3))
    truth = Observation(
        level, plan.quat[stage], zero, zero, joints, nothing, nothing, jnp.ones(6, bool), empty_free_body_state()
    )
    truth = truth._replace(**seen)
    return jax.jit(plan.find_layer(MiddleLegFlywheel).servo_command, static_argnums=0)(
        CASE.robot, plan, jnp.int32(stage), truth
    ), truth


def test_balancing_torque():
    """M_3 = -(c_1 xi_c + c_2 xi_c')/2 - M_g: to the left of the beam's middle line is +x."""
    (turning, servo), truth = order(BALANCE)
    weight = float(flywheel.leg_weight_moment(CASE.robot))
    assert weight == pytest.approx(4.65, abs=0.01)  # N m, (m1 + m2) g l_c
    assert np.argwhere(turning).tolist() == [[2, 1], [3, 1]]
    assert float(servo.torque[2, 1]) == pytest.approx(-weight, abs=1e-3)
    (_, aside), _ = order(BALANCE, position=truth.position + jnp.array([0.004, 0.0, 0.0]))
    assert float(aside.torque[2, 1] - servo.torque[2, 1]) == pytest.approx(-5000 * 0.004 / 2, abs=1e-2)
    (_, moving), _ = order(BALANCE, velocity=jnp.array([0.03, 0.0, 0.0]))
    assert float(moving.torque[2, 1] - servo.torque[2, 1]) == pytest.approx(-400 * 0.03 / 2, abs=1e-2)


def test_levelling_damps_and_returns():
    joints = order(LEVELLING)[1].angles
    (_, rest), _ = order(LEVELLING)
    (_, turned), _ = order(LEVELLING, angles=joints.at[2, 1].add(0.2), rates=jnp.zeros((6, 3)).at[2, 1].set(1.0))
    weight = float(flywheel.leg_weight_moment(CASE.robot))
    expected = -6.25 * 0.2 - 10.067 - weight * (np.cos(0.2) - 1)
    assert float(turned.torque[2, 1] - rest.torque[2, 1]) == pytest.approx(expected, rel=1e-3)
    assert float(turned.target[3, 1] - rest.target[3, 1]) == pytest.approx(0.2, abs=1e-5)  # leg 4 follows leg 3


def test_locked_legs_are_in_position_mode():
    assert not np.any(order(LOCKED)[0][0])


def test_mass_centre_of_straight_legs():
    """Six legs straight out to the sides balance each other sideways and lie in the hips' plane."""
    joints = jnp.zeros((6, 3)).at[:, 1].set(jnp.pi / 2).at[1::2, 2].set(jnp.pi)
    np.testing.assert_allclose(mass_centre(CASE.robot, joints), 0, atol=1e-6)
    feet = foot_positions(CASE.robot, joints)
    np.testing.assert_allclose(np.abs(feet[:, 1]), 0.25 + 0.855, atol=1e-6)
    lifted = joints.at[2, 1].add(0.5)  # leg 3: 1 kg of 16, 0.4738 m out
    moved = mass_centre(CASE.robot, lifted)
    lever = (0.5 * 0.26 + 0.5 * (0.52 + 0.1675)) / 16
    np.testing.assert_allclose(moved, [0, lever * (1 - np.cos(0.5)), -lever * np.sin(0.5)], atol=1e-6)
