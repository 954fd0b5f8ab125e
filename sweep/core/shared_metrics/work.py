"""Work of the drives."""

from sweep.core.metric import Array, CommonRollout, CommonTick, Metric, make_begin_with_constants


def update(state: Array, ctx: CommonTick) -> Array:
    """Add the drives' positive work since the previous report."""
    return state + ctx.positive_work


def compute(state: Array, rollout: CommonRollout) -> dict[str, Array]:
    """Return the positive work of the drives (J), by column."""
    return {"energy_j": rollout.integrate_sum(state)}


METRIC = Metric(
    make_begin_with_constants(lambda work: work, 0.0), update, compute, {"energy_j": "positive work of the drives"}
)
