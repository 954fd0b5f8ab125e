"""Largest load on the feet."""

from collections.abc import Iterator

from sweep.core.metric import make_extremes_metric
from sweep.systems.mujoco_model.tick import Array, ModelTick


def largest_foot_load(ctx: ModelTick) -> Iterator[Array]:
    """Return the largest load (N) on any foot since the previous report."""
    yield ctx.foot_loads.max(axis=(1, 2))


METRIC = make_extremes_metric(largest_foot_load, {"load_max_n": "largest load of a foot"}, needs=("feet",))
