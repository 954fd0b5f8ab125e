"""Duration of the rollout."""

from sweep.core.metric import Metric, initial_state

METRIC = Metric(
    initial_state(lambda: ()),
    lambda state, ctx: state,
    lambda state, rollout: {"duration_s": rollout.time},
    {"duration_s": "simulated time"},
)
