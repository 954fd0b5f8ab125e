"""Encoding of a rollout's motion for the HTML page: bodies and geoms once, states as compressed text.

`page/kinematics.js` reads both. The states are a stream of F frames with these columns: MuJoCo's `qpos`, the forces of
the feet, the stage, the torques of the joints, the margin and the index of its limit in `limits`, the share of
friction that each foot uses, and the lines of `signals`. All are whole numbers. A column is stored as differences from
frame to frame, first all low bytes, then all high bytes, which deflates to a third. Only `qpos` has high bytes.
"""

from typing import Any

import mujoco
import numpy as np

from sweep.contract.engine import Trace, hinge_and_slide_joints
from sweep.contract.trace_frames import base_body_id, count_finite_frames, joint_names
from sweep.core.files import deflate_to_base64, inflate_base64
from sweep.replay.height_fields import sample_height_field
from sweep.replay.hulls import geom_hull
from sweep.replay.meshes import simplify_meshes
from sweep.replay.model_geoms import VISIBLE_GROUPS, geom_color

MAX_RATE = 10.0  # frames per second, at most
MAX_CHARACTERS = 40_000  # largest number of characters in the states of a rollout; a longer one gets fewer frames
QPOS_RESOLUTION = 1e-3  # resolution of `qpos` in m and rad; coarser where int16 could not hold the largest value
QUATERNION_RESOLUTION = 1e-4  # resolution of quaternions
INT8, INT16 = 2**7 - 1, 2**15 - 1  # largest values
FORCE_LEVELS = 50  # integer of the largest force
MARGIN_LEVELS = 100  # integer of a margin of 1; margins are clipped at -1
FRICTION_LEVELS = 20  # integer of a foot that uses all friction
SIGNAL_LEVELS = 120  # integer of the largest value of a further column, and negative of the smallest
DECIMALS = 4  # decimals of lengths (m) and directions of bodies and geoms
Kind = mujoco.mjtGeom
HIDDEN_GEOMS = (Kind.mjGEOM_SDF,)  # geoms that the page cannot draw
SHAPES = {
    Kind.mjGEOM_PLANE: "plane",
    Kind.mjGEOM_SPHERE: "sphere",
    Kind.mjGEOM_CAPSULE: "capsule",
    Kind.mjGEOM_CYLINDER: "cylinder",
    Kind.mjGEOM_BOX: "box",
}


def encode_motion(trace: Trace) -> dict[str, Any]:
    """Encode the finite frames of a recorded rollout as plain values for JSON.

    Returns:
        `states`, the encoded stream in base64, at most `MAX_CHARACTERS`, for which frames are dropped if necessary;
        `frames`, their number; `step` (s), the time between frames, and of the first one; and the units of the whole
        numbers: `scales` (nq,) for `qpos`, `force_scale` (N), `torque_scale` (N m), `margin_scale`, `friction_scale`.
            `limits` are the names of the limits to which margins belong; `torque_limit` is in N m. `signals` are the
            trace's groups of columns, see `describe_signals`, and `pushes` the pushes, see `describe_pushes`.
    """
    frames = count_finite_frames(trace)
    qpos = np.asarray(trace.qpos[:frames], float)
    scales = np.maximum(qpos_resolution(trace.model), np.abs(qpos).max(axis=0) / INT16)
    force = np.asarray(trace.foot_force[:frames], float)
    force = force.reshape(frames, force[0].size)
    force_scale = max(float(np.nan_to_num(np.abs(force)).max(initial=0)) / FORCE_LEVELS, 1e-6)
    torque = np.nan_to_num(np.asarray(trace.joint_torque[:frames], float))
    torque_scale = max(float(np.abs(torque).max(initial=0)) / FORCE_LEVELS, 1e-6)
    known = np.isfinite(trace.margin[:frames]).any()
    limits = sorted(set(trace.margin_of[:frames])) if known else []
    small = [np.round(np.nan_to_num(force) / force_scale), trace.stage[:frames], np.round(torque / torque_scale)]
    if known:
        margin = np.nan_to_num(trace.margin[:frames], nan=-1.0).clip(-1.0, 1.0)
        small += [np.round(MARGIN_LEVELS * margin), np.searchsorted(limits, trace.margin_of[:frames])]
    if trace.contacts:
        share = np.nan_to_num(trace.contacts.friction_utilization(trace)[:frames])
        small.append(np.round(FRICTION_LEVELS * share).clip(0, INT8))
    signals = describe_signals(trace, frames)
    for group in signals:
        lines = zip(group["columns"], group["middles"], group["steps"], strict=True)
        small += [
            np.round((_finite_column(trace, name, frames) - middle) / step).clip(-INT8, INT8)
            for name, middle, step in lines
        ]
    whole = {
        "step": float(trace.time[0]),
        "frames": frames,
        "scales": [float(f"{scale:.6g}") for scale in scales],
        "force_scale": float(f"{force_scale:.6g}"),
        "torque_scale": float(f"{torque_scale:.6g}"),
        "torque_limit": trace.torque_limit,
        "margin_scale": 1 / MARGIN_LEVELS,
        "friction_scale": 1 / FRICTION_LEVELS,
        "limits": limits,
        "signals": signals,
        "pushes": describe_pushes(trace),
        "states": encode_states(np.round(qpos / scales).astype(np.int16), np.column_stack(small).astype(np.int8)),
    }
    kept, every = whole, 1
    while len(kept["states"]) > MAX_CHARACTERS and every < frames:
        every += 1
        kept = thin_motion(whole, every)
    return kept


def describe_signals(trace: Trace, frames: int) -> list[dict[str, Any]]:
    """Describe the groups of further columns of a trace, and how their values become whole numbers.

    Args:
        trace: The rollout.
        frames: Number of its frames.

    Returns:
        For each group its `title` with the unit, and for each line the column in `columns`, its name in `names`, the
        value of 0 in `middles` and of a step in `steps`.
    """
    signals = []
    for group in trace.groups:
        values = [_finite_column(trace, name, frames) for name in group.columns]
        ends = [(float(one.min()), float(one.max())) for one in values]
        signals.append(
            {
                "title": f"{group.title} [{group.unit}]" if group.unit else group.title,
                "columns": list(group.columns),
                "names": list(group.columns.values()),
                "middles": [float(f"{(low + high) / 2:.6g}") for low, high in ends],
                "steps": [float(f"{max((high - low) / 2 / SIGNAL_LEVELS, 1e-9):.6g}") for low, high in ends],
            }
        )
    return signals


def _finite_column(trace: Trace, name: str, frames: int) -> np.ndarray:
    return np.nan_to_num(np.asarray(trace.columns[name][:frames], float), posinf=0.0, neginf=0.0)


def describe_pushes(trace: Trace) -> list[dict[str, Any]]:
    """Describe the pushes of a trace: body, its centre of mass in its own axes (m), force (N), start and end (s)."""
    return [
        {
            "body": push.body,
            "point": round_values(trace.model.body_ipos[push.body]),
            "force": round_values(push.force),
            "start": float(push.start),
            "end": float(push.end),
        }
        for push in trace.pushes
        if np.any(push.force)
    ]


def thin_motion(motion: dict[str, Any], every: int) -> dict[str, Any]:
    """Keep every `every`-th frame of an encoded motion.

    The page interpolates between frames by a cubic.

    Args:
        motion: The result of `encode_motion`.
        every: Frames from one that is kept to the next.
    """
    frames, columns = motion["frames"], len(motion["scales"])
    content = inflate_base64(motion["states"])
    states = decode_byte_planes(content[: 2 * frames * columns], frames, np.dtype(np.int16))
    small = decode_byte_planes(content[2 * frames * columns :], frames, np.dtype(np.int8))
    every = min(every, frames)
    chosen = slice(every - 1, None, every)
    return {
        **motion,
        "step": motion["step"] * every,
        "frames": frames // every,
        "states": encode_states(states[chosen], small[chosen]),
    }


def encode_states(states: np.ndarray, small: np.ndarray) -> str:
    """Encode recorded states, F frames of two-byte and of one-byte integers, as text."""
    return deflate_to_base64(encode_byte_planes(states) + encode_byte_planes(small))


def encode_byte_planes(values: np.ndarray) -> bytes:
    """Encode integers (F, K) as row-to-row differences, column by column, low bytes before high bytes."""
    change = np.diff(values, axis=0, prepend=np.zeros_like(values[:1])).T  # wraps around, and back when it is summed
    size = values.dtype.itemsize
    return (
        np.ascontiguousarray(change)
        .astype(f"<i{size}")
        .view(np.uint8)
        .reshape(*change.shape, size)
        .transpose(0, 2, 1)
        .tobytes()
    )


def decode_byte_planes(content: bytes, frames: int, kind: np.dtype) -> np.ndarray:
    """Decode the bytes of `encode_byte_planes` into integers (frames, K) of type `kind`."""
    size = kind.itemsize
    change = np.frombuffer(content, np.uint8).reshape(-1, size, frames).transpose(0, 2, 1)
    change = np.ascontiguousarray(change).view(f"<i{size}")[..., 0]
    return np.cumsum(change, axis=1, dtype=kind).T


def qpos_resolution(model: mujoco.MjModel) -> np.ndarray:
    """Return the smallest step (nq,) in which each coordinate of `qpos` is encoded."""
    fine = np.full(model.nq, QPOS_RESOLUTION)
    for joint in range(model.njnt):
        turned = {int(mujoco.mjtJoint.mjJNT_FREE): 3, int(mujoco.mjtJoint.mjJNT_BALL): 0}.get(model.jnt_type[joint])
        if turned is not None:
            start = model.jnt_qposadr[joint] + turned
            fine[start : start + 4] = QUATERNION_RESOLUTION
    return fine


def describe_bodies(model: mujoco.MjModel, legs: int, way: np.ndarray | None = None) -> dict[str, Any]:
    """Describe the bodies of a model, their joints and visible geoms, as plain values for JSON.

    Args:
        model: The MuJoCo model.
        legs: Number of the robot's legs.
        way: Positions (n, 3) of the base in m, world axes, around which terrain is drawn; None for all of it.

    Returns:
        `bodies`: index of the parent, position and quaternion in it, and joints, see `describe_joint`. `geoms`: body,
        shape, size (of a mesh: its number in `meshes`; of a convex hull: vertices and faces; of a height field: see
        `describe_height_field`), position, quaternion, colour, and whether it is the robot's. `meshes`: vertices (m)
        and triangles, see `simplify_meshes`.
        `feet`: body and position of each foot. `hinges`: addresses of the `hinge_and_slide_joints` in `qpos`, and
        `hinge_names` their names.
    """
    root = model.body_rootid[base_body_id(model)]
    drawn = [g for g in range(model.ngeom) if model.geom_group[g] < VISIBLE_GROUPS and model.geom_rgba[g, 3] > 0]
    drawn = [g for g in drawn if Kind(model.geom_type[g]) not in HIDDEN_GEOMS]
    feet = [model.site(f"foot{leg}") for leg in range(1, legs + 1)]
    meshes = simplify_meshes(model, [g for g in drawn if model.geom_type[g] == Kind.mjGEOM_MESH])
    numbers = {mesh: number for number, mesh in enumerate(meshes)}
    return {
        "bodies": [
            {
                "parent": int(model.body_parentid[body]),
                "pos": round_values(model.body_pos[body]),
                "quat": round_values(model.body_quat[body]),
                "joints": [
                    describe_joint(model, int(j)) for j in model.body_jntadr[body] + np.arange(model.body_jntnum[body])
                ],
            }
            for body in range(model.nbody)
        ],
        "geoms": [
            {
                "body": int(model.geom_bodyid[geom]),
                "robot": bool(model.body_rootid[model.geom_bodyid[geom]] == root),
                "pos": round_values(model.geom_pos[geom]),
                "quat": round_values(model.geom_quat[geom]),
                "colour": [round(255 * float(part)) for part in geom_color(model, geom)[:3]],
                **describe_geom_shape(model, geom, way, numbers),
            }
            for geom in drawn
        ],
        "meshes": [
            {"vertices": [round_values(v) for v in mesh.vertices], "faces": mesh.faces.tolist()}
            for mesh in meshes.values()
        ],
        "feet": [[int(site.bodyid[0]), *round_values(site.pos)] for site in feet],
        "hinges": model.jnt_qposadr[hinge_and_slide_joints(model)].tolist(),
        "hinge_names": joint_names(model),
    }


def describe_joint(model: mujoco.MjModel, number: int) -> list[float]:
    """Describe a joint as a list of numbers that begins with its address in `qpos`.

    A free joint has nothing else. A hinge has axis and anchor, a ball joint zeros and its anchor, a slide its axis.
    Hinge and slide end with their coordinate in the model's reference pose, where that is not zero.
    """
    address = int(model.jnt_qposadr[number])
    axis, anchor, start = (
        round_values(model.jnt_axis[number]),
        round_values(model.jnt_pos[number]),
        float(model.qpos0[address]),
    )
    match model.jnt_type[number]:
        case mujoco.mjtJoint.mjJNT_FREE:
            return [address]
        case mujoco.mjtJoint.mjJNT_BALL:
            return [address, 0.0, 0.0, 0.0, *anchor]
        case mujoco.mjtJoint.mjJNT_SLIDE:
            return [address, *axis, *([start] if start else [])]
        case _:
            return [address, *axis, *anchor, *([start] if start else [])]


def describe_geom_shape(
    model: mujoco.MjModel, geom: int, way: np.ndarray | None, meshes: dict[int, int]
) -> dict[str, Any]:
    """Describe shape and size (m) of a geom for the page; shapes that the page cannot draw become their convex hull.

    Args:
        model: The MuJoCo model.
        geom: Id of the geom.
        way: See `describe_bodies`.
        meshes: Number of each mesh in the list `meshes`, by its id.
    """
    kind = Kind(model.geom_type[geom])
    if kind == Kind.mjGEOM_HFIELD:
        return {"shape": "field", **describe_height_field(model, geom, way)}
    if kind in SHAPES:
        return {"shape": SHAPES[kind], "size": round_values(model.geom_size[geom])}
    if kind == Kind.mjGEOM_MESH:
        return {"shape": "mesh", "mesh": meshes[int(model.geom_dataid[geom])]}
    vertices, faces = geom_hull(model, geom)
    return {"shape": "mesh", "vertices": [round_values(v) for v in vertices], "faces": faces}


def describe_height_field(model: mujoco.MjModel, geom: int, way: np.ndarray | None) -> dict[str, Any]:
    """Describe a fixed height field by the coordinates and heights (m) of its points in the geom's axes.

    Args:
        model: The MuJoCo model.
        geom: Id of the geom.
        way: See `describe_bodies`.

    Returns:
        `x` and `y` in the geom's axes, and `heights`, row by row, in m.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    turn = data.geom_xmat[geom].reshape(3, 3)
    grid = sample_height_field(model, geom, None if way is None else (way - data.geom_xpos[geom]) @ turn)
    return {"x": round_values(grid.x), "y": round_values(grid.y), "heights": round_values(grid.heights.ravel())}


def round_values(values: np.ndarray) -> list[float]:
    """Round numbers to `DECIMALS` decimals."""
    return [float(f"{value:.{DECIMALS}f}") + 0.0 for value in np.asarray(values, float)]
