"""Kinematics, inertia and bias forces of a robot, in the world's axes and about the origin of its base.

Composite rigid bodies and the recursive Newton-Euler method, over stacks of like bodies.
"""

from typing import NamedTuple

from sweep.systems.mujoco_model.kernel.layout import HINGE, RobotLayout
from sweep.systems.mujoco_model.kernel.numbers import ModelFieldValues
from sweep.systems.mujoco_model.kernel.scalars import (
    NO_MATRIX,
    NOTHING,
    ONE,
    ZERO,
    Axes,
    Scalar,
    SymmetricMatrix,
    Vector,
    outer_product,
    quaternion_axes,
    rotate_body_about_axis,
    rotate_to_world,
    scaled_identity,
)
from sweep.systems.mujoco_model.kernel.tendons import add_tendon_armature

BASE = (0, -1)  # stands for the free joint where others have the index of a stack and a number in it
UPRIGHT: Axes = (Vector(ONE, ZERO, ZERO), Vector(ZERO, ONE, ZERO), Vector(ZERO, ZERO, ONE))


class SpatialVector(NamedTuple):
    """Linear and angular velocity of a body, or force and moment on it, referred to the origin of the robot's base."""

    linear: Vector
    angular: Vector

    def __add__(self, other: "SpatialVector") -> "SpatialVector":  # pyright: ignore[reportIncompatibleMethodOverride]
        return SpatialVector(self.linear + other.linear, self.angular + other.angular)

    def __sub__(self, other: "SpatialVector") -> "SpatialVector":
        return SpatialVector(self.linear - other.linear, self.angular - other.angular)

    def __mul__(self, factor: Scalar) -> "SpatialVector":  # pyright: ignore[reportIncompatibleMethodOverride]
        return SpatialVector(self.linear * factor, self.angular * factor)

    def dot(self, other: "SpatialVector") -> Scalar:
        """Return the scalar product of a motion and a force, which is power."""
        return self.linear.dot(other.linear) + self.angular.dot(other.angular)

    def velocity_at(self, point: Vector) -> Vector:
        """Return the velocity of a point of the body that moves with this linear and angular velocity."""
        return self.linear + self.angular.cross(point)

    def sum_over_stack(self, n: int) -> "SpatialVector":
        """Return the sum of these vectors over the n bodies of a stack (corresponding bodies of all limbs)."""
        return SpatialVector(*(Vector(*(one.sum_over_stack(n) for one in part)) for part in self))


STILL = SpatialVector(NOTHING, NOTHING)


def point_force_wrench(point: Vector, force: Vector) -> SpatialVector:
    """Return a force that acts at a point, together with its moment about the base's origin."""
    return SpatialVector(force, point.cross(force))


class RigidInertia(NamedTuple):
    """Mass (kg), first moment (kg m) and inertia (kg m^2) of a body about the origin of the robot's base."""

    mass: Scalar
    moment: Vector
    inertia: SymmetricMatrix

    def __add__(self, other: "RigidInertia") -> "RigidInertia":  # pyright: ignore[reportIncompatibleMethodOverride]
        return RigidInertia(self.mass + other.mass, self.moment + other.moment, self.inertia + other.inertia)

    def momentum(self, motion: SpatialVector) -> SpatialVector:
        """Return the linear and angular momentum of the body that has the given motion."""
        return SpatialVector(
            motion.linear * self.mass + motion.angular.cross(self.moment),
            self.moment.cross(motion.linear) + self.inertia @ motion.angular,
        )

    def sum_over_stack(self, n: int) -> "RigidInertia":
        """Return the sum of inertias over the n bodies of a stack (corresponding bodies of all limbs)."""
        return RigidInertia(
            self.mass.sum_over_stack(n),
            Vector(*(one.sum_over_stack(n) for one in self.moment)),
            SymmetricMatrix(*(one.sum_over_stack(n) for one in self.inertia)),
        )


NO_INERTIA = RigidInertia(ZERO, NOTHING, NO_MATRIX)


class BodyPose(NamedTuple):
    """Positions, axes and motions of the bodies in a stack (corresponding bodies of all limbs)."""

    origin: Vector  # from the base's origin
    axes: Axes
    centre: Vector  # of mass
    motion: SpatialVector  # of the base's origin with the body
    acceleration: Vector  # of the body's origin less gravity, while no joint and no base accelerates
    spin_rate: Vector  # likewise, of its spin


class SmoothTerms(NamedTuple):
    """Kinematics, mass matrix and bias forces of the robot in a state, without constraints."""

    places: tuple[BodyPose, ...]  # by stack
    motions: dict[tuple[int, int], SpatialVector]  # of each joint per unit of its rate
    whole: RigidInertia  # of the robot, with the armature of the free joint
    momenta: dict[tuple[int, int], SpatialVector]  # of all that a joint moves, per unit of its rate
    mass: dict[tuple[tuple[int, int], tuple[int, int]], Scalar]  # of joints, (inner, outer), with armature
    bias_base: SpatialVector  # force that keeps all accelerations 0
    bias: dict[tuple[int, int], Scalar]


class RobotState(NamedTuple):
    """State of a robot: pose and motion of the base, joint angles and rates, last accelerations; world axes."""

    position: Vector  # of the base
    quat: tuple[Scalar, Scalar, Scalar, Scalar]
    velocity: SpatialVector  # of the base
    angles: dict[tuple[int, int], Scalar]  # rad or m, by joint
    rates: dict[tuple[int, int], Scalar]
    warm_base: SpatialVector  # accelerations of the step before
    warm: dict[tuple[int, int], Scalar]


def compute_smooth_terms(layout: RobotLayout, numbers: ModelFieldValues, state: RobotState) -> SmoothTerms:
    """Compute kinematics, mass matrix and bias forces of the robot in a state."""
    gravity = numbers.get_vector("opt.gravity")
    places: list[BodyPose] = []
    motions, forces, inertias = {}, [], []
    for s, stack in enumerate(layout.stacks):
        if stack.parent < 0:
            is_free = layout.has_free_base
            axes = quaternion_axes(*state.quat) if is_free else UPRIGHT
            origin, spin = NOTHING, state.velocity.angular if is_free else NOTHING
            acceleration, spin_rate, motion = -gravity, NOTHING, state.velocity if is_free else STILL
        else:
            parent = places[stack.parent]
            acceleration, spin, spin_rate = parent.acceleration, parent.motion.angular, parent.spin_rate
            offset = rotate_to_world(parent.axes, numbers.get_vector("body_pos", stack.bodies))
            acceleration = acceleration + relative_acceleration(spin, spin_rate, offset)
            origin, axes, motion = parent.origin + offset, parent.axes, parent.motion
            columns = numbers.get_rotation_columns("body_quat", stack.bodies)
            if columns is not None:
                axes = (
                    rotate_to_world(axes, columns[0]),
                    rotate_to_world(axes, columns[1]),
                    rotate_to_world(axes, columns[2]),
                )
        for k, joints in enumerate(stack.joints):
            angle, rate = state.angles[s, k], state.rates[s, k]
            moved = angle - numbers.get("qpos0", numbers.model.jnt_qposadr[joints])
            axis = numbers.get_vector("jnt_axis", joints)
            anchor = numbers.get_vector("jnt_pos", joints)
            if numbers.model.jnt_type[joints[0]] == HINGE:
                arm = rotate_to_world(axes, anchor)
                acceleration = acceleration + relative_acceleration(spin, spin_rate, arm)
                point = origin + arm
                axes, world = rotate_body_about_axis(axes, axis, moved)  # pyright: ignore[reportArgumentType]
                turn = world * rate
                spin_rate = spin_rate + spin.cross(turn)
                spin = spin + turn
                arm = -rotate_to_world(axes, anchor)
                acceleration = acceleration + relative_acceleration(spin, spin_rate, arm)
                origin = point + arm
                motions[s, k] = SpatialVector(point.cross(world), world)
            else:
                world = rotate_to_world(axes, axis)  # pyright: ignore[reportArgumentType]
                slid = world * moved
                acceleration = (
                    acceleration + relative_acceleration(spin, spin_rate, slid) + spin.cross(world * rate) * 2.0
                )
                origin = origin + slid
                motions[s, k] = SpatialVector(world, NOTHING)
            motion = motion + motions[s, k] * rate
        arm = rotate_to_world(axes, numbers.get_vector("body_ipos", stack.bodies))  # pyright: ignore[reportArgumentType]
        centre, mass = origin + arm, numbers.get("body_mass", stack.bodies)
        own = _inertia(numbers, axes, stack.bodies)  # pyright: ignore[reportArgumentType]
        force = (acceleration + relative_acceleration(spin, spin_rate, arm)) * mass
        moment = own @ spin_rate + spin.cross(own @ spin)
        forces.append(SpatialVector(force, moment + centre.cross(force)))
        inertias.append(RigidInertia(mass, centre * mass, own + _point_inertia(mass, centre)))
        places.append(BodyPose(origin, axes, centre, motion, acceleration, spin_rate))  # pyright: ignore
    momenta, mass_matrix, bias = {}, {}, {}
    for s in reversed(range(len(layout.stacks))):
        stack = layout.stacks[s]
        for k in reversed(range(len(stack.joints))):
            bias[s, k] = motions[s, k].dot(forces[s])
            momenta[s, k] = inertias[s].momentum(motions[s, k])
            for inner in list_ancestor_joints(layout, (s, k)):
                mass_matrix[inner, (s, k)] = motions[inner].dot(momenta[s, k])
            dofs = numbers.model.jnt_dofadr[stack.joints[k]]
            mass_matrix[(s, k), (s, k)] = motions[s, k].dot(momenta[s, k]) + numbers.get("dof_armature", dofs)
        if stack.parent >= 0:
            up = layout.stacks[stack.parent].n == 1 and stack.n > 1
            forces[stack.parent] += forces[s].sum_over_stack(stack.n) if up else forces[s]
            inertias[stack.parent] += inertias[s].sum_over_stack(stack.n) if up else inertias[s]
    add_tendon_armature(layout, numbers, mass_matrix)
    whole = inertias[0]
    dofs = layout.base_dof_indices(numbers.model)
    if len(dofs) and numbers.may_be_nonzero("dof_armature", dofs):
        armature = numbers.get("dof_armature", dofs[:1])
        whole = whole + RigidInertia(armature, NOTHING, scaled_identity(armature))
    return SmoothTerms(tuple(places), motions, whole, momenta, mass_matrix, forces[0], bias)


def list_ancestor_joints(layout: RobotLayout, joint: tuple[int, int]) -> list[tuple[int, int]]:
    """Return the joints between the base and `joint`, from the base outward, excluding `joint`."""
    moving = layout.moving_joints(joint[0])
    return moving[: moving.index(joint)]


def relative_acceleration(spin: Vector, spin_rate: Vector, arm: Vector) -> Vector:
    """Return the acceleration of a point of a body relative to another of its points at distance vector `arm`."""
    return spin_rate.cross(arm) + spin.cross(spin.cross(arm))


def _point_inertia(mass: Scalar, place: Vector) -> SymmetricMatrix:
    """Inertia of a point mass about the origin."""
    w = place * mass
    xx, yy, zz = w.x * place.x, w.y * place.y, w.z * place.z
    return SymmetricMatrix(yy + zz, xx + zz, xx + yy, -(w.x * place.y), -(w.x * place.z), -(w.y * place.z))


def _inertia(numbers: ModelFieldValues, axes: Axes, bodies) -> SymmetricMatrix:
    """Inertia about the centre of mass, from the principal moments of the bodies."""
    columns = numbers.get_rotation_columns("body_iquat", bodies)
    principal = axes if columns is None else tuple(rotate_to_world(axes, column) for column in columns)
    moments = [numbers.get("body_inertia", bodies, k) for k in range(3)]
    last = 2
    for k in range(3):  # the axis of symmetry of a rod or a disc
        if (moments[(k + 1) % 3] - moments[(k + 2) % 3]).is_exactly(0):
            last = (k + 1) % 3
    found = scaled_identity(moments[last])
    for k in range(3):
        if k != last:
            found = found + outer_product(principal[k], moments[k] - moments[last])
    return found
