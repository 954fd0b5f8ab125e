"""Slip: distance of loaded feet from the points where they touched down."""

from typing import NamedTuple

from sweep.core.metric import Array, CommonStart, CommonTick, FootHolds, Metric, array_namespace


class Slip(NamedTuple):
    """Touchdown points of the feet, and the largest slip so far (m)."""

    holds: FootHolds
    largest: Array


def begin(start: CommonStart) -> Slip:
    """Return the initial state, in which no foot is loaded."""
    return Slip(start.foot_holds(), start.constant(0.0))


def update(state: Slip, ctx: CommonTick) -> Slip:
    """Update the touchdown points and the largest slip (m)."""
    holds, slips = state.holds.update(ctx)
    xp = array_namespace(slips)
    return Slip(holds, xp.maximum(state.largest, xp.max(slips, axis=-1)))


METRIC = Metric(
    begin,
    update,
    lambda state, rollout: {"slip_max_m": state.largest},
    {"slip_max_m": "largest slip of a loaded foot from where it took hold"},
    needs=("feet",),
)
