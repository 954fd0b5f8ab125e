"""Cost of transport: work over weight times distance."""

from sweep.core.metric import Array, CommonRollout, array_namespace, make_end_metric


def compute(state: tuple[()], rollout: CommonRollout) -> dict[str, Array]:
    """Compute the cost of transport, work over weight times distance, from the work and distance metrics."""
    way = rollout.columns["travelled_m"]
    xp = array_namespace(way)
    return {"cost_of_transport": rollout.columns["energy_j"] / (rollout.weight * xp.maximum(xp.abs(way), 1e-9))}


METRIC = make_end_metric(
    compute,
    {"cost_of_transport": "positive work of the drives over weight and way along the commanded direction"},
    reads=("travelled_m", "energy_j"),
)
