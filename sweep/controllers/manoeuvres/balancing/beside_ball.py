"""Moves of a robot between a free ball and the floor: the vocabulary of climbing it and of coming down.

World axes as in `ball`: the robot faces x. Places are seen from the ball's centre, in its Koenig frame and in units of
its radius R.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.controllers.gaits import GALLOP
from sweep.controllers.manoeuvres.balancing.ball import BallDrive, OnBall
from sweep.controllers.manoeuvres.balancing.parts import InParts, Steps
from sweep.controllers.plan import CYCLE_B, GRIP, Stage, Stance, by_side
from sweep.controllers.support import Support
from sweep.controllers.tracker import Guided, joint_targets
from sweep.core.errors import InputError
from sweep.core.parameters import count, parameters, quantity
from sweep.formulas.leg import SIDE
from sweep.models.case import Case
from sweep.models.frames import WORLD, fixed, koenig
from sweep.models.legs import LEGS
from sweep.models.obstacles.ball import Ball

FRONT, MIDDLE, REAR = GALLOP
ON_BALL, ON_FLOOR = "ball", "floor"
FREE = Support()  # the ball is where it is measured
STILL = (0.0, 0.0)  # rates of a base that starts and ends at rest
CALM = "calm"  # how the names of steps that stop the ball begin


class Pose(NamedTuple):
    """Of the base: its axis along a tangent of a circle about the ball's centre."""

    elevation: Array | float  # deg, of the point of the tangent; 90 on top, more is ahead of it
    distance: Array | float  # R, of the axis from the ball's centre
    ahead: Array | float = 0.0  # R, of the base's centre along the tangent


class Move(NamedTuple):
    """A stage: the base goes to a pose, and a pair of feet, or none, to a place on the ball or on the floor."""

    name: str
    time: float  # s
    pose: Pose
    legs: tuple[int, int] | None = None
    where: str = ON_BALL
    place: tuple[float, float] = (0.0, 0.0)  # R aside; on the ball elevation (deg), on the floor R ahead of its centre
    lift: float = 0.08  # R
    plane: tuple[float, float, float] = (0.5, 0.0, 1.0)  # of the lift: ahead, aside, up
    rates: tuple[float, float] = (1.0, 1.0)  # of the base at the stage's ends, in its mean
    support: Support = FREE  # of the ball


class Held(NamedTuple):
    """How feet stand (m)."""

    deepening: Array | float  # of footholds inside ball and floor
    press: tuple[Array | float, Array | float]  # of feet that stand on the ball, see `Stage.press`


@parameters
class BesideBall(OnBall, InParts):
    """What manoeuvres between a free ball and the floor have in common: their grip, and steps that stop the ball.

    These are tripods of `ball_drive` at v_d = 0, as many of `calm` as the ball needs.
    """

    calm: int = count(15, at_least=1, at_most=100)  # steps at most
    calm_speed: float = quantity(0.01, "m/s", at_least=0)  # of a ball that needs no further step; 0: all are made
    step_time: float = quantity(0.9, "s", above=0, at_most=20)  # of these steps
    speed_gain: float = quantity(0.6, "s", at_least=0)  # k_v, of pushes that stop the ball
    aside_gain: float = quantity(0.4, "-", at_least=0)  # k_1, of how far the ball is aside now
    aside_gain_before: float = quantity(0.3, "-", at_least=0)  # k_2, of how far it was aside a step before
    press: float = quantity(1.6e-3, "m", at_least=0, at_most=0.05)  # feet on the ball deeper than they are measured
    squeeze: float = quantity(3.8e-3, "m", at_least=0, at_most=0.05)  # the same to the middle
    ease: float = quantity(0.15, "s", above=0)  # in which feet go over to where they are measured
    patience: float = quantity(0.1, "s", at_least=0)  # longest wait for a touchdown

    @property
    def calming(self) -> BallDrive:
        """The steps that stop the ball."""
        return self.driven(steps=self.calm, speed=0.0, step_time=self.step_time, speed_gain=self.speed_gain,
                           aside_gain=self.aside_gain, aside_gain_before=self.aside_gain_before)  # fmt: skip

    @property
    def parts(self) -> Mapping[str, Guided]:
        """The calming steps."""
        return {CALM: Steps(self.calming, self.calm_speed, math.inf)}


def refuse(belief: Case, start: Callable[[], Stance]) -> None:
    """Raise `InputError` where a foot is out of reach at the start, by plain numbers."""
    if not all(isinstance(x, float) for x in jax.tree.leaves((belief.robot, belief.obstacle, belief.manoeuvre))):
        return
    with jax.ensure_compile_time_eval():
        lacks = np.asarray(joint_targets(belief.robot, start())[1])
    if not lacks.max() <= 0:
        raise InputError(
            f"obstacle.radius = {belief.on(Ball).radius:g} is not allowed: at the start of manoeuvre = "
            f"{belief.manoeuvre.kind} foot {lacks.argmax() + 1} is {lacks.max():.3f} m out of reach"
        )


def centre(ball: Ball, pose: Pose) -> Float[Array, " 3"]:
    """The base's centre (m)."""
    angle = jnp.radians(jnp.asarray(pose.elevation, float))
    sin, cos = jnp.sin(angle), jnp.cos(angle)
    ahead = -pose.distance * cos + pose.ahead * sin
    return ball.radius * jnp.stack([ahead, jnp.zeros_like(ahead), pose.distance * sin + pose.ahead * cos])


def pitch(pose: Pose) -> Array:
    """How far the base is turned nose down (rad)."""
    return jnp.radians(jnp.asarray(pose.elevation, float) - 90)


def point_on(ball: Ball, leg: int, aside: Array | float, elevation: Array | float) -> Float[Array, " 3"]:
    """A point (m) of the ball's surface, `aside` (R) from the middle plane on the leg's side, at an elevation (deg)."""
    angle, out = jnp.radians(jnp.asarray(elevation, float)), jnp.asarray(aside, float)
    round_ = jnp.sqrt(1 - out**2)
    return ball.radius * jnp.stack([-round_ * jnp.cos(angle), SIDE[leg - 1] * out, round_ * jnp.sin(angle)])


def foothold(ball: Ball, leg: int, move: Move, deepening: Array | float) -> Float[Array, " 3"]:
    """Where a move takes a leg's foot (m)."""
    aside, other = move.place
    if move.where == ON_BALL:
        return point_on(ball, leg, aside, other) * (1 - deepening / ball.radius)
    out, ahead = jnp.asarray(aside, float) * ball.radius, jnp.asarray(other, float) * ball.radius
    return jnp.stack([ahead, SIDE[leg - 1] * out, -ball.radius - jnp.asarray(deepening, float)])


def stages(
    ball: Ball, moves: Sequence[Move], before: Pose, stand: dict[int, int], held: Held, prefix: str = ""
) -> list[Stage]:
    """Stages of moves, the base coming from the pose `before`; feet stand in the frames `stand`, which is kept true."""
    out = []
    for move in moves:
        turn = pitch(move.pose) - pitch(before)
        swing = {leg: foothold(ball, leg, move, held.deepening) for leg in move.legs or ()}
        out.append(Stage(
            prefix + move.name, move.time, swing, CYCLE_B, jnp.asarray(move.lift, float) * ball.radius,
            by_side(move.plane), position=centre(ball, move.pose),
            turn=jnp.stack([jnp.zeros_like(turn), turn, jnp.zeros_like(turn)]),
            rates=move.rates, pivot=jnp.zeros(3), arc=jnp.abs(turn), support=(move.support,), onset=GRIP,
            press=held.press, base_frame=koenig(0),
            foot_frames=tuple(koenig(0) if leg in swing else stand[leg] for leg in LEGS),
        ))  # fmt: skip
        stand |= {leg: fixed(0) if move.where == ON_BALL else WORLD for leg in swing}
        before = move.pose
    return out
