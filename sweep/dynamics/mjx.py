"""The smooth dynamics of `dynamics`, from MJX."""

from collections.abc import Callable
from functools import partial

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from mujoco import mjx
from mujoco.mjx._src import math as mjx_math
from mujoco.mjx._src import smooth

from sweep.dynamics.interface import N_LEGS, Smooth, SmoothDynamics, Topology
from sweep.models import scene
from sweep.models.case import Case
from sweep.models.obstacles.surface import Bodies


def of(top: Topology) -> Callable[[Case], SmoothDynamics]:
    """The smooth dynamics of a world, for every world of the topology."""
    model = mjx.put_model(top.model, impl="jax")
    data = mjx.make_data(model, impl="jax")
    return lambda world: partial(smooth_dynamics, top, model.replace(**varying(top, model, world)), data)


def varying(top: Topology, model: mjx.Model, case: Case) -> dict[str, Array]:
    """The arrays of the topology's `model` that follow from the parameters of `case`, by field. Pure JAX."""
    changed = {}
    for field, values in scene.leaves(case).items():
        table = top.names[{"body": "body", "site": "site", "dof": "joint"}[field.split("_")[0]]]
        index = np.array([table[name] for name in values], int)
        if field == "dof_armature":
            index = np.asarray(model.jnt_dofadr)[index]
        if len(index):
            rows = jnp.stack([jnp.asarray(value) for value in values.values()])
            changed[field] = getattr(model, field).at[index].set(rows.astype(getattr(model, field).dtype))
    return changed


def smooth_dynamics(top: Topology, model: mjx.Model, data: mjx.Data, q: Array, v: Array) -> Smooth:
    """Blocks at configuration q (nq,) and velocity v (nv,). `data` is an empty MJX data of the topology."""
    d = data.replace(qpos=q, qvel=v)
    for stage in (smooth.kinematics, smooth.com_pos, smooth.crb, smooth.com_vel, smooth.rne):
        d = stage(model, d)
    cdof = d.cdof
    momentum = mjx_math.inert_mul  # (composite inertia, motion) -> wrench
    crb = d._impl.crb[top.model.dof_bodyid]  # pyright: ignore[reportAttributeAccessIssue]
    wrench = jnp.stack([momentum(crb[i], cdof[i]) for i in range(crb.shape[0])])
    leg_motion, leg_wrench = cdof[top.leg], wrench[top.leg]  # (6, 3, 6)
    upper = jnp.einsum("lic,ljc->lij", leg_motion, leg_wrench)  # right where dof i is not below dof j
    upper = jnp.triu(upper)
    m_leg = upper + jnp.swapaxes(jnp.triu(upper, 1), 1, 2)
    m_leg = m_leg + model.dof_armature[top.leg][:, :, None] * jnp.eye(3, dtype=q.dtype)
    base = cdof[:6]
    m_cross = jnp.einsum("ic,ljc->lij", base, leg_wrench)
    r = len(top.root)
    m_root, m_cross = _root_blocks(cdof, wrench, m_cross, top, r)
    point = d.site_xpos[top.points]
    com = d.subtree_com
    j_root, j_leg, j_body = _jacobians(cdof, com, point, top, r)
    bodies = Bodies(d.xpos[np.array(top.free, int)], d.xmat[np.array(top.free, int)])
    potential = scene.GRAVITY * jnp.sum(model.body_mass * d.xipos[:, 2])
    return Smooth(m_root, m_cross, m_leg, d.qfrc_bias[top.root], d.qfrc_bias[top.leg], point, j_root, j_leg, bodies,
                  j_body, potential, d.xpos[2:], com[1])  # fmt: skip


def _root_blocks(cdof: Array, wrench: Array, cross: Array, top: Topology, r: int) -> tuple[Array, Array]:
    """Root block (r, r), one 6x6 block per root body, and the legs' coupling padded to (6, r, 3)."""
    blocks = [cdof[dofs] @ wrench[dofs].T for dofs in top.root.reshape(-1, 6)]
    if len(blocks) == 1:
        return blocks[0], cross
    m_root = jnp.zeros((r, r), cdof.dtype)
    for k, block in enumerate(blocks):
        m_root = m_root.at[6 * k : 6 * k + 6, 6 * k : 6 * k + 6].set(block)
    return m_root, jnp.pad(cross, ((0, 0), (0, r - 6), (0, 0)))


def _point_jacobian(motion: Array, offset: Array) -> Array:
    """(n, 3, d) velocity of points at `offset` (n, 3) from the reference of the spatial motions (d, 6)."""
    linear = motion[None, :, 3:] + jnp.cross(motion[None, :, :3], offset[:, None, :])
    return jnp.swapaxes(linear, 1, 2)


def _jacobians(cdof: Array, com: Array, point: Array, top: Topology, r: int) -> tuple[Array, Array, Array]:
    """Jacobians of the contact points by root and leg dofs, and of free bodies' material under each point."""
    base_body = 1
    feet = point[:N_LEGS]
    j_feet = _point_jacobian(cdof[:6], feet - com[base_body])
    own = cdof[top.leg]  # (6, 3, 6)
    j_leg = own[:, :, 3:] + jnp.cross(own[:, :, :3], (feet - com[base_body])[:, None, :])
    j_leg = jnp.swapaxes(j_leg, 1, 2)
    if not top.free:
        return j_feet, j_leg, jnp.zeros((0, point.shape[0], 3, 6), point.dtype)
    dofs = top.root.reshape(-1, 6)[1:]
    j_body = jnp.stack([_point_jacobian(cdof[d], point - com[b]) for d, b in zip(dofs, top.free, strict=True)])
    j_root = jnp.zeros((point.shape[0], 3, r), point.dtype).at[:N_LEGS, :, :6].set(j_feet)
    for i, body in enumerate(top.owner):
        if body >= 0:
            j_root = j_root.at[i, :, 6 * (body + 1) : 6 * (body + 2)].set(j_body[body, i])
    return j_root, j_leg, j_body
