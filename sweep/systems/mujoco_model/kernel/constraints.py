"""Contacts with planes, limits of joints and friction of joints, as MuJoCo models them.

A constraint has a residual: the acceleration that a motion gives it, less the one that it asks for. Its force is minus
the slope of a convex cost of that residual, so that the accelerations minimize the sum of all costs and of Gauss's.
"""

from typing import Any, NamedTuple

import mujoco
import numpy as np

from sweep.systems.mujoco_model.geom_pairs import may_touch
from sweep.systems.mujoco_model.kernel.layout import BOX, CAPSULE, Layout, Plane, refuse
from sweep.systems.mujoco_model.kernel.numbers import ModelNumbers, power_of
from sweep.systems.mujoco_model.kernel.scalars import (
    NOTHING,
    ONE,
    ZERO,
    Scalar,
    Symmetric,
    Vector,
    clip,
    known_vector,
    largest,
    outer_product,
    rotate,
    smallest,
    square_root,
    where,
)
from sweep.systems.mujoco_model.kernel.smooth import RobotState, Smooth, wrench_at

TINY = 1e-15  # below which MuJoCo takes a number for 0
ELLIPTIC = int(mujoco.mjtCone.mjCONE_ELLIPTIC)
CORNERS = np.array([[1, y, z] for y in (-1, 1) for z in (-1, 1)], float)  # one of each opposite pair


class Law(NamedTuple):
    """Stiffness and damping of a constraint, and its impedance by depth, of MuJoCo's `solref` and `solimp`."""

    stiffness: Scalar  # 1/s^2
    damping: Scalar  # 1/s
    impedance: tuple[Scalar, Scalar, Scalar, float, float]  # least, largest, width, middle, power


class Point(NamedTuple):
    """A point of a body that can touch a plane: of a sphere, of an end of a capsule, or a corner of a box."""

    stack: int
    centre: Vector  # in the body's axes
    corner: Vector  # from there to a corner, whose opposite counts where it is lower; 0 for a sphere
    radius: Scalar
    along: Vector | None  # axis of a capsule, of which MuJoCo makes the tangents
    bodies: np.ndarray  # ids (n,) of the bodies
    geoms: np.ndarray  # ids (n,)
    real: np.ndarray  # (n,) whether the place of a row is one, and no filling


class Contact(NamedTuple):
    """Contacts of like points with a plane: frame, inverse regularization, and wanted acceleration."""

    point: Point
    at: Vector  # from the base's origin
    frame: tuple[Vector, Vector, Vector]  # normal and tangents, world axes
    friction: Scalar | None  # None for none: condim 1
    regular: Scalar  # friction over the root of impratio: of an elliptic cone
    weight: Scalar  # inverse of the regularization; 0 without contact
    wanted: Vector  # acceleration along normal and tangents


class JointRow(NamedTuple):
    """Constraint on the acceleration of one joint of each limb: a limit of its range, or its friction."""

    joint: tuple[int, int]
    side: Scalar  # of the joint's acceleration in the row
    weight: Scalar
    wanted: Scalar
    most: Scalar | None  # N m or N, of friction; None for a limit


class Constraints(NamedTuple):
    """All constraints of a state."""

    contacts: tuple[Contact, ...]
    rows: tuple[JointRow, ...]
    is_elliptic: bool


def find_points(layout: Layout, numbers: ModelNumbers, plane: int) -> list[Point]:
    """Return the places that may touch a plane; those of a body alone in rows of `layout.group`."""
    model, found = numbers.model, []
    for s, stack in enumerate(layout.stacks):
        singles: list[Point] = []
        for geoms in stack.geoms:
            if not all(may_touch(model, int(g), plane) for g in geoms):
                continue
            place = numbers.vector("geom_pos", geoms)
            columns = numbers.rotation("geom_quat", geoms)
            real = np.ones(len(geoms), bool)

            def to_body_axes(v: Vector, columns: Any = columns) -> Vector:
                return v if columns is None else rotate(columns, v)

            size = [numbers.get("geom_size", geoms, k) for k in range(3)]
            if model.geom_type[geoms[0]] == BOX:
                for one in CORNERS:
                    corner = to_body_axes(Vector(*(a * float(b) for a, b in zip(size, one, strict=True))))
                    singles.append(Point(s, place, corner, ZERO, None, stack.bodies, geoms, real))
            elif model.geom_type[geoms[0]] == CAPSULE:
                along = to_body_axes(Vector(ZERO, ZERO, ONE))
                for side in (1.0, -1.0):
                    end = place + along * (size[1] * side)
                    singles.append(Point(s, end, NOTHING, size[0], along, stack.bodies, geoms, real))
            else:
                singles.append(Point(s, place, NOTHING, size[0], None, stack.bodies, geoms, real))
        packable = stack.n == 1 and len(singles) > 1 and all(_is_known(one) for one in singles)
        found += _pack(singles, layout.group) if packable else singles
    return found


def _is_known(point: Point) -> bool:
    parts = (*point.centre, *point.corner, point.radius)
    return point.along is None and all(one.is_known for one in parts)


def _pack(singles: list[Point], group: int) -> list[Point]:
    """Put points of one body into rows of `group`; free places repeat the first point and are marked as not real."""
    found = []
    for first in range(0, len(singles), group):
        chosen = singles[first : first + group]
        filled = chosen + chosen[:1] * (group - len(chosen))

        def join(numbers: list[Scalar]) -> Scalar:
            return Scalar(np.array([one.value for one in numbers]))

        def vectors(name: str, filled: list[Point] = filled) -> Vector:
            return Vector(*(join([getattr(one, name)[k] for one in filled]) for k in range(3)))

        found.append(
            Point(
                chosen[0].stack,
                vectors("centre"),
                vectors("corner"),
                join([one.radius for one in filled]),
                None,
                np.concatenate([one.bodies for one in filled]),
                np.concatenate([one.geoms for one in filled]),
                np.arange(group) < len(chosen),
            )
        )
    return found


def find_contacts(layout: Layout, numbers: ModelNumbers, state: RobotState, smooth: Smooth) -> list[Contact]:
    """Find the contacts of a state with all planes; those that are apart have no weight."""
    found = []
    for plane in layout.planes:
        normal, start = known_vector(plane.normal), locate_plane(numbers, plane)
        height = normal.dot(state.position - start)
        for point in find_points(layout, numbers, plane.geom):
            place = smooth.places[point.stack]
            centre = place.origin + rotate(place.axes, point.centre)
            if not all(one.is_exactly(0) for one in point.corner):
                arm = rotate(place.axes, point.corner)
                centre = centre + arm * where(normal.dot(arm) > ZERO, -ONE, ONE)
            distance = height + normal.dot(centre) - point.radius
            at = centre - normal * (point.radius + distance * 0.5)
            along = None if point.along is None else rotate(place.axes, point.along)
            frame = (normal, *_tangents(normal, along))
            found.append(_contact(numbers, plane.geom, point, distance, at, frame, place.motion.velocity_at(at)))
    return found


def locate_plane(numbers: ModelNumbers, plane: Plane) -> Vector:
    """Return a place of a plane in the world (m), which may differ between rollouts."""
    if numbers.model.geom_bodyid[plane.geom]:
        return known_vector(plane.position)
    return numbers.vector("geom_pos", np.array([plane.geom]))


def _tangents(normal: Vector, along: Vector | None) -> tuple[Vector, Vector]:
    """Tangents as `mju_makeFrame` chooses them: the first one along a capsule's axis, if that is not upright."""
    n = np.array([float(one.value) for one in normal])
    usual = np.array([0.0, 1, 0]) if abs(n[1]) < 0.5 else np.array([0.0, 0, 1])
    usual = usual - n * (n @ usual)
    usual = known_vector(usual / np.linalg.norm(usual))
    if along is None:
        return usual, normal.cross(usual)
    flat = along - normal * normal.dot(along)
    length = square_root(largest(flat.dot(flat), TINY**2))
    lies = Scalar(TINY) < length
    first = Vector(*(where(lies, a / length, b) for a, b in zip(flat, usual, strict=True)))
    return first, normal.cross(first)


def _contact(
    numbers: ModelNumbers, plane: int, point: Point, distance: Scalar, at: Vector, frame: Any, velocity: Vector
) -> Contact:
    """A row of contacts from distances (m), places and velocities (m/s)."""
    model, geoms, ground = numbers.model, point.geoms, np.array([plane])
    dims = np.maximum(model.geom_condim[geoms], model.geom_condim[plane])
    first, second = (model.geom_priority[one] for one in (geoms, ground))
    wins = np.where(first > second, 1, np.where(first < second, -1, 0))
    if len(set(wins.tolist())) > 1 or len(set(dims.tolist())) > 1:
        raise refuse("limbs whose contacts differ in priority or dimension")
    dim = int({0: dims[0], 1: model.geom_condim[geoms[0]], -1: model.geom_condim[plane]}[int(wins[0])])
    law, friction = _mix(numbers, geoms, ground, int(wins[0]))
    margin = _sum_margins(numbers, geoms, ground)
    inverse = numbers.get("body_invweight0", point.bodies, 0) + numbers.get("body_invweight0", np.array([0]), 0)
    impratio = numbers.get("opt.impratio")
    is_elliptic = model.opt.cone == ELLIPTIC
    if dim > 1 and not is_elliptic:
        inverse = inverse * (1 + friction * friction) * (2 * friction * friction / impratio)
    impedance = compute_impedance(law, distance - margin)
    weight = where(distance < margin, impedance / (inverse * (1 - impedance)), ZERO)
    if not point.real.all():
        weight = weight * Scalar(point.real.astype(float))
    speed = [one.dot(velocity) for one in frame]
    wanted = -(speed[0] * law.damping) - law.stiffness * impedance * (distance - margin)
    tangents = [-(one * law.damping) for one in speed[1:]]
    regular = friction / square_root(impratio)
    return Contact(point, at, frame, friction if dim > 1 else None, regular, weight, Vector(wanted, *tangents))


def _sum_margins(numbers: ModelNumbers, geoms: np.ndarray, plane: np.ndarray) -> Scalar:
    """Distance below which two geoms push: the sum of their margins."""
    return numbers.get("geom_margin", geoms) + numbers.get("geom_margin", plane)


def _mix(numbers: ModelNumbers, geoms: np.ndarray, plane: np.ndarray, winner: int) -> tuple[Law, Scalar]:
    """Law and friction of two geoms: those of the one of higher priority, or mixed."""
    each = (numbers.get("geom_solmix", geoms), numbers.get("geom_solmix", plane))
    if winner:
        share = ONE if winner > 0 else ZERO
        friction = numbers.get("geom_friction", geoms if winner > 0 else plane, 0)
    else:
        share = each[0] / (each[0] + each[1])
        friction = largest(numbers.get("geom_friction", geoms, 0), numbers.get("geom_friction", plane, 0))

    def mix_number(name: str, k: int) -> Scalar:
        return share * numbers.get(name, geoms, k) + (1 - share) * numbers.get(name, plane, k)

    reference = [mix_number("geom_solref", k) for k in range(2)]
    if not winner and min(float(numbers.model.geom_solref[g, 0]) for g in (*geoms, *plane)) <= 0:
        least = [smallest(numbers.get("geom_solref", geoms, k), numbers.get("geom_solref", plane, k)) for k in range(2)]
        reference = least  # direct formats are not mixed
    return make_law(numbers, reference, [mix_number("geom_solimp", k) for k in range(5)]), largest(friction, 1e-5)


def make_law(numbers: ModelNumbers, reference: list[Scalar], impedance: list[Scalar]) -> Law:
    """Make a law of MuJoCo's `solref` and `solimp`."""
    least, top, middle = (clip(impedance[k], 1e-4, 0.9999) for k in (0, 1, 3))
    width, power = largest(impedance[2], TINY), impedance[4]
    if not (middle.is_known and power.is_known and reference[0].is_known):
        raise refuse("time constants, or midpoints and powers of impedance, that differ between rollouts")
    time = np.ravel(reference[0].value)
    if (time > 0).all():
        constant = largest(reference[0], 2 * numbers.model.opt.timestep)
        stiffness = 1 / (top * top * constant * constant * reference[1] * reference[1])
        damping = 2 / (top * constant)
    else:
        stiffness, damping = -reference[0] / (top * top), -reference[1] / top
    return Law(stiffness, damping, (least, top, width, _same(middle), max(1.0, _same(power))))


def _same(number: Scalar) -> float:
    return float(np.ravel(number.value)[0])


def compute_impedance(law: Law, depth: Scalar) -> Scalar:
    """Return the impedance at a depth (m), see `getimpedance`."""
    least, top, width, middle, power = law.impedance
    if (top - least).is_exactly(0):
        return least
    x = clip(largest(depth, -depth) / width, 0.0, 1.0)
    y = x
    if power != 1:
        low = power_of(x, power) * (1 / middle ** (power - 1))
        high = 1 - power_of(1 - x, power) * (1 / (1 - middle) ** (power - 1))
        y = where(x < middle, low, high)
    return least + y * (top - least)


def find_rows(layout: Layout, numbers: ModelNumbers, state: RobotState) -> list[JointRow]:
    """Find limits and friction of all joints that have them."""
    model, found = numbers.model, []
    for joint in layout.joints:
        ids = layout.stacks[joint[0]].joints[joint[1]]
        dofs, rate = model.jnt_dofadr[ids], state.rates[joint]
        if numbers.is_used("dof_frictionloss", dofs):
            law = _joint_law(numbers, "dof", dofs)
            least = law.impedance[0]
            inverse = numbers.get("dof_invweight0", dofs)
            weight = least / (inverse * (1 - least))
            most = numbers.get("dof_frictionloss", dofs)
            found.append(JointRow(joint, ONE, weight, -(rate * law.damping), most))
        limited = model.jnt_limited[ids].astype(bool)
        if limited.any():
            low, high = (numbers.get("jnt_range", ids, k) for k in range(2))
            if not limited.all():
                far = Scalar(np.where(limited, 0.0, 1e6))
                low, high = low - far, high + far
            under, over = state.angles[joint] - low, high - state.angles[joint]
            is_low = under < over
            depth, side = where(is_low, under, over), where(is_low, ONE, -ONE)
            law = _joint_law(numbers, "jnt", ids)
            margin = numbers.get("jnt_margin", ids)
            impedance = compute_impedance(law, depth - margin)
            inverse = numbers.get("dof_invweight0", dofs)
            weight = where(depth < margin, impedance / (inverse * (1 - impedance)), ZERO)
            wanted = -(side * rate) * law.damping - law.stiffness * impedance * (depth - margin)
            found.append(JointRow(joint, side, weight, wanted, None))
    return found


def _joint_law(numbers: ModelNumbers, kind: str, ids: np.ndarray) -> Law:
    reference = [numbers.get(f"{kind}_solref", ids, k) for k in range(2)]
    return make_law(numbers, reference, [numbers.get(f"{kind}_solimp", ids, k) for k in range(5)])


class ContactSlope(NamedTuple):
    """Force of a row of contacts at a residual, and the second derivative of the cost, in the contact's frame."""

    force: Vector  # along normal and tangents
    curve: Symmetric  # likewise


def contact_slope(contact: Contact, residual: Vector, is_elliptic: bool) -> ContactSlope:
    """Return the force of a row of contacts and the second derivative of its cost, in the contact's frame."""
    weight = contact.weight
    if contact.friction is None:
        inside = residual.x < ZERO
        force = -(weight * smallest(residual.x, ZERO))
        curve = where(inside, weight, ZERO)
        return ContactSlope(Vector(force, ZERO, ZERO), Symmetric(curve, ZERO, ZERO, ZERO, ZERO, ZERO))
    if not is_elliptic:
        return _pyramid_slope(contact, residual)
    mu, friction = contact.regular, contact.friction
    normal = residual.x * mu
    u = residual.y * friction, residual.z * friction
    slip = square_root(u[0] * u[0] + u[1] * u[1])
    is_open = ~(normal < mu * slip)
    sticks = (mu * normal + slip < ZERO) | ~(slip > ZERO) & (normal < ZERO)
    share = weight / (mu * mu * (1 + mu * mu))
    inverse = 1 / where(slip > ZERO, slip, ONE)
    excess = normal - mu * slip
    pull = share * excess
    cone = [-(pull * mu), *(pull * mu * inverse * one * friction for one in u)]
    # rows 1 and 2 of an elliptic contact have the weight of row 0, times impratio: of friction / regular, squared
    ratio = friction / mu
    tangential = weight * ratio * ratio
    stick = [-(weight * residual.x), -(tangential * residual.y), -(tangential * residual.z)]
    force = [where(sticks, a, where(is_open, ZERO, b)) for a, b in zip(stick, cone, strict=True)]
    along = [one * inverse for one in u]
    turn = mu * normal * inverse
    level = mu * mu - turn
    bent = Symmetric(
        share * mu * mu,
        share * (level + turn * along[0] * along[0]) * friction * friction,
        share * (level + turn * along[1] * along[1]) * friction * friction,
        -(share * mu * along[0]) * mu * friction,
        -(share * mu * along[1]) * mu * friction,
        share * turn * along[0] * along[1] * friction * friction,
    )
    plain = Symmetric(weight, tangential, tangential, ZERO, ZERO, ZERO)
    curve = Symmetric(*(where(sticks, a, where(is_open, ZERO, b)) for a, b in zip(plain, bent, strict=True)))
    return ContactSlope(Vector(force[0], force[1], force[2]), curve)


def _edges(contact: Contact, residual: Vector) -> list[Scalar]:
    """Residuals of the four edges of a pyramid."""
    friction: Any = contact.friction
    y, z = friction * residual.y, friction * residual.z
    return [residual.x + y, residual.x - y, residual.x + z, residual.x - z]


def _pyramid_slope(contact: Contact, residual: Vector) -> ContactSlope:
    friction: Any = contact.friction
    edges = _edges(contact, residual)
    low = [smallest(one, ZERO) for one in edges]
    minus = -contact.weight
    turn = minus * friction
    force = Vector(minus * (low[0] + low[1] + low[2] + low[3]), turn * (low[0] - low[1]), turn * (low[2] - low[3]))
    active = [where(one < ZERO, contact.weight, ZERO) for one in edges]
    y, z, square = active[0] + active[1], active[2] + active[3], friction * friction
    curve = Symmetric(
        y + z, square * y, square * z, friction * (active[0] - active[1]), friction * (active[2] - active[3]), ZERO
    )
    return ContactSlope(force, curve)


def contact_line(contact: Contact, residual: Vector, change: Vector, is_elliptic: bool) -> tuple[Scalar, Scalar]:
    """Return first and second derivative of a row's cost along a change of its residual."""
    if contact.friction is None or not is_elliptic:
        pairs = (
            [(residual.x, change.x)]
            if contact.friction is None
            else zip(_edges(contact, residual), _edges(contact, change), strict=True)
        )
        first, second = ZERO, ZERO
        for one, moved in pairs:
            pull = where(one < ZERO, contact.weight * moved, ZERO)
            first, second = first + pull * one, second + pull * moved
        return first, second
    slope = contact_slope(contact, residual, is_elliptic)
    return -slope.force.dot(change), change.dot(slope.curve @ change)


def row_force(row: JointRow, residual: Scalar) -> tuple[Scalar, Scalar]:
    """Return the force of a joint's row, and the cost's second derivative."""
    if row.most is None:
        inside = residual < ZERO
        return -(row.weight * smallest(residual, ZERO)), where(inside, row.weight, ZERO)
    pull = -(row.weight * residual)
    force = largest(smallest(pull, row.most), -row.most)
    return force, where((pull < row.most) & (-row.most < pull), row.weight, ZERO)


def contact_wrench(contact: Contact, force: Vector) -> Any:
    """Return the wrench on the body of a force in the contact's frame."""
    normal, first, second = contact.frame
    return wrench_at(contact.at, normal * force.x + first * force.y + second * force.z)


def world_curve(contact: Contact, curve: Symmetric) -> Symmetric:
    """Return a matrix of the contact's frame in the world's axes."""
    normal, first, second = contact.frame
    upright = normal.z.is_exactly(1) and first.y.is_exactly(1) and contact.point.along is None
    if upright:  # the tangents are y and -x
        c = curve
        return Symmetric(c.zz, c.yy, c.xx, -c.yz, -c.xz, c.xy)
    found = outer_product(normal, curve.xx) + outer_product(first, curve.yy) + outer_product(second, curve.zz)
    for a, b, c in ((normal, first, curve.xy), (normal, second, curve.xz), (first, second, curve.yz)):
        mixed = outer_product(a + b, ONE) + _negative(outer_product(a, ONE)) + _negative(outer_product(b, ONE))
        found = found + Symmetric(*(one * c for one in mixed))
    return found


def _negative(matrix: Symmetric) -> Symmetric:
    return Symmetric(*(-one for one in matrix))
