"""A trace as an MCAP file for Foxglove: moving robot, contact forces, joints, loads, stages, outcome, configuration."""

import json
import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import foxglove
import mujoco
import numpy as np
from foxglove import Channel, Context
from foxglove.channels import FrameTransformsChannel, JointStatesChannel, SceneUpdateChannel
from foxglove.mcap import MCAPWriteOptions
from foxglove.messages import (
    ArrowPrimitive,
    Color,
    Duration,
    FrameTransform,
    FrameTransforms,
    JointState,
    JointStates,
    Pose,
    SceneEntity,
    SceneUpdate,
    Timestamp,
)

from sweep.core.errors import Fault
from sweep.core.files import descriptor, write_atomically
from sweep.engines.base import Trace
from sweep.trace.arrows import ARROW_RADIUS, FORCE_COLOR, arrow_tips
from sweep.trace.layout import layout
from sweep.trace.sampling import at_rate, finite_frames, joint_angle, joint_names, joint_rate
from sweep.trace.shapes import WORLD, body_name, entities, moving_bodies, quaternion, vector

PICTURE_RATE = (
    50.0  # Hz, of transforms and arrows; joints and loads are written every tick, a peak must not fall between
)

_STAGE_SCHEMA = {
    "title": "sweep.Stage",
    "type": "object",
    "properties": {"index": {"type": "integer"}, "name": {"type": "string"}},
}


def write_mcap(path: str | Path, trace: Trace, config: Mapping[str, Any], outcome: Mapping[str, Any]) -> None:
    """Write `trace` to `path`, and a Foxglove layout beside it (`<name>.layout.json`); beside a device none.

    `config` is attached as `config.json`; `outcome` is a message at the start and a metadata record. Log times
    are simulated time. The same input gives the same bytes. Only finite frames are written; raises `ValueError`
    if there are none.
    """
    path = Path(path)
    try:
        write_atomically(path, partial(_write, trace=trace, config=config, outcome=outcome))
    except RuntimeError as error:  # as Foxglove tells of a full disk, by the write that fails or by one after it
        if not any(words in str(error) for words in ("I/O error", "after a write method failed")):
            raise
        raise Fault(f"{path} cannot be written: {error}") from None
    if path.is_file() and descriptor(path) is None:
        write_atomically(path.with_suffix(".layout.json"), f"{json.dumps(layout(trace), indent=1)}\n".encode())


def _write(path: Path, trace: Trace, config: Mapping[str, Any], outcome: Mapping[str, Any]) -> None:
    # one thread: the compressor's blocks would depend on the machine's number of cores otherwise
    options = MCAPWriteOptions(profile="", compression_threads=0)
    context = Context()  # of its own: channels of the global one would leak into the next file
    with foxglove.open_mcap(path, allow_overwrite=True, context=context, writer_options=options) as writer:
        came = dict(sorted(plain(outcome).items()))
        writer.write_metadata("outcome", {key: "" if value is None else str(value) for key, value in came.items()})
        data = json.dumps(plain(config), indent=1, sort_keys=True).encode()
        writer.attach(log_time=0, create_time=0, name="config.json", media_type="application/json", data=data)
        schema = {"title": "sweep.Outcome", "type": "object", "properties": {key: {} for key in came}}
        Channel("/outcome", schema=schema, context=context).log(came, log_time=_nanoseconds(trace.time[0]))
        _write_stages(context, trace)
        _write_pictures(context, trace)
        _write_joints(context, trace)
        if trace.foot_force.shape[1]:
            _write_loads(context, trace)


def plain(value: Any) -> Any:
    """`value` as JSON can hold it: numpy becomes Python, what is not finite becomes None, keys are words."""
    match value:
        case Mapping():
            return {str(key): plain(one) for key, one in value.items()}
        case np.ndarray() | np.generic():
            return plain(value.tolist())
        case list() | tuple():
            return [plain(item) for item in value]
        case float():
            return value if math.isfinite(value) else None
        case None | bool() | int() | str():
            return value
        case _:
            return str(value)


def _nanoseconds(seconds: Any) -> int:
    return round(float(seconds) * 1e9)


def _timestamp(nanoseconds: int) -> Timestamp:
    return Timestamp(*divmod(nanoseconds, 10**9))


def _write_stages(context: Context, trace: Trace) -> None:
    channel = Channel("/stage", schema=_STAGE_SCHEMA, context=context)
    stage = trace.stage[: finite_frames(trace)]
    for k in np.flatnonzero(np.diff(stage, prepend=-1)):
        message = {"index": int(stage[k]), "name": trace.stages[stage[k]]}
        channel.log(message, log_time=_nanoseconds(trace.time[k]))


def _write_joints(context: Context, trace: Trace) -> None:
    """Angle (rad), rate (rad/s) and largest torque of the tick (N m) of every joint; of a slide m, m/s, N."""
    channel, names = JointStatesChannel("/joint_states", context=context), joint_names(trace.model)
    angle, rate, torque = (values.tolist() for values in (joint_angle(trace), joint_rate(trace), trace.joint_torque))
    for k in range(finite_frames(trace)):
        time = _nanoseconds(trace.time[k])
        joints = [
            JointState(name=name, position=q, velocity=v, effort=effort)
            for name, q, v, effort in zip(names, angle[k], rate[k], torque[k], strict=True)
        ]
        channel.log(JointStates(timestamp=_timestamp(time), joints=joints), log_time=time)


def _write_loads(context: Context, trace: Trace) -> None:
    feet = [f"foot{leg + 1}" for leg in range(trace.foot_force.shape[1])]
    schema = {
        "title": "sweep.FootLoad",
        "description": "force on each foot, mean of the control tick, N",
        "type": "object",
        "properties": {foot: {"type": "number"} for foot in feet},
    }
    channel = Channel("/foot_load", schema=schema, context=context)
    load = np.linalg.norm(trace.foot_force, axis=-1)
    for k in range(finite_frames(trace)):
        channel.log(dict(zip(feet, plain(load[k]), strict=True)), log_time=_nanoseconds(trace.time[k]))


def _write_pictures(context: Context, trace: Trace) -> None:
    """Shapes once, then transforms of the moving bodies and force arrows."""
    scene = SceneUpdateChannel("/scene", context=context)
    forces = SceneUpdateChannel("/contact_force", context=context)
    transforms = FrameTransformsChannel("/tf", context=context)
    model, data = trace.model, mujoco.MjData(trace.model)
    names = {int(body): body_name(model, body) for body in moving_bodies(model)}
    scene.log(SceneUpdate(entities=entities(model)), log_time=_nanoseconds(trace.time[0]))
    for k in at_rate(trace, PICTURE_RATE):
        time = _nanoseconds(trace.time[k])
        data.qpos[:] = trace.qpos[k]
        mujoco.mj_kinematics(model, data)
        transforms.log(FrameTransforms(transforms=_transforms(data, names, time)), log_time=time)
        entity = _force_entity(trace.foot_position[k], trace.foot_force[k], time)
        forces.log(SceneUpdate(entities=[entity]), log_time=time)


def _transforms(data: mujoco.MjData, names: dict[int, str], time: int) -> list[FrameTransform]:
    return [
        FrameTransform(
            timestamp=_timestamp(time),
            parent_frame_id=WORLD,
            child_frame_id=name,
            translation=vector(data.xpos[body]),
            rotation=quaternion(data.xquat[body]),
        )
        for body, name in names.items()
    ]


def _force_entity(position: np.ndarray, force: np.ndarray, time: int) -> SceneEntity:
    """All force arrows under one id: every update replaces the one before."""
    tips = arrow_tips(position, force)
    return SceneEntity(
        timestamp=_timestamp(time),
        frame_id=WORLD,
        id="contact_force",
        lifetime=Duration(0, 0),
        arrows=[_arrow(tail, tip) for tail, tip in zip(position, tips, strict=True) if np.any(tail != tip)],
    )


def turn_x_to(direction: np.ndarray) -> np.ndarray:
    """Quaternion (w, x, y, z) that turns the x axis, along which Foxglove draws arrows, into `direction` (3,)."""
    x_to_z = np.array([math.sqrt(0.5), 0.0, -math.sqrt(0.5), 0.0])
    z_to_direction, both = np.empty(4), np.empty(4)
    mujoco.mju_quatZ2Vec(z_to_direction, direction)
    mujoco.mju_mulQuat(both, z_to_direction, x_to_z)
    return both


def _arrow(tail: np.ndarray, tip: np.ndarray) -> ArrowPrimitive:
    length = float(np.linalg.norm(tip - tail))
    head = min(3 * ARROW_RADIUS, length / 2)
    return ArrowPrimitive(
        pose=Pose(position=vector(tail), orientation=quaternion(turn_x_to(tip - tail))),
        shaft_length=length - head,
        shaft_diameter=2 * ARROW_RADIUS,
        head_length=head,
        head_diameter=3 * ARROW_RADIUS,
        color=Color(r=FORCE_COLOR[0], g=FORCE_COLOR[1], b=FORCE_COLOR[2], a=1.0),
    )
