"""Smooth dynamics of a legged robot in explicit equations: mass matrix, bias forces, foot Jacobians.

Generalised velocity: the base's (linear, angular), both in base axes, then alpha, beta, gamma of each leg.
"""

from functools import partial, reduce
from operator import add
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from sweep.core.constants import GRAVITY
from sweep.core.vectors import Matrix, Number, Vector, symmetric_matrix
from sweep.dynamics.interface import RobotDynamicsTerms, SmoothDynamics
from sweep.dynamics.spatial import GeneralizedVector, Inertia, JointTriple, MassMatrix, SpatialVector, SystemPose
from sweep.formulas.leg import SIDE_BY_LEG
from sweep.models.case import Case
from sweep.models.posture import leg_mounts
from sweep.models.robot import Robot, link_names


class LegLink(NamedTuple):
    """A link of a leg as a uniform rod, with its mass and inertia."""

    mass: Number
    transverse_inertia: Number  # kg m^2, about its centre
    axial_inertia: Number
    vector: Vector  # m, from its start to its end
    direction: Vector
    joint: int  # the last joint before it

    def multiply_by_inertia(self, u: Vector) -> Vector:
        """Multiply the inertia tensor about the link's centre by a vector."""
        return (
            self.transverse_inertia * u
            + ((self.axial_inertia - self.transverse_inertia) * self.direction.dot(u)) * self.direction
        )


def tree_dynamics(world: Case) -> SmoothDynamics:
    """Build a function that computes mass matrix, bias forces and foot Jacobians from explicit equations."""
    return partial(robot_dynamics_terms, world.robot, world.drive.armature)


def leg_links(robot: Robot, angle: JointTriple) -> tuple[Vector, list[LegLink]]:
    """Return the unit vectors of a leg's beta and gamma axes, and its links from the hip outward."""
    yaw, side = leg_mounts(robot).yaw.astype(angle[0].dtype), SIDE_BY_LEG.astype(angle[0].dtype)
    turn, lift, bend = yaw + angle[0], angle[1], angle[1] + angle[2]
    cos, sin = jnp.cos(turn), jnp.sin(turn)
    zero, one = jnp.zeros_like(cos), jnp.ones_like(cos)
    across, out, up = Vector(cos, sin, zero), Vector(-sin, cos, zero), Vector(zero, zero, one)
    ways = {
        "coxa": (side * out, 0),
        "thigh": ((side * jnp.sin(lift)) * out - (side * jnp.cos(lift)) * up, 1),
        "shin": (-jnp.sin(bend) * out + jnp.cos(bend) * up, 2),
    }
    found = []
    for name in link_names(robot):
        length, mass, radius = getattr(robot, name), getattr(robot, f"{name}_mass"), robot.link_radius
        direction, joint = ways[name]
        inertia = mass * (3 * radius**2 + length**2) / 12, mass * radius**2 / 2
        found.append(LegLink(mass, *inertia, length * direction, direction, joint))
    return across, found


def robot_dynamics_terms(robot: Robot, armature: Number, pose: SystemPose, v: GeneralizedVector) -> RobotDynamicsTerms:
    """Compute mass matrix, bias forces and foot Jacobians leg by leg, by recursive Newton-Euler and composite bodies.

    The bias is the force that keeps all generalised accelerations zero; the linear one is that in world axes, so that
    a moving base adds nothing to it.
    """
    axis, links = leg_links(robot, pose.angle)
    up = Vector(jnp.zeros_like(axis.x), jnp.zeros_like(axis.x), jnp.ones_like(axis.x))
    axes = (up, axis, axis)
    gravity = pose.root[0].rotation().z * -GRAVITY  # world's down, in base axes
    hips = leg_mounts(robot).hips.astype(axis.x.dtype)
    start, spin, turning = Vector.from_array(hips), v.root[0].angular, Vector(*[jnp.zeros_like(axis.x)] * 3)
    acceleration = spin.cross(spin.cross(start)) - gravity
    origins: list[Vector] = []  # of the joints
    centres, forces, moments = [], [], []  # of the links; the moments are about their centres
    joints, reached = [start], -1
    for link in links:
        for k in range(reached + 1, link.joint + 1):
            origins.append(start)
            turning = turning + v.leg[k] * spin.cross(axes[k])
            spin = spin + v.leg[k] * axes[k]
        reached = link.joint
        half = 0.5 * link.vector
        at_centre = acceleration + turning.cross(half) + spin.cross(spin.cross(half))
        acceleration = acceleration + turning.cross(link.vector) + spin.cross(spin.cross(link.vector))
        centres.append(start + half)
        forces.append(link.mass * at_centre)
        moments.append(link.multiply_by_inertia(turning) + spin.cross(link.multiply_by_inertia(spin)))
        start = start + link.vector
        joints.append(start)
    leg_bias, columns = [], []
    for k in range(3):
        moved = [i for i, link in enumerate(links) if link.joint >= k]
        moment = reduce(add, (moments[i] + (centres[i] - origins[k]).cross(forces[i]) for i in moved))
        leg_bias.append(axes[k].dot(moment))
        momenta = [links[i].mass * axes[k].cross(centres[i] - origins[k]) for i in moved]
        angular = reduce(
            add,
            (links[i].multiply_by_inertia(axes[k]) + centres[i].cross(p) for i, p in zip(moved, momenta, strict=True)),
        )
        columns.append(SpatialVector(reduce(add, momenta), angular))
    box = _box(robot)
    spin_base = v.root[0].angular
    wrench = reduce(add, forces).sum_last_axis() - robot.body_mass * gravity
    twist = reduce(add, (m + c.cross(f) for m, c, f in zip(moments, centres, forces, strict=True))).sum_last_axis()
    twist = twist + spin_base.cross(Vector(box[0] * spin_base.x, box[1] * spin_base.y, box[2] * spin_base.z))
    feet = tuple(a.cross(start - o) for a, o in zip(axes, origins, strict=True))
    body = _composite(robot, links, centres)
    mass = MassMatrix((body,), tuple(columns), _leg_block(axes, origins, columns, armature))  # pyright: ignore
    bias = GeneralizedVector((SpatialVector(wrench, twist),), tuple(leg_bias))
    return RobotDynamicsTerms(mass, bias, tuple(joints), feet)  # pyright: ignore


def _box(robot: Robot) -> tuple[Number, Number, Number]:
    """Moments of inertia of the base (kg m^2)."""
    a, b, c = (robot.body_length**2, robot.body_width**2, robot.body_height**2)
    share = robot.body_mass / 12
    return share * (b + c), share * (a + c), share * (a + b)


def _composite(robot: Robot, links: list[LegLink], centres: list[Vector]) -> Inertia:
    """Mass, first moment and inertia of the whole robot about the base's origin (composite rigid body)."""
    moment = reduce(add, (link.mass * c for link, c in zip(links, centres, strict=True)))
    entries = [jnp.zeros_like(centres[0].x)] * 6
    for link, c in zip(links, centres, strict=True):
        d, m, extra = link.direction, link.mass, link.axial_inertia - link.transverse_inertia
        round_ = link.transverse_inertia + m * c.dot(c)
        parts = [
            (d.x, d.x, c.x, c.x),
            (d.y, d.y, c.y, c.y),
            (d.z, d.z, c.z, c.z),
            (d.x, d.y, c.x, c.y),
            (d.x, d.z, c.x, c.z),
            (d.y, d.z, c.y, c.z),
        ]
        for k, (d1, d2, c1, c2) in enumerate(parts):
            entries[k] = entries[k] + extra * d1 * d2 - m * c1 * c2 + (round_ if k < 3 else 0.0)
    totals = [jnp.sum(entry, axis=-1, keepdims=True) for entry in entries]
    box = _box(robot)
    inertia = symmetric_matrix(*[totals[k] + (box[k] if k < 3 else 0.0) for k in range(6)])
    legs = centres[0].x.shape[-1]
    mass = robot.body_mass + legs * sum(link.mass for link in links)
    return Inertia(mass * jnp.ones_like(totals[0]), moment.sum_last_axis(), inertia)


def _leg_block(axes: tuple, origins: list[Vector], columns: list[SpatialVector], armature: Number) -> Matrix:
    """3x3 mass-matrix block of each leg: momentum about joint i from motion of joint j >= i."""

    def entry(i: int, j: int) -> Array:
        return axes[i].dot(columns[j].angular - origins[i].cross(columns[j].linear))

    e = {(i, j): entry(i, j) for i in range(3) for j in range(i, 3)}
    return symmetric_matrix(e[0, 0] + armature, e[1, 1] + armature, e[2, 2] + armature, e[0, 1], e[0, 2], e[1, 2])
