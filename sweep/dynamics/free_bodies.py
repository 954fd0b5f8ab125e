"""The obstacle's free bodies: rigid, each with its frame at its mass centre, along its principal axes."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp

from sweep.core.constants import GRAVITY
from sweep.core.vectors import Matrix, Vector
from sweep.dynamics.spatial import GeneralizedVector, Inertia, SpatialVector, SystemPose
from sweep.models.case import Case
from sweep.models.legs import N_LEGS
from sweep.models.obstacles.surface import BodyPoses, FreeBodyState, free_start_state

Frames = Sequence[tuple[Vector, Matrix]]  # (1,) of each body: place of its origin, and its own axes to the world's


class FreeBodies(NamedTuple):
    """Kinematics of k free bodies, base axes from the base's origin unless a field says otherwise."""

    origins: list[Vector]  # (1,) m
    axes: list[Matrix]  # (1,) own axes to base axes
    frames: Frames  # world axes


def kinematics(pose: SystemPose, to_base: Matrix) -> FreeBodies:
    """Compute positions and axes of the free bodies in base axes; `to_base` rotates from world to base axes."""
    base, *free = pose.root
    frames = [(place.position, place.rotation()) for place in free]
    origins = [to_base @ (position - base.position) for position, _ in frames]
    return FreeBodies(origins, [to_base.times(rotation) for _, rotation in frames], frames)


def resting_start_state(case: Case) -> FreeBodyState:
    """Return the start state of free bodies at rest, sunk into the floor until contact forces carry their weight."""
    free, obstacle = free_start_state(case.obstacle), case.obstacle
    if not obstacle.sizes_learnable_from_height:
        return free
    masses = jnp.stack(
        [jnp.asarray(obstacle.batched_model_fields()["body_mass"][name]) for name in obstacle.free_bodies]
    )
    return free._replace(position=free.position.at[:, 2].add(-GRAVITY * masses / case.contact.stiffness))


def inertias(case: Case, axes: list[Matrix]) -> list[Inertia]:
    """Return the spatial inertias of the free bodies in given axes."""
    leaves = case.obstacle.batched_model_fields()
    out = []
    for name, turned in zip(case.obstacle.free_bodies, axes, strict=True):
        mass, own = (jnp.asarray(leaves[field][name], turned.x.x.dtype) for field in ("body_mass", "body_inertia"))
        scaled = Matrix(*(Vector(*(part * size for part, size in zip(row, own, strict=True))) for row in turned))
        out.append(Inertia(mass[None], None, scaled.times(turned.transpose)))
    return out


def bias_wrench(inertia: Inertia, motion: SpatialVector, up: Vector) -> SpatialVector:
    """Return the force and torque that keep a body unaccelerated, against gravity and gyroscopic effects."""
    spin = motion.angular
    return SpatialVector((GRAVITY * inertia.mass) * up, spin.cross(inertia.inertia @ spin))


def contact_sites(case: Case, bodies: FreeBodies) -> list[Vector]:
    """Return the positions (m) of all contact sites in one `Vector`, or an empty list without sites.

    A site is at its body's origin unless `batched_model_fields` of the obstacle gives its position.
    """
    places, found = case.obstacle.batched_model_fields().get("site_pos", {}), []
    for name, k in case.obstacle.contact_sites:
        origin = bodies.origins[k]
        if name in places:
            origin = origin + bodies.axes[k] @ Vector.from_array(jnp.asarray(places[name], origin.x.dtype)[None])
        found.append(origin)
    return [Vector(*(jnp.concatenate(parts) for parts in zip(*found, strict=True)))] if found else []


def contact_owners(case: Case) -> tuple[int, ...]:
    """Return for each contact point the number of the free body that carries it; -1 for the robot's feet, which come
    first."""
    return (-1,) * N_LEGS + tuple(body for _, body in case.obstacle.contact_sites)


def external_wrenches(
    case: Case, pose: SystemPose, motion: GeneralizedVector, bodies: FreeBodies
) -> list[SpatialVector]:
    """Return forces (N) and torques (N m) on free bodies other than weight and contact, world axes; may be empty."""
    if not bodies.frames:
        return []
    turned = [own.rotate(rotation) for own, (_, rotation) in zip(motion.root[1:], bodies.frames, strict=True)]
    load = case.obstacle.external_wrench(
        FreeBodyState(
            jnp.concatenate([place.position.array() for place in pose.root[1:]]),
            jnp.stack([jnp.concatenate(place.quat) for place in pose.root[1:]]),
            jnp.concatenate([own.linear.array() for own in turned]),
            jnp.concatenate([own.angular.array() for own in turned]),
        )
    )
    return (
        []
        if load is None
        else [SpatialVector(Vector.from_array(x[None, :3]), Vector.from_array(x[None, 3:])) for x in load]
    )


def body_pose_arrays(bodies: FreeBodies, dtype: jnp.dtype) -> BodyPoses:
    """Convert poses of free bodies from components to arrays."""
    if not bodies.frames:
        return BodyPoses(jnp.zeros((0, 3), dtype), jnp.zeros((0, 3, 3), dtype))
    position, rotation = ([x.array() for x in parts] for parts in zip(*bodies.frames, strict=True))
    return BodyPoses(jnp.concatenate(position), jnp.concatenate(rotation))
