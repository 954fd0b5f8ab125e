"""Traces that were never simulated: the base moves along a line and joints swing."""

import mujoco
import numpy as np

from sweep.config.experiment import compose
from sweep.contract.engine import Trace
from sweep.engines.contact_forces import SurfaceContacts
from sweep.models import scene


def moved(*overrides):
    """Return the trace in the nominal world of `overrides`."""
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
        base_target=qpos[:, :7], stage=(time > 2).astype(int), stages=("stand", "walk"), metrics={},
        margin=1 - 0.4 * time, margin_of=np.where(time > 3, "slip_max", "fallen_tilt"), contacts=SurfaceContacts(),
    )  # fmt: skip


ARM = """<mujoco><asset><mesh name="knob" builtin="sphere" params="3" scale=".1 .1 .2"/></asset><worldbody>
<body name="trunk" pos="0 0 1"><freejoint/><geom type="ellipsoid" size=".3 .2 .1"/><geom type="mesh" mesh="knob"/>
<body pos=".3 0 0" quat=".8 0 .6 0"><joint type="slide" axis="1 2 0" ref="0.2"/><geom size=".05"/>
<body pos=".2 0 0"><joint type="ball" pos="-.1 0 0"/><geom type="box" size=".1 .05 .05"/>
<body pos=".2 0 0"><joint axis="0 1 1" pos="0 .1 0" ref="30"/><geom type="capsule" size=".02 .1"/></body></body></body>
</body></worldbody></mujoco>"""


def arm():
    """Return a trace of a model with joints and shapes of all kinds, and no feet."""
    model, frames = mujoco.MjModel.from_xml_string(ARM), 50
    time, none = 0.1 * (1 + np.arange(frames)), np.zeros((frames, 0, 3))
    qpos = np.tile(model.qpos0, (frames, 1)) + 0.3 * np.sin(time[:, None] + np.arange(model.nq))
    for start in (3, 8):
        qpos[:, start : start + 4] /= np.linalg.norm(qpos[:, start : start + 4], axis=1, keepdims=True)
    return Trace(
        world=None, belief=None, model=model, time=time, qpos=qpos, qvel=np.zeros((frames, model.nv)),
        joint_target=np.zeros((frames, 0)), joint_torque=np.zeros((frames, 2)), foot_position=none, foot_target=none,
        foot_force=none, base_target=qpos[:, :7], stage=np.zeros(frames, dtype=int), stages=("run",), metrics={},
        margin=np.full(frames, np.nan), margin_of=np.full(frames, ""),
    )  # fmt: skip


def body_places(trace, frame):
    """Return MuJoCo's positions of the bodies (m) in a frame."""
    data = mujoco.MjData(trace.model)
    data.qpos[:] = trace.qpos[frame]
    mujoco.mj_kinematics(trace.model, data)
    return data.xpos.copy()
