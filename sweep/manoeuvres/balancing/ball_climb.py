"""From the floor on to a free ball and to rest on its top (monograph 3.3.1, 3.3.2)."""

from collections.abc import Mapping
from typing import ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from sweep.controllers.plan import RESTS, TO_VELOCITY, Plan, Stage, SupportMotion
from sweep.controllers.tracker import FeedbackLaw
from sweep.core.errors import InputError
from sweep.core.parameters import choice, parameters, quantity
from sweep.core.rotations import IDENTITY
from sweep.formulas.ball_reach import max_ball
from sweep.fused.numbers import evaluate_with_numpy
from sweep.manoeuvres.balancing.ball import ball_move_context, require_start_within_reach, stand_pose
from sweep.manoeuvres.balancing.ball_ride import RIDE, RideUpLaw
from sweep.manoeuvres.balancing.beside_ball import CALM, BesideBallManoeuvre
from sweep.manoeuvres.goals import UPRIGHT
from sweep.models.case import Case
from sweep.models.obstacles.ball import Ball
from sweep.models.obstacles.charts import Number
from sweep.models.posture import Stance
from sweep.planning.compile_plan import compile_plan
from sweep.planning.moves import MoveContext, StandingState, initial_stance, plan_part_stages, read_plan_part
from sweep.planning.validation import are_plain_numbers


class PushOffSpeed(NamedTuple):
    """Speed with which the robot pushes off to climb a ball, read from the part `push` of the plan file: (3.1.15)."""

    speed: Number  # of the ball, over the manoeuvre's `push_speed`


@parameters
class BallClimb(BesideBallManoeuvre):
    """Climb from the floor on to a free ball and come to rest on its top."""

    goal: ClassVar = {**UPRIGHT, "obstacle_speed_error_max_mps": 0.01, "obstacle_aside_max_m": 0.05}
    kind: str = choice("ball_climb", "ball_climb")
    # speed below which the ball needs no further step; 0: all steps are made
    calm_speed: float = quantity(0.0, "m/s", at_least=0)
    # v_*, speed of the ball after the push, times the plan file's factor
    push_speed: float = quantity(0.324, "m/s", above=0)
    gain: float = quantity(0.918, "-", above=0, at_most=2)  # factor on the rate (3.1.16)
    # least rate of the ride, on a ball that stops before the top
    least_rate: float = quantity(0.2, "rad/s", at_least=0)
    most_rate: float = quantity(1.5, "rad/s", above=0)  # largest rate of the ride
    braking: float = quantity(0.8, "rad/s^2", above=0)  # deceleration of that rate towards the top
    # time in which the base moves on to the point of tangency, in the ride
    centring: float = quantity(1.52, "s", above=0)
    lean: float = quantity(2.5, "s", at_least=0)  # lean of the base against the ball's lateral speed, in the ride

    default_plan_name = "ball_climb"  # in R

    def plan(self, belief: Case) -> Plan:
        """Return the plan: feet to the ball, base to its tangent, push, ride up, stand on top, stop the ball.

        Raises:
            InputError: the ball is too large, or the feet do not reach the floor, all plain numbers.
        """
        start, up = self.climb_stages(belief)
        calm = self.stopping_drive.tripod_step_stages(stand_pose(belief, self), CALM)
        return compile_plan(start, [*up, *calm], self.patience, ease=self.ease)

    def climb_stages(self, belief: Case) -> tuple[Stance, list[Stage]]:
        """Return the start stance, and the plan stages until the robot stands on top."""
        self.validate(belief)
        require_start_within_reach(belief, lambda: self.start_stance_and_state(belief)[0])
        start, standing = self.start_stance_and_state(belief)
        stages, standing = plan_part_stages(
            "approach", self.move_context(belief, self.deepening, (0.0, 0.0)), standing, ""
        )
        on_ball = self.move_context(belief, self.deepening + self.press, (self.press, self.squeeze))
        for part, prefix in (("hold", ""), ("ride", "ride."), ("stand", "")):
            stages_of_part, standing = plan_part_stages(part, on_ball, standing, prefix)
            stages += stages_of_part
        return start, stages

    def start_stance_and_state(self, belief: Case) -> tuple[Stance, StandingState]:
        """Return the start stance (world axes), and the footholds and base from which moves continue."""
        feet, position, standing = initial_stance("start", self.move_context(belief, self.deepening, (0.0, 0.0)))
        return Stance(feet, position, jnp.array(IDENTITY)), standing

    def move_context(
        self, belief: Case, deepening: Array | float, press: tuple[Array | float, Array | float]
    ) -> MoveContext:
        """Return the coordinate systems and directions for moves in the plan file, beside and on the ball.

        Args:
            belief: believed parameters.
            deepening: depth of feet in what they stand on (m).
            press: pressure of feet on the ball (m), see `Stage.press`.
        """
        radius = belief.obstacle_of_type(Ball).radius
        speed = self.push_speed * read_plan_part(PushOffSpeed, belief, "push").speed
        rolls = SupportMotion(TO_VELOCITY, jnp.zeros(3).at[0].set(speed), jnp.zeros(3).at[1].set(speed / radius))
        supports = {"free": (SupportMotion(),), "rests": (RESTS,), "rolls": (rolls,)}
        return ball_move_context(belief, radius, deepening, press, supports, (RIDE,))

    def validate(self, belief: Case) -> None:
        """Raise an error unless the front feet reach footholds where friction holds them: (3.1.18)-(3.1.22).

        Raises:
            InputError: the ball is too large, all plain numbers.
        """
        robot, radius = belief.robot, belief.obstacle_of_type(Ball).radius
        highest = 2 * (robot.thigh + robot.shin)  # m, height of the front hips that allows the largest ball
        numbers = (robot.thigh, robot.shin, highest, robot.body_width, belief.contact.friction)
        if not are_plain_numbers(numbers, radius):
            return
        most = float(evaluate_with_numpy(lambda: max_ball(*numbers).R))
        if not radius <= most:
            raise InputError(
                f"obstacle.radius = {radius:g} is not allowed: at most {most:.2f} m can be climbed by legs of "
                f"{robot.thigh:g} and {robot.shin:g} m at friction {numbers[-1]:g} (formula max_ball)"
            )

    @property
    def feedback_laws(self) -> Mapping[str, FeedbackLaw]:
        """Feedback laws by name: the one that rides up on the ball, and the one that stops the ball."""
        return {
            RIDE: RideUpLaw(self.gain, self.least_rate, self.most_rate, self.braking, self.centring, self.lean),
            **super().feedback_laws,
        }
