"""From a free ball down to the floor ahead of it (monograph 3.4.2).

Until the front feet stand on the floor, base and feet go with the ball as it is seen; then it is meant to come to rest,
and feet on it push it there: from where it is seen when each stage begins, and while the robot leaves it from where it
was meant to be, or the base would follow a ball that rolls away. Feet are planned where they will be when the ball has
come to rest, and put down short of it by the way that a ball of the believed mass has yet to roll, at the speed that
(3.1.13) tells.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from sweep.controllers.compile_plan import compile_plan
from sweep.controllers.manoeuvres.balancing.ball import (
    StandPose,
    ball_move_context,
    require_start_within_reach,
    stance_on_ball,
    stand_pose,
)
from sweep.controllers.manoeuvres.balancing.beside_ball import CALM, BesideBall
from sweep.controllers.manoeuvres.goals import UPRIGHT
from sweep.controllers.moves import Move, move_stages, read_moves, read_numbers, standing_on
from sweep.controllers.plan import RESTS, STAYS, Plan, Stage, Support
from sweep.core.parameters import choice, parameters, quantity
from sweep.formulas.ball import ball_omega
from sweep.models.case import Case
from sweep.models.frames import fixed, koenig
from sweep.models.legs import LEGS
from sweep.models.obstacles.ball import Ball
from sweep.models.obstacles.charts import Number
from sweep.models.robot import total_mass


class StandCircle(NamedTuple):
    """Of a plan's part `perch`: what follows the ball's radius, since the legs' reach does not."""

    circle: Number  # radius of the circle of footholds on top, in units of the manoeuvre's


def ball_speed_at_floor(belief: Case, last: Move, time: Array) -> Array:
    """Of the ball (m/s) when the robot has come down to its `last` pose in `time` (s), by monograph (3.1.13)."""
    ball, distance = belief.on(Ball), last.base["tangent"][1]
    rolls = ball_omega(total_mass(belief.robot), ball.mass, ball.radius, distance * ball.radius, jnp.pi / 2,
                       jnp.pi / 2 - angle_from_top(last), -angle_from_top(last) / time, 0.0)  # fmt: skip
    return jnp.abs(rolls.omega) * ball.radius


def angle_from_top(move: Move) -> Array:
    """How far round the ball the base has come from its top (rad)."""
    return jnp.radians(jnp.asarray(move.base["tangent"][0], float) - 90)


def total_time(moves: Iterable[Move]) -> Array | float:
    """How long moves take together (s)."""
    return sum(0.0 if move.seconds is None else move.seconds for move in moves)


def timed_moves(belief: Case, rate: Array | float) -> dict[str, Move]:
    """The moves with feet where they are to be put down, and with their times, at a `rate` of the way down.

    At a constant rate down the ball is the faster the farther the mass centre has gone: as 1 - cos of the angle.
    """
    ball, (top, down, off) = belief.on(Ball), (read_moves(belief, part) for part in ("top", "down", "off"))
    last = list(down.values())[-1]
    time = total_time(down.values()) / jnp.asarray(rate, float)
    fastest = ball_speed_at_floor(belief, last, time)
    stops = 0.5 * fastest * total_time(list(off.values())[:1])
    end = angle_from_top(last)

    def shift_feet(move: Move, angle: Array | float) -> Move:
        remaining = (end - jnp.sin(end)) - (angle - jnp.sin(angle))
        turn = (stops + fastest * time / end * remaining / (1 - jnp.cos(end))) / ball.radius
        shift = {"ball": -jnp.degrees(turn), "ground": turn}
        feet = {pair: {chart: [aside, place + shift[chart]] for chart, (aside, place) in (place or {}).items()}
                for pair, place in move.feet.items()}  # fmt: skip
        return replace(move, feet=feet)

    on_top = {name: shift_feet(move, 0.0) for name, move in top.items()}
    rolling = {
        name: shift_feet(replace(move, seconds=total_time([move]) / rate), angle_from_top(move))
        for name, move in down.items()
    }
    return {**on_top, **rolling, **off}


@parameters
class BallDescend(BesideBall):
    """From standing on a free ball down to the floor ahead.

    A ball that rolls is stopped first.
    """

    goal: ClassVar = {**UPRIGHT, "obstacle_speed_error_max_mps": 0.01}
    kind: str = choice("ball_descend", "ball_descend")
    rate: float = quantity(1.0, "-", above=0, at_most=10)  # of the way down to the floor, over that of the plan's file
    rest: float = quantity(3.5, "s", above=0)  # on the floor, in the end

    own_plan = "ball_descend"  # in R

    def stand_pose(self, belief: Case) -> StandPose:
        """Where the robot stands on top, on the plan's circle."""
        circle = self.circle_ratio * read_numbers(StandCircle, belief, "perch").circle
        return stand_pose(belief, replace(self, circle_ratio=circle))

    def plan(self, belief: Case) -> Plan:
        """Calm the ball, come down, rest.

        Raises `InputError` where the feet do not reach the ball, by plain numbers.
        """
        pose = self.stand_pose(belief)
        require_start_within_reach(belief, lambda: stance_on_ball(belief, self.stand_pose(belief)))
        calm = self.calm_drive.step_stages(pose, CALM, first_share=0.5)
        return compile_plan(
            stance_on_ball(belief, pose), [*calm, *self.descent_stages(belief)], self.patience, ease=self.ease
        )

    def descent_stages(self, belief: Case) -> list[Stage]:
        """From the perch to a rest on the floor, in the end in the frame of a ball that is not to move."""
        supports = {"free": (Support(),), "rests": (RESTS,), "stays": (STAYS,)}
        context = ball_move_context(
            belief, belief.on(Ball).radius, self.deepening, (self.press, self.squeeze), supports
        )
        feet = dict(zip(LEGS, self.stand_pose(belief).feet, strict=True))
        down, _ = move_stages(timed_moves(belief, self.rate), context, standing_on(feet, 0.0, fixed(0)), "")
        last = down[-1]
        halt = Stage("rest", self.rest, foot_frames=(koenig(0),) * 6, base_frame=koenig(0), support=(STAYS,),
                     onset=last.onset, press=last.press)  # fmt: skip
        return [*down, halt]
