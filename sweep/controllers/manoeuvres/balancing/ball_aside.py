"""Driving a free ball sideways, the robot standing on it (monograph 3.3.3)."""

from dataclasses import replace
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.controllers.compile_plan import compile_plan
from sweep.controllers.frames import Stance
from sweep.controllers.layers import TickContext
from sweep.controllers.manoeuvres.balancing.ball import (
    OnBall,
    compensate_base,
    stance_on_ball,
    stand_pose,
    standing_stages,
)
from sweep.controllers.manoeuvres.goals import UPRIGHT
from sweep.controllers.plan import Plan
from sweep.controllers.tracker import Guidance, TrackerState
from sweep.core.constants import GRAVITY
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.core.rotations import rotate
from sweep.formulas.ball import ROLLING, lateral_mu
from sweep.models.case import Case
from sweep.models.obstacles.ball import Ball
from sweep.models.robot import total_mass

MU_INTEGRAL = 1.5  # integral of mu over T


@parameters
class BallAside(OnBall):
    """Drive a ball to the left at `speed`, coast, and stop it, all feet standing. Ratios are to the length a_r.

    In a stage of T the mass centre goes aside by k_l (v_d - v_b) mu(tau), (3.3.7), and comes back. k_l follows from the
    angular momentum of robot and ball about the ball's lowest point: so that one stage gives the speed that lacks. The
    print moves the base so; what its feet take the mass centre aside while the ball rolls off below adds to the push,
    and is taken back by (3.1.10) at every tick.

    The ball turns the feet on its right in under their hips as it rolls, and a leg whose foot is farther in than its
    hip turns over. On a ball that is smaller for its robot the circle of footholds is larger for it.
    """

    goal: ClassVar = {**UPRIGHT, "obstacle_speed_error_max_mps": 0.01}
    kind: str = choice("ball_aside", "ball_aside")
    speed: float = quantity(0.03, "m/s")  # v_d, to the left
    room_ratio: float = quantity(0.105, "a_r", at_least=0, at_most=1)  # of feet aside of their hips, at least
    period: float = quantity(2.0, "s", above=0, at_most=20)  # T, time of a stage
    coast: float = quantity(0.5, "s", above=0)  # between driving and stopping
    gain: float = quantity(1.0, "-", above=0)  # of k_l, over that by the angular momentum
    stops: int = count(8, at_least=1, at_most=500)  # stages that stop the ball

    def plan(self, belief: Case) -> Plan:
        """Drive, coast, stop; all feet stay."""
        pose = stand_pose(belief, replace(self, circle_ratio=self._circle_ratio(belief)))
        times = {"drive": self.period, "coast": self.coast}
        times |= {f"stop{k + 1}": self.period for k in range(self.stops)}
        return compile_plan(stance_on_ball(belief, pose), standing_stages(pose, times), 0.0)

    def _circle_ratio(self, belief: Case) -> Array:
        """d_1 (R) at which front and rear feet have their room."""
        robot = belief.robot
        aside = robot.body_width / 2 + self.room_ratio * robot.body_length
        wanted = aside / (belief.on(Ball).radius * jnp.sqrt(1 - self.chord_ratio**2))
        return jnp.clip(wanted, self.circle_ratio, 1.0)

    def init_memory(self, belief: Case, plan: Plan) -> Float[Array, ""]:
        """The push of the stage, k_l (v_d - v_b) to the left (m), before the first one."""
        return jnp.zeros(())

    def guide(self, belief: Case, ctx: TickContext, state: TrackerState) -> Guidance:
        """The mass centre over the ball, and aside of it as the stage has planned where it began."""
        plan, stage, free = ctx.plan, ctx.stage, ctx.obs.free
        wanted = jnp.where(stage == 0, self.speed, free.velocity[0, 1])  # coasting, as it goes
        wanted = jnp.where(stage > 1, 0.0, wanted)
        push = self.gain * lateral_gain(belief, plan, self.period) * (wanted - free.velocity[0, 1])
        push = jnp.where(ctx.is_first_tick, push, state.memory)
        aside = push * lateral_mu(self.period, jnp.minimum(state.clock, self.period)).mu
        feet = rotate(free.quat, state.feet)
        over = jnp.stack([jnp.zeros_like(aside), aside])
        position = compensate_base(belief.robot, plan.position[stage], feet, over, lengthwise=True)
        return Guidance(Stance(state.feet, position, plan.quat[stage]), state.feet, push)


def lateral_gain(belief: Case, plan: Plan, period: Array | float) -> Array:
    """k_l (s): the mass centre aside by k_l (v_d - v_b) mu for T changes the ball's speed from v_b to v_d.

    The mass centre's height is taken to be the base's.
    """
    ball, mass = belief.on(Ball), total_mass(belief.robot)
    inertia = ROLLING * ball.mass * ball.radius + mass * (ball.radius + plan.position[0, 2])
    return inertia / (MU_INTEGRAL * mass * GRAVITY * period)
