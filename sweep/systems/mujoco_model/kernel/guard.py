"""Contacts that the kernel does not simulate: it watches for them, so that a rollout with one is simulated elsewhere.

Each shape is enclosed by a capsule or a box, so that a distance found here is never larger than the true one.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Bool

from sweep.systems.mujoco_model.kernel.layout import (
    BOX,
    CAPSULE,
    GEOM,
    PLANE,
    SHAPES,
    SPHERE,
    Layout,
    find_stack,
    may_touch,
)
from sweep.systems.mujoco_model.kernel.numbers import ModelNumbers
from sweep.systems.mujoco_model.kernel.scalars import (
    ZERO,
    Scalar,
    Vector,
    clip,
    largest,
    rotate,
    rotate_back,
    smallest,
    square_root,
    where,
)
from sweep.systems.mujoco_model.kernel.smooth import RobotState, Smooth

NEAR = 2e-3  # m, of a distance that counts as a touch: a pair is looked at once in a tick
SAMPLES = np.linspace(-1.0, 1.0, 5)  # places along a capsule, at which its distance from a box is computed
CYLINDER, ELLIPSOID = int(GEOM.mjGEOM_CYLINDER), int(GEOM.mjGEOM_ELLIPSOID)


class Hull(NamedTuple):
    """What encloses a geom: a capsule, or a box, in the body's axes."""

    stack: int
    member: int
    place: np.ndarray  # (3,) m
    axes: np.ndarray  # (3, 3) columns
    size: np.ndarray  # (3,) m: radius and half length of a capsule along z; half sizes of a box
    is_box: bool


def find_pairs(layout: Layout, model: mujoco.MjModel) -> list[tuple[int, int]]:
    """Return the pairs of geoms that may touch and that the kernel does not simulate."""
    found = []
    excluded = set(model.exclude_signature.tolist())
    filters = not model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
    for a in range(model.ngeom):
        for b in range(a + 1, model.ngeom):
            one, other = sorted((int(model.geom_bodyid[a]), int(model.geom_bodyid[b])))
            welds = [int(model.body_weldid[body]) for body in (one, other)]
            parents = [int(model.body_weldid[model.body_parentid[weld]]) for weld in welds]
            related = all(welds) and (welds[0] == parents[1] or welds[1] == parents[0])
            if welds[0] == welds[1] or (filters and related) or (one << 16) + other in excluded:
                continue
            shapes = [int(model.geom_type[g]) for g in (a, b)]
            simulated = PLANE in shapes and any(shape in SHAPES for shape in shapes)
            if may_touch(model, a, b) and not simulated:
                found.append((a, b))
    return found


def enclose(layout: Layout, model: mujoco.MjModel, geom: int) -> Hull:
    """Return what encloses a geom of the robot."""
    stack, member = find_stack(layout, int(model.geom_bodyid[geom]))
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, model.geom_quat[geom])
    axes, place = matrix.reshape(3, 3), model.geom_pos[geom].copy()
    if kind in (SPHERE, CAPSULE, CYLINDER):
        return Hull(stack, member, place, axes, np.array([size[0], 0.0 if kind == SPHERE else size[1], 0]), False)
    if kind in (BOX, ELLIPSOID):
        return Hull(stack, member, place, axes, size.copy(), True)
    box = model.geom_aabb[geom]
    return Hull(stack, member, place + axes @ box[:3], axes, box[3:].copy(), True)


def as_capsule(hull: Hull) -> Hull:
    """Return a capsule that encloses a box."""
    if not hull.is_box:
        return hull
    order = np.argsort(hull.size)
    size = np.array([np.hypot(*hull.size[order[:2]]), hull.size[order[2]], 0])
    return hull._replace(axes=hull.axes[:, [order[0], order[1], order[2]]], size=size, is_box=False)


def is_near(
    layout: Layout, numbers: ModelNumbers, state: RobotState, smooth: Smooth, pairs: list[tuple[int, int]]
) -> Bool[Array, ""]:
    """Return whether any of the pairs touches, or nearly so.

    Args:
        layout: The stacks.
        numbers: The rollout's model.
        state: The state.
        smooth: What it makes of the robot.
        pairs: Geoms, see `find_pairs`.
    """
    model = numbers.model
    near = jnp.asarray(False)
    kinds: dict[str, list[tuple[Hull, Any]]] = {"plane": [], "box": [], "capsule": []}
    for a, b in pairs:
        if int(model.geom_type[b]) == PLANE:
            a, b = b, a
        if int(model.geom_type[a]) == PLANE:
            kinds["plane"].append((enclose(layout, model, b), a))
            continue
        one, other = enclose(layout, model, a), enclose(layout, model, b)
        if other.is_box and not one.is_box:
            one, other = other, one
        kinds["box" if one.is_box else "capsule"].append((one, as_capsule(other)))
    for name, found in kinds.items():
        for first in range(0, len(found), layout.group):
            row = found[first : first + layout.group]
            row = row + row[:1] * (layout.group - len(row))
            near = near | (DISTANCES[name](numbers, state, smooth, row) < Scalar(NEAR)).any()
    return near


def _join(values: list[Scalar], dtype: Any) -> Scalar:
    """A number of each pair of a row."""
    if all(one.is_known for one in values):
        return Scalar(np.array([one.value for one in values], float))
    return Scalar(jnp.stack([jnp.asarray(one.value, dtype) for one in values]))


def _placed(smooth: Smooth, hulls: list[Hull]) -> tuple[Vector, list[Vector], list[Scalar]]:
    """Places, axes and sizes of a row of hulls, from the base's origin and in the world's axes."""

    def member(number: Scalar, k: int) -> Scalar:
        return Scalar(number.value[k]) if number.is_stack else number

    every: list[list[Vector]] = []
    for hull in hulls:
        place = smooth.places[hull.stack]
        axes = [Vector(*(member(x, hull.member) for x in one)) for one in place.axes]
        origin = Vector(*(member(x, hull.member) for x in place.origin))
        columns = [rotate((axes[0], axes[1], axes[2]), _vector(hull.axes[:, k])) for k in range(3)]
        every.append([origin + rotate((axes[0], axes[1], axes[2]), _vector(hull.place)), *columns])
    dtype = next(x.value.dtype for place in smooth.places for v in place.axes for x in v if not x.is_known)
    joined = [Vector(*(_join([one[k][i] for one in every], dtype) for i in range(3))) for k in range(4)]
    sizes = [Scalar(np.array([hull.size[k] for hull in hulls])) for k in range(3)]
    return joined[0], joined[1:], sizes


def _vector(values: np.ndarray) -> Vector:
    return Vector(*(Scalar(0.0 if abs(x) < 1e-15 else float(x)) for x in values))


def _plane_distance(numbers: ModelNumbers, state: RobotState, smooth: Smooth, row: list[Any]) -> Scalar:
    """Height (n,) of the lowest point of each hull above its plane."""
    place, axes, size = _placed(smooth, [hull for hull, _ in row])
    model = numbers.model
    normals, starts = [], []
    for _, plane in row:
        data = np.zeros(9)
        mujoco.mju_quat2Mat(data, model.geom_quat[plane])
        normals.append(data.reshape(3, 3)[:, 2])
        starts.append(model.geom_pos[plane])
    normal = Vector(*(Scalar(np.array([one[k] for one in normals])) for k in range(3)))
    start = Vector(*(Scalar(np.array([one[k] for one in starts])) for k in range(3)))
    height = normal.dot(state.position + place - start)
    is_box = np.array([hull.is_box for hull, _ in row])
    reach = [_absolute(normal.dot(one)) for one in axes]
    box = reach[0] * size[0] + reach[1] * size[1] + reach[2] * size[2]
    return height - where(jnp.asarray(is_box), box, size[0] + reach[2] * size[1])


def _absolute(number: Scalar) -> Scalar:
    return largest(number, -number)


def _box_distance(numbers: ModelNumbers, state: RobotState, smooth: Smooth, row: list[Any]) -> Scalar:
    """Distance (n,) of each capsule from its box, at least: at some places along the capsule, less half their gap."""
    boxes, capsules = ([pair[k] for pair in row] for k in range(2))
    place, axes, size = _placed(smooth, boxes)
    middle, along, capsule = _placed(smooth, capsules)
    frame = axes[0], axes[1], axes[2]
    arm, way = rotate_back(frame, middle - place), rotate_back(frame, along[2] * capsule[1])
    nearest = Scalar(1e3)
    for share in SAMPLES:
        point = arm + way * float(share)
        outside = [_absolute(p) - s for p, s in zip(point, size, strict=True)]
        over = [largest(one, ZERO) for one in outside]
        inside = smallest(largest(largest(outside[0], outside[1]), outside[2]), ZERO)
        nearest = smallest(nearest, square_root(over[0] * over[0] + over[1] * over[1] + over[2] * over[2]) + inside)
    gap = float(SAMPLES[1] - SAMPLES[0]) / 2
    return nearest - capsule[0] - capsule[1] * gap


def _capsule_distance(numbers: ModelNumbers, state: RobotState, smooth: Smooth, row: list[Any]) -> Scalar:
    """Distance (n,) of two capsules: that of their axes' segments less both radii."""
    place, axes, size = _placed(smooth, [pair[0] for pair in row])
    middle, others, other = _placed(smooth, [pair[1] for pair in row])
    a, b, arm = axes[2], others[2], place - middle
    cosine, p, q = a.dot(b), a.dot(arm), b.dot(arm)
    sine = largest(1 - cosine * cosine, 1e-6)
    s = clip((cosine * q - p) / sine, -size[1], size[1])
    t = clip(cosine * s + q, -other[1], other[1])
    s = clip(cosine * t - p, -size[1], size[1])
    gap = arm + a * s - b * t
    return square_root(gap.dot(gap)) - size[0] - other[0]


DISTANCES = {"plane": _plane_distance, "box": _box_distance, "capsule": _capsule_distance}
