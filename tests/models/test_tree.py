"""The structured dynamics and the step's balance of momentum against C MuJoCo, on random states."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from dense import dense
from slab import Slab
from slow_cases import mark_slow_cases

from sweep.config.experiment import compose
from sweep.core.errors import InputError
from sweep.core.parameters import parameters
from sweep.dynamics import interface, tree
from sweep.dynamics.step import pack_physics_state, state_at_rest, step, unpack_physics_state
from sweep.engines import physics
from sweep.models import scene
from sweep.models.drive import position_command

ROBOTS = ("base", "three_link", "hexagon", "prototype")
STATES, H, ENOUGH = 8, 2e-3, 10


def case_of(name):
    groups = {"slab": [], "hexagon": ["robot=hexagon", "drive=strong"]}  # the light drives cannot hold its heavy legs
    case = compose(groups.get(name, [f"robot={name}"])).case
    return dataclasses.replace(case, obstacle=Slab()) if name == "slab" else case


def random_states(model, rng):
    """Positions (STATES, nq) and velocities (STATES, nv)."""
    q, v = rng.normal(size=(STATES, model.nq)), rng.normal(size=(STATES, model.nv))
    for k in (0, *range(25, model.nq, 7)):
        q[:, k + 3 : k + 7] /= np.linalg.norm(q[:, k + 3 : k + 7], axis=1, keepdims=True)
    return q, v


@pytest.mark.parametrize("double", mark_slow_cases([True, False], [False]))
@pytest.mark.parametrize("name", mark_slow_cases(ROBOTS, ROBOTS[1:]))
def test_structure_gives_mujocos_blocks(name, double):
    """Mass matrix, bias, Jacobians and places of C MuJoCo's, to round-off of the largest number of each."""
    case, rng = case_of(name), np.random.default_rng(ROBOTS.index(name))
    with jax.enable_x64(True):  # or the model's sizes are rounded
        top, model = interface.build_model_topology(case), scene.compile_model(case, geoms=False)
    q, v = random_states(model, rng)
    with jax.enable_x64(double):
        batch = jax.jit(jax.vmap(lambda q, v: dense(tree.tree_dynamics(case), q, v)))(q, v)
    tolerance = 1e-12 if double else 5e-6
    data, nv = mujoco.MjData(model), model.nv
    for i in range(STATES):
        s = jax.tree.map(lambda x, i=i: np.asarray(x)[i], batch)
        data.qpos, data.qvel = q[i], v[i]
        mujoco.mj_forward(model, data)
        mass = np.zeros((nv, nv))
        mujoco.mj_fullM(model, data, mass)
        pairs = [(s.mass, mass), (s.bias, data.qfrc_bias), (s.foot, data.site_xpos[top.foot_site_ids]),
                 (s.centre_of_mass, data.subtree_com[1]), (s.links.reshape(-1, 3), data.xpos[2:])]  # fmt: skip
        for n, site in enumerate(top.foot_site_ids):
            jacobian = np.zeros((3, nv))
            mujoco.mj_jacSite(model, data, jacobian, None, site)
            pairs.append((s.jacobian[:, n].T, jacobian))
        for given, wanted in pairs:
            np.testing.assert_allclose(given, wanted, rtol=0, atol=tolerance * (1 + np.max(np.abs(wanted))))


@pytest.mark.parametrize("name", mark_slow_cases(["base", "three_link", "slab"], ["base", "slab"]))
def test_momentum_goes_where_forces_send_it(name):
    """M (w - v) / h + bias = J' F + torques, with C MuJoCo's matrices: some feet are in the air.

    The slab falls freely under the robot, so that its feet are all that touch anything.
    """
    with jax.enable_x64(True):
        case, rng = case_of(name), np.random.default_rng(1)
        case = dataclasses.replace(case, contact=dataclasses.replace(case.contact, friction=0.3))
        top, model = interface.build_model_topology(case), scene.compile_model(case, geoms=False)
        data, nv = mujoco.MjData(model), model.nv
        q, v = random_states(model, rng)
        q[:, 3:7] = [1.0, 0.0, 0.0, 0.0]
        q[:, 7:25] = rng.uniform(-0.5, 0.5, (STATES, 18))
        if name == "slab":
            q[:, 25:] = [0.0, 0.0, 5.0, 1.0, 0.0, 0.0, 0.0]
        for state in q:
            data.qpos = state
            mujoco.mj_forward(model, data)
            state[2] += (5.05 if name == "slab" else 0.0) - np.median(data.site_xpos[top.foot_site_ids][:, 2])
        targets = q[:, 7:25].reshape(-1, 6, 3) + rng.normal(scale=2e-3, size=(STATES, 6, 3))
        limits = physics.drive_limits_at_step(case, jnp.int32(0), H)

        def one(q, v, target):
            start = state_at_rest(top, q)._replace(v=v)
            servo = position_command(case.drive, target)
            moving, report = step(tree.tree_dynamics(case), case, limits, unpack_physics_state(start), servo, H, ENOUGH)
            return pack_physics_state(moving).v, report

        with jax.disable_jit():  # to compile it takes longer than to run it
            after, report = jax.vmap(one)(*map(jnp.asarray, (q, 0.1 * v, targets)))
        after, force = np.asarray(after), np.asarray(report.force.array())
        torque, loaded = np.stack(report.torque, axis=-1), np.asarray(report.normal) > 0
    assert 0 < loaded.sum() < 6 * STATES
    for i in range(STATES):
        data.qpos, data.qvel = q[i], 0.1 * v[i]
        mujoco.mj_forward(model, data)
        gained, outside, other = np.zeros(nv), np.zeros(nv), np.zeros((3, nv))
        mujoco.mj_mulM(model, data, gained, after[i] - 0.1 * v[i])
        outside[6:24] = torque[i].ravel()
        for n, site in enumerate(top.foot_site_ids):
            jacobian = np.zeros((3, nv))
            mujoco.mj_jacSite(model, data, jacobian, None, site)
            if top.free_body_ids:
                mujoco.mj_jac(model, data, other, None, data.site_xpos[site], top.free_body_ids[0])
            outside += (jacobian - other).T @ force[i, n]
        np.testing.assert_allclose(gained / H + data.qfrc_bias, outside, atol=1e-6 * np.abs(outside).max())


def test_frame_of_a_free_body_is_at_its_mass_centre():
    @parameters
    class Lopsided(Slab):
        """Its frame is elsewhere."""

        def add_to(self, spec, friction):
            super().add_to(spec, friction)
            spec.body("slab").ipos = [0, 0, 0.1]

    with pytest.raises(InputError, match="free body slab"):
        interface.build_model_topology(dataclasses.replace(case_of("slab"), obstacle=Lopsided()))
