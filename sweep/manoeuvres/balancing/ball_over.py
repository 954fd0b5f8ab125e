"""Over a free ball: up on to it, along with it, down from it and away (monograph 3.4)."""

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import ClassVar

from sweep.controllers.plan import CYCLE_B, REGRIP, STAYS, Plan, Stage
from sweep.controllers.tracker import FeedbackLaw
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.manoeuvres.balancing.ball import BallDrive
from sweep.manoeuvres.balancing.ball_climb import BallClimb
from sweep.manoeuvres.balancing.ball_descend import BallDescend
from sweep.manoeuvres.balancing.beside_ball import CALM, BesideBallManoeuvre
from sweep.manoeuvres.balancing.parts import SettleBallLaw
from sweep.manoeuvres.climbing.walking import AHEAD, REST_TO_REST, departure_stages, foot_offsets_from_base
from sweep.manoeuvres.goals import UPRIGHT
from sweep.models.case import Case
from sweep.models.frames import koenig_frame_number
from sweep.models.legs import LEG_PAIRS
from sweep.models.obstacles.ball import Ball, tangent_base_position
from sweep.planning.compile_plan import compile_plan
from sweep.planning.gaits import GaitStep
from sweep.planning.moves import read_moves

DRIVE = "drive"


@parameters
class BallCrossing(BesideBallManoeuvre):
    """Climb a free ball, roll it to a goal by walking on it, descend, and walk away by tripod.

    Ratios are to the body's length a_r.
    """

    goal: ClassVar = {**UPRIGHT, "obstacle_speed_error_max_mps": 0.01}
    kind: str = choice("ball_over", "ball_over")
    speed: float = quantity(0.13, "m/s", above=0)  # v_d, of the ball on its way
    place: float = quantity(2.37, "m")  # x of the ball's centre where the robot comes down; it is on top near 0.37
    brake: float = quantity(0.15, "1/s", above=0)  # largest speed for each metre of distance to that place
    near: float = quantity(0.1, "m", above=0)  # largest distance to that place of a ball that is calm
    drive: int = count(50, at_least=1, at_most=500)  # largest number of steps that roll the ball
    away: int = count(4, at_least=1, at_most=200)  # number of swings by tripod on the floor
    half_step_ratio: float = quantity(0.1, "a_r", above=0, at_most=0.5)  # d_x, half the length of these swings
    lift_ratio: float = quantity(0.05, "a_r", above=0, at_most=0.5)  # d_y, their height
    hips_ratio: float = quantity(0.5, "a_r", above=0, at_most=2)  # d, height of the hips above the floor then
    spread_ratio: float = quantity(0.3, "a_r", at_least=0, at_most=2)  # distance of feet outward from their hips then
    # varpi, rate of these swings, which gives their time t*
    turning: float = quantity(3.0, "rad/s", above=0, at_most=20)

    default_plan_name = "ball_over"  # in R

    @property
    def climb_manoeuvre(self) -> BallClimb:
        """The manoeuvre `BallClimb` with this manoeuvre's parameters, which climbs the ball."""
        return BallClimb(**self._shared_parameters)

    @property
    def descent_manoeuvre(self) -> BallDescend:
        """The manoeuvre `BallDescend` with this manoeuvre's parameters, which descends from the ball."""
        return BallDescend(**self._shared_parameters)

    @property
    def _shared_parameters(self) -> dict:
        return {field.name: getattr(self, field.name) for field in fields(BesideBallManoeuvre)}

    @property
    def travel_drive(self) -> BallDrive:
        """The feedback law that rolls the ball to its goal."""
        return replace(self.stopping_drive, steps=self.drive, speed=self.speed, place=self.place, brake=self.brake)

    @property
    def feedback_laws(self) -> Mapping[str, FeedbackLaw]:
        """Feedback laws by name: for riding up on the ball, stopping it, and rolling it."""
        return {
            **self.climb_manoeuvre.feedback_laws,
            DRIVE: SettleBallLaw(self.travel_drive, self.calm_speed, self.near),
        }

    def plan(self, belief: Case) -> Plan:
        """Return the plan: climb the ball, stop it, roll it, descend, walk away.

        Raises:
            InputError: the ball is too large, or the feet do not reach the floor, all plain numbers.
        """
        pose = self.descent_manoeuvre.stand_pose(belief)
        start, up = self.climb_manoeuvre.climb_stages(belief)
        calm = self.stopping_drive.tripod_step_stages(pose, CALM)
        along = self.travel_drive.tripod_step_stages(pose, DRIVE)
        down = self.descent_manoeuvre.descent_stages(belief)
        away = self.walk_away_stages(belief)
        return compile_plan(start, [*up, *calm, *along, *down, *away], self.patience, ease=self.ease)

    def walk_away_stages(self, belief: Case) -> list[Stage]:
        """Return the plan stages that walk away by tripod, relative to a ball that is assumed to stay in place."""
        radius, length = belief.obstacle_of_type(Ball).radius, belief.robot.body_length
        height, spread = self.hips_ratio * length, self.spread_ratio * length
        step = GaitStep.from_ratios(length, self.half_step_ratio, self.lift_ratio, self.turning)
        *_, last = read_moves(belief, "off").values()
        stood = tangent_base_position(belief.obstacle_of_type(Ball), 1.0, radius, 0.0, *last.base["tangent"])
        position = stood.at[0].add(step.half_length).at[2].set(height - radius)  # clear of the ball
        under = position + foot_offsets_from_base(belief, spread, height, AHEAD)
        first = Stage("away.3-4", 1.0, {leg: under[leg - 1] for leg in LEG_PAIRS["middle"]}, CYCLE_B, 2 * step.height,
                      position=position, rates=REST_TO_REST)  # fmt: skip
        ready, walk = departure_stages(belief, step, position, spread, height, self.away, AHEAD)
        # Regrip: with `REZERO` the base would jump at once while feet follow within `ease`, and the robot would hop.
        options = {
            "foot_frames": (koenig_frame_number(0),) * 6,
            "base_frame": koenig_frame_number(0),
            "support": (STAYS,),
            "onset": REGRIP,
        }
        return [replace(stage, **options) for stage in (first, *ready, *walk, Stage("halt", 1.0))]
