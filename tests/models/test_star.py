"""The structured dynamics against C MuJoCo's, and the written-out step against the general one, on random states."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from slab import Slab

from sweep.dynamics import interface as dynamics
from sweep.dynamics import structured, tree, tree_step
from sweep.dynamics.step import State, step
from sweep.engines import batching
from sweep.models import scene
from sweep.models.contact import Anchors
from sweep.models.drive import position_mode
from sweep.study.config import compose

WORLDS = ("base", "three_link", "hexagon", "prototype", "slab")
STATES, H, ITERATIONS = 8, 2e-3, 2


def case_of(name):
    groups = {"slab": [], "hexagon": ["robot=hexagon", "drive=strong"]}  # the light drives cannot hold its heavy legs
    case = compose(groups.get(name, [f"robot={name}"])).case
    return dataclasses.replace(case, obstacle=Slab()) if name == "slab" else case


def random_states(top, rng):
    """Positions (STATES, nq) and velocities (STATES, nv)."""
    q, v = rng.normal(size=(STATES, top.model.nq)), rng.normal(size=(STATES, top.model.nv))
    for k in (0, *range(25, top.model.nq, 7)):
        q[:, k + 3 : k + 7] /= np.linalg.norm(q[:, k + 3 : k + 7], axis=1, keepdims=True)
    return q, v


@pytest.mark.parametrize("double", [True, False])
@pytest.mark.parametrize("name", WORLDS)
def test_structure_gives_mujocos_blocks(name, double):
    """Mass matrix, bias, Jacobians and places of C MuJoCo's, to round-off of the largest number of each."""
    case, rng = case_of(name), np.random.default_rng(WORLDS.index(name))
    with jax.enable_x64(True):  # or the model's sizes are rounded
        top, model = dynamics.topology(case), scene.compile_model(case, geoms=False)
    q, v = random_states(top, rng)
    with jax.enable_x64(double):
        batch = jax.jit(jax.vmap(lambda q, v: structured.smooth_dynamics(top, case, q, v)))(q, v)
    tolerance = 1e-12 if double else 5e-6
    data, nv = mujoco.MjData(model), model.nv
    for i in range(STATES):
        s = jax.tree.map(lambda x, i=i: np.asarray(x)[i], batch)
        data.qpos, data.qvel = q[i], v[i]
        mujoco.mj_forward(model, data)
        mass, bias, expected = np.zeros((nv, nv)), np.zeros(nv), np.zeros((nv, nv))
        mujoco.mj_fullM(model, data, expected)
        mass[np.ix_(top.root, top.root)], bias[top.root], bias[top.leg] = s.m_root, s.bias_root, s.bias_leg
        for leg, dofs in enumerate(top.leg):
            mass[np.ix_(top.root, dofs)], mass[np.ix_(dofs, top.root)] = s.m_cross[leg], s.m_cross[leg].T
            mass[np.ix_(dofs, dofs)] = s.m_leg[leg]
        pairs = [(mass, expected), (bias, data.qfrc_bias), (s.point, data.site_xpos[top.points]),
                 (s.centre_of_mass, data.subtree_com[1]), (s.links, data.xpos[2 : 2 + len(s.links)])]  # fmt: skip
        for n, site in enumerate(top.points):
            jacobian = np.zeros((3, nv))
            mujoco.mj_jacSite(model, data, jacobian, None, site)
            pairs.append((s.j_root[n], jacobian[:, top.root]))
            if n < 6:
                pairs.append((s.j_leg[n], jacobian[:, top.leg[n]]))
        for given, wanted in pairs:
            np.testing.assert_allclose(given, wanted, rtol=0, atol=tolerance * (1 + np.max(np.abs(wanted))))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["base", "three_link", "hexagon"])
def test_steps_agree(name):
    """In double precision to round-off: feet in the air, holding and slipping, drives at their limit or not."""
    with jax.enable_x64(True):
        case, rng = case_of(name), np.random.default_rng(1)
        top = dynamics.topology(case)
        q, v = random_states(top, rng)
        q[:, 7:25] = rng.uniform(-0.5, 0.5, (STATES, 18))
        feet = np.array(jax.vmap(lambda q, v: structured.smooth_dynamics(top, case, q, v).point)(q, v))
        q[:, 2] -= np.median(feet[:, :, 2], axis=1)  # three feet are in the ground
        feet[:, :, 2] -= np.median(feet[:, :, 2], axis=1, keepdims=True)
        feet += rng.normal(scale=1e-4, size=feet.shape)
        held = rng.random((STATES, 6)) < 0.5
        anchors = Anchors(jnp.asarray(feet), jnp.asarray(held), jnp.zeros((STATES, 6), jnp.int32))
        states = State(jnp.asarray(q), 0.1 * jnp.asarray(v), anchors)
        targets = jnp.asarray(q[:, 7:25].reshape(-1, 6, 3) + rng.normal(scale=2e-3, size=(STATES, 6, 3)))
        limits = batching.execution_limits(case, jnp.zeros(()))

        smooth = structured.of(top)(case)

        def general(state, target):
            return step(top, smooth, case, limits, state, position_mode(case.drive, target), H, ITERATIONS)

        def written_out(state, target):
            servo = position_mode(case.drive, target)
            moving, report = tree_step.step(case, limits, tree_step.from_state(state), servo, H, ITERATIONS)
            return tree_step.to_state(moving), report

        (expected, report), (given, other) = (jax.jit(jax.vmap(f))(states, targets) for f in (general, written_out))
        forces = report.forces
        assert 0 < np.sum(forces.slipping) < np.sum(forces.loaded) < 6 * STATES
        assert 0 < np.sum(report.saturated) < 18 * STATES
        for a, b in [(forces.force, other.force.array()), (report.torque, jnp.stack(other.torque, axis=-1)),
                     (report.saturated, jnp.stack(other.saturated, axis=-1)), (report.residual, other.residual[:, 0]),
                     (report.kinetic + report.smooth.potential, other.end.energy[:, 0]),
                     *zip(jax.tree.leaves(expected), jax.tree.leaves(given), strict=True)]:  # fmt: skip
            size = 1 + np.max(np.abs(a))
            np.testing.assert_allclose(b, a, rtol=0, atol=1e-9 * size)


def test_shape_is_asked_of_the_obstacle():
    @dataclasses.dataclass(frozen=True)
    class Lopsided(Slab):
        def leaves(self):
            return {**super().leaves(), "body_ipos": {"slab": jnp.ones(3)}}

    assert tree.fits(case_of("slab"))
    assert not tree.fits(dataclasses.replace(case_of("slab"), obstacle=Lopsided()))
