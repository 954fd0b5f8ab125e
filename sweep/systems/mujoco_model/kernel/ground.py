"""Contacts of the robot with shapes of the world other than planes, and of cylinders and ellipsoids with planes.

A foot may touch few of many steps of a stair at once. So steps whose contacts have the same law share rows: each row
has the nearest of what is left.
"""

import operator
from collections.abc import Callable
from functools import reduce
from typing import Any, NamedTuple

import numpy as np

from sweep.systems.mujoco_model.kernel.constraints import (
    TINY,
    ContactCandidate,
    GroundContacts,
    find_contact_margin,
    find_point_on_plane,
    make_ground_contacts,
    make_plane_tangents,
    make_tangents,
)
from sweep.systems.mujoco_model.kernel.height_fields import find_field_contacts
from sweep.systems.mujoco_model.kernel.hulls import MOST_CORNERS, MeshHull, find_hull
from sweep.systems.mujoco_model.kernel.layout import (
    BOX,
    CYLINDER,
    ELLIPSOID,
    HFIELD,
    MESH,
    SPHERE,
    BodyStack,
    CollisionPlane,
    RobotLayout,
    StaticGeom,
    simulates_shapes,
    touches_ground,
    unsupported_model_error,
)
from sweep.systems.mujoco_model.kernel.numbers import ModelFieldValues
from sweep.systems.mujoco_model.kernel.pairs import describe_law_form, find_nearest_points
from sweep.systems.mujoco_model.kernel.scalars import (
    NOTHING,
    ONE,
    ZERO,
    Axes,
    Scalar,
    Vector,
    choose,
    clip,
    constant_vector,
    keep_nearest,
    largest,
    rotate_to_body,
    rotate_to_world,
    smallest,
    square_root,
    where,
)
from sweep.systems.mujoco_model.kernel.smooth import RobotState, SmoothTerms

FAR = 1e6  # m, a distance without a contact
LEVEL = 1e-7  # m, by which a corner may be higher than the lowest one and count as such
AT_ONCE = 3  # shapes of the world with the same law that a geom of the robot touches at once
LAW_FIELDS = ("geom_friction", "geom_solref", "geom_solimp", "geom_margin", "geom_solmix")


class Nearest(NamedTuple):
    """A place where a geom of the robot is nearest to a shape of the world."""

    distance: Scalar  # m; negative where they overlap
    at: Vector  # from the base's origin
    normal: Vector  # towards the robot


def find_ground_contacts(
    layout: RobotLayout, numbers: ModelFieldValues, state: RobotState, smooth: SmoothTerms
) -> tuple[list[GroundContacts], list[Any]]:
    """Compute the contacts of cylinders and ellipsoids with planes, and of spheres and capsules with other shapes.

    Args:
        layout: Stacks of like bodies of the robot.
        numbers: Numbers of the rollout's model.
        state: State of the robot.
        smooth: Kinematics of the state.

    Returns:
        The contacts, and flags of rollouts with a contact that is not among them.
    """
    found, unsure, model = [], [], numbers.model
    for s, stack in enumerate(layout.stacks):
        for geoms in stack.geoms:
            kind, point = int(model.geom_type[geoms[0]]), _stand_for(s, stack, geoms)
            touched = [one for one in layout.planes if touches_ground(model, int(geoms[0]), one.geom)]
            for plane in touched if kind in (CYLINDER, ELLIPSOID, MESH) else []:
                centre, axes = _locate(numbers, smooth, s, geoms)
                normal = constant_vector(plane.normal)
                height = normal.dot(state.position - find_point_on_plane(numbers, plane))
                frame = (normal, *make_plane_tangents(normal, None))
                if kind == MESH:
                    points = _hull_points(numbers, plane, geoms, centre, axes)
                else:
                    places = _cylinder_points if kind == CYLINDER else _ellipsoid_point
                    points = [(at, ZERO) for at in places(numbers, plane, geoms, centre, axes)]
                for at, lift in points:
                    distance = height + normal.dot(at) + lift
                    middle = at - normal * (distance * 0.5)
                    found.append(
                        make_ground_contacts(
                            numbers, plane.geom, point, distance, middle, frame, smooth.places[s].motion
                        )
                    )
            for alike in _find_alike(layout, numbers, geoms):
                fields = [one for one in alike if one.kind == HFIELD]
                others = [one for one in alike if one.kind != HFIELD]
                nearest = [_find_nearest(numbers, state, smooth, s, geoms, one, unsure) for one in others]
                chosen = _select_nearest(nearest, unsure, numbers, geoms, alike[0].geom)
                for field in fields:
                    chosen += _find_nearest_of_field(numbers, state, smooth, s, geoms, field, unsure)
                for one in chosen:
                    frame = (one.normal, *make_tangents(one.normal))
                    found.append(
                        make_ground_contacts(
                            numbers, alike[0].geom, point, one.distance, one.at, frame, smooth.places[s].motion
                        )
                    )
    return found, unsure


def _stand_for(s: int, stack: BodyStack, geoms: np.ndarray) -> ContactCandidate:
    """Say whose contacts a row has; where they are is computed apart."""
    return ContactCandidate(s, NOTHING, NOTHING, ZERO, None, stack.bodies, geoms, np.ones(len(geoms), bool))


def _locate(numbers: ModelFieldValues, smooth: SmoothTerms, s: int, geoms: np.ndarray) -> tuple[Vector, Axes]:
    """Centres of geoms from the base's origin, and their axes."""
    place = smooth.places[s]
    columns = numbers.get_rotation_columns("geom_quat", geoms)
    axes = place.axes
    if columns is not None:
        axes = rotate_to_world(axes, columns[0]), rotate_to_world(axes, columns[1]), rotate_to_world(axes, columns[2])
    return place.origin + rotate_to_world(place.axes, numbers.get_vector("geom_pos", geoms)), axes


def _constant_axes(ground: StaticGeom) -> Axes:
    return constant_vector(ground.axes[:, 0]), constant_vector(ground.axes[:, 1]), constant_vector(ground.axes[:, 2])


def _cylinder_points(
    numbers: ModelFieldValues, plane: CollisionPlane, geoms: np.ndarray, centre: Vector, axes: Axes
) -> list[Vector]:
    """The four points of a cylinder that MuJoCo lets touch a plane: the lowest of each end, and two more of the lower.

    The three of the lower end make a triangle.
    """
    normal = constant_vector(plane.normal)
    radius, half = (numbers.get("geom_size", geoms, k) for k in range(2))
    side = where(normal.dot(axes[2]) > ZERO, -ONE, ONE)
    axis = axes[2] * side  # towards the plane
    slope = normal.dot(axis)
    down = axis * slope - normal
    square = down.dot(down)
    is_tilted = ~(square < TINY**2)
    scale = radius / square_root(where(is_tilted, square, ONE))
    arm = Vector(*(where(is_tilted, a * scale, b * radius) for a, b in zip(down, axes[0], strict=True)))
    end = axis * half
    across = arm.cross(end)
    across = across * (radius * (3**0.5 / 2) / square_root(across.dot(across)))
    low = centre + end
    return [low + arm, centre - end + arm, low + across - arm * 0.5, low - across - arm * 0.5]


def _ellipsoid_point(
    numbers: ModelFieldValues, plane: CollisionPlane, geoms: np.ndarray, centre: Vector, axes: Axes
) -> list[Vector]:
    """The lowest point of an ellipsoid."""
    size = [numbers.get("geom_size", geoms, k) for k in range(3)]
    local = rotate_to_body(axes, constant_vector(plane.normal))
    scaled = Vector(*(a * b for a, b in zip(local, size, strict=True)))
    inverse = 1 / square_root(scaled.dot(scaled))
    return [centre - rotate_to_world(axes, Vector(*(a * b * inverse for a, b in zip(scaled, size, strict=True))))]


def _hull_points(
    numbers: ModelFieldValues, plane: CollisionPlane, geoms: np.ndarray, centre: Vector, axes: Axes
) -> list[tuple[Vector, Any]]:
    """Corners of one face of a mesh's hull: of those that meet in its lowest corner, the one that faces the plane most.

    Corners and faces are constants, of which each rollout selects its own.
    """
    hulls = [find_hull(numbers.model, int(geom)) for geom in geoms]
    up = rotate_to_body(axes, constant_vector(plane.normal))

    def join(rows: list[np.ndarray]) -> Vector:
        return Vector(*(Scalar(np.array(x) if len(rows) > 1 else x[0]) for x in np.transpose(rows)))

    def each(read: Callable[[MeshHull], np.ndarray]) -> list[np.ndarray]:
        return [read(one) for one in hulls if one]

    count = max(len(one.corners) for one in hulls if one)
    corners = [join(each(lambda one, k=k: one.corners[k % len(one.corners)])) for k in range(count)]
    heights = [up.dot(one) for one in corners]
    lowest = reduce(smallest, heights)
    best, chosen, lifts = Scalar(FAR), [NOTHING] * MOST_CORNERS, [ZERO] * MOST_CORNERS
    for f in range(max(len(one.faces) for one in hulls if one)):
        normal = join(each(lambda one, f=f: one.normals[f % len(one.faces)]))
        own = [one.faces[f % len(one.faces)] for one in hulls if one]
        places = [join(each_corner) for each_corner in _face_corners(hulls, own)]
        missing = [Scalar(np.array([FAR * (k >= len(face)) for face in own])) for k in range(MOST_CORNERS)]
        is_low = reduce(operator.or_, (up.dot(one) < lowest + LEVEL for one in places))
        tilt = up.dot(normal)
        is_better = is_low & (tilt < best)
        best = where(is_better, tilt, best)
        chosen = [choose(is_better, *both) for both in zip(places, chosen, strict=True)]
        lifts = [where(is_better, a, b) for a, b in zip(missing, lifts, strict=True)]
    return [(centre + rotate_to_world(axes, place), lift) for place, lift in zip(chosen, lifts, strict=True)]


def _face_corners(hulls: list[MeshHull | None], faces: list[tuple[int, ...]]) -> list[list[np.ndarray]]:
    """Places of the corners of a face of each hull; the first again for those that it lacks."""
    return [
        [one.corners[face[k if k < len(face) else 0]] for one, face in zip(hulls, faces, strict=True) if one]
        for k in range(MOST_CORNERS)
    ]


def _find_alike(layout: RobotLayout, numbers: ModelFieldValues, geoms: np.ndarray) -> list[list[StaticGeom]]:
    """Shapes of the world that geoms may touch, those with the same law of contacts together."""
    model, found, first = numbers.model, {}, int(geoms[0])
    for one in layout.static_geoms:
        if simulates_shapes(model, first, one.geom) and touches_ground(model, first, one.geom):
            place = np.array([one.geom])
            own = one.geom if any(numbers.is_varied(name, place) for name in LAW_FIELDS) else -1
            forms = tuple(describe_law_form(model, int(geom), one.geom) for geom in geoms)
            found.setdefault((own, forms), []).append(one)
    return list(found.values())


def _find_nearest_of_field(
    numbers: ModelFieldValues,
    state: RobotState,
    smooth: SmoothTerms,
    s: int,
    geoms: np.ndarray,
    ground: StaticGeom,
    unsure: list[Any],
) -> list[Nearest]:
    """Where spheres of the robot are nearest to the prisms of a height field."""
    radius = numbers.get("geom_size", geoms, 0)
    if not radius.is_constant or numbers.is_varied("geom_pos", np.array([ground.geom])):
        raise unsupported_model_error("radii over height fields, and places of height fields, that differ")
    centre, _ = _locate(numbers, smooth, s, geoms)
    own = _constant_axes(ground)
    local = rotate_to_body(own, centre + state.position - constant_vector(ground.position))
    contacts, is_unsure = find_field_contacts(numbers, ground.geom, local, radius)
    unsure.append(is_unsure)
    found = []
    for one in contacts:
        length = square_root(one.square)
        normal = rotate_to_world(own, one.gap * (1 / largest(length, TINY)))
        distance = length - radius
        found.append(Nearest(distance, centre - normal * (radius + distance * 0.5), normal))
    return found


def _find_nearest(
    numbers: ModelFieldValues,
    state: RobotState,
    smooth: SmoothTerms,
    s: int,
    geoms: np.ndarray,
    ground: StaticGeom,
    unsure: list[Any],
) -> Nearest:
    """Where spheres or capsules of the robot are nearest to a shape of the world."""
    model, ids = numbers.model, np.array([ground.geom])
    centre, axes = _locate(numbers, smooth, s, geoms)
    radius = numbers.get("geom_size", geoms, 0)
    is_moved = model.geom_bodyid[ground.geom] == 0 and numbers.is_varied("geom_pos", ids)
    place = numbers.get_vector("geom_pos", ids) if is_moved else constant_vector(ground.position)
    place = place - state.position
    own = _constant_axes(ground)
    size = [numbers.get("geom_size", ids, k) for k in range(3)]
    if ground.kind == BOX:
        return _nearest_of_box(rotate_to_body(own, centre - place), radius, size, place, own)
    along = [
        None if kind == SPHERE else axis * length
        for kind, axis, length in (
            (ground.kind, own[2], size[1]),
            (int(model.geom_type[geoms[0]]), axes[2], numbers.get("geom_size", geoms, 1)),
        )
    ]
    places, order = [place, centre], [0, 1] if along[0] is None or along[1] is not None else [1, 0]
    points = find_nearest_points([places[k] for k in order], [along[k] for k in order])
    first, second = points[order[0]], points[order[1]]
    gap = second - first
    length = square_root(gap.dot(gap))
    normal = gap * (1 / largest(length, TINY))
    distance = length - size[0] - radius
    if points[2] is not None:
        margin = find_contact_margin(numbers, geoms, ids)
        unsure.append((points[2] & (distance < margin)).any())
    return Nearest(distance, first + normal * (size[0] + distance * 0.5), normal)


def _nearest_of_box(centre: Vector, radius: Scalar, size: list[Scalar], place: Vector, axes: Axes) -> Nearest:
    """Where spheres are nearest to a box, from their centres in the box's axes, by MuJoCo's `mjraw_SphereBox`."""
    clamped = Vector(*(clip(x, -half, half) for x, half in zip(centre, size, strict=True)))
    out = centre - clamped
    length = square_root(out.dot(out))
    is_outside = length > Scalar(TINY)
    inverse = 1 / where(is_outside, length, ONE)
    depth, inner = Scalar(FAR), [ZERO] * 3
    for k in range(3):
        for side in (-1.0, 1.0):
            here = size[k] - centre[k] * side
            here = largest(here, -here)
            is_nearer = here < depth
            depth = where(is_nearer, here, depth)
            inner = [where(is_nearer, Scalar(side if i == k else 0.0), x) for i, x in enumerate(inner)]
    normal = Vector(*(where(is_outside, x * inverse, y) for x, y in zip(out, inner, strict=True)))
    distance = where(is_outside, length, -depth) - radius
    # from the centre half way between the sphere's lowest point and the box's surface
    at = centre - normal * (radius + distance * 0.5)
    return Nearest(distance, place + rotate_to_world(axes, at), rotate_to_world(axes, normal))


def _select_nearest(
    every: list[Nearest], unsure: list[Any], numbers: ModelFieldValues, geoms: np.ndarray, ground: int
) -> list[Nearest]:
    """The nearest of several places, at most `AT_ONCE`."""
    if len(every) <= AT_ONCE:
        return every
    kept: list[Nearest] = []
    least = Scalar(FAR)  # distance of what is left out
    for one in every:
        dropped = keep_nearest(kept, one, AT_ONCE)
        least = least if dropped is None else smallest(least, dropped)
    margin = find_contact_margin(numbers, geoms, np.array([ground]))
    unsure.append((least < margin).any())
    return kept
