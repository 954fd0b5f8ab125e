"""Metrics that are computed for every system, from what all of them report; see `sweep.core.metric.CommonTick`.

Each module is one metric. A new module is found by itself: its columns exist for every system that has the parts which
the metric `needs`.
"""

from sweep.core.metric import find_metrics

METRICS = find_metrics(__name__)
