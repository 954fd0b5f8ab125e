"""Speed of the joints."""

from collections.abc import Iterator

from sweep.core.metric import Array, CommonTick, array_namespace, make_extremes_metric


def largest_rate(ctx: CommonTick) -> Iterator[Array]:
    """Return the largest rate (rad/s) of any joint since the previous report."""
    rates = ctx.joint_rates
    xp = array_namespace(rates)
    yield xp.max(xp.abs(rates), axis=(-2, -1))


METRIC = make_extremes_metric(
    largest_rate, {"joint_speed_max_radps": "largest rate of a hinge joint"}, needs=("hinges",)
)
