"""Metrics of a faultless rollout, from the metrics' own declarations."""

import numpy as np

from sweep.metrics import METRICS, applicable_metrics
from sweep.metrics.outcome import BOOKKEEPING_COLUMNS


def faultless(case=None):
    """Return a number for each column; those of rollouts on a free body too if no case is given."""
    metrics = METRICS if case is None else applicable_metrics(case)
    good = {name: 0.0 for metric in metrics for name in metric.columns}
    for cause in (cause for metric in metrics for cause in metric.causes):
        good[cause.metric] = 100.0 if cause.below else 0.0
        if cause.lead:
            good[cause.lead.metric] = 100.0
        if cause.known_at == "tick":
            good |= {f"{cause.name}_time_s": np.nan, f"{cause.name}_stage": -1.0}
    assert {name for name in good if name in BOOKKEEPING_COLUMNS} >= {"fell_time_s", "fell_stage"}
    return good | {"finished": 1.0, "finite": 1.0, "progress": 1.0, "feet_on_target": 6.0}
