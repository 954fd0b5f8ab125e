"""From a free ball down to the floor ahead of it (monograph 3.4.2).

Until the front feet stand on the floor, base and feet go with the ball as it is seen; then it is meant to come to rest,
and feet on it push it there: from where it is seen when each stage begins, and while the robot leaves it from where it
was meant to be, or the base would follow a ball that rolls away. Feet are planned where they will be when the ball has
come to rest, and put down short of it by the way that a ball of the believed mass has yet to roll, at the speed that
(3.1.13) tells. All numbers of `TABLE` but the order of its stages were searched for together, by true distances and
with the ball where it rolls to (`tools/search_plan.py`).
"""

from typing import ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from sweep.controllers.manoeuvres.balancing.ball import on_ball, perch
from sweep.controllers.manoeuvres.balancing.beside_ball import (
    CALM,
    FRONT,
    MIDDLE,
    ON_BALL,
    ON_FLOOR,
    REAR,
    STILL,
    BesideBall,
    Held,
    Move,
    Pose,
    refuse,
    stages,
)
from sweep.controllers.manoeuvres.goals import UPRIGHT
from sweep.controllers.plan import Plan, Stage, assemble
from sweep.controllers.support import RESTS, STAYS
from sweep.core.parameters import choice, parameters, quantity
from sweep.formulas.ball import ball_omega
from sweep.models.case import Case
from sweep.models.frames import fixed, koenig
from sweep.models.legs import LEGS
from sweep.models.obstacles.ball import Ball
from sweep.models.robot import total_mass


class Table(NamedTuple):
    """Its moves. Places of feet are those where they are when the ball has come to rest."""

    top: tuple[Move, ...]  # on top of the ball, to where coming down needs feet
    down: tuple[Move, ...]  # with the ball, which rolls, to the front feet's touchdown
    off: tuple[Move, ...]  # the ball stops, and is left


TABLE = Table(
    top=(
        Move("lower", 0.3, Pose(90.0, 1.333, 0.061), rates=(0.0, 1.0)),
        Move("rear", 0.7, Pose(90.0, 1.221, 0.104), REAR, place=(0.669, 95.3), lift=0.078, plane=(0.5, 0.0, 1.0)),
        Move("middle", 0.7, Pose(90.0, 1.338, 0.096), MIDDLE, place=(0.655, 121.5), lift=0.079, plane=(0.5, 0.0, 1.0)),
        Move("front", 0.7, Pose(90.3, 1.105, -0.039), FRONT, place=(0.603, 180.5), lift=0.08, plane=(0.5, 0.0, 1.0)),
    ),
    down=(
        Move("turn", 0.35, Pose(104.2, 1.102, 0.117)),
        Move(
            "middle2",
            0.6,
            Pose(119.5, 1.123, 0.072),
            MIDDLE,
            place=(0.804, 168.6),
            lift=0.212,
            plane=(0.241, 0.429, 0.791),
        ),
        Move("grip", 0.25, Pose(127.5, 1.121, 0.008)),
        Move(
            "front2",
            0.8,
            Pose(151.4, 1.086, 0.2),
            FRONT,
            ON_FLOOR,
            place=(0.716, 1.453),
            lift=0.13,
            plane=(0.851, 0.489, 0.433),
            rates=(1.0, 0.5),
        ),
    ),
    off=(
        Move("brake", 0.9, Pose(152.0, 1.086, 0.253), rates=(1.0, 0.0), support=RESTS),
        Move("hold", 0.4, Pose(148.7, 1.089, 0.262), support=RESTS),
        Move(
            "rear2",
            0.8,
            Pose(148.7, 1.082, 0.437),
            REAR,
            place=(0.621, 108.8),
            lift=0.125,
            plane=(0.5, 1.0, 0.8),
            support=RESTS,
        ),
        Move("down", 1.5, Pose(139.3, 1.074, 0.715), rates=STILL, support=RESTS),
        Move(
            "middle3",
            0.8,
            Pose(148.6, 1.075, 0.737),
            MIDDLE,
            ON_FLOOR,
            place=(0.528, 1.177),
            lift=0.116,
            plane=(1.267, -0.36, 0.193),
            support=RESTS,
        ),
        Move(
            "rear3",
            0.8,
            Pose(147.8, 1.087, 0.83),
            REAR,
            place=(0.694, 163.6),
            lift=0.23,
            plane=(0.052, 3.249, 1.414),
            support=RESTS,
        ),
        Move(
            "middle4",
            0.8,
            Pose(149.4, 1.105, 0.795),
            MIDDLE,
            ON_FLOOR,
            place=(0.573, 1.445),
            lift=0.06,
            plane=(0.0, 0.0, 1.0),
            support=RESTS,
        ),
        Move(
            "front3",
            0.8,
            Pose(151.9, 1.074, 0.676),
            FRONT,
            ON_FLOOR,
            place=(0.724, 2.056),
            lift=0.219,
            plane=(0.189, -0.417, 0.77),
            support=RESTS,
        ),
        Move("level", 2.0, Pose(90.0, -0.318, 1.896), rates=STILL, support=STAYS),
        Move(
            "rear4",
            0.8,
            Pose(90.0, -0.303, 1.718),
            REAR,
            ON_FLOOR,
            place=(0.455, 1.126),
            lift=0.137,
            plane=(1.421, 1.449, 0.199),
            support=STAYS,
        ),
    ),
)


def speed(belief: Case, table: Table, time: Array) -> Array:
    """Of the ball (m/s) when the robot has come down so far in `time` (s), by monograph (3.1.13)."""
    ball, pose = belief.on(Ball), table.down[-1].pose
    way = jnp.radians(jnp.asarray(pose.elevation, float) - 90)
    rate = -way / time
    rolls = ball_omega(total_mass(belief.robot), ball.mass, ball.radius, pose.distance * ball.radius, jnp.pi / 2,
                       jnp.pi / 2 - way, rate, 0.0)  # fmt: skip
    return jnp.abs(rolls.omega) * ball.radius


def led(belief: Case, table: Table, rate: Array | float) -> Table:
    """The table with feet where they are to be put down, and with its times, at a `rate` of the way down.

    At a constant rate down the ball is the faster the farther the mass centre has gone: as 1 - cos of the angle.
    """
    ball = belief.on(Ball)
    time = sum(move.time for move in table.down) / jnp.asarray(rate, float)
    fastest = speed(belief, table, time)
    stops = 0.5 * fastest * table.off[0].time

    def angle(move: Move) -> Array:
        return jnp.radians(jnp.asarray(move.pose.elevation, float) - 90)

    end = angle(table.down[-1])

    def ahead(move: Move, at: Array | float) -> Move:
        left = (end - jnp.sin(end)) - (at - jnp.sin(at))
        turn = (stops + fastest * time / end * left / (1 - jnp.cos(end))) / ball.radius
        aside, place = move.place
        return move._replace(place=(aside, place - jnp.degrees(turn) if move.where == ON_BALL else place + turn))

    top = tuple(ahead(move, 0.0) for move in table.top)
    down = tuple(ahead(move._replace(time=move.time / rate), angle(move)) for move in table.down)
    return Table(top, down, table.off)


@parameters
class BallDescend(BesideBall):
    """From standing on a free ball down to the floor ahead. Stages and their numbers are `TABLE`.

    A ball that rolls is stopped first.
    """

    goal: ClassVar = {**UPRIGHT, "obstacle_speed_error_max_mps": 0.01}
    kind: str = choice("ball_descend", "ball_descend")
    rate: float = quantity(1.0, "-", above=0, at_most=10)  # of the way down to the floor, over that of `TABLE`
    rest: float = quantity(3.5, "s", above=0)  # on the floor, in the end

    @property
    def table(self) -> Table:
        """The numbers of its plan."""
        return TABLE

    def plan(self, belief: Case, table: Table | None = None) -> Plan:
        """Calm the ball, come down, rest.

        Raises `InputError` where the feet do not reach the ball, by plain numbers.
        """
        perched = perch(belief, self)
        refuse(belief, lambda: on_ball(belief, perch(belief, self)))
        calm = self.calming.steps_of(perched, CALM, first=0.5)
        down = self.way_down(belief, table or self.table)
        return assemble(on_ball(belief, perched), [*calm, *down], self.patience, ease=self.ease)

    def way_down(self, belief: Case, table: Table) -> list[Stage]:
        """From the perch to a rest on the floor, in the end in the frame of a ball that is not to move."""
        ball, perched = belief.on(Ball), perch(belief, self)
        moves = [move for part in led(belief, table, self.rate) for move in part]
        on_top = Pose(90.0, perched.position[2] / ball.radius, perched.position[0] / ball.radius)
        held = Held(self.deepening, (self.press, self.squeeze))
        down = stages(ball, moves, on_top, dict.fromkeys(LEGS, fixed(0)), held)
        last = down[-1]
        halt = Stage("rest", self.rest, foot_frames=(koenig(0),) * 6, base_frame=koenig(0), support=(STAYS,),
                     onset=last.onset, press=last.press)  # fmt: skip
        return [*down, halt]
