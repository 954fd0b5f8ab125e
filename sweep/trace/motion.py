"""A rollout for a page: its bodies and geoms once, its states as a small stream of whole numbers.

`page/kinematics.js` reads both. A stream has F frames of columns: MuJoCo's `qpos`, then the feet's forces, the stage,
the torques of the joints, the margin and which of `limits` it is of, and of the friction under each foot what is used.
Columns are differences from frame to frame, each
as all its low bytes and then all its high ones, which deflates to a third; only `qpos` has high bytes.
"""

from typing import Any

import mujoco
import numpy as np

from sweep.core.files import decode_text, encode_text
from sweep.engines.base import Trace, single_joints
from sweep.trace.contact_forces import measured
from sweep.trace.hulls import hull_of
from sweep.trace.sampling import base_body, finite_frames
from sweep.trace.shapes import VISIBLE_GROUPS, geom_color

RATE = 10.0  # frames per second, at most
ROOM = 40_000  # characters of the states of a rollout, which has fewer frames where it is too long
FINE = 1e-3  # of a state's stream: m and rad; coarser where int16 could not hold the largest value
UNIT = 1e-4  # of a quaternion's numbers
INT8, INT16 = 2**7 - 1, 2**15 - 1  # of a small number, and of a state at most
LEVELS = 50  # of a force on either side of zero
MARGIN = 100  # whole numbers of a margin of 1; it is cut off at -1
FRICTION = 20  # of all the friction that there is
DIGITS = 4  # of lengths (m) and directions of bodies and geoms
Kind = mujoco.mjtGeom
UNSHOWN = (Kind.mjGEOM_HFIELD, Kind.mjGEOM_SDF)  # ground that has no faces here
SHAPES = {
    Kind.mjGEOM_PLANE: "plane",
    Kind.mjGEOM_SPHERE: "sphere",
    Kind.mjGEOM_CAPSULE: "capsule",
    Kind.mjGEOM_CYLINDER: "cylinder",
    Kind.mjGEOM_BOX: "box",
}


def motion(trace: Trace) -> dict[str, Any]:
    """`states` of the trace's finite frames as base64, no more than `ROOM` of it, and what is needed to read them.

    `scales` (nq,) are units of the whole numbers of `qpos`, `force_scale` (N) and `torque_scale` (N m) those of forces
    and torques, `margin_scale` that of margins, `friction_scale` that of shares of friction, `step` (s) is the time
    between frames, and of the first one.
    """
    frames = finite_frames(trace)
    qpos = np.asarray(trace.qpos[:frames], float)
    scales = np.maximum(units(trace.model), np.abs(qpos).max(axis=0) / INT16)
    force = np.asarray(trace.foot_force[:frames], float)
    force = force.reshape(frames, force[0].size)
    force_scale = max(float(np.nan_to_num(np.abs(force)).max(initial=0)) / LEVELS, 1e-6)
    torque = np.nan_to_num(np.asarray(trace.joint_torque[:frames], float))
    torque_scale = max(float(np.abs(torque).max(initial=0)) / LEVELS, 1e-6)
    known = np.isfinite(trace.margin[:frames]).any()
    limits = sorted(set(trace.margin_of[:frames])) if known else []
    small = [np.round(np.nan_to_num(force) / force_scale), trace.stage[:frames], np.round(torque / torque_scale)]
    if known:
        margin = np.nan_to_num(trace.margin[:frames], nan=-1.0).clip(-1.0, 1.0)
        small += [np.round(MARGIN * margin), np.searchsorted(limits, trace.margin_of[:frames])]
    if force.size:
        small.append(np.round(FRICTION * np.nan_to_num(measured(trace).share[:frames])).clip(0, INT8))
    whole = {
        "step": float(trace.time[0]),
        "frames": frames,
        "scales": [float(f"{scale:.6g}") for scale in scales],
        "force_scale": float(f"{force_scale:.6g}"),
        "torque_scale": float(f"{torque_scale:.6g}"),
        "torque_limit": trace.torque_limit,
        "margin_scale": 1 / MARGIN,
        "friction_scale": 1 / FRICTION,
        "limits": limits,
        "states": packed(np.round(qpos / scales).astype(np.int16), np.column_stack(small).astype(np.int8)),
    }
    kept, every = whole, 1
    while len(kept["states"]) > ROOM and every < frames:
        every += 1
        kept = thinned(whole, every)
    return kept


def thinned(kept: dict[str, Any], every: int) -> dict[str, Any]:
    """A motion with one in `every` of its frames, and one at least; a page shows a cubic through them."""
    frames, columns = kept["frames"], len(kept["scales"])
    content = decode_text(kept["states"])
    states = read_planes(content[: 2 * frames * columns], frames, np.dtype(np.int16))
    small = read_planes(content[2 * frames * columns :], frames, np.dtype(np.int8))
    every = min(every, frames)
    chosen = slice(every - 1, None, every)
    return {
        **kept,
        "step": kept["step"] * every,
        "frames": frames // every,
        "states": packed(states[chosen], small[chosen]),
    }


def packed(states: np.ndarray, small: np.ndarray) -> str:
    """Whole numbers of two bytes and of one as text."""
    return encode_text(planes(states) + planes(small))


def planes(values: np.ndarray) -> bytes:
    """Differences of the rows of whole numbers `values` (F, K), column by column, low bytes first."""
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


def read_planes(content: bytes, frames: int, kind: np.dtype) -> np.ndarray:
    """Whole numbers (F, K) from their `planes`."""
    size = kind.itemsize
    change = np.frombuffer(content, np.uint8).reshape(-1, size, frames).transpose(0, 2, 1)
    change = np.ascontiguousarray(change).view(f"<i{size}")[..., 0]
    return np.cumsum(change, axis=1, dtype=kind).T


def units(model: mujoco.MjModel) -> np.ndarray:
    """What a whole number of each coordinate of `qpos` stands for at best."""
    fine = np.full(model.nq, FINE)
    for joint in range(model.njnt):
        turned = {int(mujoco.mjtJoint.mjJNT_FREE): 3, int(mujoco.mjtJoint.mjJNT_BALL): 0}.get(model.jnt_type[joint])
        if turned is not None:
            start = model.jnt_qposadr[joint] + turned
            fine[start : start + 4] = UNIT
    return fine


def bodies(model: mujoco.MjModel, legs: int) -> dict[str, Any]:
    """The tree of bodies with their joints and what is drawn of them, as plain values.

    A body has its parent's index, place and quaternion in it, and joints, see `joint`. A geom has its body, shape,
    MuJoCo's size (of a mesh: vertices and faces), place, quaternion, colour, and whether it is the robot's. `feet` are
    body and place of each of the `legs`, `hinges` the addresses of the `single_joints`.
    """
    root = model.body_rootid[base_body(model)]
    drawn = [g for g in range(model.ngeom) if model.geom_group[g] < VISIBLE_GROUPS and model.geom_rgba[g, 3] > 0]
    drawn = [g for g in drawn if Kind(model.geom_type[g]) not in UNSHOWN]
    feet = [model.site(f"foot{leg}") for leg in range(1, legs + 1)]
    return {
        "bodies": [
            {
                "parent": int(model.body_parentid[body]),
                "pos": short(model.body_pos[body]),
                "quat": short(model.body_quat[body]),
                "joints": [joint(model, int(j)) for j in model.body_jntadr[body] + np.arange(model.body_jntnum[body])],
            }
            for body in range(model.nbody)
        ],
        "geoms": [
            {
                "body": int(model.geom_bodyid[geom]),
                "robot": bool(model.body_rootid[model.geom_bodyid[geom]] == root),
                "pos": short(model.geom_pos[geom]),
                "quat": short(model.geom_quat[geom]),
                "colour": [round(255 * float(part)) for part in geom_color(model, geom)[:3]],
                **shape(model, geom),
            }
            for geom in drawn
        ],
        "feet": [[int(site.bodyid[0]), *short(site.pos)] for site in feet],
        "hinges": model.jnt_qposadr[single_joints(model)].tolist(),
    }


def joint(model: mujoco.MjModel, number: int) -> list[float]:
    """A joint's address in `qpos`, alone where it is free.

    A hinge has its axis and its anchor, too, a ball an axis of zeros; a slide its axis; both end with the coordinate
    of their place in the model where that is not zero.
    """
    address = int(model.jnt_qposadr[number])
    axis, anchor, start = short(model.jnt_axis[number]), short(model.jnt_pos[number]), float(model.qpos0[address])
    match model.jnt_type[number]:
        case mujoco.mjtJoint.mjJNT_FREE:
            return [address]
        case mujoco.mjtJoint.mjJNT_BALL:
            return [address, 0.0, 0.0, 0.0, *anchor]
        case mujoco.mjtJoint.mjJNT_SLIDE:
            return [address, *axis, *([start] if start else [])]
        case _:
            return [address, *axis, *anchor, *([start] if start else [])]


def shape(model: mujoco.MjModel, geom: int) -> dict[str, Any]:
    """Shape and size of a geom; of one that has no shape of its own there, its hull."""
    kind = Kind(model.geom_type[geom])
    if kind in SHAPES:
        return {"shape": SHAPES[kind], "size": short(model.geom_size[geom])}
    vertices, faces = hull_of(model, geom)
    return {"shape": "mesh", "vertices": [short(v) for v in vertices], "faces": faces}


def short(values: np.ndarray) -> list[float]:
    """Numbers with as many digits as can be seen."""
    return [float(f"{value:.{DIGITS}f}") + 0.0 for value in np.asarray(values, float)]
