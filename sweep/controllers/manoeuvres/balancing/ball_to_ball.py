"""From one free ball to another (monograph 3.5): roll the first to the second, go over, come to rest on it, go down.

World axes as in `TwoBalls`: the robot faces x. While feet stand on both balls these are meant to roll together, as they
do in the mean, and feet on the second press it to the first: (3.5.2).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sweep.controllers.assembly import assemble
from sweep.controllers.layers import Now
from sweep.controllers.manoeuvres.balancing.ball import BallDrive, OnBall, on_ball, perch, terms
from sweep.controllers.manoeuvres.balancing.ball_descend import BallDescend
from sweep.controllers.manoeuvres.balancing.ball_ride import about_aside
from sweep.controllers.manoeuvres.balancing.beside_ball import CALM
from sweep.controllers.manoeuvres.balancing.checks import Asked, between, checked, stands_next
from sweep.controllers.manoeuvres.balancing.parts import Driven, InParts, OfBall
from sweep.controllers.manoeuvres.goals import UPRIGHT
from sweep.controllers.moves import stages_of, standing
from sweep.controllers.observation import Observation
from sweep.controllers.plan import TOGETHER, Plan, Stage, Support, ends, reference
from sweep.controllers.posture import leg_points
from sweep.controllers.programme import Programme
from sweep.controllers.refusals import at_ends, plain, refuse_reach
from sweep.controllers.tracker import Guidance, Guided, TrackerState
from sweep.core.errors import InputError
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.core.rotations import conjugate, rotate
from sweep.fused.numbers import worked_out
from sweep.models.case import Case
from sweep.models.frames import fixed
from sweep.models.legs import LEGS
from sweep.models.obstacles.surface import FreeState
from sweep.models.obstacles.two_balls import TwoBalls

ROLLS, OVER = "roll", "over"


def apart(balls: TwoBalls, free: FreeState) -> Float[Array, ""]:
    """delta, how far the balls are from each other along x (m)."""
    return free.position[1, 0] - free.position[0, 0] - 2 * balls.radius


@dataclass(frozen=True)
class BallDocking(Driven):
    """Until the first ball touches the second."""

    speed: Array | float  # m/s, as it comes there

    def led(self, belief: Case, free: FreeState) -> Guided:
        """To a place so far behind the second ball that its speed is left there."""
        place = free.position[0, 0] + apart(belief.on(TwoBalls), free) + self.speed / self.drive.brake
        return OfBall(replace(self.drive, place=place), 0)

    def arrived(self, belief: Case, free: FreeState) -> Bool[Array, ""]:
        """By how far the balls are from each other."""
        return apart(belief.on(TwoBalls), free) < 4e-3


class ClosingMemory(NamedTuple):
    """What a stage has begun with."""

    gap: Float[Array, ""]  # m, delta as the stage began


class Closing(NamedTuple):
    """As planned, but feet on the second ball go on with it to the first, and press it there: after (3.5.2).

    The print turns them by the way over R_n; the ball rolls it over R.
    """

    press: Array | float  # epsilon, m
    straight: Array | float  # share of its length, of a leg that is too straight

    def memory(self, belief: Case, plan: Plan) -> ClosingMemory:
        """The memory before the first stage."""
        return ClosingMemory(jnp.zeros(()))

    def guide(self, belief: Case, now: Now, state: TrackerState) -> Guidance:
        """The stage's own stance, with the feet moved."""
        plan, stage, balls = now.plan, now.stage, belief.on(TwoBalls)
        gap = jnp.clip(apart(balls, now.seen.free), 0.0, FARTHEST)
        memory: ClosingMemory = state.memory
        gap = jnp.where(now.begins, gap, memory.gap)
        wanted = reference(plan, stage, now.phase, state.feet, state.position)
        programme = plan.layer(Programme)
        assert programme is not None  # since it is how balls are brought together
        both = jnp.asarray(programme.support.mode)[stage, 0] == TOGETHER
        way = jnp.where(both, now.phase * (gap + self.press), 0.0)
        quat = now.free.quat[1:]
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


def touching(belief: Case) -> Case:
    """`belief` with balls that touch, one right behind the other."""
    return replace(belief, obstacle=replace(belief.on(TwoBalls), gap=0.0, offset=0.0))


@parameters
class BallToBall(OnBall, InParts):
    """Roll the first ball to the second, go over from one to the other, and calm that or get off it."""

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
    # of a leg's thigh and shin: straighter, the base goes no farther, and is planned lower or the foot nearer
    straight: float = quantity(0.985, "-", above=0, at_most=1)
    clear: float = quantity(0.05, "m", at_least=0)  # of the base's underside over the balls as it is planned lower
    patience: float = quantity(0.1, "s", at_least=0)  # longest wait for a touchdown

    needs = (TwoBalls,)
    own_plan = "ball_to_ball"

    def plan(self, belief: Case) -> Plan:
        """Roll, go over, calm the second ball.

        Raises `InputError` where a foot does not reach, or the mass centre is not between the feet that stand, by plain
        numbers.
        """
        self.refuse(belief)
        perched, down = perch(belief, self), self.down
        calm = down.calming.steps_of(down.perched(belief), CALM)
        off = down.way_down(belief) if self.finish == "floor" else []
        stages = [
            *self.rolling.steps_of(perched, ROLLS),
            *self.over(belief),
            *OfBall(down, 1).stages([*calm, *off]),
        ]
        return assemble(on_ball(belief, perched), stages, self.patience, ease=self.ease)

    def over(self, belief: Case) -> list[Stage]:
        """From ball to ball, as if they stood still, touching; as the checks of 3.5.3 leave it."""
        perched = perch(belief, self)
        feet = dict(zip(LEGS, perched.feet, strict=True))
        supports = {"free": (Support(),) * 2, "together": (Support(TOGETHER),) * 2}
        how = terms(belief, belief.robot.body_length, self.deepening, (self.press, self.squeeze), supports, (OVER,))
        stages = stages_of("over", how, standing(feet, 0.0, fixed(0)))[0]
        return checked(touching(belief), on_ball(belief, perched), stages,
                       Asked(self.spare, self.straight, self.clear))  # fmt: skip

    def refuse(self, belief: Case) -> None:
        """Raise `InputError` where a foot is out of reach, or the mass centre not `spare` m between standing feet.

        At the ends of the stages from ball to ball, by plain numbers; after what the checks of 3.5.3 do about it.
        """
        if not plain(belief.robot, belief.obstacle, self):
            return

        start = touching(belief).on(TwoBalls).start

        def over() -> tuple[Plan, Array]:
            plan = assemble(on_ball(belief, perch(belief, self)), self.over(belief), 0.0)
            return plan, between(belief.robot, ends(plan, start()), stands_next(plan.swing))

        plan, inside = worked_out(over)
        refuse_reach(belief, lambda: at_ends(plan, start()), f"{self.kind}: ")
        inside = inside.min(axis=0)
        if not inside.min() >= self.spare:
            raise InputError(
                f"{self.kind}: the mass centre is {inside.min():.3f} m between the feet that stand after stage "
                f"{plan.names[inside.argmin()]}: at least manoeuvre.spare = {self.spare:g}"
            )

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
            ROLLS: BallDocking(self.rolling, self.docking),
            OVER: Closing(self.closing, self.straight),
            **{name: OfBall(law, 1) for name, law in self.down.parts.items()},
        }
