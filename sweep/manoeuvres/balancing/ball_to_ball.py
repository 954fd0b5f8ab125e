"""From one free ball to another (monograph 3.5): roll the first to the second, go over, come to rest on it, go down.

World axes as in `TwoBalls`: the robot faces x. While feet stand on both balls, their references roll together with the
mean measured motion, and feet on the second ball press it to the first: (3.5.2).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sweep.controllers.layers import TickContext
from sweep.controllers.observation import Observation
from sweep.controllers.plan import TOGETHER, Plan, Stage, SupportMotion, reference_stance, stage_end_stances
from sweep.controllers.reference_body_motion import FreeBodyReferenceMotion
from sweep.controllers.tracker import FeedbackLaw, Guidance, TrackerState
from sweep.core.errors import InputError
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.core.rotations import conjugate, rotate
from sweep.fused.numbers import evaluate_with_numpy
from sweep.manoeuvres.balancing.ball import BallDrive, OnBallManoeuvre, ball_move_context, stance_on_ball, stand_pose
from sweep.manoeuvres.balancing.ball_descend import BallDescend
from sweep.manoeuvres.balancing.ball_ride import rotation_about_y
from sweep.manoeuvres.balancing.beside_ball import CALM
from sweep.manoeuvres.balancing.checks import (
    ReachAndSupportLimits,
    enforce_reach_and_support,
    mass_centre_margins,
    support_at_stage_end,
)
from sweep.manoeuvres.balancing.parts import DriveUntilArrivalLaw, FeedbackLawManoeuvre, SingleBallLawAdapter
from sweep.manoeuvres.goals import UPRIGHT
from sweep.models.case import Case
from sweep.models.frames import body_frame_number
from sweep.models.legs import LEGS
from sweep.models.obstacles.surface import FreeBodyState
from sweep.models.obstacles.two_balls import TwoBalls
from sweep.models.posture import leg_joint_positions
from sweep.planning.compile_plan import compile_plan
from sweep.planning.moves import make_standing_state, plan_part_stages
from sweep.planning.validation import are_plain_numbers, require_within_reach, stances_at_stage_ends

ROLLS, OVER = "roll", "over"


def ball_gap(balls: TwoBalls, free: FreeBodyState) -> Float[Array, ""]:
    """Return the gap delta between the two balls along x (m).

    Args:
        balls: the obstacle.
        free: state of the balls, world axes.
    """
    return free.position[1, 0] - free.position[0, 0] - 2 * balls.radius


@dataclass(frozen=True)
class BallDockingLaw(DriveUntilArrivalLaw):
    """Feedback law that rolls the first ball until it touches the second."""

    speed: Array | float  # m/s, on arrival

    def drive_law(self, belief: Case, free: FreeBodyState) -> FeedbackLaw:
        """Return the law that rolls the ball to a goal behind the second ball, to meet it at the docking speed."""
        place = free.position[0, 0] + ball_gap(belief.obstacle_of_type(TwoBalls), free) + self.speed / self.drive.brake
        return SingleBallLawAdapter(replace(self.drive, place=place), 0)

    def has_arrived(self, belief: Case, free: FreeBodyState) -> Bool[Array, ""]:
        """Return whether the balls touch."""
        return ball_gap(belief.obstacle_of_type(TwoBalls), free) < 4e-3


class BallClosingMemory(NamedTuple):
    """State of the law that pulls the second ball to the first, between control ticks."""

    gap: Float[Array, ""]  # m, delta at the start of the stage


@dataclass(frozen=True)
class BallClosingLaw:
    """Feedback law that pulls the second ball to the first with the feet on it, and presses it there: after (3.5.2).

    The book turns the feet by the motion over R_n; the ball rolls it over R.
    """

    press: Array | float  # m, epsilon
    straight: Array | float  # longest leg over thigh and shin before the base stops
    ends_stages: ClassVar = True

    def init_memory(self, belief: Case, plan: Plan) -> BallClosingMemory:
        """Return the initial state of the closing law."""
        return BallClosingMemory(jnp.zeros(()))

    def guide(self, belief: Case, ctx: TickContext, state: TrackerState) -> Guidance:
        """Return the planned stance with the feet on the second ball moved towards the first ball."""
        plan, stage, balls = ctx.plan, ctx.stage, belief.obstacle_of_type(TwoBalls)
        gap = jnp.clip(ball_gap(balls, ctx.obs.free), 0.0, MAX_CLOSING)
        memory: BallClosingMemory = state.memory
        gap = jnp.where(ctx.is_first_tick, gap, memory.gap)
        stance = reference_stance(plan, stage, ctx.phase, state.feet, state.position)
        programme = plan.find_layer(FreeBodyReferenceMotion)
        assert programme is not None  # since it is how balls are brought together
        both = jnp.asarray(programme.support.mode)[stage, 0] == TOGETHER
        shift = jnp.where(both, ctx.phase * (gap + self.press), 0.0)
        quat = ctx.free.quat[1:]
        turned = rotate(rotation_about_y(-shift / balls.radius)[None], rotate(quat, stance.feet))
        moved = rotate(conjugate(quat), turned - shift * jnp.array([1.0, 0.0, 0.0]))
        stands = (plan.foot_frame[stage] == body_frame_number(1))[:, None]
        return Guidance(stance._replace(feet=jnp.where(stands, moved, stance.feet)), plan.foothold[stage],
                        BallClosingMemory(gap))  # fmt: skip

    def is_stage_over(self, belief: Case, plan: Plan, state: TrackerState, obs: Observation) -> Bool[Array, ""]:
        """Return whether the stage that moves the base must end because a standing leg is nearly straight."""
        robot, is_moving = belief.robot, ~jnp.any(plan.swing[state.stage])
        points = leg_joint_positions(robot, obs.angles)
        stretch = jnp.linalg.norm(points[:, -1] - points[:, -3], axis=-1)
        return is_moving & jnp.any(obs.loaded & (stretch > self.straight * (robot.thigh + robot.shin)))


MAX_CLOSING = 0.02  # m, gap that a stage closes at most


def belief_with_touching_balls(belief: Case) -> Case:
    """Return the belief with two balls that touch, one directly behind the other."""
    return replace(belief, obstacle=replace(belief.obstacle_of_type(TwoBalls), gap=0.0, offset=0.0))


@parameters
class BallToBall(OnBallManoeuvre, FeedbackLawManoeuvre):
    """Roll the first ball to the second, step over, and stop the second ball or get off it."""

    goal: ClassVar = {**UPRIGHT, "second_ball_speed_max_mps": 0.01}
    kind: str = choice("ball_to_ball", "ball_to_ball")
    steps: int = count(40, at_least=1, at_most=200)  # largest number of steps that roll the first ball
    step_time: float = quantity(1.2, "s", above=0, at_most=20)  # time of these steps
    speed: float = quantity(0.1, "m/s", above=0)  # speed of the ball on its way
    speed_gain: float = quantity(0.6, "s", at_least=0)  # k_v, of `ball_drive`
    docking: float = quantity(0.03, "m/s", above=0)  # speed of the ball when it reaches the other one
    closing: float = quantity(2e-3, "m", at_least=0, at_most=0.05)  # epsilon, by which the balls are pressed together
    # end of the manoeuvre: at rest on the second ball, or down from it as `BallDescend`
    finish: str = choice("ball", "ball", "floor")
    calm: int = count(12, at_least=1, at_most=100)  # largest number of steps on the second ball
    # speed below which that ball needs no further step; 0: all steps are made
    calm_speed: float = quantity(0.0, "m/s", at_least=0)
    height_ratio: float = quantity(0.23, "a_r", above=0, at_most=2)  # height of the base over the ball's top
    deepening: float = quantity(1e-3, "m", at_least=0, at_most=0.05)  # depth of footholds inside the balls
    press: float = quantity(1.3e-3, "m", at_least=0, at_most=0.05)  # depth of feet below where they are measured
    squeeze: float = quantity(1.7e-3, "m", at_least=0, at_most=0.05)  # the same towards the middle plane
    ease: float = quantity(0.15, "s", above=0)  # time in which feet move over to new footholds
    spare: float = quantity(0.02, "m")  # least planned distance of the mass centre from the ends of the support
    # longest leg over thigh and shin; at that length the base stops, and is planned lower or the foot nearer
    straight: float = quantity(0.985, "-", above=0, at_most=1)
    # least clearance of the base over the balls where it is planned lower
    clear: float = quantity(0.05, "m", at_least=0)
    patience: float = quantity(0.1, "s", at_least=0)  # longest wait for a touchdown

    needs = (TwoBalls,)
    default_plan_name = "ball_to_ball"

    def plan(self, belief: Case) -> Plan:
        """Return the plan: roll to the second ball, step over, stop it, and get off if configured.

        Raises:
            InputError: a foot is out of reach, or the mass centre is not over the support, all plain numbers.
        """
        self.validate(belief)
        pose, down = stand_pose(belief, self), self.descent_manoeuvre
        calm = down.stopping_drive.tripod_step_stages(down.stand_pose(belief), CALM)
        off = down.descent_stages(belief) if self.finish == "floor" else []
        stages = [
            *self.roll_drive.tripod_step_stages(pose, ROLLS),
            *self.transfer_stages(belief),
            *SingleBallLawAdapter(down, 1).retarget_stages([*calm, *off]),
        ]
        return compile_plan(stance_on_ball(belief, pose), stages, self.patience, ease=self.ease)

    def transfer_stages(self, belief: Case) -> list[Stage]:
        """Return the plan stages from ball to ball, for touching balls at rest, corrected to keep reach and support."""
        pose = stand_pose(belief, self)
        feet = dict(zip(LEGS, pose.feet, strict=True))
        supports = {"free": (SupportMotion(),) * 2, "together": (SupportMotion(TOGETHER),) * 2}
        context = ball_move_context(
            belief, belief.robot.body_length, self.deepening, (self.press, self.squeeze), supports, (OVER,)
        )
        stages = plan_part_stages("over", context, make_standing_state(feet, 0.0, body_frame_number(0)))[0]
        return enforce_reach_and_support(belief_with_touching_balls(belief), stance_on_ball(belief, pose), stages,
                       ReachAndSupportLimits(self.spare, self.straight, self.clear))  # fmt: skip

    def validate(self, belief: Case) -> None:
        """Raise an error unless the stages from ball to ball keep reach and support; skip the check under JAX tracing.

        Raises:
            InputError: a foot is out of reach, or the mass centre is less than `spare` m inside its support.
        """
        if not are_plain_numbers(belief.robot, belief.obstacle, self, belief.plan):
            return

        start = belief_with_touching_balls(belief).obstacle_of_type(TwoBalls).start

        def plan_and_margins() -> tuple[Plan, Array]:
            plan = compile_plan(stance_on_ball(belief, stand_pose(belief, self)), self.transfer_stages(belief), 0.0)
            return plan, mass_centre_margins(
                belief.robot, stage_end_stances(plan, start()), support_at_stage_end(plan.swing)
            )

        plan, inside = evaluate_with_numpy(plan_and_margins)
        require_within_reach(belief, lambda: stances_at_stage_ends(plan, start()), f"{self.kind}: ")
        inside = inside.min(axis=0)
        if not inside.min() >= self.spare:
            raise InputError(
                f"{self.kind}: the mass centre is {inside.min():.3f} m inside the standing feet at the end of stage "
                f"{plan.names[inside.argmin()]}: at least manoeuvre.spare = {self.spare:g}"
            )

    @property
    def roll_drive(self) -> BallDrive:
        """The feedback law that rolls the first ball to the second."""
        return self.make_ball_drive(
            steps=self.steps, speed=self.speed, step_time=self.step_time, speed_gain=self.speed_gain
        )

    @property
    def descent_manoeuvre(self) -> BallDescend:
        """The manoeuvre that stops the second ball and gets down from it."""
        return BallDescend(calm=self.calm, calm_speed=self.calm_speed)

    @property
    def feedback_laws(self) -> Mapping[str, FeedbackLaw]:
        """Feedback laws by name: for rolling the first ball, changing balls, and stopping or leaving the second."""
        return {
            ROLLS: BallDockingLaw(self.roll_drive, self.docking),
            OVER: BallClosingLaw(self.closing, self.straight),
            **{name: SingleBallLawAdapter(law, 1) for name, law in self.descent_manoeuvre.feedback_laws.items()},
        }
