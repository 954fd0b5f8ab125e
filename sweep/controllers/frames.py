"""Frames in which a plan's targets live: the world's, and two that go with the obstacle's first free body."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from sweep.core.rotations import conjugate, rotate
from sweep.models.obstacles.surface import FreeState

WORLD, KOENIG, FIXED = range(3)  # the body's centre with the world's axes is its Koenig frame; FIXED has its own axes


def to_world(points: Float[Array, "n 3"], frame: Int[Array, " n"], free: FreeState) -> Float[Array, "n 3"]:
    """Points (m), each in its own frame of the body as it is in `free`."""
    if not free.position.shape[0]:
        return points
    turned = jnp.where((frame == FIXED)[:, None], rotate(free.quat[:1], points), points)
    return turned + (frame != WORLD)[:, None] * free.position[0]


def to_frame(points: Float[Array, "n 3"], frame: Int[Array, " n"], free: FreeState) -> Float[Array, "n 3"]:
    """The inverse of `to_world`."""
    if not free.position.shape[0]:
        return points
    offset = points - (frame != WORLD)[:, None] * free.position[0]
    return jnp.where((frame == FIXED)[:, None], rotate(conjugate(free.quat[:1]), offset), offset)
