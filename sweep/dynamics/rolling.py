"""Spheres that roll over a surface: their point of contact, and what resists rolling and spinning.

A contact point of the model that rolls is the centre of its sphere; it touches a radius below, along the surface's
normal. There a Coulomb moment of a given arm times the normal force opposes the turning.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.models.obstacles.surface import Bodies, Rolling, Surface

CREEP = 1e-4  # rad/s, at which the resisting moment reaches its limit: rest is a creep slower than this


class Moments(NamedTuple):
    """Moments on the spheres at a rate of turning, and how they fall with it."""

    moment: Float[Array, "m 3"]  # N m
    slope: Float[Array, "m 3 3"]  # -d moment / d rate, N m s/rad


def contact_offset(surface: Surface) -> Float[Array, "n 3"] | float:
    """From each contact point of the model to where it touches (m)."""
    return 0.0 if surface.rolling is None else -surface.rolling.radius[:, None] * surface.normal


def turning(owner: tuple[int, ...], surface: Surface, bodies: Bodies) -> Float[Array, "m 3 r"]:
    """Jacobian of the m obstacle points' rates of turning (world axes), relative to the surface under them."""
    own = [i for i, body in enumerate(owner) if body >= 0]
    jacobian = jnp.zeros((len(own), 3, 6 * (1 + bodies.rotation.shape[0])), bodies.rotation.dtype)
    for row, i in enumerate(own):
        for k, rotation in enumerate(bodies.rotation):
            share = float(owner[i] == k) - (surface.body[i] == k)
            jacobian = jacobian.at[row, :, 6 * k + 9 : 6 * k + 12].set(share * rotation)
    return jacobian


def resisting_moments(rolling: Rolling, normal: Array, load: Array, rate: Float[Array, "m 3"]) -> Moments:
    """Moments (N m) against rolling and spinning at `rate` (rad/s) under the normal forces `load` (N)."""
    spin = jnp.sum(rate * normal, axis=-1)
    roll = rate - spin[:, None] * normal
    size = jnp.sqrt(jnp.sum(roll**2, axis=-1) + 1e-20)
    along = roll / size[:, None]
    of_roll = load * rolling.roll / jnp.maximum(size, CREEP)
    of_spin = load * rolling.spin / jnp.maximum(jnp.abs(spin), CREEP)
    moment = -of_roll[:, None] * roll - (of_spin * spin)[:, None] * normal
    nn, tt = (a[:, :, None] * a[:, None, :] for a in (normal, along))
    rolls = (size > CREEP).astype(rate.dtype)[:, None, None]
    rests = (jnp.abs(spin) <= CREEP).astype(rate.dtype)
    slope = of_roll[:, None, None] * (jnp.eye(3, dtype=rate.dtype) - nn - rolls * tt)
    return Moments(moment, slope + (rests * of_spin)[:, None, None] * nn)
