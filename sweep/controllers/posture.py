"""Kinematics of the whole robot: feet, legs and mass centre by joint angles, and joint angles by a stance."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.controllers.frames import Stance
from sweep.core.rotations import conjugate, exponential, rotate
from sweep.formulas.leg import SIDE, fk, ik
from sweep.models.robot import Robot, mount_yaw, mounts


def outward(robot: Robot) -> Float[Array, "6 3"]:
    """Unit vectors in which the legs point at alpha = 0, base axes."""
    yaw = mount_yaw(robot)
    return jnp.asarray(np.stack([-SIDE * np.sin(yaw), SIDE * np.cos(yaw), np.zeros(6)], axis=-1))


def foot_centres(robot: Robot, spread: Array | float, height: Array | float) -> Float[Array, "6 3"]:
    """Feet `spread` (m) out from the hips and `height` (m) below them, base axes: C' of monograph (1.3.4)."""
    down = jnp.array([0.0, 0.0, -1.0])
    return mounts(robot) + spread * outward(robot) + height * down


def foot_positions(robot: Robot, angles: Float[Array, "6 3"]) -> Float[Array, "6 3"]:
    """Feet (m, base axes) at joint angles (rad)."""
    return _points(robot, angles, robot.thigh, robot.shin)


def leg_points(robot: Robot, angles: Float[Array, "6 3"]) -> Float[Array, "6 k 3"]:
    """Along each leg (m, base axes): hip, the coxa's end where there is one, knee, foot."""
    hips, knees, feet = mounts(robot), _points(robot, angles, robot.thigh, 0.0), foot_positions(robot, angles)
    coxa = [_points(robot, angles, 0.0, 0.0)] if robot.legs == "three_link" else []
    return jnp.stack([hips, *coxa, knees, feet], axis=1)


def feet_in_world(
    robot: Robot, position: Float[Array, " 3"], quat: Float[Array, " 4"], angles: Float[Array, "6 3"]
) -> Float[Array, "6 3"]:
    """Feet (m, world axes) of a base at `position` (m) and `quat` with joint angles (rad)."""
    return position + rotate(quat[None], foot_positions(robot, angles))


def joint_targets(robot: Robot, stance: Stance) -> tuple[Float[Array, "6 3"], Float[Array, " 6"]]:
    """Joint angles (rad) of the believed robot in a stance, and how far each foot is out of reach (m)."""
    feet = in_hips(robot, stance)
    return ik(SIDE, feet, robot.coxa, robot.thigh, robot.shin, robot.knees == "mirror")


def in_hips(robot: Robot, stance: Stance) -> Float[Array, "6 3"]:
    """Feet (m) of a stance in the axes of their hips, whose y is to the left, or turned with the mounts."""
    to_base = jnp.broadcast_to(conjugate(stance.quat), (6, 4))
    foot = rotate(to_base, stance.feet - stance.position) - mounts(robot)
    yaw = np.zeros((6, 3))
    yaw[:, 2] = -mount_yaw(robot)
    return rotate(exponential(jnp.asarray(yaw, foot.dtype)), foot)


def mass_centre(robot: Robot, angles: Float[Array, "6 3"]) -> Float[Array, " 3"]:
    """Centre of mass of the robot (m, base axes) at joint angles (rad): uniform links, as in monograph (3.1.9)."""
    hips, knees, feet = mounts(robot), _points(robot, angles, robot.thigh, 0.0), foot_positions(robot, angles)
    elbows = _points(robot, angles, 0.0, 0.0)  # where the thighs begin
    links = [(robot.thigh_mass, elbows, knees), (robot.shin_mass, knees, feet)]
    if robot.legs == "three_link":
        links.append((robot.coxa_mass, hips, elbows))
    moments = jnp.stack([mass * jnp.sum(start + end, axis=0) / 2 for mass, start, end in links])
    return jnp.sum(moments, axis=0) / (robot.body_mass + 6 * sum(mass for mass, _, _ in links))


def _points(robot: Robot, angles: Array, thigh: Array | float, shin: Array | float) -> Array:
    """Points along the legs (6, 3), base axes: the feet of legs with links of these lengths."""
    yaw = jnp.zeros((6, 3), angles.dtype).at[:, 2].set(jnp.asarray(mount_yaw(robot), angles.dtype))
    return mounts(robot) + rotate(exponential(yaw), fk(SIDE, angles, robot.coxa, thigh, shin))
