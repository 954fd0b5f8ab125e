"""Transformation of points and stances between world axes and the frames of the obstacle's free bodies."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from sweep.core.rotations import conjugate, multiply, rotate
from sweep.models.frames import body_frame_number, koenig_frame_number
from sweep.models.obstacles.surface import FreeBodyState, Obstacle, Surface, body_poses, free_start_state, surface_at
from sweep.models.posture import Stance


def points_to_world(points: Float[Array, "n 3"], frame: Int[Array, " n"], free: FreeBodyState) -> Float[Array, "n 3"]:
    """Transform points (m) to world axes, each from its own coordinate frame: the world or a free body.

    Args:
        points: points (m), each in its own frame.
        frame: number of each point's frame.
        free: state of the free bodies that the frames move with.
    """
    rotated, shift = points, jnp.zeros_like(points)
    for k in range(free.position.shape[0]):
        rotated = jnp.where((frame == body_frame_number(k))[:, None], rotate(free.quat[k : k + 1], points), rotated)
        shift = shift + _goes_with(frame, k)[:, None] * free.position[k]
    return rotated + shift if free.position.shape[0] else points


def points_to_frame(points: Float[Array, "n 3"], frame: Int[Array, " n"], free: FreeBodyState) -> Float[Array, "n 3"]:
    """Transform points (m) from world axes, each to its own coordinate frame: the world or a free body.

    Args:
        points: points (m), world axes.
        frame: number of each point's frame.
        free: state of the free bodies that the frames move with.
    """
    for k in range(free.position.shape[0]):
        points = points - _goes_with(frame, k)[:, None] * free.position[k]
        points = jnp.where(
            (frame == body_frame_number(k))[:, None], rotate(conjugate(free.quat[k : k + 1]), points), points
        )
    return points


def surface_under_feet(obstacle: Obstacle, feet: Float[Array, "6 3"], frame: Int[Array, " 6"]) -> Surface:
    """Return the obstacle's surface under footholds, with its free bodies at their start poses.

    Args:
        obstacle: the obstacle.
        feet: footholds (m), each in its own frame.
        frame: number of each foot's frame.
    """
    free = free_start_state(obstacle)
    return surface_at(obstacle, points_to_world(feet, frame, free), body_poses(free))


def stance_to_world(stance: Stance, feet: Int[Array, " 6"], base: Int[Array, ""], free: FreeBodyState) -> Stance:
    """Transform a stance (feet and base pose) from the coordinate frames of its feet and base to world axes.

    Args:
        stance: feet and base in their frames.
        feet: number of each foot's frame.
        base: number of the base's frame.
        free: state of the free bodies that the frames move with.
    """
    position, quat = points_to_world(stance.position[None], base[None], free)[0], stance.quat
    for k in range(free.position.shape[0]):
        quat = jnp.where(base == body_frame_number(k), multiply(free.quat[k], quat), quat)
    return Stance(points_to_world(stance.feet, feet, free), position, quat)


def stance_to_frame(stance: Stance, feet: Int[Array, " 6"], base: Int[Array, ""], free: FreeBodyState) -> Stance:
    """Transform a stance (feet and base pose) from world axes to the coordinate frames of its feet and base.

    Args:
        stance: feet and base, world axes.
        feet: number of each foot's frame.
        base: number of the base's frame.
        free: state of the free bodies that the frames move with.
    """
    position, quat = points_to_frame(stance.position[None], base[None], free)[0], stance.quat
    for k in range(free.position.shape[0]):
        quat = jnp.where(base == body_frame_number(k), multiply(conjugate(free.quat[k]), quat), quat)
    return Stance(points_to_frame(stance.feet, feet, free), position, quat)


def _goes_with(frame: Int[Array, " n"], body: int) -> Array:
    return (frame == koenig_frame_number(body)) | (frame == body_frame_number(body))
