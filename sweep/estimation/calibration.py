"""Proprioceptive calibration: estimates the robot's sizes from joint angles and base poses over one stance.

The robot stands and moves its base along and about one axis at a time. Its feet stay in place, so each pose gives the
position of six points through legs of uncertain length. Least squares over all poses with the believed sizes as a prior
(maximum a posteriori) yield the sizes; those that the poses do not determine stay as believed.
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from sweep.core.rotations import exponential, multiply, rotate
from sweep.models.control import Control
from sweep.models.noise import Noise
from sweep.models.posture import Stance, feet_in_world
from sweep.models.robot import Robot

# base poses, as shares of shift and turn: at rest, then one each way along and about each axis
MOVES = np.concatenate([np.zeros((1, 6)), *(np.stack([row, -row]) for row in np.eye(6))]).astype(np.float32)
ROUNDS = 4  # Gauss-Newton steps; for errors of some per cent the problem is almost linear
AROUND = 0.05  # m, prior deviation of the feet's places, and of the ground's height
TILT = 0.05  # rad, prior deviation of the ground's tilt
HEIGHT = 1e-4  # m, deviation of a standing foot's height above the ground, since the contact is compliant
LIFTED = 1.0  # m, deviation of a foot in the air, which thus has no weight


class PoseMeasurements(NamedTuple):
    """Mean sensor measurements in each of K base poses of the robot's calibration, world axes."""

    position: Float[Array, "k 3"]  # m, of the base
    quat: Float[Array, "k 4"]  # base to world
    angles: Float[Array, "k 6 3"]  # rad, joint angles
    loaded: Bool[Array, "k 6"]  # feet that carry load


class GroundPlane(NamedTuple):
    """Plane on which all feet stand during the calibration, as believed, world axes."""

    point: Float[Array, " 3"]  # m
    normal: Float[Array, " 3"]
    # whether height and tilt are unknown; those of the floor are known
    is_uncertain: Bool[Array, ""]


class CalibrationResult(NamedTuple):
    """Estimated sizes of the robot with their uncertainty, the result of a calibration."""

    robot: Robot  # robot with the estimated sizes
    covariance: Float[Array, "n n"]  # relative, of the sizes in `learnable_sizes`


def learnable_sizes(robot: Robot) -> tuple[str, ...]:
    """Return the names of the robot sizes that calibration can estimate: those that relate joint angles to feet."""
    body = ("mount_radius",) if robot.mounts == "circle" else ("body_length", "body_width")
    return *body, *(("coxa",) if robot.legs == "three_link" else ()), "thigh", "shin"


def base_poses(control: Control, start: Stance) -> tuple[Float[Array, "k 3"], Float[Array, "k 4"]]:
    """Return the base poses (world axes) in which the robot measures itself during calibration.

    Args:
        control: has the shift (m) and the turn (rad) along and about each axis.
        start: stance of the robot.

    Returns:
        Base positions (m), (K, 3), and attitudes, (K, 4).
    """
    moves, turns = jnp.asarray(MOVES, float), jnp.broadcast_to(start.quat, (len(MOVES), 4))
    position = start.position + rotate(turns, control.shift * moves[:, :3])
    return position, multiply(turns, exponential(control.turn * moves[:, 3:]))


def estimate_sizes(
    control: Control, noise: Noise, robot: Robot, ground: GroundPlane, measurements: PoseMeasurements
) -> CalibrationResult:
    """Estimate the robot's sizes from sensor measurements in the calibration poses.

    Joint and base biases and the places of the feet are estimated along with the sizes.

    Args:
        control: has the prior deviation of sizes, and the slip of feet between poses.
        noise: believed deviations of the sensor errors.
        robot: the robot, as believed before.
        ground: the believed ground.
        measurements: mean measurements of each pose.
    """
    sizes, along = learnable_sizes(robot), _tangents(ground.normal)
    dtype = measurements.position.dtype
    stood = jax.vmap(feet_in_world, (None, 0, 0, 0))(
        robot, measurements.position, measurements.quat, measurements.angles
    )
    centre = jnp.mean(stood, axis=0)
    centre = centre - ((centre - ground.point) @ ground.normal)[:, None] * ground.normal
    parts = (
        (len(sizes), control.size_error), (18, noise.joint_bias), (3, noise.position_bias),
        (3, noise.orientation_bias), (12, AROUND), (1, AROUND * ground.is_uncertain),
        (2, TILT * ground.is_uncertain),
    )  # fmt: skip
    scale = jnp.concatenate([jnp.full(count, size, dtype) for count, size in parts])
    ends = np.cumsum([count for count, _ in parts])[:-1]

    def foot_errors(x: Array, position: Array, quat: Array, angles: Array) -> Float[Array, " 18"]:
        """Errors (m) of the six feet in one pose for the scaled unknowns `x`."""
        size, joint, shift, turn, places, level, tilt = jnp.split(scale * x, ends)
        guess = replace(robot, **{name: getattr(robot, name) * (1 + size[k]) for k, name in enumerate(sizes)})
        true = position - shift, multiply(exponential(-turn), quat), angles - joint.reshape(6, 3)
        height = level + (centre - ground.point) @ along.T @ tilt
        feet = centre + places.reshape(6, 2) @ along + height[:, None] * ground.normal
        return (feet_in_world(guess, *true) - feet).ravel()

    factors = jax.lax.map(lambda pose: _factor(control, noise, robot, ground.normal, pose), measurements)
    identity = jnp.eye(len(scale), dtype=dtype)

    def normal_equations(x: Array) -> tuple[Array, Array]:
        def add(sums: tuple[Array, Array], pose: tuple[PoseMeasurements, Array]) -> tuple[tuple[Array, Array], None]:
            measured_pose = pose[0][:3]
            both = jnp.concatenate(
                [jax.jacfwd(foot_errors)(x, *measured_pose), foot_errors(x, *measured_pose)[:, None]], axis=1
            )
            both = jax.scipy.linalg.solve_triangular(pose[1], both, lower=True)
            slope, residual = both[:, :-1], both[:, -1]
            return (sums[0] + slope.T @ slope, sums[1] + slope.T @ residual), None

        return jax.lax.scan(add, (identity, x), (measurements, factors))[0]

    def step(x: Array, _: None) -> tuple[Array, None]:
        matrix, slope = normal_equations(x)
        return x - jax.scipy.linalg.cho_solve((jnp.linalg.cholesky(matrix), True), slope), None

    x, _ = jax.lax.scan(step, jnp.zeros_like(scale), None, length=ROUNDS)
    covariance = jax.scipy.linalg.cho_solve(
        (jnp.linalg.cholesky(normal_equations(x)[0]), True), identity[:, : len(sizes)]
    )
    estimates = {name: getattr(robot, name) * (1 + control.size_error * x[k]) for k, name in enumerate(sizes)}
    return CalibrationResult(replace(robot, **estimates), control.size_error**2 * covariance[: len(sizes)])


def _tangents(normal: Float[Array, " 3"]) -> Float[Array, "2 3"]:
    """Two unit vectors along the ground."""
    first = jnp.cross(jnp.array([0.0, 1.0, 0.0], normal.dtype), normal)
    first = first / jnp.linalg.norm(first)
    return jnp.stack([first, jnp.cross(normal, first)])


def _factor(
    control: Control, noise: Noise, robot: Robot, normal: Float[Array, " 3"], pose: PoseMeasurements
) -> Float[Array, "18 18"]:
    """Cholesky factor of the covariance (m^2) of the feet measured in one pose, without biases."""

    def feet(position: Array, turn: Array, angles: Array) -> Array:
        return feet_in_world(robot, position, multiply(exponential(turn), pose.quat), angles).ravel()

    arguments = pose.position, jnp.zeros_like(pose.position), pose.angles
    slopes = jax.jacfwd(feet, argnums=(0, 1, 2))(*arguments)
    share = jnp.sqrt(control.samples)
    errors = (noise.position_noise, noise.orientation_noise, noise.joint_noise)
    slope = jnp.concatenate([s.reshape(18, -1) * e / share for s, e in zip(slopes, errors, strict=True)], axis=1)
    upright = jnp.outer(normal, normal)
    slip = control.slip**2 * (jnp.eye(3) - upright) + HEIGHT**2 * upright
    covariance = jnp.kron(jnp.eye(6), slip) + jnp.diag(jnp.repeat(jnp.where(pose.loaded, 0.0, LIFTED**2), 3))
    return jnp.linalg.cholesky(slope @ slope.T + covariance)
