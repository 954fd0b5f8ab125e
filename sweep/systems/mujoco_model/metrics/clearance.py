"""Height of the base above the terrain."""

from collections.abc import Iterator

from sweep.core.metric import Array, array_namespace, make_extremes_metric
from sweep.systems.mujoco_model.tick import ModelTick


def least_base_clearance(ctx: ModelTick) -> Iterator[Array]:
    """Return the least height of the base's origin above the ground straight below it (m)."""
    height = ctx.base_position[..., 2] - ctx.ground_height
    yield array_namespace(height).min(height, axis=-1)


METRIC = make_extremes_metric(
    least_base_clearance,
    {"base_clearance_min_m": "least height of the base above the terrain straight below it"},
    needs=("base", "terrain"),
)
