"""Height of the base."""

from collections.abc import Iterator

from sweep.core.metric import Array, CommonTick, array_namespace, make_extremes_metric


def least_height(ctx: CommonTick) -> Iterator[Array]:
    """Yield the smallest height (m) of the base's origin above the world's origin since the previous report."""
    height = ctx.base_position[..., 2]
    yield array_namespace(height).min(height, axis=-1)


METRIC = make_extremes_metric(
    least_height, {"base_height_min_m": "least height of the base in world axes"}, needs=("base",)
)
