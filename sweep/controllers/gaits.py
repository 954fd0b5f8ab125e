"""Gaits: which legs swing together, in which order, and how the regular step cycles follow from it (monograph 1.3)."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.controllers.frames import Stance
from sweep.controllers.plan import CYCLE_A, Stage
from sweep.formulas import stepping
from sweep.models.legs import LEGS

TRIPOD = ((1, 4, 5), (2, 3, 6))
GALLOP = FRONT, MIDDLE, REAR = (5, 6), (3, 4), (1, 2)  # the order in the text of 1.3, and what climbs a pole
# The printed phase shifts instead take the rear pair before the middle one. On level ground they are the right ones:
# the middle feet then stand ahead of the centre of mass while the front pair swings, and behind it for the rear pair,
# where in the text's order the robot tips onto the swinging pair.
LEVEL_GALLOP = ((5, 6), (1, 2), (3, 4))
MODIFIED_GALLOP = ((5, 6), (3, 4), (1, 2), (3, 4))  # middle legs twice as often, near the pair that swings next
GAITS = {"tripod": TRIPOD, "gallop": GALLOP, "level_gallop": LEVEL_GALLOP, "modified_gallop": MODIFIED_GALLOP}


class Step(NamedTuple):
    """Geometry of the regular step cycle."""

    half_length: Array | float  # m, d_x
    height: Array | float  # m, d_y
    time: Array | float  # s, t*

    @classmethod
    def of(cls, unit: Array | float, half: Array | float, lift: Array | float, rate: Array | float) -> "Step":
        """That of ratios to a `unit` (m): of what a foot moves ahead, by halves, and of how high; at a rate (rad/s)."""
        return cls(half * unit, lift * unit, stepping.swing_time(rate))

    @property
    def landing(self) -> Array | float:
        """x* (m): a foot swings from -x* to x* about its cycle's centre."""
        return self.half_length * stepping.LANDING


def advance(gait: Sequence[Sequence[int]], step: Step) -> Array | float:
    """How far the body goes in t* (m): the front legs' stance of n - 1 swings takes 2 x*.

    Tripod 2 x*, so that v_o = k' x*/t* with k' = 2; gallop x*.
    """
    return 2 * step.landing / (len(gait) - 1)


def centre_offsets(gait: Sequence[Sequence[int]], step: Step, forward: Float[Array, " 3"]) -> Float[Array, "6 3"]:
    """Feet at the start relative to their cycles' centres (m): each as far back as its turn is near.

    A leg that swings at turns p, p' of n lands at half of what the body goes in its stance ahead of the centre, so
    that it stands symmetrically about the centre.
    """
    way = advance(gait, step)
    return jnp.stack([(_turns(gait, leg)[0] * way - _half_stance(gait, leg) * way) * forward for leg in LEGS])


def _turns(gait: Sequence[Sequence[int]], leg: int) -> list[int]:
    return [turn for turn, legs in enumerate(gait) if leg in legs]


def _half_stance(gait: Sequence[Sequence[int]], leg: int) -> float:
    """Half of the turns that a leg stands between two of its swings."""
    return (len(gait) / len(_turns(gait, leg)) - 1) / 2


def regular_steps(
    gait: Sequence[Sequence[int]],
    step: Step,
    start: Stance,
    centres: Array,
    forward: Array,
    count: int,
    deepening: Array | float,
) -> list[Stage]:
    """`count` swings of a regular gait on level ground from `start`, the body going on evenly along `forward`.

    `centres` (6, 3) are the feet's cycle centres under the hips relative to the base. A swing lands where its foot
    will have half of its stance still before the centre, `deepening` (m) below the ground.
    """
    way = advance(gait, step)
    position = start.position
    down = jnp.array([0.0, 0.0, -1.0]) * deepening
    stages = []
    for k in range(count):
        legs = gait[k % len(gait)]
        position = position + way * forward
        landing = {}
        for leg in legs:
            landing[leg] = position + centres[leg - 1] + _half_stance(gait, leg) * way * forward + down
        stance = _half_stance(gait, legs[0]) * 2
        carry = 1 / (1 + stance)  # of the way over ground, the body's own part
        name = f"{k // len(gait) + 1}.{'-'.join(map(str, legs))}"
        stages.append(Stage(name, step.time, landing, CYCLE_A, step.height, (0.0, 0.0, 1.0), carry, position))
    return stages
