"""Length of the path of the base."""

from typing import NamedTuple

from sweep.core.metric import Array, CommonStart, CommonTick, Metric, array_namespace


class PathLengthState(NamedTuple):
    """State of the path-length metric: current position of the base, and the length of its path so far (m)."""

    position: Array
    length: Array


def begin(start: CommonStart) -> PathLengthState:
    """Return the initial state: the base at its start, with a path of length 0."""
    return PathLengthState(start.base_position, start.constant_state(0.0))


def update(state: PathLengthState, ctx: CommonTick) -> PathLengthState:
    """Add the distances between successive positions of the base to the path length."""
    samples = ctx.base_position
    xp = array_namespace(samples)
    steps = samples - xp.concatenate([state.position[..., None, :], samples[..., :-1, :]], axis=-2)
    return PathLengthState(samples[..., -1, :], state.length + xp.linalg.norm(steps, axis=-1).sum(axis=-1))


METRIC = Metric(
    begin,
    update,
    lambda state, rollout: {"path_length_m": state.length},
    {"path_length_m": "length of the path of the base, sway included"},
    needs=("base",),
)
