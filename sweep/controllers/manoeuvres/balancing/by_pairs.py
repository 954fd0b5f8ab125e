"""Moves of pairs of legs between balls and ledges: the vocabulary of manoeuvres by gallop.

World axes as in the obstacles: the robot faces x. The base stays level. Ratios are to the body length a_r and the
ball's radius R.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import NamedTuple, Protocol

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.controllers.gaits import GALLOP
from sweep.controllers.plan import CYCLE_B, GRIP, Stage, Stance, by_side
from sweep.controllers.support import LEVEL, Support
from sweep.formulas.leg import SIDE
from sweep.models.case import Case
from sweep.models.frames import WORLD, fixed, koenig
from sweep.models.legs import LEGS
from sweep.models.obstacles.ball import Ball

PAIRS: Mapping[str, tuple[int, int]] = dict(zip(("front", "middle", "rear"), GALLOP, strict=True))
OTHER: Mapping[str, str] = {"front": "rear", "middle": "middle", "rear": "front"}  # of each pair, seen in the mirror
LEDGE = -1  # where feet stand that are not on a ball, which has its number


class Place(NamedTuple):
    """Of a pair of feet: on a ball from its centre (R), on a ledge from its edge (a_r)."""

    on: int
    ahead: Array | float
    aside: Array | float


class Move(NamedTuple):
    """A stage: the base goes somewhere, and a pair of feet, or none, to a place."""

    name: str
    time: Array | float  # s
    base: tuple[Array | float, Array | float]  # R ahead of a ball's centre; height, a_r
    pair: str = ""
    place: Place = Place(0, 0.0, 0.0)
    lift: Array | float = 0.1  # a_r
    plane: tuple[Array | float, ...] = (0.0, 0.25, 1.0)  # of the lift: ahead, aside, up


class Stand(NamedTuple):
    """Where base and feet are."""

    base: tuple[Array | float, Array | float]  # see `Move`
    feet: Mapping[str, Place]


class Gripping(Protocol):
    """How feet stand (m): parameters of a manoeuvre."""

    @property
    def deepening(self) -> Array | float:
        """Of footholds inside what they stand on."""
        ...

    @property
    def press(self) -> Array | float:
        """Of feet on a ball beyond where they are measured."""
        ...

    @property
    def squeeze(self) -> Array | float:
        """The same to the middle."""
        ...


class Way(ABC):
    """Places and stages; where feet stand is kept while stages are made."""

    def __init__(self, belief: Case, how: Gripping):
        self.obstacle, self.how, self.length = belief.on(Ball), how, belief.robot.body_length
        self.frames = dict.fromkeys(LEGS, WORLD)
        self.ball = 0  # from whose centre the base goes

    @abstractmethod
    def above(self, height: Array | float) -> Array | float:
        """Height of the base's centre from a ball's (m)."""

    @abstractmethod
    def ashore(self, leg: int, place: Place) -> Float[Array, " 3"]:
        """A foothold on a ledge, in the world (m)."""

    @abstractmethod
    def supports(self) -> tuple[Support, ...]:
        """Of the balls, while feet stand as they do in `frames`."""

    def stance(self, stand: Stand, centre: Float[Array, " 3"]) -> Stance:
        """At the start, beside or on the ball whose centre (m) this is."""
        feet = {leg: self.foot(leg, stand.feet[pair]) for pair, legs in PAIRS.items() for leg in legs}
        self.frames |= {leg: self._stands(stand.feet[pair].on) for pair, legs in PAIRS.items() for leg in legs}
        shifts = {leg: centre * jnp.array([0.0, 1.0, 0.0]) if frame == WORLD else centre
                  for leg, frame in self.frames.items()}  # fmt: skip
        return Stance(
            jnp.stack([feet[leg] + shifts[leg] for leg in LEGS]), self.base(stand.base) + centre, jnp.asarray(LEVEL)
        )

    def base(self, place: tuple[Array | float, Array | float]) -> Float[Array, " 3"]:
        """The base's centre, from a ball's (m)."""
        x = jnp.asarray(place[0] * self.obstacle.radius, float)
        return jnp.stack([x, jnp.zeros_like(x), jnp.asarray(self.above(place[1]), float)])

    def foot(self, leg: int, place: Place) -> Float[Array, " 3"]:
        """A foothold (m), from a ball's centre or in the world."""
        if place.on == LEDGE:
            return self.ashore(leg, place)
        x, y = (jnp.asarray(part, float) for part in (place.ahead, SIDE[leg - 1] * place.aside))
        return (self.obstacle.radius - self.how.deepening) * jnp.stack([x, y, jnp.sqrt(1 - x**2 - y**2)])

    def stage(self, move: Move, prefix: str = "") -> Stage:
        """Of a move."""
        legs = PAIRS.get(move.pair, ())
        swing = {leg: self.foot(leg, move.place) for leg in legs}
        frames = self.frames | dict.fromkeys(legs, WORLD if move.place.on == LEDGE else koenig(move.place.on))
        self.frames = {leg: frame for leg, frame in self.frames.items() if leg not in legs}
        supports = self.supports()
        self.frames |= dict.fromkeys(legs, self._stands(move.place.on))
        return Stage(
            prefix + move.name, move.time, swing, CYCLE_B, move.lift * self.length, by_side(move.plane),
            position=self.base(move.base), rates=(0.0, 0.0), base_frame=koenig(self.ball),
            foot_frames=tuple(frames[leg] for leg in LEGS), support=supports, onset=GRIP,
            press=(self.how.press, self.how.squeeze),
        )  # fmt: skip

    @staticmethod
    def _stands(on: int) -> int:
        return WORLD if on == LEDGE else fixed(on)
