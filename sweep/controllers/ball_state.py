"""What a robot that stands on a ball must know of itself and of the ball (monograph 3.1.1, 3.1.2)."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.controllers.frames import Stance
from sweep.controllers.observation import Observation
from sweep.controllers.posture import feet_in_world, joint_targets, mass_centre
from sweep.core.constants import GRAVITY
from sweep.core.rotations import exponential, rotate
from sweep.formulas.ball import ROLLING
from sweep.formulas.leg import SIDE
from sweep.models.obstacles.ball import Ball
from sweep.models.robot import Robot, total_mass

UP = (0.0, 0.0, 1.0)
FORE = (-1.0, -1.0, 0.0, 0.0, 1.0, 1.0)  # rear, middle and front legs


def centre_of_mass(robot: Robot, stance: Stance) -> Float[Array, " 3"]:
    """r_m (m) of a stance, world axes: monograph (3.1.9)."""
    return stance.position + rotate(stance.quat, mass_centre(robot, joint_targets(robot, stance)[0]))


def follow_up(robot: Robot, stance: Stance) -> Float[Array, "2 2"]:
    """Horizontal part of D in (3.1.1): how the mass centre follows the body while the feet stand."""

    def centre(shift: Array) -> Array:
        position = stance.position + jnp.append(shift, 0.0)
        return centre_of_mass(robot, stance._replace(position=position))[:2]

    return jax.jacfwd(centre)(jnp.zeros(2, stance.position.dtype))


def base_move(robot: Robot, stance: Stance, wanted: Float[Array, " 2"]) -> Float[Array, " 2"]:
    """By how much (m) the base must move for the mass centre to move by `wanted`: D^-1 of (3.1.1).

    None where a leg is at its full length, at which nothing can be said of how the mass centre follows.
    """
    (a, b), (c, d) = follow_up(robot, stance)
    move = jnp.stack([d * wanted[0] - b * wanted[1], a * wanted[1] - c * wanted[0]]) / (a * d - b * c)
    return jnp.where(jnp.all(jnp.isfinite(move)), move, 0.0)


def measured_stance(robot: Robot, seen: Observation) -> Stance:
    """Feet and base where they are measured, world axes."""
    feet = feet_in_world(robot, seen.position, seen.quat, seen.angles)
    return Stance(feet, seen.position, seen.quat)


def angular_momentum(robot: Robot, ball: Ball, seen: Observation) -> Float[Array, " 3"]:
    """K_S (N m s) of robot and ball about the ball's lowest point S, the feet standing on the ball.

    Links count as if they did not turn about the robot's mass centre, which is a hundredth of it.
    """
    stance, free = measured_stance(robot, seen), seen.free
    centre, velocity, turn = free.position[0], free.velocity[0], free.turn[0]
    up = ball.radius * jnp.asarray(UP)
    feet = velocity + jnp.cross(turn, stance.feet - centre)
    moves = Stance(feet, seen.velocity, jnp.zeros_like(seen.quat))
    place, rate = jax.jvp(lambda s: centre_of_mass(robot, s), (stance,), (moves,))
    rate = jnp.where(jnp.all(jnp.isfinite(rate)), rate, seen.velocity)  # a leg at its full length has no derivative
    of_robot = total_mass(robot) * jnp.cross(place - centre + up, rate)
    return of_robot + ball.mass * (jnp.cross(up, velocity) + (ROLLING - 1) * ball.radius**2 * turn)


def towards(momentum: Float[Array, " 3"], mass: Array | float) -> Float[Array, " 2"]:
    """K_S x g / (m g^2): by how much (m s) the mass centre must be ahead, and for how long, to take K_S away."""
    return jnp.stack([-momentum[1], momentum[0]]) / (mass * GRAVITY)


def footholds(radius: Array | float, circle: Array | float, chord: Array | float) -> Float[Array, "6 3"]:
    """Feet from the ball's centre (m): list after fig. 3.1.7, x ahead.

    On a circle of radius d1 = `circle`, front and rear feet d2 = `chord` from its middle. The printed list gives leg i
    the place of leg 7 - i.
    """
    ahead = jnp.asarray(FORE) * chord
    aside = SIDE * jnp.sqrt(circle**2 - ahead**2)
    above = jnp.sqrt(radius**2 - circle**2)
    return jnp.stack([ahead, aside, above + 0 * ahead], axis=-1)


def turned_back(feet: Float[Array, "6 3"], alpha: Array | float, along: Float[Array, " 2"]) -> Float[Array, "6 3"]:
    """The turned foot frame: feet (m, from the ball's centre) turned by `alpha` (rad) against its way `along`.

    Their circle is then as far behind the vertical at touchdown as it is ahead of it when the feet lift off: the top of
    a ball that rolls forward takes them forward.
    """
    left = jnp.stack([-along[1], along[0], jnp.zeros_like(along[0])])
    return rotate(exponential(-alpha * left)[None], feet)


def over_ball(start: Array, goal: Array, share: Array, phase: Array, height: Array) -> Float[Array, "6 3"]:
    """Feet on their way over the ball, from its centre: on the arc from `start` to `goal`, `height` (m) above it."""
    chord = start + share * (goal - start)
    radius, goal_radius = (jnp.linalg.norm(p, axis=-1, keepdims=True) for p in (start, goal))
    radius = radius + phase * (goal_radius - radius) + height
    return chord / jnp.linalg.norm(chord, axis=-1, keepdims=True) * radius
