"""Duration of the rollout."""

from sweep.core.metric import end_metric

METRIC = end_metric(lambda state, rollout: {"duration_s": rollout.time}, {"duration_s": "simulated time"})
