"""From one free ball to another (monograph 3.5): roll the first to the second, go over, come to rest on it, go down.

World axes as in `TwoBalls`: the robot faces x. While feet stand on both balls these are meant to roll together, as they
do in the mean, and feet on the second press it to the first: (3.5.2).
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from sweep.controllers.ball_state import centre_of_mass
from sweep.controllers.manoeuvres.balancing.ball import BallDrive, DriveMemory, OnBall, on_ball, perch
from sweep.controllers.manoeuvres.balancing.ball_descend import BallDescend
from sweep.controllers.manoeuvres.balancing.ball_ride import about_aside
from sweep.controllers.manoeuvres.balancing.beside_ball import CALM
from sweep.controllers.manoeuvres.balancing.by_pairs import Move, Place, Way
from sweep.controllers.manoeuvres.balancing.parts import InParts, OfBall, has_just_begun
from sweep.controllers.manoeuvres.goals import UPRIGHT
from sweep.controllers.observation import Observation
from sweep.controllers.plan import Plan, Stage, Stance, assemble, reference
from sweep.controllers.posture import leg_points
from sweep.controllers.support import LEVEL, TOGETHER, Support
from sweep.controllers.tracker import Guidance, Guided, TrackerState, bodies, joint_targets
from sweep.core.errors import InputError
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.core.rotations import conjugate, rotate
from sweep.models.case import Case
from sweep.models.frames import fixed
from sweep.models.legs import LEGS
from sweep.models.obstacles.surface import FreeState
from sweep.models.obstacles.two_balls import TwoBalls

ROLLS, OVER = "roll", "over."


class Table(NamedTuple):
    """The numbers of the way from ball to ball: the base is told from the first ball, then from the second."""

    first: tuple[Move, ...]
    second: tuple[Move, ...]


TABLE = Table(
    first=(
        Move("squat", 0.7, (0.118, 0.256)),
        Move("middle", 0.76, (0.038, 0.309), "middle", Place(0, 0.126, 0.758), 0.098, (-0.012, 0.399, 1)),
        Move("front", 0.76, (0, 0.318), "front", Place(0, 0.617, 0.58), 0.114, (-0.605, 0.281, 1)),
        Move("lean", 0.6, (0.272, 0.226)),
        Move("rear", 0.76, (0.361, 0.154), "rear", Place(0, -0.121, 0.722), 0.089, (-0.007, 0.491, 1)),
        Move("middle2", 0.76, (0.266, 0.163), "middle", Place(0, 0.44, 0.713), 0.12, (0.002, 0.512, 1)),
        Move("front2", 0.76, (0.207, 0.136), "front", Place(1, -0.457, 0.566), 0.445, (0.07, 0.692, 1)),
        Move("ahead", 2, (0.899, 0.06)),
        Move("rear2", 0.76, (0.95, 0.06), "rear", Place(0, 0.355, 0.509), 0.12, (-0.016, -0.003, 1)),
        Move("middle3", 0.76, (0.899, 0.111), "middle", Place(1, -0.592, 0.568), 0.287, (-0.496, 0.803, 1)),
    ),
    second=(
        Move("front3", 0.76, (-1.142, 0.077), "front", Place(1, -0.105, 0.648), 0.149, (1.263, 0.813, 1)),
        Move("ahead2", 1.2, (-0.641, 0.14)),
        Move("middle4", 0.76, (-0.62, 0.125), "middle", Place(1, -0.352, 0.701), 0.145, (1.067, 2.063, 1)),
        Move("front4", 0.76, (-0.682, 0.159), "front", Place(1, 0.342, 0.536), 0.115, (0.134, 1.403, 1)),
        Move("ahead3", 1.6, (-0.2, 0.12)),
        Move("rear3", 0.76, (-0.16, 0.15), "rear", Place(1, -0.558, 0.673), 0.145, (1.486, 0.937, 1)),
        Move("middle5", 0.76, (-0.171, 0.086), "middle", Place(1, -0.035, 0.68), 0.131, (-1.913, 1.59, 1)),
    ),
)


def apart(balls: TwoBalls, free: FreeState) -> Float[Array, ""]:
    """delta, how far the balls are from each other along x (m)."""
    return free.position[1, 0] - free.position[0, 0] - 2 * balls.radius


class Docking(NamedTuple):
    """Steps that roll the first ball to the second, until they touch."""

    drive: BallDrive
    speed: Array | float  # m/s, as it comes there

    def memory(self, belief: Case, plan: Plan) -> DriveMemory:
        """Of the drive."""
        return self.drive.memory(belief, plan)

    def guide(
        self, belief: Case, plan: Plan, state: TrackerState, seen: Observation, begins: Bool[Array, ""], period: float
    ) -> Guidance:
        """By the drive's law, to a place so far behind the second ball that its speed is left there."""
        place = seen.free.position[0, 0] + apart(belief.on(TwoBalls), seen.free) + self.speed / self.drive.brake
        told = OfBall(replace(self.drive, place=place), 0)
        return told.guide(belief, plan, state, seen, begins, period)

    def ends(self, belief: Case, plan: Plan, state: TrackerState, seen: Observation) -> Bool[Array, ""]:
        """No step is begun where the balls touch."""
        return has_just_begun(plan, state) & (apart(belief.on(TwoBalls), seen.free) < 4e-3)


class ClosingMemory(NamedTuple):
    """Of a stage."""

    gap: Float[Array, ""]  # m, delta as the stage began


class Closing(NamedTuple):
    """As planned, but feet on the second ball go on with it to the first, and press it there: after (3.5.2).

    The print turns them by the way over R_n; the ball rolls it over R.
    """

    press: Array | float  # epsilon, m
    straight: Array | float  # share of its length, of a leg that is too straight

    def memory(self, belief: Case, plan: Plan) -> ClosingMemory:
        """Not begun."""
        return ClosingMemory(jnp.zeros(()))

    def guide(
        self, belief: Case, plan: Plan, state: TrackerState, seen: Observation, begins: Bool[Array, ""], period: float
    ) -> Guidance:
        """The stage's own stance, with the feet moved."""
        stage, balls = state.stage, belief.on(TwoBalls)
        gap = jnp.clip(apart(balls, seen.free), 0.0, FARTHEST)
        memory: ClosingMemory = state.memory
        gap = jnp.where(begins, gap, memory.gap)
        phase = jnp.clip(state.clock / plan.duration[stage], 0.0, 1.0)
        wanted = reference(plan, stage, phase, state.feet, state.position)
        assert plan.support is not None
        both = jnp.asarray(plan.support.mode)[stage, 0] == TOGETHER
        way = jnp.where(both, phase * (gap + self.press), 0.0)
        quat = bodies(plan, state, seen.free).quat[1:]
        turned = rotate(about_aside(-way / balls.radius)[None], rotate(quat, wanted.feet))
        moved = rotate(conjugate(quat), turned - way * jnp.array([1.0, 0.0, 0.0]))
        stands = (plan.foot_frame[stage] == fixed(1))[:, None]
        return Guidance(wanted._replace(feet=jnp.where(stands, moved, wanted.feet)), plan.foothold[stage],
                        ClosingMemory(gap))  # fmt: skip

    def ends(self, belief: Case, plan: Plan, state: TrackerState, seen: Observation) -> Bool[Array, ""]:
        """The base goes no farther where a leg that stands gets too straight; the next pair is moved then."""
        robot, goes = belief.robot, ~jnp.any(plan.swing[state.stage])
        points = leg_points(robot, seen.angles)
        stretch = jnp.linalg.norm(points[:, -1] - points[:, -3], axis=-1)
        return goes & jnp.any(seen.loaded & (stretch > self.straight * (robot.thigh + robot.shin)))


FARTHEST = 0.02  # m, that a stage closes


@parameters
class BallToBall(OnBall, InParts):
    """From one ball to another. Stages and their numbers are `TABLE`."""

    goal: ClassVar = {**UPRIGHT, "second_ball_speed_max_mps": 0.01}
    kind: str = choice("ball_to_ball", "ball_to_ball")
    steps: int = count(40, at_least=1, at_most=200)  # that roll the first ball, at most
    step_time: float = quantity(1.2, "s", above=0, at_most=20)  # of these steps
    speed: float = quantity(0.1, "m/s", above=0)  # of the ball on its way
    speed_gain: float = quantity(0.6, "s", at_least=0)  # k_v, of `ball_drive`
    docking: float = quantity(0.03, "m/s", above=0)  # of the ball as it comes to the other one
    closing: float = quantity(2e-3, "m", at_least=0, at_most=0.05)  # epsilon, by which the balls are pressed together
    finish: str = choice("ball", "ball", "floor")  # where: at rest on the second ball, or down from it as `BallDescend`
    calm: int = count(12, at_least=1, at_most=100)  # steps on the second ball, at most
    calm_speed: float = quantity(0.0, "m/s", at_least=0)  # of a ball that needs no further step; 0: all are made
    height_ratio: float = quantity(0.23, "a_r", above=0, at_most=2)  # of the base over the ball's top
    deepening: float = quantity(1e-3, "m", at_least=0, at_most=0.05)  # footholds inside the balls
    press: float = quantity(1.3e-3, "m", at_least=0, at_most=0.05)  # feet deeper than they are measured
    squeeze: float = quantity(1.7e-3, "m", at_least=0, at_most=0.05)  # the same to the middle
    ease: float = quantity(0.15, "s", above=0)  # in which feet go over to where they are measured
    spare: float = quantity(0.02, "m")  # of the mass centre between the feet that stand, at least, when it is planned
    # of a standing leg's thigh and shin: straighter, the base goes no farther
    straight: float = quantity(0.985, "-", above=0, at_most=1)
    patience: float = quantity(0.1, "s", at_least=0)  # longest wait for a touchdown

    needs = (TwoBalls,)

    @property
    def table(self) -> Table:
        """The numbers of its plan."""
        return TABLE

    def plan(self, belief: Case, table: Table | None = None) -> Plan:
        """Roll, go over, calm the second ball.

        Raises `InputError` where a foot does not reach, or the mass centre is not between the feet that stand, by plain
        numbers.
        """
        table, perched = table or self.table, perch(belief, self)
        numbers = jax.tree.leaves((belief.robot, belief.obstacle, belief.manoeuvre))
        if all(isinstance(x, float) for x in numbers):
            with jax.ensure_compile_time_eval():
                way = BetweenBalls(belief, self)
                way.over(table)
                way.refuse(self.spare)
        down = self.down
        calm = down.calming.steps_of(perch(belief, down), CALM)
        off = down.way_down(belief, down.table) if self.finish == "floor" else []
        stages = [
            *self.rolling.steps_of(perched, ROLLS),
            *BetweenBalls(belief, self).over(table),
            *OfBall(down, 1).stages([*calm, *off]),
        ]
        return assemble(on_ball(belief, perched), stages, self.patience, ease=self.ease)

    @property
    def rolling(self) -> BallDrive:
        """The steps that roll the first ball."""
        return self.driven(steps=self.steps, speed=self.speed, step_time=self.step_time, speed_gain=self.speed_gain)

    @property
    def down(self) -> BallDescend:
        """The steps that stop the second ball, and the way down from it."""
        return BallDescend(calm=self.calm, calm_speed=self.calm_speed)

    @property
    def parts(self) -> Mapping[str, Guided]:
        """Steps, the way over, steps."""
        return {
            ROLLS: Docking(self.rolling, self.docking),
            OVER: Closing(self.closing, self.straight),
            **{name: OfBall(law, 1) for name, law in self.down.parts.items()},
        }


class BetweenBalls(Way):
    """From the first ball to the second, as if they stood still, touching."""

    def __init__(self, belief: Case, how: "BallToBall"):
        super().__init__(belief, how)
        self.belief = belief
        self.frames = dict.fromkeys(LEGS, fixed(0))
        self.feet = perch(belief, how).feet  # from the first ball's centre (m)
        self.checked: list[Checked] = []

    def above(self, height: Array | float) -> Array | float:
        """From a ball's top."""
        return self.obstacle.radius + height * self.length

    def ashore(self, leg: int, place: Place) -> Float[Array, " 3"]:
        """There is no ledge."""
        raise AssertionError

    def supports(self) -> tuple[Support, ...]:
        """The balls are meant to roll together while feet stand on both."""
        both = {fixed(0), fixed(1)} <= set(self.frames.values())
        return (Support(TOGETHER) if both else Support(),) * 2

    def stage(self, move: Move, prefix: str = "") -> Stage:
        """Of a move; what is to be checked of its end is kept."""
        stage = super().stage(move, prefix)
        between = 2 * self.obstacle.radius * jnp.array([1.0, 0.0, 0.0])
        for leg, foothold in stage.swing.items():
            self.feet = self.feet.at[leg - 1].set(foothold + move.place.on * between)
        assert stage.position is not None
        stance = Stance(self.feet, stage.position + self.ball * between, jnp.asarray(LEVEL))
        swings = np.array([leg in stage.swing for leg in LEGS])
        ahead = centre_of_mass(self.belief.robot, stance)[0]
        stands = jnp.where(swings, jnp.nan, self.feet[:, 0])
        inside = jnp.minimum(ahead - jnp.nanmin(stands), jnp.nanmax(stands) - ahead)
        self.checked.append(Checked(stage.name, joint_targets(self.belief.robot, stance)[1], inside))
        return stage

    def over(self, table: Table) -> list[Stage]:
        """From ball to ball."""
        stages = [self.stage(move, OVER) for move in table.first]
        self.ball = 1
        return stages + [self.stage(move, OVER) for move in table.second]

    def refuse(self, spare: Array | float) -> None:
        """Raise `InputError` where a foot is out of reach, or the mass centre not `spare` m between standing feet."""
        kind = self.belief.manoeuvre.kind
        for name, shortfall, inside in self.checked:
            if not (most := float(jnp.max(shortfall))) <= 0:
                leg = int(jnp.argmax(shortfall)) + 1
                raise InputError(f"{kind}: foot {leg} is {most:.3f} m out of reach at the end of stage {name}")
            if not (left := float(inside)) >= spare:
                raise InputError(
                    f"{kind}: the mass centre is {left:.3f} m between the feet that stand in stage {name}: "
                    f"at least manoeuvre.spare = {spare:g}"
                )


class Checked(NamedTuple):
    """Of the end of a stage."""

    name: str
    shortfall: Float[Array, " 6"]  # m, of each foot's reach
    inside: Float[Array, ""]  # m, of the mass centre between the feet that stand, along the way
