"""Which frames of a trace to show, and where the robot's base is in them."""

import mujoco
import numpy as np

from sweep.engines.base import Trace
from sweep.models.legs import JOINTS

BASE = "base"  # the robot's body
KINDS = ("alpha", "beta", "gamma")  # the joints of a leg, from the body outwards


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


def evenly(trace: Trace, number: int) -> np.ndarray:
    """Indices of at most `number` finite frames, evenly spaced, the first and the last among them."""
    return np.unique(np.linspace(0, finite_frames(trace) - 1, number).round().astype(int))


def base_pose(trace: Trace) -> np.ndarray:
    """Position (m) and quaternion (w, x, y, z) of the base in the world, (F, 7).

    In a model without such a body it is the first thing that moves freely; without any, the middle of the model.
    """
    model = trace.model
    free = np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE))
    if not len(free):
        return np.tile([*model.stat.center, 1.0, 0.0, 0.0, 0.0], (len(trace.qpos), 1))
    named = [joint for joint in free if model.body(model.jnt_bodyid[joint]).name == BASE]
    start = int(model.jnt_qposadr[(named or free)[0]])
    return trace.qpos[:, start : start + 7]


def joint_angle(trace: Trace) -> np.ndarray:
    """Joint angles (F, 18) in rad, leg by leg, alpha, beta, gamma."""
    return trace.qpos[:, [int(trace.model.joint(name).qposadr[0]) for name in JOINTS]]


def joint_rate(trace: Trace) -> np.ndarray:
    """Joint rates (F, 18) in rad/s, leg by leg, alpha, beta, gamma."""
    return trace.qvel[:, [int(trace.model.joint(name).dofadr[0]) for name in JOINTS]]


def mass_centres(trace: Trace, frames: slice) -> np.ndarray:
    """Mass centre of the robot (m, world) in some frames, (N, 3)."""
    data, centres = mujoco.MjData(trace.model), []
    for qpos in trace.qpos[frames]:
        data.qpos[:] = qpos
        mujoco.mj_kinematics(trace.model, data)
        mujoco.mj_comPos(trace.model, data)
        centres.append(data.subtree_com[trace.model.body(BASE).id].copy())
    return np.array(centres)
