"""From the floor on to a free ball and to rest on its top (monograph 3.3.1, 3.3.2)."""

from collections.abc import Mapping
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp

from sweep.controllers.manoeuvres.balancing.ball import perch
from sweep.controllers.manoeuvres.balancing.ball_ride import RIDE, UP, Ride
from sweep.controllers.manoeuvres.balancing.beside_ball import (
    CALM,
    FRONT,
    MIDDLE,
    ON_FLOOR,
    REAR,
    STILL,
    BesideBall,
    Held,
    Move,
    Pose,
    centre,
    foothold,
    refuse,
    stages,
)
from sweep.controllers.manoeuvres.goals import UPRIGHT
from sweep.controllers.plan import Plan, Stage, Stance, assemble
from sweep.controllers.support import RESTS, TO_VELOCITY, Support
from sweep.controllers.tracker import Guided
from sweep.core.errors import InputError
from sweep.core.parameters import choice, parameters, quantity
from sweep.core.rotations import IDENTITY
from sweep.formulas.ball_reach import max_ball
from sweep.models.case import Case
from sweep.models.frames import WORLD
from sweep.models.legs import LEGS
from sweep.models.obstacles.ball import Ball


class Table(NamedTuple):
    """The numbers of the plan: where the feet start, moves to the ball and up to the push, the ride, moves on top."""

    floor: tuple[tuple[float, float], ...]  # R, of rear, middle and front feet, see `Move.place`
    level: Pose
    approach: tuple[Move, ...]  # the ball is not gripped yet
    hold: tuple[Move, ...]
    push: Move
    ride: tuple[Move, ...]  # with places as if the base were on top
    top: tuple[Move, ...]


TABLE = Table(
    floor=((0.536, -2.083), (0.536, -1.452), (0.536, -1.131)),
    level=Pose(90.0, -0.286, -1.678),
    approach=(
        Move(
            "front",
            0.8,
            Pose(90.0, -0.286, -1.678),
            FRONT,
            place=(0.4825, 23.3313),
            lift=0.1832,
            plane=(-0.88, 0.9478, 0.219),
            support=RESTS,
        ),
        Move("turn1", 0.55, Pose(72.9768, 0.372, -1.612), rates=(0.0, 1.1), support=RESTS),
        Move("turn2", 0.5, Pose(50.4739, 0.8937, -1.2292), support=RESTS),
        Move("turn3", 0.55, Pose(30.7263, 1.0863, -0.7968), rates=(1.1, 0.0), support=RESTS),
        Move(
            "rear",
            0.8,
            Pose(31.6996, 1.0887, -0.7902),
            REAR,
            ON_FLOOR,
            place=(0.7661, -1.395),
            lift=0.0339,
            plane=(-0.1808, -0.1877, 1.0516),
            support=RESTS,
        ),
        Move(
            "middle",
            0.8,
            Pose(32.1957, 1.086, -0.7802),
            MIDDLE,
            ON_FLOOR,
            place=(0.516, -1.1311),
            lift=0.0187,
            plane=(-0.0032, 0.0051, 1.0028),
            support=RESTS,
        ),
        Move(
            "front2",
            0.8,
            Pose(32.1846, 1.089, -0.8167),
            FRONT,
            place=(0.637, 62.5141),
            lift=0.0782,
            plane=(-0.5, 1.0, 0.8),
            support=RESTS,
        ),
        Move(
            "middle2",
            0.8,
            Pose(32.5262, 1.085, -0.8117),
            MIDDLE,
            place=(0.81, 4.2),
            lift=0.141,
            plane=(-0.7619, 1.0563, -0.2171),
            support=RESTS,
        ),
    ),
    hold=(
        Move("grip", 0.4, Pose(32.8374, 1.0879, -0.7857), rates=STILL, support=RESTS),
        Move("lift", 1.5, Pose(31.8345, 1.0928, -0.4435), rates=STILL, support=RESTS),
        Move(
            "front3",
            0.8,
            Pose(31.5451, 1.0913, -0.4577),
            FRONT,
            place=(0.799, 76.0),
            lift=0.16,
            plane=(-0.5, 1.0, 0.8),
            support=RESTS,
        ),
        Move("grip2", 0.6, Pose(28.2564, 1.0794, -0.4208), rates=STILL, support=RESTS),
    ),
    push=Move("push", 0.9, Pose(30.1, 1.081, -0.2636), rates=(0.0, 2.0)),
    ride=(
        Move("rear3", 1.05, Pose(90.0, 1.078), REAR, place=(0.5365, 52.0), lift=0.0794, plane=(0.0079, 0.5617, 0.5876)),
        Move("middle3", 0.5, Pose(90.0, 1.078), MIDDLE, place=(0.6899, 89.6245), lift=0.0733, plane=(0.0, 0.5, 1.0)),
        Move(UP, 3.0, Pose(90.0, 1.078)),
    ),
    top=(
        Move(
            "middle4", 0.6, Pose(90.0, 1.0929, -0.0579), MIDDLE, place=(0.613, 90.0), lift=0.0463, plane=(0.0, 0.5, 1.0)
        ),
        Move(
            "front4",
            0.6,
            Pose(90.0, 1.17, 0.0228),
            FRONT,
            place=(0.438, 118.5),
            lift=0.0567,
            plane=(0.0, 0.5, 1.0),
            rates=(1.0, 0.0),
        ),
        Move("rise", 0.6, Pose(89.9928, 1.1416, 0.0995), rates=STILL),
        Move("rear4", 0.6, Pose(90.0, 1.2387, 0.1102), REAR, place=(0.438, 61.5), lift=0.1276, plane=(0.0, 0.5, 1.0)),
    ),
)


@parameters
class BallClimb(BesideBall):
    """From the floor on to a free ball and to rest on its top. Stages and their numbers are `TABLE`."""

    goal: ClassVar = {**UPRIGHT, "obstacle_speed_error_max_mps": 0.01, "obstacle_aside_max_m": 0.05}
    kind: str = choice("ball_climb", "ball_climb")
    calm_speed: float = quantity(0.0, "m/s", at_least=0)  # of a ball that needs no further step; 0: all are made
    push_speed: float = quantity(0.324, "m/s", above=0)  # v_*, of the ball after the push
    gain: float = quantity(0.918, "-", above=0, at_most=2)  # of the rate (3.1.16)
    most_rate: float = quantity(1.5, "rad/s", above=0)  # of the ride, at most
    centring: float = quantity(1.52, "s", above=0)  # in which the base goes on to the point of its tangent, in the ride
    lean: float = quantity(2.5, "s", at_least=0)  # of the base against the ball's speed aside, in the ride

    @property
    def table(self) -> Table:
        """The numbers of its plan."""
        return TABLE

    def plan(self, belief: Case, table: Table | None = None) -> Plan:
        """Feet to the ball, base to its tangent, push, ride, stand on top, calm the ball.

        Raises `InputError` where the ball is too large, or the feet do not reach the floor, by plain numbers.
        """
        start, up = self.way_up(belief, table or self.table)
        calm = self.calming.steps_of(perch(belief, self), CALM)
        return assemble(start, [*up, *calm], self.patience, ease=self.ease)

    def way_up(self, belief: Case, table: Table) -> tuple[Stance, list[Stage]]:
        """Where the robot stands at the start, and the stages to where the ball is to be calmed; see `plan`."""
        ball = belief.on(Ball)
        self.refuse(belief)
        refuse(belief, lambda: self.stance(ball, table))
        touching = Held(self.deepening, (0.0, 0.0))
        held = Held(self.deepening + self.press, (self.press, self.squeeze))
        rolls = Support(TO_VELOCITY, jnp.zeros(3).at[0].set(self.push_speed),
                        jnp.zeros(3).at[1].set(self.push_speed / ball.radius))  # fmt: skip
        stand, hold = dict.fromkeys(LEGS, WORLD), (*table.hold, table.push._replace(support=rolls))
        moves = stages(ball, table.approach, table.level, stand, touching)
        moves += stages(ball, hold, table.approach[-1].pose, stand, held)
        moves += stages(ball, table.ride, table.push.pose, stand, held, RIDE)
        moves += stages(ball, table.top, table.ride[-1].pose, stand, held)
        return self.stance(ball, table), moves

    def stance(self, ball: Ball, table: Table) -> Stance:
        """Where the robot stands at the start."""
        start, up = Move("", 0.0, table.level, where=ON_FLOOR), jnp.zeros(3).at[2].set(ball.radius)
        feet = [foothold(ball, leg, start._replace(place=table.floor[(leg - 1) // 2]), self.deepening) for leg in LEGS]
        return Stance(jnp.stack(feet) + up, centre(ball, table.level) + up, jnp.array(IDENTITY))

    def refuse(self, belief: Case) -> None:
        """Raise `InputError` where the front feet do not reach so high that friction holds them: (3.1.18)-(3.1.22)."""
        robot, radius = belief.robot, belief.on(Ball).radius
        highest = 2 * (robot.thigh + robot.shin)  # of the front hips for which the ball may be largest
        numbers = (robot.thigh, robot.shin, highest, robot.body_width, belief.contact.friction)
        if not all(isinstance(x, float) for x in (*numbers, radius)):
            return
        with jax.ensure_compile_time_eval():
            most = float(max_ball(*numbers).R)
        if not radius <= most:
            raise InputError(
                f"obstacle.radius = {radius:g} is not allowed: at most {most:.2f} m can be climbed by legs of "
                f"{robot.thigh:g} and {robot.shin:g} m at friction {numbers[-1]:g} (formula max_ball)"
            )

    @property
    def parts(self) -> Mapping[str, Guided]:
        """The ride up, and the calming steps."""
        return {RIDE: Ride(self.gain, self.most_rate, self.centring, self.lean), **super().parts}
