"""Programmed support: how free bodies are meant to move during a stage, where feet do not just follow them as seen."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int

# a body is: where it is seen; going over to a velocity; going to a pose; rolling along with the others; held where it
# was meant to be when the stage before ended; one that floats: going to a pose, but along the world's y axis and in
# height where it is
MEASURED, TO_VELOCITY, TO_POSE, TOGETHER, KEPT, ALONGSIDE = range(6)
STILL, LEVEL = np.zeros(3, np.float32), np.array([1, 0, 0, 0], np.float32)


class Support(NamedTuple):
    """How a free body is meant to move from where it is seen when a stage begins; of a plan, over S stages, k bodies.

    To the velocity (with its rate of turning) that it has at the stage's end, at constant acceleration: monograph
    (3.3.5), also to rest. Not from one into the floor: a body that chatters on it falls for a step now and then, and
    would be meant to go on and sink by millimetres. To a pose, spent by lambda_1. Together: as the mean of all bodies
    has moved and turned. Kept: not from where it is seen, so that it is pulled back there.
    """

    mode: Int[Array, "*b"] | int = MEASURED
    velocity: Float[Array, "*b 3"] | np.ndarray = STILL  # m/s
    turn: Float[Array, "*b 3"] | np.ndarray = STILL  # rad/s
    position: Float[Array, "*b 3"] | np.ndarray = STILL  # m
    quat: Float[Array, "*b 4"] | np.ndarray = LEVEL


RESTS, STAYS = Support(TO_VELOCITY), Support(KEPT)
