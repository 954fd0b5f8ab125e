"""Where free bodies are, from noisy measurements of their pose and velocity."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from sweep.core.rotations import conjugate, exponential, logarithm, multiply
from sweep.models.obstacles.surface import FreeState


class Observer(NamedTuple):
    """Two filters in a row: after one alone, feet that stand on a body would still change speed at every tick."""

    first: FreeState
    second: FreeState


def followed(observer: Observer, seen: FreeState, time: Array | float, period: float) -> Observer:
    """The poses a control tick of `period` (s) on: complementary filters.

    They go on with the measured velocities and are drawn to the measured poses, each with half of the time constant
    `time` (s), so that steady motion is followed without lag. With 0 s they are the measured ones.
    """
    first = _drawn(observer.first, seen, time / 2, period)
    return Observer(first, _drawn(observer.second, first, time / 2, period))


def _drawn(estimate: FreeState, to: FreeState, time: Array | float, period: float) -> FreeState:
    share = period / jnp.maximum(time, period)
    position = estimate.position + period * to.velocity
    quat = multiply(exponential(period * to.turn), estimate.quat)
    off = logarithm(multiply(to.quat, conjugate(quat)))
    quat = multiply(exponential(share * off), quat)
    # rounded products of thousands of ticks lose their length, and with it the feet that stand on the body their place
    quat = quat / jnp.linalg.norm(quat, axis=-1, keepdims=True)
    return to._replace(position=position + share * (to.position - position), quat=quat)
