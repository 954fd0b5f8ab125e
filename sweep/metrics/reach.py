"""Whether feet can be where they are told to be."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.metrics.metric import Begin, Cause, Elapsed, Metric, Moment


def begin(start: Begin) -> Float[Array, ""]:
    """Nothing is out of reach."""
    return jnp.zeros((), start.feet.dtype)


def update(so_far: Float[Array, ""], now: Moment) -> Float[Array, ""]:
    """Distance by which the farthest foot target lies beyond its leg (m)."""
    return jnp.maximum(so_far, now.shortfall)


def figures(found: Float[Array, ""], at: Elapsed) -> dict[str, Array]:
    """See `METRIC`."""
    return {"reach_shortfall_max_m": found}


METRIC = Metric(
    begin,
    update,
    figures,
    {"reach_shortfall_max_m": "largest distance of a foot target beyond its leg's reach"},
    (
        Cause(
            "unreachable",
            "a foot target was out of the leg's reach by more than reach_shortfall_max_m",
            "reach_shortfall_max_m",
            "reach_shortfall_max_m",
            5e-3,
            "m",
        ),
    ),
)
