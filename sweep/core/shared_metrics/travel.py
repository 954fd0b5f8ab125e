"""How far and how fast the base moves."""

from typing import NamedTuple

from sweep.core.metric import Array, CommonRollout, CommonStart, CommonTick, Metric, array_namespace


class TravelState(NamedTuple):
    """State of the travel metrics: start and current position of the base (m), displacement along the command (m), time
    of motion (s).

    The way is None where the direction never changes: it follows from the two positions, without a sum's rounding.
    """

    start_position: Array
    position: Array
    command_displacement: Array | None
    motion_time: Array


def begin(start: CommonStart) -> TravelState:
    """Return the initial state: the base at its start, without displacement."""
    zero = start.constant_state(0.0)
    return TravelState(start.base_position, start.base_position, zero if start.command_direction_varies else None, zero)


def update(state: TravelState, ctx: CommonTick) -> TravelState:
    """Update the base's position, and add its displacement along the commanded direction."""
    way, moving = ctx.motion_along_command(state.position)
    total = None if state.command_displacement is None else state.command_displacement + way
    return TravelState(state.start_position, ctx.base_position[..., -1, :], total, state.motion_time + moving)


def compute(state: TravelState, rollout: CommonRollout) -> dict[str, Array]:
    """Return the distances that the base covered (m), and its mean speed (m/s), by column."""
    between = state.position - state.start_position
    xp = array_namespace(between)
    way = (
        rollout.displacement_along_command(between)
        if state.command_displacement is None
        else state.command_displacement
    )
    return {
        "distance_m": xp.linalg.norm(between[..., :2], axis=-1),
        "travelled_m": way,
        "speed_mps": way / xp.maximum(rollout.integrate_sum(state.motion_time), 1e-9),
    }


METRIC = Metric(
    begin,
    update,
    compute,
    {
        "distance_m": "horizontal distance between the first and last position of the base",
        "travelled_m": "way of the base along the commanded direction",
        "speed_mps": "mean speed along the commanded direction while the command moves the base",
    },
    needs=("base",),
)
