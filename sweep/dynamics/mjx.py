"""Smooth dynamics of the robot computed by MJX."""

from collections.abc import Callable
from functools import partial

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from mujoco import mjx
from mujoco.mjx._src import math as mjx_math
from mujoco.mjx._src import smooth

from sweep.core.vectors import Matrix, Vector
from sweep.dynamics.interface import ModelTopology, RobotDynamicsTerms, SmoothDynamics
from sweep.dynamics.spatial import GeneralizedVector, Inertia, MassMatrix, SpatialVector, SystemPose, pack_state
from sweep.models import scene
from sweep.models.case import Case
from sweep.models.legs import N_LEGS

BASE_BODY_ID = 1  # body id


def mjx_dynamics(top: ModelTopology) -> Callable[[Case], SmoothDynamics]:
    """Build a function that computes mass matrix, bias forces and foot Jacobians by MJX."""
    model = mjx.put_model(top.model, impl="jax")
    data = mjx.make_data(model, impl="jax")
    return lambda world: partial(
        smooth_dynamics, top, model.replace(**parameter_dependent_fields(top, model, world)), data
    )


def parameter_dependent_fields(top: ModelTopology, model: mjx.Model, case: Case) -> dict[str, Array]:
    """Return the MJX model fields that depend on varied parameters, by name; values may be traced."""
    changed = {}
    for field, values in scene.batched_model_fields(case).items():
        table = top.ids_by_name[{"body": "body", "site": "site", "dof": "joint"}[field.split("_")[0]]]
        index = np.array([table[name] for name in values], int)
        if field == "dof_armature":
            index = np.asarray(model.jnt_dofadr)[index]
        if len(index):
            rows = jnp.stack([jnp.asarray(value) for value in values.values()])
            changed[field] = getattr(model, field).at[index].set(rows.astype(getattr(model, field).dtype))
    return changed


def smooth_dynamics(
    top: ModelTopology, model: mjx.Model, data: mjx.Data, pose: SystemPose, motion: GeneralizedVector
) -> RobotDynamicsTerms:
    """Compute mass matrix, bias forces and foot Jacobians at a pose and motion with MJX."""
    q, v = pack_state(pose, motion)
    d = data.replace(qpos=q, qvel=v)
    for stage in (smooth.kinematics, smooth.com_pos, smooth.crb, smooth.com_vel, smooth.rne):
        d = stage(model, d)
    base, leg = d.cdof[:6], d.cdof[top.leg_dofs]  # (6, 6), (6, 3, 6)
    momentum = mjx_math.inert_mul  # (composite inertia, motion) -> wrench
    crb = d._impl.crb[top.model.dof_bodyid]  # pyright: ignore[reportAttributeAccessIssue]
    wrench = jnp.stack([momentum(inertia, motion) for inertia, motion in zip(crb, d.cdof, strict=True)])
    upper = jnp.triu(jnp.einsum("lic,ljc->lij", leg, wrench[top.leg_dofs]))  # right where dof i is not below dof j
    m_leg = upper + jnp.swapaxes(jnp.triu(upper, 1), 1, 2)
    m_leg = m_leg + model.dof_armature[top.leg_dofs][:, :, None] * jnp.eye(3, dtype=q.dtype)
    turned = d.xmat[BASE_BODY_ID]
    cross = jnp.einsum("ic,ljc->jli", base, wrench[top.leg_dofs])  # (3, 6, 6), linear parts in world axes
    columns = tuple(SpatialVector(Vector.from_array(c[:, :3] @ turned), Vector.from_array(c[:, 3:])) for c in cross)
    whole = base @ wrench[:6].T
    arm = turned.T @ whole[:3, 3:]  # minus the matrix of the first moment cross
    moment = Vector(arm[1:2, 2], arm[2:3, 0], arm[0:1, 1])
    inertia = Inertia(whole[0:1, 0], moment, Matrix.from_array(whole[None, 3:, 3:]))
    bias = d.qfrc_bias
    forces = SpatialVector(Vector.from_array((bias[:3] @ turned)[None]), Vector.from_array(bias[None, 3:6]))
    foot, per_leg = d.site_xpos[top.foot_site_ids], (top.model.nbody - 2 - len(top.free_body_ids)) // N_LEGS
    swept = leg[:, :, 3:] + jnp.cross(leg[:, :, :3], (foot - d.subtree_com[BASE_BODY_ID])[:, None, :])
    links = d.xpos[2 : 2 + N_LEGS * per_leg].reshape(N_LEGS, per_leg, 3)
    joints = [*jnp.swapaxes(links, 0, 1), foot]
    return RobotDynamicsTerms(
        MassMatrix((inertia,), columns, Matrix.from_array(m_leg)),  # pyright: ignore
        GeneralizedVector((forces,), tuple(bias[top.leg_dofs].T)),  # pyright: ignore
        tuple(Vector.from_array((joint - d.xpos[BASE_BODY_ID]) @ turned) for joint in joints),
        tuple(Vector.from_array(swept[:, k] @ turned) for k in range(3)),  # pyright: ignore
    )
