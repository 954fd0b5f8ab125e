"""Select frames of a trace, and extract poses, joints and mass centres from it."""

import mujoco
import numpy as np

from sweep.contract.engine import Trace, hinge_and_slide_joints

BASE_BODY = "base"  # name of the robot's trunk in its model


def count_finite_frames(trace: Trace) -> int:
    """Return the number of trace frames before the simulation diverged. Raises `ValueError` if it is 0."""
    bad = ~np.isfinite(trace.qpos).all(axis=1)
    count = int(np.argmax(bad)) if bad.any() else len(bad)
    if count == 0:
        raise ValueError("the trace has no finite frame")
    return count


def frames_at_times(trace: Trace, times: np.ndarray) -> np.ndarray:
    """Return indices of the finite trace frames nearest to given times (s).

    Args:
        trace: The rollout.
        times: Times (N,), s.

    Returns:
        Indices (N,) of the frames.
    """
    clock = trace.time[: count_finite_frames(trace)]
    after = np.clip(np.searchsorted(clock, times), 1, max(len(clock) - 1, 1))
    nearest = np.where(np.abs(times - clock[after - 1]) <= np.abs(clock[after % len(clock)] - times), after - 1, after)
    return np.minimum(nearest, len(clock) - 1)


def frames_at_rate(trace: Trace, rate: float) -> np.ndarray:
    """Return indices of trace frames at a constant frame rate (1/s).

    Args:
        trace: The rollout's states over time.
        rate: Frames per simulated second.

    Returns:
        Indices of the chosen finite frames, in order; all of them where the trace has fewer.
    """
    start, end = trace.time[0], trace.time[count_finite_frames(trace) - 1]
    return np.unique(frames_at_times(trace, start + np.arange(int((end - start) * rate + 1e-6) + 1) / rate))


def base_body_id(model: mujoco.MjModel) -> int:
    """Return the body id of the robot's base in a MuJoCo model.

    This is the moving body named `base`, else the first body with a free joint, else the first that moves.
    """
    named = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, BASE_BODY)
    free = model.jnt_bodyid[model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)]
    moving = np.flatnonzero(model.body_weldid != 0)
    return next((int(body) for body in (named, *free[:1], *moving[:1]) if body in moving), 0)


def base_pose(trace: Trace) -> np.ndarray:
    """Return position (m) and quaternion (w, x, y, z) of the base in world axes at the F frames of a trace, (F, 7).

    If the base has no free joint, this is the centre of the model.
    """
    model, body = trace.model, base_body_id(trace.model)
    joint = model.body_jntadr[body]
    if joint < 0 or model.jnt_type[joint] != int(mujoco.mjtJoint.mjJNT_FREE):
        return np.tile([*model.stat.center, 1.0, 0.0, 0.0, 0.0], (len(trace.qpos), 1))
    start = int(model.jnt_qposadr[joint])
    return trace.qpos[:, start : start + 7]


def joint_positions(trace: Trace) -> np.ndarray:
    """Return the positions (rad or m) of the J hinge and slide joints at the F frames of a trace, (F, J)."""
    return trace.qpos[:, trace.model.jnt_qposadr[hinge_and_slide_joints(trace.model)]]


def joint_rates(trace: Trace) -> np.ndarray:
    """Return the rates of J hinge and slide joints (rad/s or m/s) at F frames of a trace, (F, J)."""
    return trace.qvel[:, trace.model.jnt_dofadr[hinge_and_slide_joints(trace.model)]]


def joint_names(model: mujoco.MjModel) -> list[str]:
    """Return the names of all hinge and slide joints in the model's order."""
    return [model.joint(joint).name or f"joint_{joint}" for joint in hinge_and_slide_joints(model)]


def centres_of_mass(trace: Trace, frames: slice) -> np.ndarray:
    """Compute the robot's mass centre at some frames of a trace.

    Args:
        trace: The trace, with its MuJoCo model.
        frames: Which of its frames.

    Returns:
        Positions (N, 3), m, world axes.
    """
    data, centres = mujoco.MjData(trace.model), []
    for qpos in trace.qpos[frames]:
        data.qpos[:] = qpos
        mujoco.mj_kinematics(trace.model, data)
        mujoco.mj_comPos(trace.model, data)
        centres.append(data.subtree_com[trace.model.body(BASE_BODY).id].copy())
    return np.array(centres)
