"""Driving a free ball sideways, the robot standing on it (monograph 3.3.3)."""

from dataclasses import replace
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.controllers.layers import TickContext
from sweep.controllers.plan import Plan
from sweep.controllers.tracker import Guidance, TrackerState
from sweep.core.constants import GRAVITY
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.core.rotations import rotate
from sweep.formulas.ball import ROLLING_INERTIA, lateral_mu
from sweep.manoeuvres.balancing.ball import (
    OnBallManoeuvre,
    base_position_for_mass_centre,
    stance_on_ball,
    stand_pose,
    standing_stages,
)
from sweep.manoeuvres.goals import UPRIGHT
from sweep.models.case import Case
from sweep.models.obstacles.ball import Ball
from sweep.models.posture import Stance
from sweep.models.robot import total_mass
from sweep.planning.compile_plan import compile_plan

MU_INTEGRAL = 1.5  # integral of mu over T, in units of T


@parameters
class BallAside(OnBallManoeuvre):
    """Roll a ball to the left at `speed`, coast, and stop it, with all feet standing.
    Ratios are to the body length a_r.

    In a stage of T, the mass centre moves sideways by k_l (v_d - v_b) mu(tau), (3.3.7), and back. k_l follows from the
    angular momentum of robot and ball about the ball's lowest point, so that one stage yields the missing speed. The
    book moves the base by that. While the ball rolls off below, the feet would carry the mass centre sideways and add
    to the push; (3.1.10) corrects this at every tick.

    As the ball rolls, it turns the feet on its right in under their hips, and a leg whose foot is inward of its hip
    turns over. So on a ball that is small for its robot, the circle of footholds is larger.
    """

    goal: ClassVar = {**UPRIGHT, "obstacle_speed_error_max_mps": 0.01}
    kind: str = choice("ball_aside", "ball_aside")
    speed: float = quantity(0.03, "m/s")  # v_d, to the left
    room_ratio: float = quantity(0.105, "a_r", at_least=0, at_most=1)  # least distance of feet outward from their hips
    period: float = quantity(2.0, "s", above=0, at_most=20)  # T, time of a stage
    coast: float = quantity(0.5, "s", above=0)  # time between driving and stopping
    gain: float = quantity(1.0, "-", above=0)  # factor on k_l
    stops: int = count(8, at_least=1, at_most=500)  # number of stages that stop the ball

    def plan(self, belief: Case) -> Plan:
        """Return the plan with the stages drive, coast and stop, with all feet standing."""
        pose = stand_pose(belief, replace(self, circle_ratio=self._circle_ratio(belief)))
        times = {"drive": self.period, "coast": self.coast}
        times |= {f"stop{k + 1}": self.period for k in range(self.stops)}
        return compile_plan(stance_on_ball(belief, pose), standing_stages(pose, times), 0.0)

    def _circle_ratio(self, belief: Case) -> Array:
        """Radius d_1 (R) of the foothold circle at which front and rear feet are as far apart as the hips."""
        robot = belief.robot
        aside = robot.body_width / 2 + self.room_ratio * robot.body_length
        wanted = aside / (belief.obstacle_of_type(Ball).radius * jnp.sqrt(1 - self.chord_ratio**2))
        return jnp.clip(wanted, self.circle_ratio, 1.0)

    def init_memory(self, belief: Case, plan: Plan) -> Float[Array, ""]:
        """Return the law's state before the first tick: no sideways motion of the base (m) planned yet."""
        return jnp.zeros(())

    def guide(self, belief: Case, ctx: TickContext, state: TrackerState) -> Guidance:
        """Return the stance that leans sideways over the ball by the motion planned at the start of the stage."""
        plan, stage, free = ctx.plan, ctx.stage, ctx.obs.free
        wanted_speed = jnp.where(stage == 0, self.speed, free.velocity[0, 1])  # while coasting, the measured speed
        wanted_speed = jnp.where(stage > 1, 0.0, wanted_speed)
        push = self.gain * lateral_lean_gain(belief, plan, self.period) * (wanted_speed - free.velocity[0, 1])
        push = jnp.where(ctx.is_first_tick, push, state.memory)
        aside = push * lateral_mu(self.period, jnp.minimum(state.clock, self.period)).mu
        feet = rotate(free.quat, state.feet)
        centre = jnp.stack([jnp.zeros_like(aside), aside])
        position = base_position_for_mass_centre(belief.robot, plan.position[stage], feet, centre, lengthwise=True)
        return Guidance(Stance(state.feet, position, plan.quat[stage]), state.feet, push)


def lateral_lean_gain(belief: Case, plan: Plan, period: Array | float) -> Array:
    """Return the gain k_l (s): lateral lean of the mass centre per change of the ball's speed within one stage.

    The mass centre's height is taken as the base's.

    Args:
        belief: has robot and ball.
        plan: has the height of the base.
        period: T (s).
    """
    ball, mass = belief.obstacle_of_type(Ball), total_mass(belief.robot)
    inertia = ROLLING_INERTIA * ball.mass * ball.radius + mass * (ball.radius + plan.position[0, 2])
    return inertia / (MU_INTEGRAL * mass * GRAVITY * period)
