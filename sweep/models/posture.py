"""Kinematics of the whole robot: hips, feet, leg points and mass centre, and joint angles from a stance."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.core.rotations import conjugate, exponential, rotate
from sweep.formulas.leg import (
    SIDE_BY_LEG,
    circular_hip_positions,
    forward_kinematics,
    inverse_kinematics,
    rectangular_hip_positions,
)
from sweep.models.robot import Robot


class Stance(NamedTuple):
    """Positions of the feet and pose of the base, planned or measured; world axes unless said otherwise."""

    feet: Float[Array, "6 3"]  # m
    position: Float[Array, " 3"]  # m, of the base
    quat: Float[Array, " 4"]  # base to world


class LegMounts(NamedTuple):
    """Positions and directions in which legs 1 to 6 are mounted on the base, base axes."""

    hips: Float[Array, "6 3"]  # m
    yaw: np.ndarray  # rad, (6,), of the axes of each leg: 0 where alpha counts from the y axis, else that of the radius


def leg_mounts(robot: Robot) -> LegMounts:
    """Return hip positions of legs 1 to 6 and the yaw of their axes: monograph 1.1, (1.1.5)."""
    hips = (
        circular_hip_positions(robot.mount_radius)
        if robot.mounts == "circle"
        else rectangular_hip_positions(robot.body_length, robot.body_width)
    )
    if robot.leg_axes == "sides":
        return LegMounts(hips, np.zeros(6))
    corners = np.array([[-1, -1, 0, 0, 1, 1], SIDE_BY_LEG * np.array([1, 1, 2, 2, 1, 1])]) * np.array([[3**0.5], [1.0]])
    return LegMounts(hips, np.arctan2(-SIDE_BY_LEG * corners[0], SIDE_BY_LEG * corners[1]))


def leg_directions(robot: Robot) -> Float[Array, "6 3"]:
    """Return the unit vectors along which the legs point at alpha = 0, base axes."""
    yaw = leg_mounts(robot).yaw
    return jnp.asarray(np.stack([-SIDE_BY_LEG * np.sin(yaw), SIDE_BY_LEG * np.cos(yaw), np.zeros(6)], axis=-1))


def foot_centres(robot: Robot, spread: Array | float, height: Array | float) -> Float[Array, "6 3"]:
    """Return foot positions at a fixed offset from their hips, base axes (m): C' of monograph (1.3.4).

    Args:
        robot: the robot.
        spread: distance of each foot outward from its hip (m).
        height: distance of each foot below its hip (m).
    """
    down = jnp.array([0.0, 0.0, -1.0])
    return leg_mounts(robot).hips + spread * leg_directions(robot) + height * down


def foot_positions(robot: Robot, angles: Float[Array, "6 3"]) -> Float[Array, "6 3"]:
    """Return the foot positions (m, base axes) at joint angles (rad).

    Args:
        robot: the robot.
        angles: joint angles (rad).
    """
    return _points(robot, angles, robot.thigh, robot.shin)


def leg_joint_positions(robot: Robot, angles: Float[Array, "6 3"]) -> Float[Array, "6 k 3"]:
    """Return the joints of each leg (m, base axes): hip, end of the coxa if there is one, knee, foot.

    Args:
        robot: the robot.
        angles: joint angles (rad).
    """
    hips, knees, feet = leg_mounts(robot).hips, _points(robot, angles, robot.thigh, 0.0), foot_positions(robot, angles)
    coxa = [_points(robot, angles, 0.0, 0.0)] if robot.legs == "three_link" else []
    return jnp.stack([hips, *coxa, knees, feet], axis=1)


def feet_in_world(
    robot: Robot, position: Float[Array, " 3"], quat: Float[Array, " 4"], angles: Float[Array, "6 3"]
) -> Float[Array, "6 3"]:
    """Return the foot positions (m, world axes) at joint angles and a base pose.

    Args:
        robot: the robot.
        position: base position (m).
        quat: base to world.
        angles: joint angles (rad).
    """
    return position + rotate(quat[None], foot_positions(robot, angles))


def joint_targets(robot: Robot, stance: Stance) -> tuple[Float[Array, "6 3"], Float[Array, " 6"]]:
    """Return the joint angles of a stance by inverse kinematics, and how far each foot is out of reach.

    Args:
        robot: the robot, as believed.
        stance: feet and base, world axes.

    Returns:
        Joint angles (rad), (6, 3), and the distance (m) by which each foot is out of reach, (6,), 0 within reach.
    """
    feet = feet_in_hip_axes(robot, stance)
    return inverse_kinematics(SIDE_BY_LEG, feet, robot.coxa, robot.thigh, robot.shin, robot.knees == "mirror")


def feet_in_hip_axes(robot: Robot, stance: Stance) -> Float[Array, "6 3"]:
    """Return the foot positions of a stance in the axes of their hips.

    The y axis of a hip points to the left or, for radial legs, is turned with the mount.

    Args:
        robot: the robot.
        stance: feet and base, world axes.

    Returns:
        Feet (m), (6, 3).
    """
    mounts, turns = leg_mounts(robot), np.zeros((6, 3))
    turns[:, 2] = -mounts.yaw
    feet = rotate(jnp.broadcast_to(conjugate(stance.quat), (6, 4)), stance.feet - stance.position) - mounts.hips
    return rotate(exponential(jnp.asarray(turns, feet.dtype)), feet)


def mass_centre(robot: Robot, angles: Float[Array, "6 3"]) -> Float[Array, " 3"]:
    """Return the robot's mass centre (m, base axes) at joint angles; links are uniform: monograph (3.1.9).

    Args:
        robot: the robot.
        angles: joint angles (rad).
    """
    hips, knees, feet = leg_mounts(robot).hips, _points(robot, angles, robot.thigh, 0.0), foot_positions(robot, angles)
    elbows = _points(robot, angles, 0.0, 0.0)
    links = [(robot.thigh_mass, elbows, knees), (robot.shin_mass, knees, feet)]
    if robot.legs == "three_link":
        links.append((robot.coxa_mass, hips, elbows))
    moments = jnp.stack([mass * jnp.sum(start + end, axis=0) / 2 for mass, start, end in links])
    return jnp.sum(moments, axis=0) / (robot.body_mass + 6 * sum(mass for mass, _, _ in links))


def _points(robot: Robot, angles: Array, thigh: Array | float, shin: Array | float) -> Array:
    """Ends of legs (6, 3), base axes, if their links had the lengths `thigh` and `shin` (m)."""
    mounts = leg_mounts(robot)
    turns = jnp.zeros((6, 3), angles.dtype).at[:, 2].set(jnp.asarray(mounts.yaw, angles.dtype))
    return mounts.hips + rotate(exponential(turns), forward_kinematics(SIDE_BY_LEG, angles, robot.coxa, thigh, shin))
