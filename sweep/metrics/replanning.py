"""Reach of the newest plan, after the robot has learned sizes."""

from collections.abc import Iterator

from jaxtyping import Array, Float

from sweep.core.metric import Cause, make_extremes_metric
from sweep.metrics.tick import MetricContext


def plan_reach_shortfall(ctx: MetricContext) -> Iterator[Float[Array, ""]]:
    """Yield by how much (m) the farthest foothold of the newest plan is beyond a leg's reach."""
    assert ctx.learned.shortfall is not None  # since it applies
    yield ctx.learned.shortfall


METRIC = make_extremes_metric(
    plan_reach_shortfall,
    {"replanned_shortfall_max_m": "largest distance beyond a leg's reach of a foothold planned again; inf: no plan"},
    (
        Cause(
            "no_plan",
            "replanning found no plan within the legs' reach, by replanned_shortfall_max_m",
            "replanned_shortfall_max_m",
            5e-3,
        ),
    ),
    applies=lambda case: case.control.replan != "never",
)
