"""Whether what the robot has learned leaves it a plan."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.metrics.metric import Begin, Cause, Elapsed, Metric, Moment


def begin(start: Begin) -> Float[Array, ""]:
    """No lack of reach: it starts with a plan."""
    return jnp.zeros((), start.feet.dtype)


def update(so_far: Float[Array, ""], now: Moment) -> Float[Array, ""]:
    """Distance by which the newest plan leaves the legs' reach (m)."""
    assert now.learned is not None
    assert now.learned.shortfall is not None  # since it applies
    return jnp.maximum(so_far, now.learned.shortfall)


def figures(found: Float[Array, ""], at: Elapsed) -> dict[str, Array]:
    """See `METRIC`."""
    return {"replanned_shortfall_max_m": found}


METRIC = Metric(
    begin,
    update,
    figures,
    {"replanned_shortfall_max_m": "largest distance beyond a leg's reach of a foothold planned again; inf: no plan"},
    (
        Cause(
            "no_plan",
            "what was learned left no plan within the legs' reach, by replanned_shortfall_max_m",
            "replanned_shortfall_max_m",
            5e-3,
        ),
    ),
    applies=lambda case: case.control.replan != "never",
)
