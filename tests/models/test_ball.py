"""A free ball: it rolls, slides, spins and slows down as mechanics says, history and under the robot."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from validity.simulation import simulate

from sweep.config.experiment import compose
from sweep.core.constants import GRAVITY
from sweep.dynamics.free_bodies import resting_start_state
from sweep.formulas.leg import SIDE_BY_LEG
from sweep.models import scene
from sweep.models.obstacles.ball import Ball
from sweep.models.posture import Stance, joint_targets
from sweep.models.scene import compile_native_model

STEP, SECONDS, FALL, PERIOD = 2e-3, 2.0, 1.0, 0.4
UPRIGHT = jnp.array([1.0, 0, 0, 0])
BALL_AT, BALL_MOVES = slice(25, 28), slice(24, 27)  # in q and v
ROLLS, SPINS, RESTS, FALLS, ON_ICE = range(5)
SPEED, SPIN, ARM = 0.3, 0.2, 4e-3


@pytest.fixture(scope="module")
def nominal():
    return dataclasses.replace(compose([]).case, obstacle=Ball())


@pytest.fixture(scope="module")
def history(nominal):
    """Three balls on their own, and two on which the robot moves its body: in free fall, and on ice.

    The three roll, spin about the vertical, and rest under a turn too slow to be one. Their robots are far above and
    never come down.
    """
    robot, ball = nominal.robot, nominal.obstacle
    across = zip((-0.3, -0.3, 0, 0, 0.3, 0.3), SIDE_BY_LEG, strict=True)
    feet = jnp.stack([jnp.array([x, float(side) * 0.4, 0.0]) for x, side in across])
    feet = feet.at[:, 2].set(jnp.sqrt(ball.radius**2 - feet[:, 0] ** 2 - feet[:, 1] ** 2) - 0.5e-3)
    t = np.arange(0, SECONDS, STEP)
    shift = (0.5 - 0.5 * np.cos(2 * np.pi * t / PERIOD))[:, None] * np.array([0.05, 0.03, 0.03])
    place = jnp.array([0.0, 0.0, 1.11])
    references = jax.vmap(lambda s: joint_targets(robot, Stance(feet, place + s, UPRIGHT))[0])(jnp.asarray(shift))
    q, v = np.zeros((5, 32)), np.zeros((5, 30))
    q[:, 3] = q[:, 28] = 1.0
    q[:, 7:25] = np.ravel(references[0])
    q[:, BALL_AT] = [0, 0, ball.radius]
    q[FALLS, 27] += 8.0
    q[:, :3] = q[:, BALL_AT] + np.asarray(place)
    q[: RESTS + 1, 2] = 40.0
    v[ROLLS, 24], v[ROLLS, 28] = SPEED, SPEED / ball.radius
    v[SPINS, 29] = SPIN
    v[RESTS, 28] = 1e-6
    roll, spin = np.full(5, ARM), np.full(5, ARM)
    world = dataclasses.replace(nominal, obstacle=dataclasses.replace(
        ball, rolling_friction=roll, spinning_friction=spin, floor_grip=np.array([1.0, 1.0, 1.0, 1.0, 0.0])
    ))  # fmt: skip
    return simulate(world, nominal, q.astype(np.float32), np.asarray(references, np.float32), v=v)


def test_rolling_ball_slows_down(history, nominal):
    """The moment f N about the contact, where the moment of inertia is 7/5 M R^2."""
    slowing = ARM * GRAVITY / (7 / 5 * nominal.obstacle.radius)
    lost = SPEED - history.v[-1, ROLLS, 24]
    assert lost == pytest.approx(slowing * SECONDS, rel=0.01)
    slip = history.v[:, ROLLS, 24] - nominal.obstacle.radius * history.v[:, ROLLS, 28]
    assert np.abs(slip[100:]).max() < 1e-3 * SPEED  # of the indentation, 1 mm of the radius


@pytest.mark.parametrize("speed", [0.3, 0.02])
def test_rolling_ball_slows_down_in_c(nominal, speed):
    """So does it in the second engine, at any speed: MuJoCo's friction is viscous below one that it chooses."""
    ball = dataclasses.replace(nominal.obstacle, speed=speed)
    model = compile_native_model(dataclasses.replace(nominal, obstacle=ball), 1e-3)
    data, start = mujoco.MjData(model), ball.start()
    data.qpos[2], data.qpos[BALL_AT] = 40.0, start.position[0]
    data.qvel[BALL_MOVES], data.qvel[27:30] = start.velocity[0], start.turn[0]
    mujoco.mj_step(model, data, 2000)
    slowing = ball.rolling_friction * GRAVITY / (7 / 5 * ball.radius)
    assert speed - data.qvel[24] == pytest.approx(slowing * data.time, rel=0.01)


def test_spinning_ball_slows_down(history, nominal):
    slowing = ARM * GRAVITY / (2 / 5 * nominal.obstacle.radius**2)
    stops = SPIN / slowing
    assert 0.5 < stops < SECONDS - 0.2
    assert history.v[round(stops / 2 / STEP), SPINS, 29] == pytest.approx(SPIN / 2, rel=0.02)
    assert np.abs(history.v[round((stops + 0.1) / STEP) :, SPINS, 29]).max() < 1e-4


def test_ball_at_rest_stays(history):
    assert np.abs(history.q[:, RESTS, BALL_AT][:, :2]).max() < 1e-5


def test_contact_damps_alike_at_a_shorter_step(nominal):
    """A ball that falls rebounds as spring and damper have it, which do not pull; one at rest in the floor stays."""
    ball, damping, fall, step = nominal.obstacle, nominal.contact.damping, 0.01, 5e-4
    ratio = damping / (2 * np.sqrt(nominal.contact.stiffness * ball.mass))
    own = np.sqrt(1 - ratio**2)
    rebound = np.exp(-ratio / own * (np.pi - np.arctan2(2 * ratio * own, 1 - 2 * ratio**2)))
    q = np.tile(np.zeros(32), (2, 1))
    q[:, 3] = q[:, 28] = 1.0
    q[:, 2] = 40.0
    q[:, BALL_AT] = [np.add(ball.start().position[0], [0, 0, fall]), resting_start_state(nominal).position[0]]
    targets = np.zeros((round(0.15 / step), 6, 3), np.float32)
    history = simulate(nominal, nominal, q.astype(np.float32), targets, h=step)
    fast = history.v[:, :, 26]
    assert fast[:, 0].max() / -fast[:, 0].min() == pytest.approx(rebound, rel=0.03)
    assert np.abs(fast[:, 1]).max() < 1e-3  # unsunk, 0.1 m/s


def totals(nominal, history, row):
    """Momentum (N s) and energy (J) of robot and ball after every step, by C MuJoCo."""
    model = scene.compile_model(nominal, geoms=False)
    model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    data, out = mujoco.MjData(model), []
    for q, v in zip(history.q[:, row], history.v[:, row], strict=True):
        data.qpos, data.qvel = q, v
        mujoco.mj_forward(model, data)
        mujoco.mj_subtreeVel(model, data)
        out.append([*(data.subtree_linvel[0] * model.body_subtreemass[0]), data.energy.sum()])
    return np.array(out)


@pytest.mark.parametrize("row", [FALLS, ON_ICE])
def test_robot_and_ball_keep_their_momentum(nominal, history, row):
    """Nothing outside pushes sideways; in free fall weight alone adds to it. The rest is the integrator's."""
    moving = slice(None, round(FALL / STEP))
    total, ball = totals(nominal, history, row)[moving], nominal.obstacle.mass * history.v[moving, row, BALL_MOVES]
    weight = GRAVITY * STEP * (1 + np.arange(len(total)))
    if row == FALLS:
        total[:, 2] += (nominal.obstacle.mass + 16) * weight
        ball[:, 2] += nominal.obstacle.mass * weight
    axes = slice(0, 3 if row == FALLS else 2)
    assert np.abs(ball[:, axes]).max() > 0.5  # N s: they do push each other
    assert np.abs(total[:, axes]).max() < 3e-3 * np.abs(ball[:, axes]).max()


@pytest.mark.parametrize("row", [FALLS, ON_ICE])
def test_energy_comes_from_the_drives(nominal, history, row):
    """What is gained is not more than the drives' work; some is lost in contact and in the stiff drives.

    The integrator's own share is left out: falling freely it keeps the energy less h g/2 times the momentum.
    """
    moving = slice(100, round(FALL / STEP))
    total, work = totals(nominal, history, row)[moving], np.cumsum(history.work[moving, row])
    energy = total[:, 3] - 0.5 * STEP * GRAVITY * total[:, 2]
    gain = energy - energy[0] - (work - work[0])
    assert gain.max() < 5e-3 * np.ptp(work)
    assert gain.min() > -0.25 * np.ptp(work)
