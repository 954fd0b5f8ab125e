"""Where feet and base are told to be, in the frames of a plan (`sweep/models/frames.py`), from one to another."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from sweep.core.rotations import conjugate, multiply, rotate
from sweep.models.frames import fixed, koenig
from sweep.models.obstacles.surface import FreeState, Obstacle, Surface, free_start, poses, under


class Stance(NamedTuple):
    """Where feet and base are, or are meant to be. World axes."""

    feet: Float[Array, "6 3"]  # m
    position: Float[Array, " 3"]  # m, of the base
    quat: Float[Array, " 4"]  # base to world


def to_world(points: Float[Array, "n 3"], frame: Int[Array, " n"], free: FreeState) -> Float[Array, "n 3"]:
    """Points (m), each in its own frame of the bodies as they are in `free`."""
    turned, shift = points, jnp.zeros_like(points)
    for k in range(free.position.shape[0]):
        turned = jnp.where((frame == fixed(k))[:, None], rotate(free.quat[k : k + 1], points), turned)
        shift = shift + _goes_with(frame, k)[:, None] * free.position[k]
    return turned + shift if free.position.shape[0] else points


def to_frame(points: Float[Array, "n 3"], frame: Int[Array, " n"], free: FreeState) -> Float[Array, "n 3"]:
    """The inverse of `to_world`."""
    for k in range(free.position.shape[0]):
        points = points - _goes_with(frame, k)[:, None] * free.position[k]
        points = jnp.where((frame == fixed(k))[:, None], rotate(conjugate(free.quat[k : k + 1]), points), points)
    return points


def ground(obstacle: Obstacle, feet: Float[Array, "6 3"], frame: Int[Array, " 6"]) -> Surface:
    """The obstacle at footholds (m) in some frames, its free bodies as they start."""
    free = free_start(obstacle)
    return under(obstacle, to_world(feet, frame, free), poses(free))


def stance_to_world(stance: Stance, feet: Int[Array, " 6"], base: Int[Array, ""], free: FreeState) -> Stance:
    """A stance whose feet and base are in the given frames; only a body's own axes turn its attitude."""
    position, quat = to_world(stance.position[None], base[None], free)[0], stance.quat
    for k in range(free.position.shape[0]):
        quat = jnp.where(base == fixed(k), multiply(free.quat[k], quat), quat)
    return Stance(to_world(stance.feet, feet, free), position, quat)


def stance_to_frame(stance: Stance, feet: Int[Array, " 6"], base: Int[Array, ""], free: FreeState) -> Stance:
    """The inverse of `stance_to_world`."""
    position, quat = to_frame(stance.position[None], base[None], free)[0], stance.quat
    for k in range(free.position.shape[0]):
        quat = jnp.where(base == fixed(k), multiply(conjugate(free.quat[k]), quat), quat)
    return Stance(to_frame(stance.feet, feet, free), position, quat)


def _goes_with(frame: Int[Array, " n"], body: int) -> Array:
    return (frame == koenig(body)) | (frame == fixed(body))
