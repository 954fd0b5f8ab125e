"""Gaits: which legs swing together and in which order, and the regular steps that follow from it (monograph 1.3)."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.controllers.plan import CYCLE_A, Stage
from sweep.formulas import stepping
from sweep.models.legs import LEGS
from sweep.models.posture import Stance

TRIPOD = ((1, 4, 5), (2, 3, 6))
GALLOP = FRONT, MIDDLE, REAR = (5, 6), (3, 4), (1, 2)  # order as in the text of 1.3; used for climbing poles
# As the printed phase shifts have it: the rear pair before the middle one. On level ground this order is right: the
# middle feet then stand ahead of the mass centre while the front pair swings, and behind it while the rear pair does.
# In the order of the text the robot tips onto the swinging pair.
LEVEL_GALLOP = ((5, 6), (1, 2), (3, 4))
MODIFIED_GALLOP = ((5, 6), (3, 4), (1, 2), (3, 4))  # middle legs twice as often, near the pair that swings next
GAITS = {"tripod": TRIPOD, "gallop": GALLOP, "level_gallop": LEVEL_GALLOP, "modified_gallop": MODIFIED_GALLOP}
MEANINGS = {  # of gaits, in a line each
    "tripod": "legs 1, 4, 5 swing together, then 2, 3, 6",
    "gallop": "pairs swing in the order front, middle, rear, as on poles; on level ground the robot tips and slips",
    "level_gallop": "pairs swing in the order front, rear, middle: the gallop that is stable on level ground",
    "modified_gallop": "pairs swing in the order front, middle, rear, middle; it slips on level ground, too",
}


class GaitStep(NamedTuple):
    """Half length, lift and duration of a swing in a regular gait."""

    half_length: Array | float  # m, d_x
    height: Array | float  # m, d_y
    time: Array | float  # s, t*

    @classmethod
    def from_ratios(
        cls, unit: Array | float, half: Array | float, lift: Array | float, rate: Array | float
    ) -> "GaitStep":
        """Make a step whose length and lift are given as ratios to the length `unit` (m).

        Args:
            unit: length (m) that the ratios refer to.
            half: half the step length over `unit`.
            lift: height of the swing over `unit`.
            rate: rate varpi (rad/s) of the swing, which gives its time t*.
        """
        return cls(half * unit, lift * unit, stepping.swing_time(rate))

    @property
    def half_swing_length(self) -> Array | float:
        """Half length x* (m) of a swing: a foot moves from -x* to x* about the centre of its cycle."""
        return self.half_length * stepping.LANDING_RATIO


def body_advance_per_swing(gait: Sequence[Sequence[int]], step: GaitStep) -> Array | float:
    """Return how far (m) the body moves during one swing of a gait.

    For the tripod 2 x*, so that v_o = k' x*/t* with k' = 2; for the gallop x*.

    Args:
        gait: legs that swing together, in order.
        step: the regular step.
    """
    return 2 * step.half_swing_length / (len(gait) - 1)


def initial_foot_offsets(
    gait: Sequence[Sequence[int]], step: GaitStep, forward: Float[Array, " 3"]
) -> Float[Array, "6 3"]:
    """Return the feet at the start, (6, 3) in m, relative to the centres of their gait cycles.

    A leg that swings at turns p, p' of n lands ahead of its centre by half of what the body covers during its stance,
    so that the stance is symmetric about the centre.

    Args:
        gait: legs that swing together, in order.
        step: the regular step.
        forward: unit vector of the walking direction.
    """
    advance = body_advance_per_swing(gait, step)
    return jnp.stack([(_turns(gait, leg)[0] * advance - _half_stance(gait, leg) * advance) * forward for leg in LEGS])


def _turns(gait: Sequence[Sequence[int]], leg: int) -> list[int]:
    return [turn for turn, legs in enumerate(gait) if leg in legs]


def _half_stance(gait: Sequence[Sequence[int]], leg: int) -> float:
    return (len(gait) / len(_turns(gait, leg)) - 1) / 2


def regular_gait_stages(
    gait: Sequence[Sequence[int]],
    step: GaitStep,
    start: Stance,
    centres: Array,
    forward: Array,
    count: int,
    deepening: Array | float,
) -> list[Stage]:
    """Return the stages of a regular gait on level ground, with the base moving on evenly.

    Each foot lands half of its stance ahead of the centre of its cycle.

    Args:
        gait: legs that swing together, in order.
        step: the regular step.
        start: stance before the first swing.
        centres: centres of the feet's cycles relative to the base (m), (6, 3).
        forward: unit vector of the walking direction.
        count: number of swings.
        deepening: depth (m) of footholds below the ground.
    """
    advance = body_advance_per_swing(gait, step)
    position = start.position
    down = jnp.array([0.0, 0.0, -1.0]) * deepening
    stages = []
    for k in range(count):
        legs = gait[k % len(gait)]
        position = position + advance * forward
        landing = {}
        for leg in legs:
            landing[leg] = position + centres[leg - 1] + _half_stance(gait, leg) * advance * forward + down
        stance = _half_stance(gait, legs[0]) * 2
        carry = 1 / (1 + stance)
        name = f"{k // len(gait) + 1}.{'-'.join(map(str, legs))}"
        stages.append(Stage(name, step.time, landing, CYCLE_A, step.height, (0.0, 0.0, 1.0), carry, position))
    return stages
