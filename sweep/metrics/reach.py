"""Whether feet can be where they are told to be."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.metrics.metric import Begin, Cause, Elapsed, Metric, Moment


class Reach(NamedTuple):
    """Distance by which the farthest foot target lies beyond its leg, and what legs could still stretch or fold (m)."""

    shortfall: Float[Array, ""]
    left: Float[Array, ""]


def begin(start: Begin) -> Reach:
    """Nothing is out of reach."""
    dtype = start.feet.dtype
    return Reach(jnp.zeros((), dtype), jnp.full((), jnp.inf, dtype))


def update(so_far: Reach, now: Moment) -> Reach:
    """Of the farthest foot target, and of the legs as they are."""
    robot, leg = now.world.robot, now.tick.joints
    stretch = jnp.linalg.norm(leg[:, -1] - leg[:, -3], axis=-1)
    left = jnp.minimum(robot.thigh + robot.shin - stretch, stretch - jnp.abs(robot.thigh - robot.shin))
    return Reach(jnp.maximum(so_far.shortfall, now.shortfall), jnp.minimum(so_far.left, jnp.min(left) - now.shortfall))


def figures(found: Reach, at: Elapsed) -> dict[str, Array]:
    """The worst foot so far, beyond its reach or within it."""
    return {"reach_shortfall_max_m": found.shortfall, "reach_reserve_min_m": found.left}


METRIC = Metric(
    begin,
    update,
    figures,
    {
        "reach_shortfall_max_m": "largest distance of a foot target beyond its leg's reach",
        "reach_reserve_min_m": "least length by which a leg could be longer or shorter, the former taken off",
    },
    (
        Cause(
            "unreachable",
            "a foot target was out of the leg's reach by more than reach_shortfall_max_m",
            "reach_shortfall_max_m",
            5e-3,
        ),
    ),
)
