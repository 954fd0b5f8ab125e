"""Smooth dynamics of a star-shaped robot and the obstacle's free bodies, from MJX, as arrowhead blocks.

Generalised velocity: the root part (base, then free bodies, 6 each: world linear, body angular), then 3 per leg.
The mass matrix couples legs through the base only, so it is kept as blocks and never as a full matrix.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float
from mujoco import mjx
from mujoco.mjx._src import math as mjx_math
from mujoco.mjx._src import smooth

from sweep.case import Case
from sweep.models import scene
from sweep.models.obstacles.surface import Bodies

N_LEGS = 6


@dataclass(frozen=True)
class Topology:
    """What does not change while sizes and masses are swept. Contact points: the six feet, then obstacle sites."""

    model: mjx.Model
    names: Mapping[str, Mapping[str, int]]  # ids by kind ("body", "site", "joint") and name
    root: np.ndarray  # (r,) dofs of the base and of the free bodies
    leg: np.ndarray  # (6, 3) dofs of the legs
    free: tuple[int, ...]  # body ids of the free bodies
    points: np.ndarray  # (n,) site ids of the contact points
    owner: tuple[int, ...]  # (n,) free body that carries the point, -1 for the robot's feet
    links_per_leg: int


class Smooth(NamedTuple):
    """Mass matrix blocks, bias and contact points of one configuration. r root dofs, n contact points."""

    m_root: Float[Array, "r r"]
    m_cross: Float[Array, "6 r 3"]
    m_leg: Float[Array, "6 3 3"]  # with armature
    bias_root: Float[Array, " r"]  # Coriolis and gravity
    bias_leg: Float[Array, "6 3"]
    point: Float[Array, "n 3"]  # m, world
    j_root: Float[Array, "n 3 r"]  # world velocity of a point
    j_leg: Float[Array, "6 3 3"]  # of foot i by its own leg
    bodies: Bodies
    j_body: Float[Array, "k n 3 6"]  # velocity of the body's material under each point
    potential: Float[Array, ""]  # J
    links: Float[Array, "l 3"]  # m, world position of every link's frame, leg by leg
    centre_of_mass: Float[Array, " 3"]  # m, of the robot


def topology(case: Case) -> Topology:
    """The compiled model of `case` (plain numbers) and the index tables of its arrowhead."""
    model = scene.compile_model(case, geoms=False)
    kinds = {"body": mujoco.mjtObj.mjOBJ_BODY, "site": mujoco.mjtObj.mjOBJ_SITE, "joint": mujoco.mjtObj.mjOBJ_JOINT}
    sizes = {"body": model.nbody, "site": model.nsite, "joint": model.njnt}
    names = {kind: {mujoco.mj_id2name(model, obj, i): i for i in range(sizes[kind])} for kind, obj in kinds.items()}
    free = tuple(names["body"][name] for name in case.obstacle.free_bodies)
    root = np.concatenate([np.arange(6), *[model.body_dofadr[b] + np.arange(6) for b in free]]).astype(np.int32)
    joints = np.array([model.jnt_dofadr[names["joint"][joint]] for joint in scene.JOINTS], np.int32)
    feet = [names["site"][f"foot{leg}"] for leg in scene.LEGS]
    extra = [names["site"][name] for name, _ in case.obstacle.contact_sites]
    owner = (-1,) * N_LEGS + tuple(body for _, body in case.obstacle.contact_sites)
    points = np.array(feet + extra, np.int32)
    per_leg = len(scene.links(case.robot))
    return Topology(mjx.put_model(model), names, root, joints.reshape(6, 3), free, points, owner, per_leg)


def varying(top: Topology, case: Case) -> dict[str, Array]:
    """The model's arrays that follow from the parameters of `case`, by field. Pure JAX."""
    model = top.model
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
