"""Export of a trace as an MCAP file for Foxglove: robot, contact forces, joints, loads, stages, outcome,
configuration."""

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

from sweep.contract.engine import Trace
from sweep.contract.trace_frames import count_finite_frames, frames_at_rate, joint_names, joint_positions, joint_rates
from sweep.core.errors import Fault
from sweep.core.files import path_descriptor, write_atomically
from sweep.core.json_values import to_json_value
from sweep.replay.arrows import ARROW_RADIUS, FORCE_COLOR, arrow_tips
from sweep.replay.layout import foxglove_layout
from sweep.replay.model_geoms import body_name, moving_body_ids
from sweep.replay.shapes import WORLD, foxglove_quaternion, foxglove_vector, scene_entities

PICTURE_RATE = 50.0  # Hz, of transforms and arrows; joints and loads are written every tick, so that no peak is lost

_STAGE_SCHEMA = {
    "title": "sweep.Stage",
    "type": "object",
    "properties": {"index": {"type": "integer"}, "name": {"type": "string"}},
}


def write_mcap(path: str | Path, trace: Trace, config: Mapping[str, Any], outcome: Mapping[str, Any]) -> None:
    """Write a recorded rollout as an MCAP file, and a Foxglove layout beside it (`<name>.layout.json`).

    Only finite frames are written. Log times are simulated time. The same input gives the same bytes.

    Args:
        path: The file. A device, such as /dev/stdout, gets no layout.
        trace: The rollout.
        config: Configuration of the study, attached as `config.json`.
        outcome: Outcome and metrics, written as a message at the start and as a metadata record.

    Raises:
        ValueError: The trace has no finite frame.
        Fault: The disk refuses the write.
    """
    path = Path(path)
    try:
        write_atomically(path, partial(_write, trace=trace, config=config, outcome=outcome))
    except RuntimeError as error:  # Foxglove's error for a full disk, from the write that fails or a later one
        if not any(words in str(error) for words in ("I/O error", "after a write method failed")):
            raise
        raise Fault(f"{path} cannot be written: {error}") from None
    if path.is_file() and path_descriptor(path) is None:
        write_atomically(path.with_suffix(".layout.json"), f"{json.dumps(foxglove_layout(trace), indent=1)}\n".encode())


def _write(path: Path, trace: Trace, config: Mapping[str, Any], outcome: Mapping[str, Any]) -> None:
    # one thread: the compressor's blocks would depend on the machine's number of cores otherwise
    options = MCAPWriteOptions(profile="", compression_threads=0)
    context = Context()  # channels of the global context would leak into the next file
    with foxglove.open_mcap(path, allow_overwrite=True, context=context, writer_options=options) as writer:
        came = dict(sorted(to_json_value(outcome).items()))
        writer.write_metadata("outcome", {key: "" if value is None else str(value) for key, value in came.items()})
        data = json.dumps(to_json_value(config), indent=1, sort_keys=True).encode()
        writer.attach(log_time=0, create_time=0, name="config.json", media_type="application/json", data=data)
        schema = {"title": "sweep.Outcome", "type": "object", "properties": {key: {} for key in came}}
        Channel("/outcome", schema=schema, context=context).log(came, log_time=_nanoseconds(trace.time[0]))
        _write_stages(context, trace)
        _write_pictures(context, trace)
        _write_joints(context, trace)
        if trace.foot_force.shape[1]:
            _write_loads(context, trace)


def _nanoseconds(seconds: Any) -> int:
    return round(float(seconds) * 1e9)


def _timestamp(nanoseconds: int) -> Timestamp:
    return Timestamp(*divmod(nanoseconds, 10**9))


def _write_stages(context: Context, trace: Trace) -> None:
    channel = Channel("/stage", schema=_STAGE_SCHEMA, context=context)
    stage = trace.stage[: count_finite_frames(trace)]
    for k in np.flatnonzero(np.diff(stage, prepend=-1)):
        message = {"index": int(stage[k]), "name": trace.stages[stage[k]]}
        channel.log(message, log_time=_nanoseconds(trace.time[k]))


def _write_joints(context: Context, trace: Trace) -> None:
    """Write angle (rad or m), rate (rad/s or m/s) and largest torque of the tick (N m or N) of every joint."""
    channel, names = JointStatesChannel("/joint_states", context=context), joint_names(trace.model)
    angle, rate, torque = (
        values.tolist() for values in (joint_positions(trace), joint_rates(trace), trace.joint_torque)
    )
    for k in range(count_finite_frames(trace)):
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
    for k in range(count_finite_frames(trace)):
        channel.log(dict(zip(feet, to_json_value(load[k]), strict=True)), log_time=_nanoseconds(trace.time[k]))


def _write_pictures(context: Context, trace: Trace) -> None:
    """Write the geoms once, then transforms of the moving bodies and force arrows at `PICTURE_RATE`."""
    scene = SceneUpdateChannel("/scene", context=context)
    forces = SceneUpdateChannel("/contact_force", context=context)
    transforms = FrameTransformsChannel("/tf", context=context)
    model, data = trace.model, mujoco.MjData(trace.model)
    names = {int(body): body_name(model, body) for body in moving_body_ids(model)}
    scene.log(SceneUpdate(entities=scene_entities(model)), log_time=_nanoseconds(trace.time[0]))
    for k in frames_at_rate(trace, PICTURE_RATE):
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
            translation=foxglove_vector(data.xpos[body]),
            rotation=foxglove_quaternion(data.xquat[body]),
        )
        for body, name in names.items()
    ]


def _force_entity(position: np.ndarray, force: np.ndarray, time: int) -> SceneEntity:
    """All force arrows under one id, so that every update replaces the one before."""
    tips = arrow_tips(position, force)
    return SceneEntity(
        timestamp=_timestamp(time),
        frame_id=WORLD,
        id="contact_force",
        lifetime=Duration(0, 0),
        arrows=[_arrow(tail, tip) for tail, tip in zip(position, tips, strict=True) if np.any(tail != tip)],
    )


def rotation_from_x_axis(direction: np.ndarray) -> np.ndarray:
    """Return the quaternion (w, x, y, z) that rotates the x axis to `direction` (3,); Foxglove draws arrows along x."""
    x_to_z = np.array([math.sqrt(0.5), 0.0, -math.sqrt(0.5), 0.0])
    z_to_direction, both = np.empty(4), np.empty(4)
    mujoco.mju_quatZ2Vec(z_to_direction, direction)
    mujoco.mju_mulQuat(both, z_to_direction, x_to_z)
    return both


def _arrow(tail: np.ndarray, tip: np.ndarray) -> ArrowPrimitive:
    length = float(np.linalg.norm(tip - tail))
    head = min(3 * ARROW_RADIUS, length / 2)
    return ArrowPrimitive(
        pose=Pose(position=foxglove_vector(tail), orientation=foxglove_quaternion(rotation_from_x_axis(tip - tail))),
        shaft_length=length - head,
        shaft_diameter=2 * ARROW_RADIUS,
        head_length=head,
        head_diameter=3 * ARROW_RADIUS,
        color=Color(r=FORCE_COLOR[0], g=FORCE_COLOR[1], b=FORCE_COLOR[2], a=1.0),
    )
