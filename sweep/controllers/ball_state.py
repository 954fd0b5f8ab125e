"""State of a robot on a ball: mass centre, angular momentum and footholds (monograph 3.1.1, 3.1.2)."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.controllers.observation import Observation
from sweep.core.constants import GRAVITY
from sweep.core.rotations import exponential, rotate
from sweep.formulas.ball import ROLLING_INERTIA
from sweep.formulas.leg import SIDE_BY_LEG
from sweep.models.obstacles.ball import Ball
from sweep.models.posture import Stance, feet_in_world, joint_targets, mass_centre
from sweep.models.robot import Robot, total_mass

UP = (0.0, 0.0, 1.0)
FORE = (-1.0, -1.0, 0.0, 0.0, 1.0, 1.0)  # direction of rear, middle and front legs along the body


def centre_of_mass(robot: Robot, stance: Stance) -> Float[Array, " 3"]:
    """Return the centre of mass r_m (m, world axes) of a robot in a given stance: monograph (3.1.9).

    Args:
        robot: the robot, as believed.
        stance: feet and base, world axes.
    """
    return stance.position + rotate(stance.quat, mass_centre(robot, joint_targets(robot, stance)[0]))


def mass_centre_jacobian(robot: Robot, stance: Stance) -> Float[Array, "2 2"]:
    """Return the Jacobian D (2, 2): horizontal motion of the mass centre per motion of the base, feet fixed; (3.1.1).

    Args:
        robot: the robot, as believed.
        stance: feet and base, world axes.
    """

    def centre(shift: Array) -> Array:
        position = stance.position + jnp.append(shift, 0.0)
        return centre_of_mass(robot, stance._replace(position=position))[:2]

    return jax.jacfwd(centre)(jnp.zeros(2, stance.position.dtype))


def base_shift_for_mass_centre(robot: Robot, stance: Stance, wanted: Float[Array, " 2"]) -> Float[Array, " 2"]:
    """Return the horizontal base shift (m) that moves the mass centre by `wanted` (m), by the inverse of D in (3.1.1).

    The shift is 0 if a leg is at full length, where D is not defined.

    Args:
        robot: the robot, as believed.
        stance: feet and base, world axes.
        wanted: shift of the mass centre (m).
    """
    (a, b), (c, d) = mass_centre_jacobian(robot, stance)
    move = jnp.stack([d * wanted[0] - b * wanted[1], a * wanted[1] - c * wanted[0]]) / (a * d - b * c)
    return jnp.where(jnp.all(jnp.isfinite(move)), move, 0.0)


def measured_stance(robot: Robot, obs: Observation) -> Stance:
    """Return the stance (feet and base pose, world axes) that follows from an observation.

    Args:
        robot: the robot, as believed.
        obs: the measurement.
    """
    feet = feet_in_world(robot, obs.position, obs.quat, obs.angles)
    return Stance(feet, obs.position, obs.quat)


def angular_momentum(robot: Robot, ball: Ball, obs: Observation) -> Float[Array, " 3"]:
    """Return the angular momentum K_S (N m s) of robot and ball about the ball's lowest point S, all feet on the ball.

    The spin of links about the robot's mass centre is neglected, 1 % of the whole.

    Args:
        robot: the robot, as believed.
        ball: the ball, as believed.
        obs: the measurement.

    Returns:
        K_S in world axes.
    """
    stance, free = measured_stance(robot, obs), obs.free
    centre, velocity, turn = free.position[0], free.velocity[0], free.turn[0]
    up = ball.radius * jnp.asarray(UP)
    feet = velocity + jnp.cross(turn, stance.feet - centre)
    moves = Stance(feet, obs.velocity, jnp.zeros_like(obs.quat))
    centre_of_robot, rate = jax.jvp(lambda s: centre_of_mass(robot, s), (stance,), (moves,))
    rate = jnp.where(jnp.all(jnp.isfinite(rate)), rate, obs.velocity)
    robot_momentum = total_mass(robot) * jnp.cross(centre_of_robot - centre + up, rate)
    return robot_momentum + ball.mass * (jnp.cross(up, velocity) + (ROLLING_INERTIA - 1) * ball.radius**2 * turn)


def momentum_cancelling_lean(momentum: Float[Array, " 3"], mass: Array | float) -> Float[Array, " 2"]:
    """Return the lean of the mass centre times its duration (m s) that cancels the angular momentum of robot and ball.

    Args:
        momentum: angular momentum K_S (N m s), world axes.
        mass: of the robot (kg).
    """
    return jnp.stack([-momentum[1], momentum[0]]) / (mass * GRAVITY)


def ball_footholds(radius: Array | float, circle: Array | float, chord: Array | float) -> Float[Array, "6 3"]:
    """Return the footholds of the six feet on a ball, in m from its centre, with x pointing ahead of the robot.

    The printed list exchanges legs i and 7 - i.

    Args:
        radius: of the ball (m).
        circle: radius d_1 of the circle of footholds (m).
        chord: distance d_2 of front and rear feet from the middle of that circle (m).
    """
    ahead = jnp.asarray(FORE) * chord
    aside = SIDE_BY_LEG * jnp.sqrt(circle**2 - ahead**2)
    above = jnp.sqrt(radius**2 - circle**2)
    return jnp.stack([ahead, aside, above + 0 * ahead], axis=-1)


def rotate_footholds_backward(
    feet: Float[Array, "6 3"], alpha: Array | float, along: Float[Array, " 2"]
) -> Float[Array, "6 3"]:
    """Rotate footholds on a ball by an angle `alpha` (rad) opposite to the direction in which the ball rolls.

    A ball that rolls forward carries the feet on its top forward. Their circle is thus as far behind the vertical at
    touchdown as it is ahead of it at lift-off.

    Args:
        feet: footholds relative to the ball's centre (m), world axes.
        alpha: angle (rad).
        along: unit vector of the ball's motion, in the plane.
    """
    leftward = jnp.stack([-along[1], along[0], jnp.zeros_like(along[0])])
    return rotate(exponential(-alpha * leftward)[None], feet)


def swing_foot_arc(start: Array, goal: Array, share: Array, phase: Array, height: Array) -> Float[Array, "6 3"]:
    """Return the positions of swinging feet on an arc over the ball, relative to its centre (m).

    Args:
        start: feet at lift-off (m, from the centre), (6, 3).
        goal: footholds (m, from the centre), (6, 3).
        share: share of the chord from start to goal that is covered.
        phase: phase of the stage, 0 to 1, along which the radius changes from that of the start to that of the goal.
        height: lift above that radius (m).
    """
    chord = start + share * (goal - start)
    radius, goal_radius = (jnp.linalg.norm(p, axis=-1, keepdims=True) for p in (start, goal))
    radius = radius + phase * (goal_radius - radius) + height
    return chord / jnp.linalg.norm(chord, axis=-1, keepdims=True) * radius
