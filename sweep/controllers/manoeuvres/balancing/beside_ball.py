"""Moves of a robot between a free ball and the floor: the vocabulary of climbing it and of coming down.

World axes as in `ball`: the robot faces x. Places are seen from the ball's centre, in its Koenig frame and in units of
its radius R.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.controllers.frames import WORLD, fixed, koenig
from sweep.controllers.gaits import GALLOP
from sweep.controllers.plan import CYCLE_B, PRESS, Stage, Stance
from sweep.controllers.support import Support
from sweep.controllers.tracker import joint_targets
from sweep.core.errors import InputError
from sweep.formulas.leg import SIDE
from sweep.models.case import Case
from sweep.models.legs import LEGS
from sweep.models.obstacles.ball import Ball

FRONT, MIDDLE, REAR = GALLOP
ON_BALL, ON_FLOOR = "ball", "floor"
FREE = Support()  # the ball is where it is measured


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
    onset: str = PRESS  # or `GRIP`


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
        ahead, aside, up = (jnp.asarray(x, float) for x in move.plane)
        out.append(Stage(
            prefix + move.name, move.time, swing, CYCLE_B, jnp.asarray(move.lift, float) * ball.radius,
            jnp.stack([jnp.stack([ahead, side * aside, up]) for side in SIDE]),
            position=centre(ball, move.pose), turn=jnp.stack([jnp.zeros_like(turn), turn, jnp.zeros_like(turn)]),
            rates=move.rates, pivot=jnp.zeros(3), arc=jnp.abs(turn), support=(move.support,), onset=held.onset,
            press=held.press, base_frame=koenig(0),
            foot_frames=tuple(koenig(0) if leg in swing else stand[leg] for leg in LEGS),
        ))  # fmt: skip
        stand |= {leg: fixed(0) if move.where == ON_BALL else WORLD for leg in swing}
        before = move.pose
    return out
