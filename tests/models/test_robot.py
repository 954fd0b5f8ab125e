"""The robot from numbers: MJX on `leaves` computes what C MuJoCo computes from a freshly compiled model."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from dense import Dense, dense
from mujoco import mjx
from slow_cases import mark_slow_cases

from sweep.backends import devices
from sweep.config.experiment import compose
from sweep.core.rotations import rotate
from sweep.dynamics import interface as dynamics
from sweep.dynamics import mjx as mjx_dynamics
from sweep.engines import batching
from sweep.formulas.leg import SIDE_BY_LEG, forward_kinematics
from sweep.models import scene
from sweep.models.case import Case
from sweep.models.legs import LEGS
from sweep.models.posture import Stance, joint_targets, leg_mounts

ROBOTS = ("base", "three_link", "circular", "prototype", "hexagon")
WIDTH = 3


pytestmark = pytest.mark.usefixtures("double")


def swept(nominal: Case, rng: np.random.Generator) -> Case:
    """Every length, mass and mount, and the armature, off by up to 30 % in its own way."""

    def vary(group):
        values = {
            f.name: getattr(group, f.name) * rng.uniform(0.7, 1.3, WIDTH)
            for f in dataclasses.fields(group)
            if isinstance(getattr(group, f.name), float)
        }
        return dataclasses.replace(group, **values)

    robot = vary(nominal.robot)
    if nominal.robot.legs == "two_link":
        robot = dataclasses.replace(robot, coxa=0.0)
    return dataclasses.replace(nominal, robot=robot, drive=vary(nominal.drive))


_compiled = {}


def smooth_batch(nominal: Case, case: Case, q: np.ndarray, v: np.ndarray) -> tuple[dynamics.ModelTopology, Dense]:
    """The smooth dynamics of a batch; robots with the same links share one compiled program, as sweeps do."""
    top = dynamics.build_model_topology(nominal)
    model = mjx.put_model(top.model)
    if nominal.robot.legs not in _compiled:
        data = mjx.make_data(model)

        def smooth(fields, q, v):
            return dense(partial(mjx_dynamics.smooth_dynamics, top, model.replace(**fields), data), q, v)

        _compiled[nominal.robot.legs] = jax.jit(jax.vmap(smooth))
    fields = jax.vmap(
        partial(mjx_dynamics.parameter_dependent_fields, top, model), in_axes=(devices.vmap_in_axes(case),)
    )(case)
    mounted = jnp.broadcast_to(top.model.body_quat, (WIDTH, *top.model.body_quat.shape))
    return top, _compiled[nominal.robot.legs]({**fields, "body_quat": mounted}, q, v)


@pytest.mark.parametrize("name", mark_slow_cases(ROBOTS, ROBOTS[1:]))
def test_swept_leaves_equal_fresh_models(name):
    rng = np.random.default_rng(ROBOTS.index(name))
    nominal = compose([f"robot={name}"]).case
    case = swept(nominal, rng)
    q = rng.normal(size=(WIDTH, 25))
    q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
    v = rng.normal(size=(WIDTH, 24))

    top, batch = smooth_batch(nominal, case, q, v)
    for i in range(WIDTH):
        s = jax.tree.map(lambda x, i=i: np.asarray(x)[i], batch)
        m = scene.compile_model(batching.rollout_parameters(case, i), geoms=False)
        d = mujoco.MjData(m)
        d.qpos, d.qvel = q[i], v[i]
        mujoco.mj_forward(m, d)
        mass = np.zeros((24, 24))
        mujoco.mj_fullM(m, d, mass)
        close = partial(np.testing.assert_allclose, rtol=1e-9, atol=1e-9)
        close(s.mass, mass)
        close(s.bias, d.qfrc_bias)
        close(s.foot, d.site_xpos[top.foot_site_ids])
        close(s.centre_of_mass, d.subtree_com[1])
        for leg, site in enumerate(top.foot_site_ids):
            jacobian = np.zeros((3, 24))
            mujoco.mj_jacSite(m, d, jacobian, None, site)
            close(s.jacobian[:, leg].T, jacobian)


@pytest.mark.parametrize("name", ROBOTS)
def test_kinematics_equal_mujocos(name):
    """Random joint angles: closed-form feet are MuJoCo's, and the closed-form inverse leads back to the same feet."""
    rng = np.random.default_rng(7)
    case = compose([f"robot={name}"]).case
    robot = case.robot
    m = scene.compile_model(case, geoms=False)
    d = mujoco.MjData(m)
    feet_ids = [m.site(f"foot{leg}").id for leg in LEGS]
    mounts = leg_mounts(robot)
    yaw = mounts.yaw
    turn = np.stack([np.cos(yaw / 2), 0 * yaw, 0 * yaw, np.sin(yaw / 2)], axis=-1)

    def feet_at(q):
        d.qpos = q
        mujoco.mj_kinematics(m, d)
        return d.site_xpos[feet_ids].copy()

    for _ in range(20):
        q = rng.uniform(-np.pi, np.pi, 25)
        q[7::3] /= 2  # with a coxa, a leg turned right round its hip is another leg
        q[3:7] /= np.linalg.norm(q[3:7])
        feet = feet_at(q)
        joints = jnp.asarray(q[7:].reshape(6, 3))
        local = mounts.hips + rotate(
            jnp.asarray(turn), forward_kinematics(SIDE_BY_LEG, joints, robot.coxa, robot.thigh, robot.shin)
        )
        world = q[:3] + rotate(jnp.broadcast_to(jnp.asarray(q[3:7]), (6, 4)), local)
        np.testing.assert_allclose(world, feet, atol=1e-12)
        angles, shortfall = joint_targets(robot, Stance(jnp.asarray(feet), jnp.asarray(q[:3]), jnp.asarray(q[3:7])))
        assert np.max(shortfall) < 1e-12
        np.testing.assert_allclose(feet_at(np.concatenate([q[:7], np.ravel(angles)])), feet, atol=1e-7)


def test_prototype_has_the_books_proportions():
    robot = compose(["robot=prototype"]).case.robot
    lengths = np.array([robot.mount_radius, robot.coxa, robot.thigh, robot.shin]) / robot.body_length
    np.testing.assert_allclose(lengths, [0.5, 0.129927, 0.272263, 0.465693], atol=1e-6)


def test_base_robot_weighs_16_kg():
    model = scene.compile_model(compose(["robot=base"]).case, geoms=False)
    assert model.body_mass.sum() == pytest.approx(16.0)
