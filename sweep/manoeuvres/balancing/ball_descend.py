"""From a free ball down to the floor ahead of it (monograph 3.4.2).

Until the front feet stand on the floor, base and feet go with the measured ball. Then the ball's reference comes to
rest, and feet on the ball push it there: from the measured pose when each stage starts, and while the robot leaves it
from the last reference, since the base would otherwise follow a ball that rolls away. Footholds are planned where they
will be when the ball rests. They are put down short of that by the distance that a ball of the believed mass has yet to
roll, at the speed of (3.1.13).
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from sweep.controllers.plan import RESTS, STAYS, Plan, Stage, SupportMotion
from sweep.core.parameters import choice, parameters, quantity
from sweep.formulas.ball import ball_omega
from sweep.manoeuvres.balancing.ball import (
    StandPose,
    ball_move_context,
    require_start_within_reach,
    stance_on_ball,
    stand_pose,
)
from sweep.manoeuvres.balancing.beside_ball import CALM, BesideBallManoeuvre
from sweep.manoeuvres.goals import UPRIGHT
from sweep.models.case import Case
from sweep.models.frames import body_frame_number, koenig_frame_number
from sweep.models.legs import LEGS
from sweep.models.obstacles.ball import Ball
from sweep.models.obstacles.charts import Number
from sweep.models.robot import total_mass
from sweep.planning.compile_plan import compile_plan
from sweep.planning.moves import Move, make_standing_state, move_stages, read_moves, read_plan_part


class FootholdCircle(NamedTuple):
    """Radius of the circle of footholds on top of the ball, read from the part `perch` of the plan file."""

    circle: Number  # radius of the circle of footholds on top, over the manoeuvre's


def ball_speed_at_floor(belief: Case, last: Move, time: Array) -> Array:
    """Return the speed of the ball (m/s) when the robot has reached the floor: monograph (3.1.13).

    Args:
        belief: has robot and ball.
        last: move to the last pose on the ball.
        time: of the way down (s).
    """
    ball, distance = belief.obstacle_of_type(Ball), last.base["tangent"][1]
    rolls = ball_omega(total_mass(belief.robot), ball.mass, ball.radius, distance * ball.radius, jnp.pi / 2,
                       jnp.pi / 2 - base_angle_from_top(last), -base_angle_from_top(last) / time, 0.0)  # fmt: skip
    return jnp.abs(rolls.omega) * ball.radius


def base_angle_from_top(move: Move) -> Array:
    """Return the angle (rad) of the base from the ball's top after a move."""
    return jnp.radians(jnp.asarray(move.base["tangent"][0], float) - 90)


def total_move_duration(moves: Iterable[Move]) -> Array | float:
    """Return the total duration (s) of moves."""
    return sum(0.0 if move.seconds is None else move.seconds for move in moves)


def timed_descent_moves(belief: Case, rate: Array | float) -> dict[str, Move]:
    """Return the moves of the descent, with footholds and durations adapted to the rolling of the ball.

    At a constant rate down, the speed of the ball grows with the angle as 1 - cos.

    Args:
        belief: believed parameters.
        rate: of the way down, over that of the plan file.
    """
    ball, (top, down, off) = (
        belief.obstacle_of_type(Ball),
        (read_moves(belief, part) for part in ("top", "down", "off")),
    )
    last = list(down.values())[-1]
    time = total_move_duration(down.values()) / jnp.asarray(rate, float)
    fastest = ball_speed_at_floor(belief, last, time)
    stops = 0.5 * fastest * total_move_duration(list(off.values())[:1])
    end = base_angle_from_top(last)

    def shift_feet(move: Move, angle: Array | float) -> Move:
        remaining = (end - jnp.sin(end)) - (angle - jnp.sin(angle))
        turn = (stops + fastest * time / end * remaining / (1 - jnp.cos(end))) / ball.radius
        shift = {"ball": -jnp.degrees(turn), "ground": turn}
        feet = {pair: {chart: [aside, place + shift[chart]] for chart, (aside, place) in (place or {}).items()}
                for pair, place in move.feet.items()}  # fmt: skip
        return replace(move, feet=feet)

    on_top = {name: shift_feet(move, 0.0) for name, move in top.items()}
    rolling = {
        name: shift_feet(replace(move, seconds=total_move_duration([move]) / rate), base_angle_from_top(move))
        for name, move in down.items()
    }
    return {**on_top, **rolling, **off}


@parameters
class BallDescend(BesideBallManoeuvre):
    """Descend from a free ball to the floor ahead; a rolling ball is stopped first."""

    goal: ClassVar = {**UPRIGHT, "obstacle_speed_error_max_mps": 0.01}
    kind: str = choice("ball_descend", "ball_descend")
    # rate of the way down to the floor, over that of the plan file
    rate: float = quantity(1.0, "-", above=0, at_most=10)
    rest: float = quantity(3.5, "s", above=0)  # final time on the floor

    default_plan_name = "ball_descend"  # in R

    def stand_pose(self, belief: Case) -> StandPose:
        """Return the robot's pose on top of the ball, with its feet on the circle that the plan file gives."""
        circle = self.circle_ratio * read_plan_part(FootholdCircle, belief, "perch").circle
        return stand_pose(belief, replace(self, circle_ratio=circle))

    def plan(self, belief: Case) -> Plan:
        """Return the plan: stop the ball, descend, rest.

        Raises:
            InputError: the feet do not reach the ball, all plain numbers.
        """
        pose = self.stand_pose(belief)
        require_start_within_reach(belief, lambda: stance_on_ball(belief, self.stand_pose(belief)))
        calm = self.stopping_drive.tripod_step_stages(pose, CALM, first_share=0.5)
        return compile_plan(
            stance_on_ball(belief, pose), [*calm, *self.descent_stages(belief)], self.patience, ease=self.ease
        )

    def descent_stages(self, belief: Case) -> list[Stage]:
        """Return the plan stages from the pose on top of the ball to rest on the floor.

        The last one is in the frame of a ball that is to stay in place.
        """
        supports = {"free": (SupportMotion(),), "rests": (RESTS,), "stays": (STAYS,)}
        context = ball_move_context(
            belief, belief.obstacle_of_type(Ball).radius, self.deepening, (self.press, self.squeeze), supports
        )
        feet = dict(zip(LEGS, self.stand_pose(belief).feet, strict=True))
        down, _ = move_stages(
            timed_descent_moves(belief, self.rate), context, make_standing_state(feet, 0.0, body_frame_number(0)), ""
        )
        last = down[-1]
        halt = Stage("rest", self.rest, foot_frames=(koenig_frame_number(0),) * 6, base_frame=koenig_frame_number(0),
                     support=(STAYS,), onset=last.onset, press=last.press)  # fmt: skip
        return [*down, halt]
