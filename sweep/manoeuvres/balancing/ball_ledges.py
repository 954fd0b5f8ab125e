"""From a ledge on to a ball that leans on it, with the ball to the far ledge, and off (monograph 3.2).

World axes as in `Ledges`: the robot faces x. The way off is the way on backwards in time, mirrored. While a foot stands
on a ledge, the ball's reference is at rest, since feet that followed the measured ball would let it drift. The mass
centre stays between the ledge's edge and the ball's centre, so that the ball is pressed to the wall.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Bool

from sweep.controllers.plan import LEVEL, RESTS, Plan, SupportMotion
from sweep.controllers.tracker import FeedbackLaw
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.manoeuvres.balancing.ball import (
    BallDrive,
    OnBallManoeuvre,
    ball_move_context,
    require_start_within_reach,
    stand_pose,
)
from sweep.manoeuvres.balancing.parts import DriveUntilArrivalLaw, FeedbackLawManoeuvre
from sweep.manoeuvres.goals import UPRIGHT
from sweep.models.case import Case
from sweep.models.obstacles.ledges import Ledges
from sweep.models.obstacles.surface import FreeBodyState
from sweep.models.posture import Stance
from sweep.planning.compile_plan import compile_plan
from sweep.planning.moves import (
    MoveContext,
    StandingState,
    initial_stance,
    mirror_move,
    move_stages,
    plan_part_stages,
    read_placement_move,
)

ROLLS, ON, OFF = "roll", "on", "off"


@dataclass(frozen=True)
class WallDockingLaw(DriveUntilArrivalLaw):
    """Feedback law that rolls the ball until it rests at the far wall."""

    speed: Array | float  # m/s, at the wall
    near: Array | float  # m, largest remaining distance to the wall
    calm: Array | float  # m/s, largest speed of a ball that rests there

    def drive_law(self, belief: Case, free: FreeBodyState) -> FeedbackLaw:
        """Return the law that rolls the ball to a goal behind the wall, to meet the wall at the docking speed."""
        return replace(self.drive, place=belief.obstacle_of_type(Ledges).far_wall_x + self.speed / self.drive.brake)

    def has_arrived(self, belief: Case, free: FreeBodyState) -> Bool[Array, ""]:
        """Return whether the ball is at the wall and nearly at rest."""
        remaining = belief.obstacle_of_type(Ledges).far_wall_x - free.position[0, 0]
        return (remaining < self.near) & (jnp.linalg.norm(free.velocity[0]) < self.calm)


@parameters
class BallLedges(OnBallManoeuvre, FeedbackLawManoeuvre):
    """Step from a ledge on to a ball, roll it to the opposite wall, and step off on to the ledge there."""

    goal: ClassVar = {
        **UPRIGHT, "docking_gap_max_m": 4e-3, "docking_speed_max_mps": 0.04, "past_centre_max_m": 0.02
    }  # fmt: skip
    kind: str = choice("ball_ledges", "ball_ledges")
    steps: int = count(34, at_least=1, at_most=200)  # largest number of steps that roll the ball
    step_time: float = quantity(1.2, "s", above=0, at_most=20)  # time of these steps
    speed: float = quantity(0.1, "m/s", above=0)  # speed of the ball on its way
    speed_gain: float = quantity(0.3, "s", at_least=0)  # k_v, of `ball_drive`
    brake: float = quantity(0.1, "1/s", above=0)  # largest speed for each metre of remaining distance
    docking: float = quantity(0.015, "m/s", above=0)  # speed of the ball when it reaches the far wall
    calm_speed: float = quantity(0.01, "m/s", above=0)  # largest speed of a ball that rests there
    near: float = quantity(4e-3, "m", above=0)  # largest remaining distance of a ball that is there
    height_ratio: float = quantity(0.34, "a_r", above=0, at_most=2)  # height of the base over the ball's top
    deepening: float = quantity(1e-3, "m", at_least=0, at_most=0.05)  # depth of footholds inside ball and ledges
    # depth of feet on the ball below where they are measured
    press: float = quantity(1e-3, "m", at_least=0, at_most=0.05)
    squeeze: float = quantity(1.5e-3, "m", at_least=0, at_most=0.05)  # the same towards the middle plane
    ease: float = quantity(0.15, "s", above=0)  # time in which feet move over to new footholds
    patience: float = quantity(0.1, "s", at_least=0)  # longest wait for a touchdown

    needs = (Ledges,)
    default_plan_name = "ball_ledges"

    def plan(self, belief: Case) -> Plan:
        """Return the plan: on to the ball, over to the far ledge, off.

        Raises:
            InputError: a foot is out of reach at the start, all plain numbers.
        """
        require_start_within_reach(belief, lambda: self.start_stance_and_state(belief)[0])
        context, (stance, standing) = self.move_context(belief), self.start_stance_and_state(belief)
        name, stands = read_placement_move(belief, "start")
        stand = replace(stands, feet={})
        halt = replace(mirror_move(belief, stand, ()), seconds=1.0)
        stages, _ = move_stages({name: stand}, context, standing, "")
        get_on, standing = plan_part_stages("on", context, standing)
        get_off, standing = plan_part_stages("off", context, standing)
        last, _ = move_stages({"halt": halt}, context, standing, "")
        rolling = self.roll_drive.tripod_step_stages(stand_pose(belief, self), ROLLS)
        return compile_plan(stance, [*stages, *get_on, *rolling, *get_off, *last], self.patience, ease=self.ease)

    def start_stance_and_state(self, belief: Case) -> tuple[Stance, StandingState]:
        """Return the start stance, and the same feet and base as a `StandingState`, level with the ball sideways."""
        feet, position, standing = initial_stance("start", self.move_context(belief))
        aside = belief.obstacle_of_type(Ledges).start().position[0] * jnp.array([0.0, 1.0, 0.0])
        return Stance(feet + aside, position, jnp.asarray(LEVEL)), standing

    def move_context(self, belief: Case) -> MoveContext:
        """Return the coordinate systems and directions for moves in the plan file, on ledges and ball."""
        press, supports = (self.press, self.squeeze), {"free": (SupportMotion(),), "rests": (RESTS,)}
        return ball_move_context(belief, belief.robot.body_length, self.deepening, press, supports, (ON, OFF))

    @property
    def roll_drive(self) -> BallDrive:
        """The feedback law that rolls the ball to the other wall."""
        return self.make_ball_drive(
            steps=self.steps, speed=self.speed, step_time=self.step_time, speed_gain=self.speed_gain, brake=self.brake
        )

    @property
    def feedback_laws(self) -> Mapping[str, FeedbackLaw]:
        """Feedback laws by name: the one that rolls the ball until it rests at the far wall."""
        return {ROLLS: WallDockingLaw(self.roll_drive, self.docking, self.near, self.calm_speed)}
