"""Detection of contacts that the kernel does not simulate, so that such rollouts are simulated by another engine.

Each shape is enclosed by a capsule or a box, so that a distance found here is never larger than the true one.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Bool

from sweep.systems.mujoco_model.geom_pairs import find_geom_pairs
from sweep.systems.mujoco_model.kernel.constraints import find_point_on_plane
from sweep.systems.mujoco_model.kernel.layout import (
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    PLANE,
    SPHERE,
    RobotLayout,
    find_stack_of_body,
    simulates_shapes,
)
from sweep.systems.mujoco_model.kernel.numbers import ModelFieldValues
from sweep.systems.mujoco_model.kernel.pairs import find_simulated_pairs
from sweep.systems.mujoco_model.kernel.scalars import (
    ZERO,
    Scalar,
    Vector,
    clip,
    constant_vector,
    join_vectors,
    largest,
    rotate_to_body,
    rotate_to_world,
    rotation_matrix,
    smallest,
    square_root,
    where,
)
from sweep.systems.mujoco_model.kernel.smooth import RobotState, SmoothTerms

NEAR = 2e-3  # m, of a distance that counts as a touch: a pair is looked at once in a tick
SAMPLES = np.linspace(-1.0, 1.0, 5)  # places along a capsule, at which its distance from a box is computed
WORLD = -1  # stands for the index of a stack


class EnclosingHull(NamedTuple):
    """Capsule or box that encloses a geom, in the axes of the geom's body."""

    stack: int  # WORLD for one that does not move
    member: int
    place: np.ndarray  # (3,) m
    axes: np.ndarray  # (3, 3) columns
    size: np.ndarray  # (3,) m: radius and half length of a capsule along z; half sizes of a box
    is_box: bool


def find_unsimulated_geom_pairs(layout: RobotLayout, model: mujoco.MjModel) -> list[tuple[int, int]]:
    """Return the pairs of geoms that may touch but whose contacts the kernel does not simulate."""
    simulated = {frozenset(pair) for pair in find_simulated_pairs(layout, model)}
    for one in (*layout.planes, *layout.static_geoms):
        others = (g for g in range(model.ngeom) if simulates_shapes(model, g, one.geom))
        simulated |= {frozenset((one.geom, g)) for g in others}
    return [(a, b) for a, b in find_geom_pairs(model).tolist() if frozenset((a, b)) not in simulated]


def enclose_geom(layout: RobotLayout, model: mujoco.MjModel, geom: int) -> EnclosingHull:
    """Return a capsule or a box that encloses a geom, in the axes of its body; in the world's if it does not move."""
    stack, member = WORLD, 0
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    axes, place = rotation_matrix(model.geom_quat[geom]), model.geom_pos[geom].copy()
    if model.body_weldid[model.geom_bodyid[geom]]:
        stack, member = find_stack_of_body(layout, int(model.geom_bodyid[geom]))
    else:
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        axes, place = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom].copy()
    if kind in (SPHERE, CAPSULE, CYLINDER):
        return EnclosingHull(
            stack, member, place, axes, np.array([size[0], 0.0 if kind == SPHERE else size[1], 0]), False
        )
    if kind in (BOX, ELLIPSOID):
        return EnclosingHull(stack, member, place, axes, size.copy(), True)
    box = model.geom_aabb[geom]
    return EnclosingHull(stack, member, place + axes @ box[:3], axes, box[3:].copy(), True)


def enclose_in_capsule(hull: EnclosingHull) -> EnclosingHull:
    """Return a capsule that encloses a box."""
    if not hull.is_box:
        return hull
    order = np.argsort(hull.size)
    size = np.array([np.hypot(*hull.size[order[:2]]), hull.size[order[2]], 0])
    return hull._replace(axes=hull.axes[:, [order[0], order[1], order[2]]], size=size, is_box=False)


def has_near_pair(
    layout: RobotLayout, numbers: ModelFieldValues, state: RobotState, smooth: SmoothTerms, pairs: list[tuple[int, int]]
) -> Bool[Array, ""]:
    """Return whether any of the given pairs of geoms touches or nearly touches in a state.

    Args:
        layout: Stacks of like bodies of the robot.
        numbers: Numbers of the rollout's model.
        state: State of the robot.
        smooth: Kinematics of the state.
        pairs: Geoms, see `find_unsimulated_geom_pairs`.
    """
    model, near = numbers.model, jnp.asarray(False)
    planes = {plane.geom: plane for plane in layout.planes}
    kinds: dict[str, list[tuple[EnclosingHull, Any]]] = {"plane": [], "box": [], "capsule": []}
    for a, b in pairs:
        if int(model.geom_type[b]) == PLANE:
            a, b = b, a
        if int(model.geom_type[a]) == PLANE:
            kinds["plane"].append((enclose_geom(layout, model, b), planes[a]))
            continue
        one, other = enclose_geom(layout, model, a), enclose_geom(layout, model, b)
        if other.is_box and not (one.is_box and enclose_in_capsule(one).size[0] > enclose_in_capsule(other).size[0]):
            one, other = other, one  # the capsule about the smaller box encloses less beside it
        kinds["box" if one.is_box else "capsule"].append((one, enclose_in_capsule(other)))
    for name, found in kinds.items():
        for first in range(0, len(found), layout.group):
            row = found[first : first + layout.group]
            row = row + row[:1] * (layout.group - len(row))
            near = near | (DISTANCES[name](numbers, state, smooth, row) < Scalar(NEAR)).any()
    return near


def _placed(
    state: RobotState, smooth: SmoothTerms, hulls: list[EnclosingHull]
) -> tuple[Vector, list[Vector], list[Scalar]]:
    """Places, axes and sizes of a row of hulls, from the base's origin and in the world's axes."""

    every: list[list[Vector]] = []
    for hull in hulls:
        if hull.stack == WORLD:
            own = [constant_vector(hull.axes[:, k]) for k in range(3)]
            every.append([constant_vector(hull.place) - state.position, *own])
            continue
        place = smooth.places[hull.stack]
        x, y, z = (one.stack_member(hull.member) for one in place.axes)
        columns = [rotate_to_world((x, y, z), constant_vector(hull.axes[:, k])) for k in range(3)]
        origin = place.origin.stack_member(hull.member) + rotate_to_world((x, y, z), constant_vector(hull.place))
        every.append([origin, *columns])
    joined = [join_vectors([one[k] for one in every]) for k in range(4)]
    sizes = [Scalar(np.array([hull.size[k] for hull in hulls])) for k in range(3)]
    return joined[0], joined[1:], sizes


def _plane_distance(numbers: ModelFieldValues, state: RobotState, smooth: SmoothTerms, row: list[Any]) -> Scalar:
    """Height (n,) of the lowest point of each hull above its plane."""
    place, axes, size = _placed(state, smooth, [hull for hull, _ in row])
    places = [find_point_on_plane(numbers, plane) for _, plane in row]
    start = join_vectors(places)
    normal = Vector(*(Scalar(np.array([plane.normal[k] for _, plane in row])) for k in range(3)))
    height = normal.dot(state.position + place - start)
    is_box = np.array([hull.is_box for hull, _ in row])
    reach = [_absolute(normal.dot(one)) for one in axes]
    box = reach[0] * size[0] + reach[1] * size[1] + reach[2] * size[2]
    return height - where(jnp.asarray(is_box), box, size[0] + reach[2] * size[1])


def _absolute(number: Scalar) -> Scalar:
    return largest(number, -number)


def _box_distance(numbers: ModelFieldValues, state: RobotState, smooth: SmoothTerms, row: list[Any]) -> Scalar:
    """Lower bound (n,) of the distance of each capsule from its box.

    The distance is computed at some places along the capsule, and reduced by half the gap between them.
    """
    boxes, capsules = ([pair[k] for pair in row] for k in range(2))
    place, axes, size = _placed(state, smooth, boxes)
    middle, along, capsule = _placed(state, smooth, capsules)
    frame = axes[0], axes[1], axes[2]
    arm, way = rotate_to_body(frame, middle - place), rotate_to_body(frame, along[2] * capsule[1])
    nearest = Scalar(1e3)
    for share in SAMPLES:
        point = arm + way * float(share)
        outside = [_absolute(p) - s for p, s in zip(point, size, strict=True)]
        over = [largest(one, ZERO) for one in outside]
        inside = smallest(largest(largest(outside[0], outside[1]), outside[2]), ZERO)
        nearest = smallest(nearest, square_root(over[0] * over[0] + over[1] * over[1] + over[2] * over[2]) + inside)
    gap = float(SAMPLES[1] - SAMPLES[0]) / 2
    return nearest - capsule[0] - capsule[1] * gap


def _capsule_distance(numbers: ModelFieldValues, state: RobotState, smooth: SmoothTerms, row: list[Any]) -> Scalar:
    """Distance (n,) of two capsules: that of their axes' segments less both radii."""
    place, axes, size = _placed(state, smooth, [pair[0] for pair in row])
    middle, others, other = _placed(state, smooth, [pair[1] for pair in row])
    a, b, arm = axes[2], others[2], place - middle
    cosine, p, q = a.dot(b), a.dot(arm), b.dot(arm)
    sine = largest(1 - cosine * cosine, 1e-6)
    s = clip((cosine * q - p) / sine, -size[1], size[1])
    t = clip(cosine * s + q, -other[1], other[1])
    s = clip(cosine * t - p, -size[1], size[1])
    gap = arm + a * s - b * t
    return square_root(gap.dot(gap)) - size[0] - other[0]


DISTANCES = {"plane": _plane_distance, "box": _box_distance, "capsule": _capsule_distance}
