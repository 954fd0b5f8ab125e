"""Proprioceptive calibration: a robot's sizes from the joint angles and base poses of one stance.

The robot stands and moves its base, along and about one axis at a time. Its feet stay where they are, so that each pose
says where six points are, by legs whose lengths are not quite known. Least squares over all poses, with what was
believed before as prior (maximum a posteriori), give the sizes; what the poses do not tell stays as it was believed.
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from sweep.controllers.frames import Stance
from sweep.controllers.posture import feet_in_world
from sweep.core.rotations import exponential, multiply, rotate
from sweep.models.control import Control
from sweep.models.noise import Noise
from sweep.models.robot import Robot

# Base poses: as it stands, then there and back along and about each axis.
MOVES = np.concatenate([np.zeros((1, 6)), *(np.stack([row, -row]) for row in np.eye(6))]).astype(np.float32)
ROUNDS = 4  # Gauss-Newton steps: errors of some per cent are nearly linear
AROUND = 0.05  # m, deviation of the feet's places before anything is measured, and of the height of ground
TILT = 0.05  # rad, the same of its tilt
HEIGHT = 1e-4  # m, deviation of a standing foot's height about the ground: the contact gives way
LIFTED = 1.0  # m, the same of a foot that does not stand: it tells nothing


class Measured(NamedTuple):
    """Means over the samples of each of K poses. World axes."""

    position: Float[Array, "k 3"]  # m, of the base
    quat: Float[Array, "k 4"]  # base to world
    angles: Float[Array, "k 6 3"]  # rad
    loaded: Bool[Array, "k 6"]


class Ground(NamedTuple):
    """The believed plane that all feet stand on. World axes."""

    point: Float[Array, " 3"]  # m
    normal: Float[Array, " 3"]
    unsure: Bool[Array, ""]  # whether it may be higher and tilted: the floor is where the world's axes lie, it may not


class Calibrated(NamedTuple):
    """What calibration has found."""

    robot: Robot  # as it is believed from now on
    covariance: Float[Array, "n n"]  # relative, of the sizes of `names`


def names(robot: Robot) -> tuple[str, ...]:
    """The sizes that can be learned: those that joint angles and the feet's places depend on."""
    body = ("mount_radius",) if robot.mounts == "circle" else ("body_length", "body_width")
    return *body, *(("coxa",) if robot.legs == "three_link" else ()), "thigh", "shin"


def poses(control: Control, start: Stance) -> tuple[Float[Array, "k 3"], Float[Array, "k 4"]]:
    """Base places (m) and attitudes of the calibration, world axes."""
    moves, turns = jnp.asarray(MOVES, float), jnp.broadcast_to(start.quat, (len(MOVES), 4))
    position = start.position + rotate(turns, control.shift * moves[:, :3])
    return position, multiply(turns, exponential(control.turn * moves[:, 3:]))


def estimate(control: Control, noise: Noise, robot: Robot, ground: Ground, seen: Measured) -> Calibrated:
    """The sizes that explain best what is measured.

    Beside them biases of the joints and of the base's pose, and the places of the feet, are unknown. Deviations of all
    errors are those of the sensors as they are believed (`noise`), and those of the feet as `control` has them.
    """
    sizes, along = names(robot), _tangents(ground.normal)
    dtype = seen.position.dtype
    stood = jax.vmap(feet_in_world, (None, 0, 0, 0))(robot, seen.position, seen.quat, seen.angles)
    centre = jnp.mean(stood, axis=0)
    centre = centre - ((centre - ground.point) @ ground.normal)[:, None] * ground.normal
    parts = (
        (len(sizes), control.size_error), (18, noise.joint_bias), (3, noise.position_bias),
        (3, noise.orientation_bias), (12, AROUND), (1, AROUND * ground.unsure),
        (2, TILT * ground.unsure),
    )  # fmt: skip
    scale = jnp.concatenate([jnp.full(count, size, dtype) for count, size in parts])
    ends = np.cumsum([count for count, _ in parts])[:-1]

    def off(x: Array, position: Array, quat: Array, angles: Array) -> Float[Array, " 18"]:
        """By how much feet are not where they stand (m), in one pose."""
        size, joint, shift, turn, places, level, tilt = jnp.split(scale * x, ends)
        guess = replace(robot, **{name: getattr(robot, name) * (1 + size[k]) for k, name in enumerate(sizes)})
        true = position - shift, multiply(exponential(-turn), quat), angles - joint.reshape(6, 3)
        height = level + (centre - ground.point) @ along.T @ tilt
        feet = centre + places.reshape(6, 2) @ along + height[:, None] * ground.normal
        return (feet_in_world(guess, *true) - feet).ravel()

    factors = jax.lax.map(lambda pose: _factor(control, noise, robot, ground.normal, pose), seen)
    identity = jnp.eye(len(scale), dtype=dtype)

    def normal_equations(x: Array) -> tuple[Array, Array]:
        def add(so_far: tuple[Array, Array], pose: tuple[Measured, Array]) -> tuple[tuple[Array, Array], None]:
            here = pose[0][:3]
            both = jnp.concatenate([jax.jacfwd(off)(x, *here), off(x, *here)[:, None]], axis=1)
            both = jax.scipy.linalg.solve_triangular(pose[1], both, lower=True)
            slope, left = both[:, :-1], both[:, -1]
            return (so_far[0] + slope.T @ slope, so_far[1] + slope.T @ left), None

        return jax.lax.scan(add, (identity, x), (seen, factors))[0]

    def step(x: Array, _: None) -> tuple[Array, None]:
        matrix, slope = normal_equations(x)
        return x - jax.scipy.linalg.cho_solve((jnp.linalg.cholesky(matrix), True), slope), None

    x, _ = jax.lax.scan(step, jnp.zeros_like(scale), None, length=ROUNDS)
    known = jax.scipy.linalg.cho_solve((jnp.linalg.cholesky(normal_equations(x)[0]), True), identity[:, : len(sizes)])
    found = {name: getattr(robot, name) * (1 + control.size_error * x[k]) for k, name in enumerate(sizes)}
    return Calibrated(replace(robot, **found), control.size_error**2 * known[: len(sizes)])


def _tangents(normal: Float[Array, " 3"]) -> Float[Array, "2 3"]:
    """Unit vectors along the ground."""
    first = jnp.cross(jnp.array([0.0, 1.0, 0.0], normal.dtype), normal)
    first = first / jnp.linalg.norm(first)
    return jnp.stack([first, jnp.cross(normal, first)])


def _factor(
    control: Control, noise: Noise, robot: Robot, normal: Float[Array, " 3"], seen: Measured
) -> Float[Array, "18 18"]:
    """Cholesky factor of the covariance (m^2) of the feet's places as one pose tells them, without biases."""

    def feet(position: Array, turn: Array, angles: Array) -> Array:
        return feet_in_world(robot, position, multiply(exponential(turn), seen.quat), angles).ravel()

    at = seen.position, jnp.zeros_like(seen.position), seen.angles
    slopes = jax.jacfwd(feet, argnums=(0, 1, 2))(*at)
    share = jnp.sqrt(control.samples)
    errors = (noise.position_noise, noise.orientation_noise, noise.joint_noise)
    slope = jnp.concatenate([s.reshape(18, -1) * e / share for s, e in zip(slopes, errors, strict=True)], axis=1)
    upright = jnp.outer(normal, normal)
    own = control.slip**2 * (jnp.eye(3) - upright) + HEIGHT**2 * upright
    apart = jnp.kron(jnp.eye(6), own) + jnp.diag(jnp.repeat(jnp.where(seen.loaded, 0.0, LIFTED**2), 3))
    return jnp.linalg.cholesky(slope @ slope.T + apart)
