"""Which frames of a trace to show, and where the robot's base is in them."""

import mujoco
import numpy as np

from sweep.engines.base import Trace, single_joints

BASE = "base"  # the robot's body


def finite_frames(trace: Trace) -> int:
    """Number of frames before the simulation stopped being finite; at least 1 or `ValueError`."""
    bad = ~np.isfinite(trace.qpos).all(axis=1)
    count = int(np.argmax(bad)) if bad.any() else len(bad)
    if count == 0:
        raise ValueError("the trace has no finite frame")
    return count


def at_times(trace: Trace, times: np.ndarray) -> np.ndarray:
    """Indices (N,) of the finite frames nearest to `times` (s)."""
    clock = trace.time[: finite_frames(trace)]
    after = np.clip(np.searchsorted(clock, times), 1, max(len(clock) - 1, 1))
    nearest = np.where(np.abs(times - clock[after - 1]) <= np.abs(clock[after % len(clock)] - times), after - 1, after)
    return np.minimum(nearest, len(clock) - 1)


def at_rate(trace: Trace, rate: float) -> np.ndarray:
    """Indices of finite frames, `rate` of them per simulated second, or every frame if there are fewer."""
    start, end = trace.time[0], trace.time[finite_frames(trace) - 1]
    return np.unique(at_times(trace, start + np.arange(int((end - start) * rate + 1e-6) + 1) / rate))


def base_body(model: mujoco.MjModel) -> int:
    """The robot's body: the one called base if that moves, the first that is free, or the first that moves."""
    named = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, BASE)
    free = model.jnt_bodyid[model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)]
    moving = np.flatnonzero(model.body_weldid != 0)
    return next((int(body) for body in (named, *free[:1], *moving[:1]) if body in moving), 0)


def base_pose(trace: Trace) -> np.ndarray:
    """Position (m) and quaternion (w, x, y, z) of the base in the world, (F, 7).

    Where it is not free, the middle of the model.
    """
    model, body = trace.model, base_body(trace.model)
    joint = model.body_jntadr[body]
    if joint < 0 or model.jnt_type[joint] != int(mujoco.mjtJoint.mjJNT_FREE):
        return np.tile([*model.stat.center, 1.0, 0.0, 0.0, 0.0], (len(trace.qpos), 1))
    start = int(model.jnt_qposadr[joint])
    return trace.qpos[:, start : start + 7]


def joint_angle(trace: Trace) -> np.ndarray:
    """Places (F, J) of the `single_joints`, rad or m; of the six-legged robot leg by leg, alpha, beta, gamma."""
    return trace.qpos[:, trace.model.jnt_qposadr[single_joints(trace.model)]]


def joint_rate(trace: Trace) -> np.ndarray:
    """Rates (F, J) of the same, rad/s or m/s."""
    return trace.qvel[:, trace.model.jnt_dofadr[single_joints(trace.model)]]


def joint_names(model: mujoco.MjModel) -> list[str]:
    """What the `single_joints` are called."""
    return [model.joint(joint).name or f"joint_{joint}" for joint in single_joints(model)]


def mass_centres(trace: Trace, frames: slice) -> np.ndarray:
    """Mass centre of the robot (m, world) in some frames, (N, 3)."""
    data, centres = mujoco.MjData(trace.model), []
    for qpos in trace.qpos[frames]:
        data.qpos[:] = qpos
        mujoco.mj_kinematics(trace.model, data)
        mujoco.mj_comPos(trace.model, data)
        centres.append(data.subtree_com[trace.model.body(BASE).id].copy())
    return np.array(centres)
