"""Contact points: the viscoelastic law with a Coulomb limit (monograph 1.2.2), and the forces on the bodies in contact.

The damping is evaluated implicitly. A contact point of the model that rolls is the centre of its sphere; it touches a
radius below, along the surface's normal. There a Coulomb moment of a given arm times the normal force opposes the
turning.
"""

from collections.abc import Sequence
from functools import reduce
from operator import add
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sweep.core.vectors import Matrix, Vector, select_vector, vector_along_axis
from sweep.dynamics import free_bodies
from sweep.dynamics.free_bodies import Frames, FreeBodies
from sweep.dynamics.spatial import SpatialVector
from sweep.models.case import Case
from sweep.models.contact import Contact
from sweep.models.legs import N_LEGS
from sweep.models.obstacles.surface import BodyPoses, RollingResistance, Surface

FACE_DTYPE = jnp.int32  # in double precision obstacles may tell wider ones
CREEP_RATE = 1e-4  # rad/s, at which the resisting moment reaches its limit: rest is a creep slower than this


class ContactAnchors(NamedTuple):
    """Points on the surface to which the tangential springs of n contact points are attached: r_T of (1.2.2)."""

    # m, in the axes of the body that owns the face, world axes for the fixed world; of what rolls, from the contact
    positions: Vector
    loaded: Bool[Array, " n"]
    face: Int[Array, " n"]


class ContactGeometry(NamedTuple):
    """Normals, spring offsets and other data of n contacts that stay constant within a step, in base or world axes."""

    depth: Float[Array, " n"]
    normal: Vector
    stretch: Vector  # tangential part of anchor minus point, m
    friction: Float[Array, " n"]  # friction coefficient
    damping: Float[Array, " n"] | float  # N s/m, d_n and the surface's own

    def rotate(self, rotation: Matrix) -> "ContactGeometry":
        """Return the geometry with all vectors rotated to other axes."""
        return self._replace(normal=rotation @ self.normal, stretch=rotation @ self.stretch)


class ContactForces(NamedTuple):
    """Forces of n contacts for an assumed velocity at the end of the step, made by `contact_forces`."""

    force: Vector  # N, on the point
    normal: Float[Array, " n"]  # N, along the surface normal
    tangential: Vector  # N
    direction: Vector  # of the tangential force
    elastic_share: Float[Array, " n"]  # of the elastic force that holds
    slipping: Bool[Array, " n"]
    loaded: Bool[Array, " n"]


def make_initial_anchors(n: int, dtype: jnp.dtype) -> ContactAnchors:
    """Make the contact anchors (spring attachments) of n points that are not in contact."""
    return ContactAnchors(Vector.from_array(jnp.zeros((n, 3), dtype)), jnp.zeros(n, bool), jnp.zeros(n, FACE_DTYPE))


def _to_world_axes(place: Vector, body: Array, frames: Frames) -> Vector:
    """Points from the axes of the free body that each belongs to (-1: the world) to world axes."""
    for k, (origin, rotation) in enumerate(frames):
        place = select_vector(body == k, rotation @ place + origin, place)
    return place


def _to_body_axes(place: Vector, body: Array, frames: Frames) -> Vector:
    """Points from world axes to the axes of the free body that each belongs to; the inverse of `_to_world_axes`."""
    for k, (origin, rotation) in enumerate(frames):
        place = select_vector(body == k, rotation.transpose @ (place - origin), place)
    return place


def _frames(bodies: BodyPoses) -> Frames:
    """Poses of free bodies as components, for the transformation of points."""
    places = zip(bodies.position, bodies.rotation, strict=True)
    return [(Vector.from_array(position[None]), Matrix.from_array(rotation[None])) for position, rotation in places]


def transform_points_to_world(
    place: Float[Array, "n 3"], body: Int[Array, " n"], bodies: BodyPoses
) -> Float[Array, "n 3"]:
    """Transform points from the frames of free bodies to the world frame.

    Args:
        place: Points (m), each in the frame of its body.
        body: Number of each point's free body; -1 for the world.
        bodies: Poses of the free bodies.

    Returns:
        Points (m, world axes).
    """
    return _to_world_axes(Vector.from_array(place), body, _frames(bodies)).array()


def transform_points_to_body(
    place: Float[Array, "n 3"], body: Int[Array, " n"], bodies: BodyPoses
) -> Float[Array, "n 3"]:
    """Transform points from the world frame to the frames of free bodies, the inverse of `transform_points_to_world`.

    Args:
        place: Points (m, world axes).
        body: Number of each point's free body; -1 for the world.
        bodies: Poses of the free bodies.

    Returns:
        Points (m), each in the frame of its body.
    """
    return _to_body_axes(Vector.from_array(place), body, _frames(bodies)).array()


def contact_geometry(
    contact: Contact, surface: Surface, anchors: ContactAnchors, point: Vector, frames: Frames
) -> tuple[ContactGeometry, Vector]:
    """Return normals and other data of contacts at the start of a step, and their anchors (spring ends), world axes.

    A point keeps its anchor while it stays loaded on the same face; otherwise it takes hold where it is now.
    """
    normal = Vector.from_array(surface.normal)
    held = anchors.loaded & (anchors.face == surface.face)
    fresh = point + surface.depth * normal
    kept = _to_world_axes(anchors.positions, surface.body, frames)
    if surface.rolling is not None:
        kept = select_vector(surface.rolling.radius > 0, point + anchors.positions, kept)
    place = select_vector(held, kept, fresh)
    gap = place - point
    stretch = gap - gap.dot(normal) * normal
    damping = contact.damping if surface.damping is None else contact.damping + surface.damping
    return ContactGeometry(surface.depth, normal, stretch, contact.friction * surface.friction_scale, damping), place


def contact_forces(contact: Contact, geometry: ContactGeometry, velocity: Vector) -> ContactForces:
    """Compute the contact forces on points that move at `velocity` (m/s, relative to the surface) in a step.

    N = c_n depth - d_n v_n where positive; the tangential force is elastic up to the Coulomb limit. The depth is that
    at the step's start, the velocity that at its end: to first order in the step nothing but d_n damps. With the
    depth at its end, c_n h would come on top.
    """
    n, g = geometry.normal, geometry.damping
    v_normal = velocity.dot(n)
    normal = jnp.maximum(0.0, contact.stiffness * geometry.depth - g * v_normal)
    loaded = normal > 0
    elastic = contact.stiffness * geometry.stretch - g * (velocity - v_normal * n)
    size = jnp.sqrt(elastic.dot(elastic) + 1e-6)
    most = geometry.friction * normal
    slipping = loaded & ~(size <= most)  # a limit that is not a number must show, not hold
    share = jnp.where(loaded, jnp.where(slipping, most / size, 1.0), 0.0)
    tangential = share * elastic
    return ContactForces(normal * n + tangential, normal, tangential, (1 / size) * elastic, share, slipping, loaded)


def contact_damping(geometry: ContactGeometry, forces: ContactForces, h: float) -> Matrix:
    """Return the derivative -h d force / d velocity (N s^2/m) of contact forces, for a time step h.

    It keeps the coupling of the limit to the normal force, which makes it unsymmetric: without it the two iterations of
    a step diverge at 2 ms. Its parts are kept as values: worked out twice, they might differ.
    """
    n, t = geometry.normal, forces.direction
    scale = h * geometry.damping
    slips, holds = forces.slipping.astype(t.x.dtype), forces.loaded.astype(t.x.dtype)
    round_ = scale * forces.elastic_share
    along_n = scale * (holds - forces.elastic_share) * n + (scale * slips * geometry.friction) * t
    along_t = (-scale * slips * forces.elastic_share) * t
    round_, along_n, along_t = jax.lax.optimization_barrier((round_, along_n, along_t))
    rows = enumerate(zip(along_n, along_t, strict=True))
    return Matrix(*(a * n + b * t + vector_along_axis(k, round_) for k, (a, b) in rows))


def update_anchors(
    contact: Contact,
    surface: Surface,
    point: Vector,
    frames: Frames,
    place: Vector,
    forces: ContactForces,
    velocity: Vector,
    h: float,
) -> ContactAnchors:
    """Return the contact anchors (ends of tangential springs) after a step; a slipping point drags its anchor along.

    The contact of what rolls moves over both surfaces alike: only the slip between them, at `velocity`, stretches it.
    All in world axes.
    """
    normal = Vector.from_array(surface.normal)
    landed = point + h * velocity + (surface.depth - h * normal.dot(velocity)) * normal
    dragged = landed + (1 / contact.stiffness) * forces.tangential
    place = select_vector(forces.slipping, dragged, place)
    kept = _to_body_axes(place, surface.body, frames)
    if surface.rolling is not None:
        kept = select_vector(surface.rolling.radius > 0, place - point - h * velocity, kept)
    return ContactAnchors(kept, forces.loaded, surface.face.astype(FACE_DTYPE))


class RollingResistanceMoments(NamedTuple):
    """Moments against rolling and spinning of spheres (N m), and how fast they grow with the angular rate."""

    moment: Vector  # (m,) N m
    slope: Matrix  # (m,) -d moment / d rate, N m s/rad


def rolling_resistance_moments(
    rolling: RollingResistance, normal: Vector, load: Float[Array, "*m"], rate: Vector
) -> RollingResistanceMoments:
    """Return the moments (N m) against rolling and spinning at `rate` (rad/s) under the normal forces `load` (N)."""
    spin = rate.dot(normal)
    roll = rate - spin * normal
    size = jnp.sqrt(roll.dot(roll) + 1e-20)
    of_roll = load * rolling.roll / jnp.maximum(size, CREEP_RATE)
    of_spin = load * rolling.spin / jnp.maximum(jnp.abs(spin), CREEP_RATE)
    moment = -of_roll * roll - (of_spin * spin) * normal
    rests = (jnp.abs(spin) <= CREEP_RATE).astype(spin.dtype)
    along_n = (rests * of_spin - of_roll) * normal
    along_t = ((size > CREEP_RATE).astype(spin.dtype) * of_roll / size**2) * roll
    rows = zip(along_n, along_t, strict=True)
    return RollingResistanceMoments(
        moment, Matrix(*(a * normal - b * roll + vector_along_axis(k, of_roll) for k, (a, b) in enumerate(rows)))
    )


class BodyContactJacobian(NamedTuple):
    """Role of the base or a free body in n contacts: which points it carries, and which points stand on it."""

    body: int
    sign: Float[Array, " n"] | None  # 1 carries, -1 is stood on, 0 neither; None: it carries all
    points: Vector  # m, of the points from the body's origin

    def apply_contact_signs(self, v: Vector) -> Vector:
        """Multiply each point's vector by 1 if the body carries the point, -1 if it supports the point, else 0."""
        return v if self.sign is None else self.sign * v

    def force_rows_to_wrench(self, m: Matrix) -> tuple[Matrix, Matrix]:
        """Convert rows of a matrix for forces on contact points to rows for force and torque on the body."""
        m = m if self.sign is None else m.scale(self.sign)
        return m, m.transpose.times_cross_matrix(-self.points).transpose

    def velocity_columns_to_twist(self, m: Matrix) -> tuple[Matrix, Matrix]:
        """Convert a matrix for velocities of contact points to matrices for the body's linear and angular velocity."""
        m = m if self.sign is None else m.scale(self.sign)
        return m, m.times_cross_matrix(-self.points)


class ContactSet(NamedTuple):
    """Contact points that follow one contact law: the feet, or the contact sites of free bodies."""

    geometry: ContactGeometry
    arms: tuple[BodyContactJacobian, ...]
    rolling: RollingResistance | None = None

    def velocity(self, root: Sequence[SpatialVector]) -> Vector:
        """Return velocities of the points relative to their surfaces (m/s), from those of base and free bodies."""
        return reduce(
            add,
            [
                arm.apply_contact_signs(root[arm.body].linear + root[arm.body].angular.cross(arm.points))
                for arm in self.arms
            ],
        )

    def relative_spin(self, root: Sequence[SpatialVector]) -> Vector:
        """Return angular velocities (rad/s) of bodies with contact points relative to the bodies they touch."""
        return reduce(add, [arm.apply_contact_signs(root[arm.body].angular) for arm in self.arms])

    def root_wrenches(self, force: Vector, moment: Vector | None = None) -> list[tuple[int, SpatialVector]]:
        """Return force and torque on base and free bodies, from forces and moments at the contact points."""
        out = []
        for arm in self.arms:
            own = arm.apply_contact_signs(force)
            torque = (
                arm.points.cross(own) if moment is None else arm.points.cross(own) + arm.apply_contact_signs(moment)
            )
            out.append((arm.body, SpatialVector(own.sum_last_axis(), torque.sum_last_axis())))
        return out


def free_body_contact_jacobians(
    points: Vector, body: Array, owner: Sequence[int], origins: Sequence[Vector]
) -> tuple[BodyContactJacobian, ...]:
    """Return for each free body which contact points it carries (`owner`), and which points stand on it (`body`)."""
    shares = [jnp.equal(np.array(owner), k) - (body == k).astype(points.x.dtype) for k in range(len(origins))]
    return tuple(
        BodyContactJacobian(k + 1, share, points - origin)
        for k, (share, origin) in enumerate(zip(shares, origins, strict=True))
    )


class DetectedContacts(NamedTuple):
    """Contacts of the feet, or of free bodies, at the start of a step; world axes unless stated otherwise."""

    contacts: ContactSet
    surface: Surface
    points: Vector  # m
    anchor_positions: Vector  # m, the anchors

    def next_anchors(
        self, law: Contact, forces: ContactForces, velocity: Vector, rotation: Matrix, frames: Frames, h: float
    ) -> ContactAnchors:
        """Return the contact anchors (spring attachments) after the step, from forces and velocities in base axes."""
        world = forces._replace(tangential=rotation @ forces.tangential)
        return update_anchors(
            law, self.surface, self.points, frames, self.anchor_positions, world, rotation @ velocity, h
        )


def find_contacts(
    case: Case, anchors: Sequence[ContactAnchors], base: Vector, rotation: Matrix, feet: Vector, free: FreeBodies
) -> list[DetectedContacts]:
    """Find the contacts at the start of a step: those of the feet, then those of free bodies.

    Args:
        case: The world.
        anchors: Anchors of feet and sites.
        base: Position of the base (m, world axes).
        rotation: Base axes to world axes.
        feet: Positions of the feet (m, base axes, from the base).
        free: Kinematics of the free bodies.
    """
    to_base, at = rotation.transpose, [feet, *free_bodies.contact_sites(case, free)]
    points = [base + rotation @ each for each in at]
    owner, bodies = free_bodies.contact_owners(case), free_bodies.body_pose_arrays(free, feet.x.dtype)
    surface = case.obstacle.surface(jnp.concatenate([each.array() for each in points]), owner, bodies)
    touches = []
    for k, (held, span) in enumerate(zip(anchors, (slice(N_LEGS), slice(N_LEGS, None)), strict=False)):
        own, place, point = jax.tree.map(lambda x, span=span: x[span], surface), at[k], points[k]
        own = own if k else own._replace(rolling=None)  # feet do not
        if own.rolling is not None:
            offset = -own.rolling.radius * Vector.from_array(own.normal)
            point, place = point + offset, place + to_base @ offset
        geometry, anchor = contact_geometry(case.contact, own, held, point, free.frames)
        carried = free_body_contact_jacobians(place, own.body, owner[span], free.origins)
        if k == 0:
            carried = (BodyContactJacobian(0, None, place), *carried)
        touches.append(DetectedContacts(ContactSet(geometry.rotate(to_base), carried, own.rolling), own, point, anchor))
    return touches
