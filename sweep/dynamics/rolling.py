"""Spheres that roll over a surface: their point of contact, and what resists rolling and spinning.

A contact point of the model that rolls is the centre of its sphere; it touches a radius below, along the surface's
normal. There a Coulomb moment of a given arm times the normal force opposes the turning.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.core.vectors import Matrix, Vector, along
from sweep.models.obstacles.surface import Rolling

CREEP = 1e-4  # rad/s, at which the resisting moment reaches its limit: rest is a creep slower than this


class Moments(NamedTuple):
    """Moments on the spheres at a rate of turning, and how they fall with it."""

    moment: Vector  # (m,) N m
    slope: Matrix  # (m,) -d moment / d rate, N m s/rad


def resisting_moments(rolling: Rolling, normal: Vector, load: Float[Array, "*m"], rate: Vector) -> Moments:
    """Moments (N m) against rolling and spinning at `rate` (rad/s) under the normal forces `load` (N)."""
    spin = rate.dot(normal)
    roll = rate - spin * normal
    size = jnp.sqrt(roll.dot(roll) + 1e-20)
    of_roll = load * rolling.roll / jnp.maximum(size, CREEP)
    of_spin = load * rolling.spin / jnp.maximum(jnp.abs(spin), CREEP)
    moment = -of_roll * roll - (of_spin * spin) * normal
    rests = (jnp.abs(spin) <= CREEP).astype(spin.dtype)
    along_n = (rests * of_spin - of_roll) * normal
    along_t = ((size > CREEP).astype(spin.dtype) * of_roll / size**2) * roll
    rows = zip(along_n, along_t, strict=True)
    return Moments(moment, Matrix(*(a * normal - b * roll + along(k, of_roll) for k, (a, b) in enumerate(rows))))
