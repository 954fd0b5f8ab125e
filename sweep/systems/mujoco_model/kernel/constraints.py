"""Contacts with planes, limits of joints and friction of joints, as MuJoCo models them.

A constraint has a residual: the acceleration that a motion gives it, less the one that it asks for. Its force is minus
the slope of a convex cost of that residual, so that the accelerations minimize the sum of all costs and of Gauss's.
"""

import operator
from functools import reduce
from typing import Any, NamedTuple

import mujoco
import numpy as np

from sweep.systems.mujoco_model.kernel.layout import (
    BOX,
    CAPSULE,
    SPHERE,
    CollisionPlane,
    RobotLayout,
    find_contact_pair_ids,
    touches_ground,
    unsupported_model_error,
)
from sweep.systems.mujoco_model.kernel.numbers import ModelFieldValues, raise_to_power
from sweep.systems.mujoco_model.kernel.scalars import (
    NO_MATRIX,
    NOTHING,
    ONE,
    ZERO,
    Scalar,
    SymmetricMatrix,
    Vector,
    as_symmetric_matrix,
    clip,
    constant_vector,
    largest,
    quaternion_axes,
    rotate_to_world,
    smallest,
    square_root,
    where,
)
from sweep.systems.mujoco_model.kernel.smooth import (
    UPRIGHT,
    RobotState,
    SmoothTerms,
    SpatialVector,
    point_force_wrench,
)

TINY = 1e-15  # below which MuJoCo takes a number for 0
LEAST_FRICTION = 1e-5  # MuJoCo's mjMINMU
FRICTION_OF_DIMENSION = (0, 0, 1, 2, 2)  # which of a geom's three frictions each dimension after the first has
ELLIPTIC = int(mujoco.mjtCone.mjCONE_ELLIPTIC)
CORNERS = np.array([[1, y, z] for y in (-1, 1) for z in (-1, 1)], float)  # one of each opposite pair


class ConstraintLaw(NamedTuple):
    """Stiffness, damping and impedance of a constraint, as MuJoCo's `solref` and `solimp` define them."""

    stiffness: Scalar  # 1/s^2
    damping: Scalar  # 1/s
    impedance: tuple[Scalar, Scalar, Scalar, Scalar, Scalar]  # least, largest, width, middle, power; two last known


class ContactCandidate(NamedTuple):
    """A point of a body that may touch a plane: a sphere's centre, an end of a capsule, or a corner of a box."""

    stack: int
    centre: Vector  # in the body's axes
    corner: Vector  # from there to a corner, whose opposite counts where it is lower; 0 for a sphere
    radius: Scalar
    along: Vector | None  # axis of a capsule, of which MuJoCo makes the tangents
    bodies: np.ndarray  # ids (n,) of the bodies
    geoms: np.ndarray  # ids (n,)
    real: np.ndarray  # (n,) whether the place of a row is one, and no filling


class GroundContacts(NamedTuple):
    """Contacts of corresponding points of all limbs with a geom of the world: frame, friction and accelerations."""

    point: ContactCandidate
    at: Vector  # from the base's origin
    frame: tuple[Vector, Vector, Vector]  # normal and tangents, world axes
    friction: tuple[Scalar, ...]  # of each dimension after the normal one: sliding twice, torsional, rolling twice
    regular: Scalar  # sliding friction over the root of impratio: of an elliptic cone
    weight: Scalar  # inverse of the regularization; 0 without contact
    wanted: tuple[Scalar, ...]  # accelerations along normal and tangents, then angular ones about them

    @property
    def dim(self) -> int:
        """Number of constraint dimensions of each contact (MuJoCo's condim): 1, 3, 4 or 6."""
        return len(self.friction) + 1

    @property
    def n(self) -> int:
        """Number of places in the row."""
        return len(self.point.real)


class JointConstraint(NamedTuple):
    """Constraint row of one dimension for corresponding joints of all limbs: a limit, friction, or an equality.

    It is one of a sum of joint positions, of the base in one direction (friction of the free joint), or of both.
    """

    terms: tuple[tuple[tuple[int, int], Scalar], ...]  # joints, and the row's acceleration per unit of theirs
    n: int  # limbs that have such a row
    weight: Scalar
    wanted: Scalar
    most: Scalar | None = None  # N m or N, of friction; None for others
    direction: SpatialVector | None = None  # of the base; None without a term of the base
    is_equality: bool = False
    is_unit: bool = False  # whether the only factor is 1 or -1

    def project(self, base: SpatialVector, joints: dict[tuple[int, int], Scalar]) -> Scalar:
        """Return the row's acceleration for accelerations of the base and of the joints."""
        parts = [factor * joints[joint] for joint, factor in self.terms]
        if self.direction is not None:
            parts.append(self.direction.dot(base))
        return reduce(operator.add, parts)


class Constraints(NamedTuple):
    """All constraints that act on the robot in a state: contacts, joint limits, joint friction."""

    contacts: tuple[GroundContacts, ...]
    rows: tuple[JointConstraint, ...]
    is_elliptic: bool
    pairs: tuple[Any, ...] = ()  # `PairContacts` of the robot's geoms with one another


def find_contact_candidates(layout: RobotLayout, numbers: ModelFieldValues, plane: int) -> list[ContactCandidate]:
    """Return the points of the robot that may touch a plane."""
    model, found = numbers.model, []
    for s, stack in enumerate(layout.stacks):
        singles: list[ContactCandidate] = []
        for geoms in stack.geoms:
            if not all(touches_ground(model, int(g), plane) for g in geoms):
                continue
            place = numbers.get_vector("geom_pos", geoms)
            columns = numbers.get_rotation_columns("geom_quat", geoms)
            real = np.ones(len(geoms), bool)

            def to_body_axes(v: Vector, columns: Any = columns) -> Vector:
                return v if columns is None else rotate_to_world(columns, v)

            size = [numbers.get("geom_size", geoms, k) for k in range(3)]
            if model.geom_type[geoms[0]] == BOX:
                for one in CORNERS:
                    corner = to_body_axes(Vector(*(a * float(b) for a, b in zip(size, one, strict=True))))
                    singles.append(ContactCandidate(s, place, corner, ZERO, None, stack.bodies, geoms, real))
            elif model.geom_type[geoms[0]] == CAPSULE:
                along = to_body_axes(Vector(ZERO, ZERO, ONE))
                for side in (1.0, -1.0):
                    end = place + along * (size[1] * side)
                    singles.append(ContactCandidate(s, end, NOTHING, size[0], along, stack.bodies, geoms, real))
            elif model.geom_type[geoms[0]] == SPHERE:
                singles.append(ContactCandidate(s, place, NOTHING, size[0], None, stack.bodies, geoms, real))
        packable = stack.n == 1 and len(singles) > 1 and all(_is_known(one) for one in singles)
        found += _pack(singles, layout.group) if packable else singles
    return found


def _is_known(point: ContactCandidate) -> bool:
    parts = (*point.centre, *point.corner, point.radius)
    return point.along is None and all(one.is_constant for one in parts)


def _pack(singles: list[ContactCandidate], group: int) -> list[ContactCandidate]:
    """Put points of one body into rows of `group`; free places repeat the first point and are marked as not real."""
    found = []
    for first in range(0, len(singles), group):
        chosen = singles[first : first + group]
        filled = chosen + chosen[:1] * (group - len(chosen))

        def join(numbers: list[Scalar]) -> Scalar:
            return Scalar(np.array([one.value for one in numbers]))

        def vectors(name: str, filled: list[ContactCandidate] = filled) -> Vector:
            return Vector(*(join([getattr(one, name)[k] for one in filled]) for k in range(3)))

        found.append(
            ContactCandidate(
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


def find_contacts(
    layout: RobotLayout, numbers: ModelFieldValues, state: RobotState, smooth: SmoothTerms
) -> list[GroundContacts]:
    """Compute the contacts of the robot with all planes in a state; points above a plane have zero weight."""
    found = []
    for plane in layout.planes:
        normal, start = constant_vector(plane.normal), find_point_on_plane(numbers, plane)
        height = normal.dot(state.position - start)
        for point in find_contact_candidates(layout, numbers, plane.geom):
            place = smooth.places[point.stack]
            centre = place.origin + rotate_to_world(place.axes, point.centre)
            if not all(one.is_exactly(0) for one in point.corner):
                arm = rotate_to_world(place.axes, point.corner)
                centre = centre + arm * where(normal.dot(arm) > ZERO, -ONE, ONE)
            distance = height + normal.dot(centre) - point.radius
            at = centre - normal * (point.radius + distance * 0.5)
            along = None if point.along is None else rotate_to_world(place.axes, point.along)
            frame = (normal, *make_plane_tangents(normal, along))
            found.append(make_ground_contacts(numbers, plane.geom, point, distance, at, frame, place.motion))
    return found


def find_point_on_plane(numbers: ModelFieldValues, plane: CollisionPlane) -> Vector:
    """Return a point (m, world axes) of a plane, whose height may differ between rollouts."""
    if numbers.model.geom_bodyid[plane.geom]:
        return constant_vector(plane.position)
    return numbers.get_vector("geom_pos", np.array([plane.geom]))


def make_plane_tangents(normal: Vector, along: Vector | None) -> tuple[Vector, Vector]:
    """Return tangents of a plane as `mju_makeFrame` chooses them.

    Args:
        normal: Normal, which is known.
        along: Axis of a capsule, along which the first tangent is unless it is upright; None for other shapes.
    """
    n = np.array([float(one.value) for one in normal])
    usual = np.array([0.0, 1, 0]) if abs(n[1]) < 0.5 else np.array([0.0, 0, 1])
    usual = usual - n * (n @ usual)
    usual = constant_vector(usual / np.linalg.norm(usual))
    if along is None:
        return usual, normal.cross(usual)
    flat = along - normal * normal.dot(along)
    length = square_root(largest(flat.dot(flat), TINY**2))
    lies = Scalar(TINY) < length
    first = Vector(*(where(lies, a / length, b) for a, b in zip(flat, usual, strict=True)))
    return first, normal.cross(first)


def make_tangents(normal: Vector) -> tuple[Vector, Vector]:
    """Return tangents to normals that are computed, as `mju_makeFrame` chooses them."""
    is_flat = (normal.y < 0.5) & (Scalar(-0.5) < normal.y)
    along = where(is_flat, normal.y, normal.z)
    first = Vector(ZERO, where(is_flat, ONE, ZERO), where(is_flat, ZERO, ONE)) - normal * along
    first = first * (1 / square_root(first.dot(first)))
    return first, normal.cross(first)


class ContactNumbers(NamedTuple):
    """Friction, regularization and reference acceleration of a row of contacts, by MuJoCo's law of contacts."""

    friction: tuple[Scalar, ...]  # of each dimension after the normal one: sliding twice, torsional, rolling twice
    regular: Scalar  # sliding friction over the root of impratio: of an elliptic cone
    weight: Scalar  # inverse of the regularization; 0 without contact
    wanted: tuple[Scalar, ...]  # accelerations along normal and tangents, then angular ones about them


def apply_contact_law(
    numbers: ModelFieldValues,
    geoms: tuple[np.ndarray, np.ndarray],
    bodies: tuple[np.ndarray, np.ndarray],
    distance: Scalar,
    frame: tuple[Vector, Vector, Vector],
    motion: tuple[Vector, Vector],
) -> ContactNumbers:
    """Compute what MuJoCo's law of contacts gives for a row of contacts of two geoms each.

    Args:
        numbers: Numbers of the rollout's model.
        geoms: Ids (n,) or (1,) of the geoms of both sides.
        bodies: Ids (n,) or (1,) of their bodies; 0 for the world.
        distance: Distances of the geoms, m.
        frame: Normal and tangents, world axes.
        motion: Linear and angular velocity of one side relative to the other at the place of contact, world axes.
    """
    law, frictions, margin = _find_law(numbers, *geoms)
    dim, friction = len(frictions) + 1, frictions[0] if frictions else ZERO
    inverse = numbers.get("body_invweight0", bodies[0], 0) + numbers.get("body_invweight0", bodies[1], 0)
    impratio = numbers.get("opt.impratio")
    is_elliptic = numbers.model.opt.cone == ELLIPTIC
    if dim > 1 and not is_elliptic:
        inverse = inverse * (1 + friction * friction) * (2 * friction * friction / impratio)
    impedance = compute_impedance(law, distance - margin)
    weight = where(distance < margin, impedance / (inverse * (1 - impedance)), ZERO)
    speed = contact_frame_components(frame, *motion, dim)
    wanted = -(speed[0] * law.damping) - law.stiffness * impedance * (distance - margin)
    others = tuple(-(one * law.damping) for one in speed[1:])
    regular = friction / square_root(impratio)
    return ContactNumbers(tuple(frictions), regular, weight, (wanted, *others))


def make_ground_contacts(
    numbers: ModelFieldValues,
    ground: int,
    point: ContactCandidate,
    distance: Scalar,
    at: Vector,
    frame: tuple[Vector, Vector, Vector],
    motion: SpatialVector,
) -> GroundContacts:
    """Return a row of contacts of the robot with a geom of the world.

    Args:
        numbers: Numbers of the rollout's model.
        ground: Id of the geom of the world.
        point: Bodies and geoms of the robot.
        distance: Distances of the geoms, m.
        at: Places of contact, from the base's origin.
        frame: Normal, towards the robot, and tangents; world axes.
        motion: Motion of the bodies.
    """
    geoms, bodies = (point.geoms, np.array([ground])), (point.bodies, np.array([0]))
    found = apply_contact_law(numbers, geoms, bodies, distance, frame, (motion.velocity_at(at), motion.angular))
    if not point.real.all():
        found = found._replace(weight=found.weight * Scalar(point.real.astype(float)))
    return GroundContacts(point, at, frame, *found)


def describe_contact_law(
    model: mujoco.MjModel, geoms: np.ndarray, others: np.ndarray
) -> tuple[np.ndarray | None, int, int]:
    """Return which parameters the contacts of geoms with others have.

    Args:
        model: The model.
        geoms: Ids (n,) of the geoms of one side.
        others: Ids (n,) or (1,) of those of the other side.

    Returns:
        Ids (n,) of their explicit pairs, None without; 1 if the parameters are those of `geoms` by priority, -1 if
        they are those of `others`, 0 if they are mixed; and the dimension of the contacts.

    Raises:
        InputError: They differ in one of these.
    """
    pairs, winner = find_contact_pair_ids(model, geoms, others), 0
    if pairs is not None:
        dims = model.pair_dim[pairs]
    else:
        dims = np.maximum(model.geom_condim[geoms], model.geom_condim[others])
        first, second = (model.geom_priority[one] for one in (geoms, others))
        wins = np.where(first > second, 1, np.where(first < second, -1, 0))
        if len(set(wins.tolist())) > 1:
            raise unsupported_model_error("limbs whose contacts differ in priority")
        winner = int(wins[0])
        dims = {0: dims, 1: model.geom_condim[geoms], -1: model.geom_condim[others]}[winner]
    if len(set(dims.tolist())) > 1:
        raise unsupported_model_error("limbs whose contacts differ in dimension")
    return pairs, winner, int(dims[0])


def _find_law(
    numbers: ModelFieldValues, geoms: np.ndarray, others: np.ndarray
) -> tuple[ConstraintLaw, list[Scalar], Scalar]:
    """Law of the contacts of geoms with others, friction of each dimension after the first, and margin (m)."""
    pairs, winner, dim = describe_contact_law(numbers.model, geoms, others)
    chosen = FRICTION_OF_DIMENSION[: dim - 1]
    if pairs is not None:
        reference = [numbers.get("pair_solref", pairs, k) for k in range(2)]
        law = make_constraint_law(numbers, reference, [numbers.get("pair_solimp", pairs, k) for k in range(5)])
        friction = [largest(numbers.get("pair_friction", pairs, k), LEAST_FRICTION) for k in range(len(chosen))]
        return law, friction, find_contact_margin(numbers, geoms, others)
    law, friction = _mix(numbers, geoms, others, winner)
    return law, [friction[k] for k in chosen], find_contact_margin(numbers, geoms, others)


def contact_frame_components(frame: Any, linear: Vector, angular: Vector, dim: int) -> tuple[Scalar, ...]:
    """Return the components of linear and angular motion along the axes of a contact's frame.

    Args:
        frame: Normal and tangents.
        linear: Motion of the point of contact, in world axes.
        angular: Angular motion, in world axes.
        dim: Dimensions of the contact.

    Returns:
        Linear components along normal and tangents, then angular ones, `dim` in all.
    """
    return tuple(frame[k % len(frame)].dot(linear if k < len(frame) else angular) for k in range(dim))


def find_contact_margin(numbers: ModelFieldValues, geoms: np.ndarray, others: np.ndarray) -> Scalar:
    """Return the distance (m) below which geoms and others push: that of explicit pairs, or the sum of their margins.

    Args:
        numbers: Numbers of the rollout's model.
        geoms: Ids (n,) of the geoms.
        others: Ids (n,) or (1,) of the other geoms.
    """
    pairs = find_contact_pair_ids(numbers.model, geoms, others)
    if pairs is not None:
        return numbers.get("pair_margin", pairs)
    return numbers.get("geom_margin", geoms) + numbers.get("geom_margin", others)


def _mix(
    numbers: ModelFieldValues, geoms: np.ndarray, others: np.ndarray, winner: int
) -> tuple[ConstraintLaw, list[Scalar]]:
    """Law and friction (sliding, torsional, rolling) of two geoms: of the one of higher priority, or mixed."""
    each = (numbers.get("geom_solmix", geoms), numbers.get("geom_solmix", others))
    if winner:
        share = ONE if winner > 0 else ZERO
        friction = [numbers.get("geom_friction", geoms if winner > 0 else others, k) for k in range(3)]
    else:
        share = each[0] / (each[0] + each[1])
        both = ([numbers.get("geom_friction", one, k) for one in (geoms, others)] for k in range(3))
        friction = [largest(*each) for each in both]

    def mix_number(name: str, k: int) -> Scalar:
        return share * numbers.get(name, geoms, k) + (1 - share) * numbers.get(name, others, k)

    reference = [mix_number("geom_solref", k) for k in range(2)]
    if not winner and min(float(numbers.model.geom_solref[g, 0]) for g in (*geoms, *others)) <= 0:
        least = [
            smallest(numbers.get("geom_solref", geoms, k), numbers.get("geom_solref", others, k)) for k in range(2)
        ]
        reference = least  # direct formats are not mixed
    return make_constraint_law(numbers, reference, [mix_number("geom_solimp", k) for k in range(5)]), [
        largest(one, LEAST_FRICTION) for one in friction
    ]


def make_constraint_law(numbers: ModelFieldValues, reference: list[Scalar], impedance: list[Scalar]) -> ConstraintLaw:
    """Make stiffness, damping and impedance of a constraint from MuJoCo's `solref` and `solimp`."""
    least, top, middle = (clip(impedance[k], 1e-4, 0.9999) for k in (0, 1, 3))
    width, power = largest(impedance[2], TINY), impedance[4]
    if not (middle.is_constant and power.is_constant and reference[0].is_constant):
        raise unsupported_model_error(
            "time constants, or midpoints and powers of impedance, that differ between rollouts"
        )
    time = np.ravel(reference[0].value)
    if len(set(time > 0)) > 1:
        raise unsupported_model_error("limbs whose solref differ in format")
    if (time > 0).all():
        is_safe = not numbers.model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_REFSAFE)
        constant = largest(reference[0], 2 * numbers.model.opt.timestep if is_safe else 0.0)
        stiffness = 1 / (top * top * constant * constant * reference[1] * reference[1])
        damping = 2 / (top * constant)
    else:
        stiffness, damping = -reference[0] / (top * top), -reference[1] / top
    return ConstraintLaw(stiffness, damping, (least, top, width, middle, largest(power, 1.0)))


def compute_impedance(law: ConstraintLaw, depth: Scalar) -> Scalar:
    """Return a constraint's impedance at a penetration depth (m), by the formula of MuJoCo's `getimpedance`."""
    least, top, width, middle, power = law.impedance
    if (top - least).is_exactly(0):
        return least
    x = clip(largest(depth, -depth) / width, 0.0, 1.0)
    y = x
    for exponent in np.unique(power.value):
        if exponent != 1:
            low = raise_to_power(x, exponent) * Scalar(1 / middle.value ** (exponent - 1))
            high = 1 - raise_to_power(1 - x, exponent) * Scalar(1 / (1 - middle.value) ** (exponent - 1))
            curve = where(x < middle, low, high)
            y = curve if power.is_exactly(exponent) else where(power.value == exponent, curve, y)
    return least + y * (top - least)


def compute_joint_constraints(
    layout: RobotLayout, numbers: ModelFieldValues, state: RobotState
) -> list[JointConstraint]:
    """Compute the rows of all joints that have range limits or friction."""
    model, found = numbers.model, _find_base_friction(layout, numbers, state)
    for joint in layout.joints:
        ids = layout.stacks[joint[0]].joints[joint[1]]
        dofs, rate = model.jnt_dofadr[ids], state.rates[joint]
        if numbers.may_be_nonzero("dof_frictionloss", dofs):
            found.append(_friction_row(numbers, ((joint, ONE),), dofs, rate))
        limited = model.jnt_limited[ids].astype(bool)
        if limited.any():
            low, high = (numbers.get("jnt_range", ids, k) for k in range(2))
            if not limited.all():
                far = Scalar(np.where(limited, 0.0, 1e6))
                low, high = low - far, high + far
            under, over = state.angles[joint] - low, high - state.angles[joint]
            is_low = under < over
            depth, side = where(is_low, under, over), where(is_low, ONE, -ONE)
            law = read_constraint_law(numbers, "jnt_solref", "jnt_solimp", ids)
            margin = numbers.get("jnt_margin", ids)
            impedance = compute_impedance(law, depth - margin)
            inverse = numbers.get("dof_invweight0", dofs)
            weight = where(depth < margin, impedance / (inverse * (1 - impedance)), ZERO)
            wanted = -(side * rate) * law.damping - law.stiffness * impedance * (depth - margin)
            found.append(JointConstraint(((joint, side),), len(ids), weight, wanted, is_unit=True))
    return found


def _friction_row(
    numbers: ModelFieldValues,
    terms: tuple[tuple[tuple[int, int], Scalar], ...],
    dofs: np.ndarray,
    rate: Scalar,
    direction: SpatialVector | None = None,
) -> JointConstraint:
    """Friction of degrees of freedom (n,) that move at a rate."""
    law = read_constraint_law(numbers, "dof_solref", "dof_solimp", dofs)
    least = law.impedance[0]
    weight = least / (numbers.get("dof_invweight0", dofs) * (1 - least))
    most = numbers.get("dof_frictionloss", dofs)
    return JointConstraint(terms, len(dofs), weight, -(rate * law.damping), most, direction, is_unit=True)


def _find_base_friction(layout: RobotLayout, numbers: ModelFieldValues, state: RobotState) -> list[JointConstraint]:
    """Friction of the free joint: along the world's axes, and about the base's."""
    dofs = layout.base_dof_indices(numbers.model)
    if not len(dofs) or not numbers.may_be_nonzero("dof_frictionloss", dofs):
        return []
    found = []
    for k, axis in enumerate((*UPRIGHT, *quaternion_axes(*state.quat))):
        direction = SpatialVector(axis, NOTHING) if k < len(UPRIGHT) else SpatialVector(NOTHING, axis)
        found.append(_friction_row(numbers, (), dofs[k : k + 1], direction.dot(state.velocity), direction))
    return found


def read_constraint_law(numbers: ModelFieldValues, reference: str, impedance: str, ids: np.ndarray) -> ConstraintLaw:
    """Make the law of constraints from fields of the model.

    Args:
        numbers: Numbers of the rollout's model.
        reference: MuJoCo's name of the field with `solref`.
        impedance: MuJoCo's name of the field with `solimp`.
        ids: Elements (n,).
    """
    given = [numbers.get(reference, ids, k) for k in range(2)]
    return make_constraint_law(numbers, given, [numbers.get(impedance, ids, k) for k in range(5)])


class ContactHessian(NamedTuple):
    """Second derivative (Hessian) of a contact's cost: force and moment per unit of motion, world axes."""

    linear: SymmetricMatrix  # force by linear motion
    mixed: tuple[Vector, Vector, Vector] | None  # force by angular motion, by rows; None for condim 1 and 3
    angular: SymmetricMatrix  # moment by angular motion

    def stack_member(self, k: int) -> "ContactHessian":
        """Return the second derivative of contact `k` of a row."""
        first, second = (SymmetricMatrix(*(x.stack_member(k) for x in one)) for one in (self.linear, self.angular))
        mixed = None if self.mixed is None else tuple(row.stack_member(k) for row in self.mixed)
        return ContactHessian(first, mixed, second)  # pyright: ignore[reportArgumentType]

    def multiply_motion(self, motion: SpatialVector) -> SpatialVector:
        """Return the product of the Hessian and a motion of the contact: force and moment."""
        force = self.linear @ motion.linear
        if self.mixed is None:
            return SpatialVector(force, NOTHING)
        force = force + Vector(*(row.dot(motion.angular) for row in self.mixed))
        moment = self.angular @ motion.angular
        for row, speed in zip(self.mixed, motion.linear, strict=True):
            moment = moment + row * speed
        return SpatialVector(force, moment)


class _Cone(NamedTuple):
    """Where a residual is, of an elliptic cone of any dimension."""

    normal: Scalar  # scaled by `GroundContacts.regular`
    sideways: list[Scalar]  # the others, scaled by their friction
    slip: Scalar  # their length
    is_open: Any
    sticks: Any


def _find_cone(contact: GroundContacts, residual: tuple[Scalar, ...]) -> _Cone:
    normal = residual[0] * contact.regular
    sideways = [a * b for a, b in zip(residual[1:], contact.friction, strict=True)]
    slip = square_root(sum((one * one for one in sideways), ZERO))
    return _Cone(normal, sideways, slip, *_zones(contact.regular, normal, slip))


def _zones(mu: Scalar, normal: Scalar, slip: Scalar) -> tuple[Any, Any]:
    """Whether an elliptic contact is open, and whether it sticks; else it slides."""
    is_open = ~(normal < mu * slip)
    sticks = (mu * normal + slip < ZERO) | ~(slip > ZERO) & (normal < ZERO)
    return is_open, sticks


def _sliding_weight(contact: GroundContacts) -> Scalar:
    """Weight of a sliding contact's distance from an elliptic cone."""
    square = contact.regular * contact.regular
    return contact.weight / (square * (1 + square))


def _sticking_weights(contact: GroundContacts) -> list[Scalar]:
    """Weights of the rows of a sticking contact: those after the first have its weight times (friction / regular)^2."""
    ratios = [one / contact.regular for one in contact.friction]
    return [contact.weight, *(contact.weight * one * one for one in ratios)]


def contact_force(contact: GroundContacts, residual: tuple[Scalar, ...], is_elliptic: bool) -> tuple[Scalar, ...]:
    """Return the forces (N) and moments (N m) of contacts, along the axes of the contact frame.

    Args:
        contact: The row of contacts.
        residual: Residuals of its dimensions.
        is_elliptic: Whether its cone is elliptic.

    Returns:
        A number for each dimension of the contact.
    """
    weight = contact.weight
    if contact.dim == 1:
        return (-(weight * smallest(residual[0], ZERO)),)
    if not is_elliptic:
        edges = [[smallest(one, ZERO) for one in pair] for pair in _edges(contact, residual)]
        normal = -(weight * sum((a + b for a, b in edges), ZERO))
        turned = [-(weight * friction * (a - b)) for friction, (a, b) in zip(contact.friction, edges, strict=True)]
        return (normal, *turned)
    cone, mu = _find_cone(contact, residual), contact.regular
    pull = _sliding_weight(contact) * (cone.normal - mu * cone.slip) * mu
    inverse = 1 / where(cone.slip > ZERO, cone.slip, ONE)
    slide = [-pull, *(pull * inverse * a * b for a, b in zip(cone.sideways, contact.friction, strict=True))]
    stick = [-(a * b) for a, b in zip(_sticking_weights(contact), residual, strict=True)]
    return tuple(where(cone.sticks, a, where(cone.is_open, ZERO, b)) for a, b in zip(stick, slide, strict=True))


def contact_cost_hessian(contact: GroundContacts, residual: tuple[Scalar, ...], is_elliptic: bool) -> ContactHessian:
    """Return the second derivative (Hessian) of the cost of contacts with respect to their motion."""
    weight, dim = contact.weight, contact.dim
    lower = [[ZERO] * (i + 1) for i in range(dim)]  # in the contact's frame
    if dim == 1:
        lower[0][0] = where(residual[0] < ZERO, weight, ZERO)
    elif not is_elliptic:
        for i, (one, other) in enumerate(_edges(contact, residual), 1):
            a, b = (where(edge < ZERO, weight, ZERO) for edge in (one, other))
            friction = contact.friction[i - 1]
            lower[0][0] = lower[0][0] + a + b
            lower[i][0] = friction * (a - b)
            lower[i][i] = friction * friction * (a + b)
    else:
        cone, mu = _find_cone(contact, residual), contact.regular
        share, inverse = _sliding_weight(contact), 1 / where(cone.slip > ZERO, cone.slip, ONE)
        turn = mu * cone.normal * inverse
        level = mu * mu - turn
        along = [one * inverse for one in cone.sideways]
        stick = _sticking_weights(contact)
        slides = where(cone.is_open, ZERO, share)
        slides = where(cone.sticks, ZERO, slides)
        lower[0][0] = where(cone.sticks, stick[0], slides * mu * mu)
        for i, (way, friction) in enumerate(zip(along, contact.friction, strict=True), 1):
            part = slides * friction
            lower[i][0] = -(part * mu * mu * way)
            for j in range(1, i + 1):
                bend = turn * way * along[j - 1] + (level if i == j else ZERO)
                lower[i][j] = part * bend * contact.friction[j - 1]
            lower[i][i] = where(cone.sticks, stick[i], lower[i][i])
    return _curve_in_world(contact.frame, lower)


def _curve_in_world(frame: tuple[Vector, Vector, Vector], lower: list[list[Scalar]]) -> ContactHessian:
    """Turn a matrix of the contact's frame, given by its lower triangle, to the world's axes."""
    dim = len(lower)

    def block(rows: range, columns: range) -> list[Vector]:
        """Rows of the sum of frame[i] C[i][j] frame[j]ᵀ over a block of the matrix."""
        found = [NOTHING] * 3
        for i in rows:
            inner = NOTHING
            for j in columns:
                inner = inner + frame[j % 3] * lower[max(i, j)][min(i, j)]
            found = [row + inner * part for row, part in zip(found, frame[i % 3], strict=True)]
        return found

    forces, moments = range(min(dim, 3)), range(3, dim)
    linear = as_symmetric_matrix(block(forces, forces))
    if dim <= 3:
        return ContactHessian(linear, None, NO_MATRIX)
    mixed = block(forces, moments)
    return ContactHessian(linear, (mixed[0], mixed[1], mixed[2]), as_symmetric_matrix(block(moments, moments)))


def _edges(contact: GroundContacts, residual: tuple[Scalar, ...]) -> list[tuple[Scalar, Scalar]]:
    """Residuals of each pair of opposite edges of a pyramid."""
    scaled = [a * b for a, b in zip(contact.friction, residual[1:], strict=True)]
    return [(residual[0] + one, residual[0] - one) for one in scaled]


class LineSearchCost(NamedTuple):
    """Cost of contacts along a search direction, for the line search of the constraint solver."""

    contact: GroundContacts
    edges: list[tuple[Scalar, Scalar]]  # residual and its change, of the normal or of all edges of a pyramid
    normal: tuple[Scalar, Scalar] | None  # of an elliptic cone, scaled: at the start, and its change
    slip: tuple[Scalar, Scalar, Scalar] | None  # square of the slip by the powers of the length, half of the middle one

    def derivatives(self, length: Scalar) -> tuple[Scalar, Scalar]:
        """Return first and second derivative of the cost at a step length along the search direction."""
        first, second, weight = ZERO, ZERO, self.contact.weight
        if self.normal is None or self.slip is None:
            for start, change in self.edges:
                residual = start + length * change
                pull = where(residual < ZERO, weight * change, ZERO)
                first, second = first + pull * residual, second + pull * change
            return first, second
        mu, (start, change), (least, middle, square) = self.contact.regular, self.normal, self.slip
        normal, rise = start + length * change, middle + length * square
        slip = square_root(largest(least + length * (middle + rise), ZERO))
        is_open, sticks = _zones(mu, normal, slip)
        stick = weight / (mu * mu)
        bend = stick * (change * change + square)
        pull = stick * (start * change + middle) + length * bend
        inverse = 1 / where(slip > ZERO, slip, ONE)
        turn = rise * inverse
        gap, grows = normal - mu * slip, change - mu * turn
        share = _sliding_weight(self.contact)
        slides = share * (grows * grows - gap * mu * inverse * largest(square - turn * turn, ZERO))
        first = where(sticks, pull, where(is_open, ZERO, share * gap * grows))
        return first, where(sticks, bend, where(is_open, ZERO, slides))


def make_line_search_cost(
    contact: GroundContacts, residual: tuple[Scalar, ...], change: tuple[Scalar, ...], is_elliptic: bool
) -> LineSearchCost:
    """Return the cost of contacts along a search direction, which changes their residuals by `change` per unit."""
    if contact.dim == 1:
        return LineSearchCost(contact, [(residual[0], change[0])], None, None)
    if not is_elliptic:
        starts, changes = _edges(contact, residual), _edges(contact, change)
        edges = [pair for both in zip(starts, changes, strict=True) for pair in zip(*both, strict=True)]
        return LineSearchCost(contact, edges, None, None)
    a, b = ([x * friction for x, friction in zip(one[1:], contact.friction, strict=True)] for one in (residual, change))
    products = [sum((x * y for x, y in zip(*pair, strict=True)), ZERO) for pair in ((a, a), (a, b), (b, b))]
    normal = residual[0] * contact.regular, change[0] * contact.regular
    return LineSearchCost(contact, [], normal, (products[0], products[1], products[2]))


def joint_constraint_force(row: JointConstraint, residual: Scalar) -> tuple[Scalar, Scalar]:
    """Return the force of a row of joints, and the second derivative of its cost."""
    if row.is_equality:
        return -(row.weight * residual), row.weight
    if row.most is None:
        inside = residual < ZERO
        return -(row.weight * smallest(residual, ZERO)), where(inside, row.weight, ZERO)
    pull = -(row.weight * residual)
    force = largest(smallest(pull, row.most), -row.most)
    return force, where((pull < row.most) & (-row.most < pull), row.weight, ZERO)


def contact_wrench(contact: GroundContacts, force: tuple[Scalar, ...]) -> SpatialVector:
    """Return the force and moment that a contact exerts on the body, from components in the contact's frame."""
    parts = [NOTHING, NOTHING]
    for k, one in enumerate(force):
        parts[k // 3] = parts[k // 3] + contact.frame[k % 3] * one
    wrench = point_force_wrench(contact.at, parts[0])
    return wrench if contact.dim <= 3 else SpatialVector(wrench.linear, wrench.angular + parts[1])
