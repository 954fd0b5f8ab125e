"""Contacts of spheres and capsules of the robot with one another, such as one foot with another foot.

Such a contact couples two limbs, which meet in the base only otherwise; `coupling` solves the equations then.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np

from sweep.systems.mujoco_model.geom_pairs import find_geom_pairs
from sweep.systems.mujoco_model.kernel.constraints import (
    TINY,
    apply_contact_law,
    describe_contact_law,
    make_tangents,
)
from sweep.systems.mujoco_model.kernel.layout import (
    CAPSULE,
    SPHERE,
    RobotLayout,
    find_stack_of_body,
)
from sweep.systems.mujoco_model.kernel.numbers import ModelFieldValues
from sweep.systems.mujoco_model.kernel.scalars import (
    ONE,
    ZERO,
    Scalar,
    Vector,
    clip,
    join_vectors,
    largest,
    rotate_to_world,
    square_root,
    where,
)
from sweep.systems.mujoco_model.kernel.smooth import SmoothTerms, SpatialVector

Joint = tuple[int, int]
BodyMember = tuple[int, int]  # index of a stack, and of a body in it
JointMember = tuple[Joint, int]  # a joint of a stack, and the index of its body there
MOST_OPERATIONS = 8_000  # multiplications and additions that all pairs of a model may cost in an iteration
PARALLEL = 100  # axes of capsules are parallel if their determinant is so many rounding errors


class PairRow(NamedTuple):
    """Pairs of geoms with shapes and contact laws of the same form, whose contacts are computed together."""

    kinds: tuple[int, int]  # shapes of the first and of the second geoms
    geoms: tuple[np.ndarray, np.ndarray]  # ids (n,)
    bodies: tuple[tuple[BodyMember, ...], tuple[BodyMember, ...]]
    real: np.ndarray  # (n,) whether the place of a row is a pair, and no filling


class PairContacts(NamedTuple):
    """Contacts of a row of pairs; forces and motions are those of the second geom relative to the first."""

    row: PairRow
    is_unsure: Any  # () bool, whether axes of touching capsules are parallel, where MuJoCo has two contacts
    at: Vector  # from the base's origin
    frame: tuple[Vector, Vector, Vector]  # normal and tangents, world axes
    friction: tuple[Scalar, ...]  # see `ContactNumbers`
    regular: Scalar
    weight: Scalar
    wanted: tuple[Scalar, ...]

    @property
    def dim(self) -> int:
        """Number of constraint dimensions of each contact (MuJoCo's condim): 1, 3, 4 or 6."""
        return len(self.friction) + 1

    @property
    def n(self) -> int:
        """Number of places in the row."""
        return len(self.row.real)


def find_simulated_pairs(layout: RobotLayout, model: mujoco.MjModel) -> list[tuple[int, int]]:
    """Return the pairs of geoms of the robot whose contacts the kernel simulates.

    They are those of spheres and capsules; none if they cost too much together, see `count_operations`.
    """
    pairs = np.unique(np.sort(find_geom_pairs(model), axis=1), axis=0)
    is_simulated = np.isin(model.geom_type[pairs], (SPHERE, CAPSULE)).all(axis=1)
    is_simulated &= (model.body_weldid[model.geom_bodyid[pairs]] != 0).all(axis=1)
    found = [tuple(sorted(map(int, one), key=lambda g: (model.geom_type[g], g))) for one in pairs[is_simulated]]
    bodies = [tuple(find_stack_of_body(layout, int(model.geom_bodyid[g])) for g in one) for one in found]
    dims = [describe_contact_law(model, *(np.array([g]) for g in one))[2] for one in found]
    is_too_large = found and count_operations(layout, list(zip(bodies, dims, strict=True))) > MOST_OPERATIONS  # pyright: ignore[reportArgumentType]
    return [] if is_too_large else found  # pyright: ignore[reportReturnType]


def find_pair_rows(layout: RobotLayout, model: mujoco.MjModel) -> list[PairRow]:
    """Return the simulated pairs of a model as rows of as many as a group has bodies."""
    alike: dict[tuple, list[tuple[int, int]]] = {}
    for a, b in find_simulated_pairs(layout, model):
        alike.setdefault((*model.geom_type[[a, b]].tolist(), *describe_law_form(model, a, b)), []).append((a, b))
    found = []
    for key, pairs in alike.items():
        for first in range(0, len(pairs), layout.group):
            chosen = pairs[first : first + layout.group]
            filled = chosen + chosen[:1] * (layout.group - len(chosen))
            geoms = [np.array(one) for one in zip(*filled, strict=True)]
            bodies = [tuple(find_stack_of_body(layout, int(b)) for b in model.geom_bodyid[one]) for one in geoms]
            real = np.arange(layout.group) < len(chosen)
            found.append(PairRow((key[0], key[1]), (geoms[0], geoms[1]), (bodies[0], bodies[1]), real))
    return found


def describe_law_form(model: mujoco.MjModel, a: int, b: int) -> tuple:
    """Return what the contacts of two geoms must have in common with those of others to be computed with them.

    Args:
        model: The model.
        a: Id of the first geom.
        b: Id of the second geom.
    """
    pairs, winner, dim = describe_contact_law(model, np.array([a]), np.array([b]))
    if pairs is not None:
        return dim, *model.pair_solref[pairs[0]].tolist(), *model.pair_solimp[pairs[0]].tolist()
    fields = model.geom_solmix, model.geom_solref, model.geom_solimp
    return dim, winner, *(x for g in (a, b) for one in fields for x in np.ravel(one[g]).tolist())


def moving_members(layout: RobotLayout, body: BodyMember) -> list[JointMember]:
    """Return the joints between the base and a body, from the base outward."""
    return [(j, body[1] if layout.stacks[j[0]].n > 1 else 0) for j in layout.moving_joints(body[0])]


def inner_members(layout: RobotLayout, joint: JointMember) -> list[JointMember]:
    """Return the joints with which a joint of a limb has an entry in the equations, from the base outward."""
    inner = layout.inner_joints[joint[0]]
    return [(one, joint[1] if layout.stacks[one[0]].n > 1 else 0) for one in inner]


def joints_between(layout: RobotLayout, bodies: tuple[BodyMember, BodyMember]) -> tuple[list[JointMember], ...]:
    """Return the joints that move the first but not the second of two bodies, and the other way round."""
    one, other = (moving_members(layout, body) for body in bodies)
    return [x for x in one if x not in other], [x for x in other if x not in one]


def order_elimination(
    layout: RobotLayout, couplings: list[tuple[BodyMember, BodyMember]]
) -> tuple[list[JointMember], int]:
    """Return the order in which joints are eliminated from the equations of motion, and what this costs.

    The next joint is always one that the fewest of those left meet; the base is last.

    Args:
        layout: Stacks of like bodies of the robot.
        couplings: Bodies of each pair of geoms that may touch.

    Returns:
        The joints of all limbs; and the number of multiplications with an addition, the base's 6x6 system included.
    """
    base = [("base", k) for k in range(6 * layout.has_free_base)]
    meets: dict[Any, set] = {}
    for joint in layout.joints:
        for member in range(layout.stacks[joint[0]].n):
            inner = inner_members(layout, (joint, member))
            meets[joint, member] = {*inner, *base}
            for one in inner:
                meets[one].add((joint, member))
    for both in couplings:
        one, other = joints_between(layout, both)
        for x in one:
            for y in other:
                meets[x].add(y)
                meets[y].add(x)
    order, cost = [], sum(k * (k + 1) // 2 for k in range(len(base)))
    while meets:
        chosen = min(meets, key=lambda x: len(meets[x]))
        near = meets.pop(chosen)
        cost += len(near) * (len(near) + 3) // 2
        for one in near:
            if one in meets:
                meets[one] |= near
                meets[one] -= {one, chosen}
        order.append(chosen)
    return order, cost


def count_operations(layout: RobotLayout, pairs: list[tuple[tuple[BodyMember, BodyMember], int]]) -> int:
    """Return the multiplications with an addition that pairs of geoms cost in an iteration of Newton's method.

    Args:
        layout: Stacks of like bodies of the robot.
        pairs: Bodies of each pair, and the dimension of its contact.
    """
    total = order_elimination(layout, [bodies for bodies, _ in pairs])[1]
    for bodies, dim in pairs:
        joints, size = sum(map(len, joints_between(layout, bodies))), 3 if dim <= 3 else 6
        total += size * size * joints + size * joints * (joints + 1) // 2
    return total


def find_pair_contacts(layout: RobotLayout, numbers: ModelFieldValues, smooth: SmoothTerms) -> list[PairContacts]:
    """Compute the contacts of the robot's geoms with one another in a state; geoms apart have zero weight."""
    return [_find_row_contacts(numbers, smooth, row) for row in find_pair_rows(layout, numbers.model)]


def _find_row_contacts(numbers: ModelFieldValues, smooth: SmoothTerms, row: PairRow) -> PairContacts:
    model, places, along = numbers.model, [], []
    for geoms, bodies, kind in zip(row.geoms, row.bodies, row.kinds, strict=True):
        centres, axes = [], []
        for geom, (stack, member) in zip(geoms, bodies, strict=True):
            place, ids = smooth.places[stack], np.array([geom])
            x, y, z = (one.stack_member(member) for one in place.axes)
            offset = rotate_to_world((x, y, z), numbers.get_vector("geom_pos", ids))
            centres.append(place.origin.stack_member(member) + offset)
            columns = numbers.get_rotation_columns("geom_quat", ids)
            axes.append(z if columns is None else rotate_to_world((x, y, z), columns[2]))
        places.append(join_vectors(centres))
        along.append(join_vectors(axes) * numbers.get("geom_size", geoms, 1) if kind == CAPSULE else None)
    first, second, parallel = find_nearest_points(places, along)
    radius = [numbers.get("geom_size", geoms, 0) for geoms in row.geoms]
    gap = second - first
    length = square_root(gap.dot(gap))
    normal = gap * (1 / largest(length, TINY))
    distance = length - radius[0] - radius[1]
    at = first + normal * (radius[0] + distance * 0.5)
    frame = (normal, *make_tangents(normal))
    motions = [place.motion for place in smooth.places]
    moving = [join_motions(motions, bodies) for bodies in row.bodies]
    relative = moving[1] - moving[0]
    bodies = model.geom_bodyid[row.geoms[0]], model.geom_bodyid[row.geoms[1]]
    found = apply_contact_law(numbers, row.geoms, bodies, distance, frame, (relative.velocity_at(at), relative.angular))
    weight = found.weight * Scalar(row.real.astype(float))
    is_unsure = np.array(False) if parallel is None else (parallel & (weight > ZERO)).any()
    return PairContacts(row, is_unsure, at, frame, *found._replace(weight=weight))


def join_motions(
    motions: Mapping[int, SpatialVector] | Sequence[SpatialVector], bodies: tuple[BodyMember, ...]
) -> SpatialVector:
    """Join the motions of the bodies in a row of geom pairs into one vector, from the motions of all stacks."""
    parts = [[motions[s][k].stack_member(m) for s, m in bodies] for k in range(2)]
    return SpatialVector(join_vectors(parts[0]), join_vectors(parts[1]))


def find_nearest_points(places: list[Vector], along: list[Vector | None]) -> tuple[Vector, Vector, Any]:
    """Return the nearest points of the middles of two shapes, as MuJoCo finds them.

    Args:
        places: Centres of both shapes.
        along: Half of the middle of each: a capsule's is a segment, a sphere's its centre (None). A sphere is first.

    Returns:
        The points of both, and whether the segments of two capsules are parallel; None for other shapes.
    """
    (a, b), (one, other) = places, along
    if other is None:
        return a, b, None
    if one is None:  # a sphere and a capsule
        square = other.dot(other)
        share = clip(other.dot(a - b) / square, -ONE, ONE)
        return a, b + other * share, None
    arm = a - b
    p, q, r = one.dot(one), -one.dot(other), other.dot(other)
    u, v = -one.dot(arm), other.dot(arm)
    determinant = p * r - q * q
    limit = largest(TINY, p * r * float(PARALLEL * np.finfo(determinant.value.dtype).eps))
    parallel = determinant < limit
    inverse = 1 / largest(determinant, limit)
    s, t = (r * u - q * v) * inverse, (p * v - q * u) * inverse
    t = where(s > ONE, (v - q) / r, where(s < -ONE, (v + q) / r, t))
    s = where(t > ONE, (u - q) / p, where(t < -ONE, (u + q) / p, s))
    return a + one * clip(s, -ONE, ONE), b + other * clip(t, -ONE, ONE), parallel
