"""A robot on a free slab on a frictionless floor: nothing outside pushes sideways, so momentum stays where it was."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from slab import Slab
from validity.simulation import simulate

from sweep.config.experiment import compose
from sweep.core.rotations import exponential
from sweep.manoeuvres.walking.walk import level_stance
from sweep.models import scene
from sweep.models.posture import Stance, joint_targets

STEP, SECONDS, SETTLED = 2e-3, 3.0, 100
STICKS, SLIDES = range(2)


@pytest.fixture(scope="module")
def nominal():
    return dataclasses.replace(compose([]).case, obstacle=Slab())


@pytest.fixture(scope="module")
def history(nominal):
    """The robot shifts, tilts and turns its body over its feet; on a gripping and on a frictionless slab."""
    start, _ = level_stance(nominal, 0.3, 0.525)
    t = np.arange(0, SECONDS, STEP)
    gently = (0.5 - 0.5 * np.cos(np.pi * np.clip(t, 0, 1)))[:, None]
    shift = gently * np.stack([0.06 * np.sin(4 * t), 0.05 * np.sin(3 * t), 0.03 * np.sin(5 * t)], axis=1)
    turn = gently * np.stack([0.06 * np.sin(3 * t), 0.06 * np.sin(4 * t), 0.08 * np.sin(2 * t)], axis=1)
    references = jax.vmap(
        lambda s, r: joint_targets(nominal.robot, Stance(start.feet, start.position + s, exponential(r)))[0]
    )(jnp.asarray(shift), jnp.asarray(turn))
    thickness = nominal.obstacle.half_height
    base = start.position.at[2].add(2 * thickness)
    q = np.concatenate([base, start.quat, np.ravel(references[0]), [0, 0, thickness, 1, 0, 0, 0]])
    world = dataclasses.replace(nominal, obstacle=Slab(grip=np.array([1.0, 0.0])))  # pyright: ignore[reportArgumentType]
    return simulate(world, nominal, np.stack([q, q]).astype(np.float32), np.asarray(references, np.float32))


def momentum(nominal, history, row) -> np.ndarray:
    """Of robot and slab together after every step, by C MuJoCo from positions and velocities (N s)."""
    model = scene.compile_model(nominal, geoms=False)
    data = mujoco.MjData(model)
    total = []
    for q, v in zip(history.q[:, row], history.v[:, row], strict=True):
        data.qpos, data.qvel = q, v
        mujoco.mj_forward(model, data)
        mujoco.mj_subtreeVel(model, data)
        total.append(data.subtree_linvel[0] * model.body_subtreemass[0])
    return np.array(total)


@pytest.mark.slow
def test_nothing_breaks(history):
    assert np.all(np.isfinite(history.q))


def test_horizontal_momentum_is_conserved(nominal, history):
    """To 1e-4 of the impulse that robot and slab exchange.

    What is left is the integrator's, which takes the mass matrix at the start of a step: it is the same in double
    precision and halves with the time step.
    """
    exchanged = STEP * np.abs(history.force[:, STICKS, :, :2].sum(axis=1)).sum(axis=0).max()
    assert exchanged > 5.0  # N s: the slab really is pushed about
    assert np.abs(momentum(nominal, history, STICKS)[:, :2]).max() < 1e-4 * exchanged


def test_feet_do_not_creep_on_the_slab(history):
    turned = np.zeros((len(history.q), 9))
    for rotation, q in zip(turned, history.q[:, STICKS], strict=True):
        mujoco.mju_quat2Mat(rotation, q[28:32])
    offset = history.foot[1:, STICKS] - history.q[:-1, STICKS, None, 25:28]  # feet are those before a step
    held = np.einsum("tji,tnj->tni", turned.reshape(-1, 3, 3)[:-1], offset)[SETTLED:]
    creep = np.abs(held - held[0]).max()
    assert creep < 0.1e-3


def test_frictionless_slab_is_not_moved(history):
    """The other row's robot slides about on its slab, which feels normal forces only."""
    assert np.abs(history.q[:, SLIDES, 25:27]).max() < 0.1e-3
    assert np.abs(history.q[:, STICKS, 25:27]).max() > 10e-3
