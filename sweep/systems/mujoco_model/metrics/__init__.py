"""Metrics that only user MuJoCo models have; each module is one, and new modules are found automatically.

Those of `sweep.core.shared_metrics` exist for models as well. Their causes do not: a scenario defines its own.
"""

from sweep.core import shared_metrics
from sweep.core.metric import Cause, Metric, find_metrics

MODEL_METRICS = find_metrics(__name__)
METRICS: tuple[Metric, ...] = (*shared_metrics.METRICS.values(), *MODEL_METRICS.values())
# every model has them; those of invalidity decide before others
CAUSES: tuple[Cause, ...] = tuple(
    sorted((cause for metric in MODEL_METRICS.values() for cause in metric.causes), key=lambda cause: not cause.invalid)
)
