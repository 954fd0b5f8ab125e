"""Viscoelastic foot contact with a Coulomb limit (monograph 1.2.2), evaluated implicitly."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from sweep.core.parameters import parameters, quantity
from sweep.models.obstacles.surface import Bodies, Surface


@parameters
class Contact:
    """Viscoelastic point contact with a Coulomb limit.

    The factor epsilon that the book puts beside d_n is undefined there; it is 1 here.
    """

    stiffness: float = quantity(1e6, "N/m", above=0)  # c_n, force for each metre that a foot sinks in
    damping: float = quantity(100.0, "N*s/m", at_least=0)  # d_n, force against the speed at which it sinks in
    friction: float = quantity(1.0, "-", at_least=0)  # k_f, largest tangential force over the normal force


class Anchors(NamedTuple):
    """Where each of n contact points holds on: r_T of (1.2.2)."""

    # m, in the axes of the body that owns the face, world axes for the fixed world; of what rolls, from the contact
    place: Float[Array, "n 3"]
    loaded: Bool[Array, " n"]
    face: Int[Array, " n"]


class Geometry(NamedTuple):
    """Everything of a contact that stays fixed while a step's velocity is solved for."""

    depth: Float[Array, " n"]
    normal: Float[Array, "n 3"]
    stretch: Float[Array, "n 3"]  # tangential part of anchor minus point, m
    limit: Float[Array, " n"]  # friction coefficient


class Forces(NamedTuple):
    """Contact forces at a velocity, and how they fall with it."""

    force: Float[Array, "n 3"]  # N, on the point, world axes
    normal: Float[Array, " n"]  # N, along the surface normal
    tangential: Float[Array, "n 3"]  # N
    slope: Float[Array, "n 3 3"]  # -d force / d velocity, N s/m
    slipping: Bool[Array, " n"]
    loaded: Bool[Array, " n"]


def to_world(place: Array, body: Array, bodies: Bodies) -> Array:
    """Points (n, 3) from the axes of the free body that each belongs to (-1: the world) to world axes."""
    for k in range(bodies.position.shape[0]):
        moved = place @ bodies.rotation[k].T + bodies.position[k]
        place = jnp.where((body == k)[:, None], moved, place)
    return place


def to_body(place: Array, body: Array, bodies: Bodies) -> Array:
    """The inverse of `to_world`."""
    for k in range(bodies.position.shape[0]):
        moved = (place - bodies.position[k]) @ bodies.rotation[k]
        place = jnp.where((body == k)[:, None], moved, place)
    return place


def approach(
    contact: Contact, surface: Surface, anchors: Anchors, point: Array, bodies: Bodies
) -> tuple[Geometry, Array]:
    """Contact geometry at the start of a step, and the anchors in world axes.

    A point keeps its anchor while it stays loaded on the same face; otherwise it takes hold where it is now.
    """
    held = anchors.loaded & (anchors.face == surface.face)
    fresh = point + surface.depth[:, None] * surface.normal
    kept = to_world(anchors.place, surface.body, bodies)
    if surface.rolling is not None:
        kept = jnp.where(surface.rolling.radius[:, None] > 0, point + anchors.place, kept)
    place = jnp.where(held[:, None], kept, fresh)
    gap = place - point
    stretch = gap - jnp.sum(gap * surface.normal, axis=-1, keepdims=True) * surface.normal
    return Geometry(surface.depth, surface.normal, stretch, contact.friction * surface.grip), place


def contact_forces(contact: Contact, geometry: Geometry, velocity: Float[Array, "n 3"], h: float) -> Forces:
    """Forces at the end of a step of h seconds that is passed at `velocity` (m/s, relative to the surface).

    N = c_n depth - (c_n h + d_n) v_n where positive; the tangential force is elastic up to the Coulomb limit. The
    slope keeps the coupling of the limit to the normal force, which makes it unsymmetric: without it the two
    iterations of a step diverge at 2 ms.
    """
    g = contact.stiffness * h + contact.damping
    n = geometry.normal
    v_normal = jnp.sum(velocity * n, axis=-1)
    normal = jnp.maximum(0.0, contact.stiffness * geometry.depth - g * v_normal)
    loaded = normal > 0
    elastic = contact.stiffness * geometry.stretch - g * (velocity - v_normal[:, None] * n)
    size = jnp.sqrt(jnp.sum(elastic**2, axis=-1) + 1e-6)
    slipping = loaded & ~(size <= geometry.limit * normal)  # a limit that is not a number must show, not hold
    share = jnp.where(loaded, jnp.where(slipping, geometry.limit * normal / size, 1.0), 0.0)
    direction = elastic / size[:, None]
    tangential = share[:, None] * elastic
    slips, holds = slipping.astype(n.dtype), loaded.astype(n.dtype)
    nn = n[:, :, None] * n[:, None, :]
    tt = direction[:, :, None] * direction[:, None, :]
    tn = direction[:, :, None] * n[:, None, :]
    along = share[:, None, None] * (jnp.eye(3, dtype=n.dtype) - nn - slips[:, None, None] * tt)
    coupling = (slips * geometry.limit)[:, None, None] * tn
    slope = g * (holds[:, None, None] * nn + along + coupling)
    return Forces(normal[:, None] * n + tangential, normal, tangential, slope, slipping, loaded)


def settle(
    contact: Contact,
    surface: Surface,
    point: Array,
    bodies: Bodies,
    place: Array,
    forces: Forces,
    velocity: Array,
    h: float,
) -> Anchors:
    """Anchors after the step: a slipping point drags its anchor along, so that it holds just the Coulomb limit.

    The contact of what rolls moves over both surfaces alike: only the slip between them, at `velocity`, stretches it.
    """
    v_normal = jnp.sum(velocity * surface.normal, axis=-1)
    landed = point + h * velocity + (surface.depth - h * v_normal)[:, None] * surface.normal
    dragged = landed + forces.tangential / contact.stiffness
    place = jnp.where(forces.slipping[:, None], dragged, place)
    kept = to_body(place, surface.body, bodies)
    if surface.rolling is not None:
        kept = jnp.where(surface.rolling.radius[:, None] > 0, place - point - h * velocity, kept)
    return Anchors(kept, forces.loaded, surface.face)
