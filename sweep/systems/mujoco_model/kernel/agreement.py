"""How well the kernel's accelerations agree with C MuJoCo's, on random states of the user's own model."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from sweep.core.errors import InputError
from sweep.fused import eager
from sweep.systems.mujoco_model.kernel.guard import find_unsimulated_geom_pairs
from sweep.systems.mujoco_model.kernel.layout import FREE, HFIELD, PLANE, SPHERE, RobotLayout, unsupported_model_error
from sweep.systems.mujoco_model.kernel.numbers import ModelFieldValues
from sweep.systems.mujoco_model.kernel.step import compute_forward_dynamics, read_state, write_state

STATES = 256
ALLOWED = 1e-9  # difference of accelerations, as a share of them
ITERATIONS = 60  # of both solvers, which converge here
SEED = 20
MISSED = "contacts that all random states around the start of a rollout have"


class AccelerationAgreement(NamedTuple):
    """Relative differences between the kernel's and C MuJoCo's accelerations in random states."""

    states: int
    in_contact: int
    median: float
    largest: float

    def __str__(self) -> str:
        return (
            f"accelerations of {self.states} random states, {self.in_contact} of them in contact, differ from C "
            f"MuJoCo's by {self.largest:.1g} at most (median {self.median:.1g}), in double precision"
        )

    def require_within_tolerance(self, model: str) -> None:
        """Raise `InputError` if the kernel's accelerations differ too much from those of C MuJoCo."""
        if not self.largest <= ALLOWED:
            raise InputError(
                f"engine.name = kernel is not allowed for {model}: {self}, {ALLOWED:g} is allowed (engine=native)"
            )


def draw_states(model: mujoco.MjModel, keyframe: int, count: int) -> list[mujoco.MjData]:
    """Draw random states around the start of a rollout, with the robot's lowest point just below the ground.

    Returns:
        The states, for which `mj_forward` has been called with a solver that converges.
    """
    model = _strict(model)
    rng, found = np.random.default_rng(SEED), []
    free = np.flatnonzero(model.jnt_type == FREE)
    joints = np.flatnonzero(model.jnt_type > FREE)
    planes = [g for g in range(model.ngeom) if model.geom_type[g] == PLANE]
    for k in range(count):
        data = mujoco.MjData(model)
        if keyframe >= 0:
            mujoco.mj_resetDataKeyframe(model, data, keyframe)
        spread = (0.02, 0.1, 0.35)[k % 3]
        data.qpos[model.jnt_qposadr[joints]] += spread * rng.normal(size=len(joints))
        data.qvel[:] = rng.normal(size=model.nv)
        data.ctrl[:] = data.ctrl + spread * rng.normal(size=model.nu)
        if len(free):
            at = int(model.jnt_qposadr[free[0]])
            turn, quat = spread * rng.normal(size=3), data.qpos[at + 3 : at + 7].copy()
            mujoco.mju_quatIntegrate(quat, turn, 1.0)
            data.qpos[at + 3 : at + 7] = quat
            depth = 0.01 * abs(rng.normal())
            _lower(model, data, planes, at, depth)
        data.qacc_warmstart[:] = 0
        mujoco.mj_forward(model, data)
        found.append(data)
    return found


def _lower(model: mujoco.MjModel, data: mujoco.MjData, planes: list[int], at: int, depth: float) -> None:
    """Move the robot along the first plane's normal, until the point nearest to the ground is `depth` below."""
    if not planes:
        _lower_to_field(model, data, at, depth)
        return
    mujoco.mj_kinematics(model, data)
    normal = data.geom_xmat[planes[0]].reshape(3, 3)[:, 2]
    start = data.geom_xpos[planes[0]]
    is_ground = model.body_weldid[model.geom_bodyid] == 0
    margins = model.geom_margin, model.pair_margin
    before = [one.copy() for one in margins]
    for one in margins:
        one[:] = 10.0  # all points that may touch are contacts
    mujoco.mj_fwdPosition(model, data)
    for one, values in zip(margins, before, strict=True):
        one[:] = values
    near = [float(c.dist) for c in data.contact[: data.ncon] if is_ground[c.geom1] or is_ground[c.geom2]]
    distance = min(near) if near else float(normal @ (data.qpos[at : at + 3] - start))
    data.qpos[at : at + 3] -= (distance + depth) * normal


def _lower_to_field(model: mujoco.MjModel, data: mujoco.MjData, at: int, depth: float) -> None:
    """Move the robot along the world's z axis, until a sphere's lowest point is `depth` below a height field."""
    data.qpos[at + 2] += model.stat.extent
    mujoco.mj_kinematics(model, data)
    down, near = np.array([0.0, 0.0, -1.0]), []
    spheres = (model.geom_type == SPHERE) & ((model.geom_contype | model.geom_conaffinity) != 0)
    for field in np.flatnonzero(model.geom_type == HFIELD):
        for geom in np.flatnonzero(spheres & (model.body_weldid[model.geom_bodyid] != 0)):
            distance = mujoco.mj_rayHfield(model, data, int(field), data.geom_xpos[geom], down, None)
            near += [distance - model.geom_size[geom, 0]] if distance > 0 else []
    data.qpos[at + 2] -= min(near) + depth if near else model.stat.extent


def _strict(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy whose solver converges."""
    from copy import copy

    model = copy(model)
    model.opt.iterations, model.opt.ls_iterations, model.opt.tolerance = 10 * ITERATIONS, 200, 0.0
    return model


def compare_accelerations(
    layout: RobotLayout, model: mujoco.MjModel, keyframe: int, count: int = STATES
) -> AccelerationAgreement:
    """Compare the kernel's accelerations in random states with those of MuJoCo's `mj_forward`, in double precision.

    Args:
        layout: Stacks of like bodies of the robot.
        model: The model.
        keyframe: Index of the keyframe about which states are drawn; -1 for none.
        count: Number of states.
    """
    drawn = draw_states(model, keyframe, count)
    watched = {
        frozenset(pair) for pair in find_unsimulated_geom_pairs(layout, model)
    }  # such rollouts are simulated elsewhere

    def is_simulated(data: mujoco.MjData) -> bool:
        return all(frozenset((c.geom1, c.geom2)) not in watched for c in data.contact[: data.ncon])

    chosen = [one for one in drawn if is_simulated(one)]
    if not chosen:
        raise unsupported_model_error(MISSED)
    with jax.enable_x64(True):

        def forward(qpos, qvel, warm, ctrl):
            state = read_state(layout, model, qpos, qvel, warm)
            result, _ = compute_forward_dynamics(layout, ModelFieldValues(model, {}, {}), state, ctrl, (), ITERATIONS)
            moved = state._replace(
                warm_base=result.solution.acceleration.base, warm=result.solution.acceleration.joints
            )
            found = write_state(layout, model, moved)[2]
            return jnp.append(found, jnp.asarray(result.is_unsure, found.dtype))

        shapes = [jax.ShapeDtypeStruct((size,), jnp.float64) for size in (model.nq, model.nv, model.nv, model.nu)]
        program = eager.trace_numpy_program(forward, *shapes)
        names = "qpos", "qvel", "qacc_smooth", "ctrl"
        rows = [np.stack([getattr(one, name) for one in chosen]) for name in names]
        found = np.asarray(program(len(chosen), *rows), float)
    is_sure = found[:, -1] == 0  # others are simulated elsewhere, too
    if not is_sure.any():
        raise unsupported_model_error(MISSED)
    found, chosen = found[is_sure, :-1], [one for one, sure in zip(chosen, is_sure, strict=True) if sure]
    there = np.stack([one.qacc for one in chosen])
    off = np.linalg.norm(found - there, axis=1) / np.linalg.norm(there, axis=1)
    touching = sum(one.ncon > 0 for one in chosen)
    return AccelerationAgreement(
        len(chosen), touching, float(np.median(off)), float(np.nan_to_num(off, nan=np.inf).max())
    )
