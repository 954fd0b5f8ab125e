"""Slip: distance of loaded feet from the points where they touched down."""

from typing import NamedTuple

from sweep.core.metric import Array, CommonStart, CommonTick, Metric, TouchdownPoints, array_namespace


class SlipState(NamedTuple):
    """State of the slip metric: touchdown points of the feet, and the largest slip so far (m)."""

    touchdown_points: TouchdownPoints
    largest_slip: Array


def begin(start: CommonStart) -> SlipState:
    """Return the initial state, in which no foot is loaded."""
    return SlipState(start.init_touchdown_points(), start.constant_state(0.0))


def update(state: SlipState, ctx: CommonTick) -> SlipState:
    """Update the touchdown points and the largest slip (m)."""
    holds, slips = state.touchdown_points.update(ctx)
    xp = array_namespace(slips)
    return SlipState(holds, xp.maximum(state.largest_slip, xp.max(slips, axis=-1)))


METRIC = Metric(
    begin,
    update,
    lambda state, rollout: {"slip_max_m": state.largest_slip},
    {"slip_max_m": "largest slip of a loaded foot from where it took hold"},
    needs=("feet",),
)
