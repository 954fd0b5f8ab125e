"""A trace of the robot that was never simulated: its base goes along a line, its joints swing."""

import mujoco
import numpy as np

from sweep.engines.base import Trace
from sweep.models import scene
from sweep.study.config import compose


def moved(*overrides):
    """The trace, of the nominal world that `overrides` describe."""
    case = compose(list(overrides)).case
    model, frames = scene.compile_model(case), 50
    time = 0.1 * (1 + np.arange(frames))
    qpos = np.tile(model.qpos0, (frames, 1))
    qpos[:, 7:25] = 0.3 * np.sin(time[:, None] + np.arange(18))
    qpos[:, :3] = np.column_stack([0.2 * time, 1.5 - 0.1 * time, 0.5 + 0 * time])
    qpos[:, 3], qpos[:, 6] = np.cos(0.1 * time), np.sin(0.1 * time)
    none, force = np.zeros((frames, 18)), np.zeros((frames, 6, 3))
    force[:, ::2, 2] = 90.0
    return Trace(
        world=case, belief=case, model=model, time=time, qpos=qpos, qvel=np.zeros((frames, model.nv)),
        joint_target=none, joint_torque=none, foot_position=force, foot_target=force, foot_force=force,
        base_target=qpos[:, :7], stage=(time > 2).astype(int), stages=("stand", "walk"), figures={},
        margin=1 - 0.4 * time, margin_of=np.where(time > 3, "slip_max", "fallen_tilt"),
    )  # fmt: skip


def body_places(trace, frame):
    """Where MuJoCo has the bodies (m) in a frame."""
    data = mujoco.MjData(trace.model)
    data.qpos[:] = trace.qpos[frame]
    mujoco.mj_kinematics(trace.model, data)
    return data.xpos.copy()
