"""Duration of the rollout."""

from sweep.core.metric import make_end_metric

METRIC = make_end_metric(lambda state, rollout: {"duration_s": rollout.time}, {"duration_s": "simulated time"})
