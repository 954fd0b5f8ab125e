"""Slip: distance of loaded feet from where they took hold."""

from typing import NamedTuple

from sweep.core.metric import Array, CommonStart, CommonTick, FootHolds, Metric, array_namespace


class Slip(NamedTuple):
    """Where feet hold, and the largest slip so far (m)."""

    holds: FootHolds
    largest: Array


def begin(start: CommonStart) -> Slip:
    """Initial state; no foot is loaded yet."""
    return Slip(start.foot_holds(), start.constant(0.0))


def update(state: Slip, ctx: CommonTick) -> Slip:
    """Update the largest slip."""
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
