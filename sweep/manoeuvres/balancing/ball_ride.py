"""The ride up on a ball that rolls in the robot's direction (monograph 3.1.4, 3.3.2)."""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from sweep.controllers.ball_state import centre_of_mass, measured_stance
from sweep.controllers.layers import TickContext
from sweep.controllers.observation import Observation
from sweep.controllers.plan import Plan, reference_stance
from sweep.controllers.tracker import Guidance, TrackerState
from sweep.core.constants import GRAVITY
from sweep.core.rotations import exponential, logarithm, rotate
from sweep.formulas.ball import ROLLING_INERTIA, climbing_rate
from sweep.models.case import Case
from sweep.models.obstacles.ball import Ball, tangent_base_position, tangent_pitch
from sweep.models.posture import Stance
from sweep.models.robot import total_mass

RIDE = "ride"
LEAN_LAG, LEAN_MAX = 0.3, 0.03  # s and m, time constant and largest value of the lateral lean


class RideUpMemory(NamedTuple):
    """State of the law that rides up on a ball: elevation and displacement of the base, time since the start."""

    elevation: Float[Array, ""]  # rad, of the tangent along which the base lies
    distance: Float[Array, ""]  # m, of the base's axis from the ball's centre
    ahead: Float[Array, ""]  # m, of the base's centre along the tangent
    aside: Float[Array, ""]  # m, of the base's centre to the left
    time: Float[Array, ""]  # s, since the ride started


@dataclass(frozen=True)
class RideUpLaw:
    """Feedback law that moves the base up on a rolling ball, so that the ball stops when the robot is on top: (3.1.16).

    If feet slip more on one side, the ball rolls sideways; the base leans the other way to slow that down, though not
    while the first feet step, which pass close to the next legs. Footholds of the plan are those of a base on top; feet
    go to where these are by then, as far round the ball as the base is.
    """

    gain: Array | float  # factor on the rate
    least: Array | float  # rad/s, of the rate, also after the ball has stopped
    most: Array | float  # rad/s, of the rate
    braking: Array | float  # rad/s^2, of the rate towards the top
    centring: Array | float  # s, in which the base first moves to the point of tangency
    lean: Array | float  # s, lateral lean over the ball's lateral speed
    ends_stages: ClassVar = True

    def init_memory(self, belief: Case, plan: Plan) -> RideUpMemory:
        """Return the initial state of the ride-up law."""
        first = _first_stage(plan)
        x, _, z = plan.position[first - 1]
        elevation = 0.5 * np.pi + logarithm(plan.quat[first])[1]
        sin, cos = jnp.sin(elevation), jnp.cos(elevation)
        return RideUpMemory(elevation, z * sin - x * cos, x * sin + z * cos, jnp.zeros(()), jnp.zeros(()))

    def guide(self, belief: Case, ctx: TickContext, state: TrackerState) -> Guidance:
        """Return the stance with the base moved up along the ball, and the swinging feet moved with the base."""
        ball, memory, plan, period = belief.obstacle_of_type(Ball), state.memory, ctx.plan, ctx.period
        distance, rate = memory.distance, self.climb_rate(belief, ctx.obs)
        share = jnp.minimum(1.0, memory.time / self.centring)
        share = share**2 * (3 - 2 * share)
        forward = jnp.clip(distance * rate * (1 - share), 0.0, -4 * jnp.minimum(memory.ahead, 0.0))
        turning = jnp.maximum(0.0, rate - forward / distance)
        elevation = jnp.minimum(0.5 * np.pi, memory.elevation + turning * period)
        lean = jnp.clip(-self.lean * ctx.obs.free.velocity[0, 1], -LEAN_MAX, LEAN_MAX)
        lean = jnp.where(state.stage > _first_stage(plan), lean, 0.0)
        aside = memory.aside + jnp.minimum(1.0, period / LEAN_LAG) * (lean - memory.aside)
        memory = RideUpMemory(elevation, distance, memory.ahead + forward * period, aside, memory.time + period)
        pose = jnp.degrees(elevation), distance / ball.radius, memory.ahead / ball.radius
        down = -tangent_pitch(ball, 1.0, *pose)
        turn = rotation_about_y(down + memory.ahead / distance)
        swing, phase = plan.swing[state.stage][:, None], state.clock / plan.duration[state.stage]
        goal = jnp.where(swing, rotate(turn[None], plan.foothold[state.stage]), state.feet)
        goal = jnp.where(phase < 1, goal, state.goal)  # late feet stay clear of those ahead
        feet = reference_stance(plan, state.stage, jnp.clip(phase, 0.0, 1.0), state.feet, state.position, goal).feet
        position = tangent_base_position(ball, 1.0, 1.0, 0.0, *pose).at[1].set(aside)
        return Guidance(Stance(feet, position, rotation_about_y(down)), goal, memory)

    def climb_rate(self, belief: Case, obs: Observation) -> Float[Array, ""]:
        """Return the angular rate (rad/s) of the climb around the ball from the measured mass centre: (3.1.16).

        The rate of (3.1.16) grows up to the top: a robot that stopped there at once would tip over its front feet. So
        it is limited by `braking`.

        Args:
            belief: has robot and ball.
            obs: measurement of this tick.
        """
        ball, robot = belief.obstacle_of_type(Ball), belief.robot
        off = centre_of_mass(robot, measured_stance(robot, obs)) - obs.free.position[0]
        elevation = jnp.arctan2(off[2], -off[0])
        omega = jnp.maximum(obs.free.turn[0, 1], 0.0)
        p = (
            total_mass(robot)
            * jnp.hypot(off[0], off[2])
            / (ball.radius * (ROLLING_INERTIA * ball.mass + total_mass(robot)))
        )
        remaining = jnp.maximum(0.5 * np.pi - elevation, 0.0)
        effort = jnp.log((1 + p) / (1 + p * jnp.cos(remaining)))
        enough = (omega * ball.radius) ** 2 > 4 * effort**2 * ball.radius * GRAVITY
        root = climbing_rate(jnp.where(enough, omega, 10.0), effort, ball.radius)
        fastest = omega / (2 * jnp.maximum(effort, 1e-6))
        most = jnp.minimum(self.most, jnp.sqrt(2 * self.braking * remaining))
        return jnp.minimum(jnp.maximum(self.gain * jnp.where(enough, root, fastest), self.least), most)

    def is_stage_over(self, belief: Case, plan: Plan, state: TrackerState, obs: Observation) -> Bool[Array, ""]:
        """Return whether the robot is on top, which ends the last stage of the ride."""
        last = _first_stage(plan) + plan.laws.count(RIDE) - 1
        return (state.stage == last) & (state.memory.elevation >= 0.5 * np.pi - 1e-4)


def _first_stage(plan: Plan) -> int:
    """Index of the ride's first stage."""
    return plan.laws.index(RIDE)


def rotation_about_y(angle: Array) -> Float[Array, " 4"]:
    """Return the rotation by `angle` (rad) about y, nose down."""
    return exponential(jnp.zeros(3).at[1].set(angle))
