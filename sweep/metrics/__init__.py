"""Metrics of the robot, and the causes of failure that follow from them.

Each module of this folder that defines a `METRIC` is one metric; a new one is found by itself. Some extend a metric of
`sweep.core.shared_metrics`, which is not computed twice.
"""

from sweep.core import shared_metrics
from sweep.core.metric import Cause, Metric, find_metrics, select_metrics
from sweep.models.case import Case

CAUSE_ORDER = (
    "progress",
    "attitude",
    "rest",
    "slip",
    "depth",
    "reach",
    "replanning",
    "shins",
    "clearance",
    "planned_forces",
    "free_bodies",
    "raft",
    "ledges",
    "two_balls",
    "drives",
    "footholds",
    "landing",
    "edges",
    "support",
    "load",
    "calibration",
    "calibration_poses",
    "touch",
    "solver",
)  # of causes at the same time the first decides; a new module comes after these
NON_METRIC_MODULES = "accumulator", "outcome", "tick"  # modules that are no metric
AVAILABLE_PARTS = "base", "hinges", "hinge_drives", "feet"  # of what shared metrics need
# shared metrics that the robot leaves out: each would enlarge its GPU kernels
OMITTED_SHARED_METRICS = "base_height", "path_length"

HEXAPOD_METRICS = find_metrics(__name__, CAUSE_ORDER, NON_METRIC_MODULES)
_KNOWN = {column for metric in HEXAPOD_METRICS.values() for column in metric.columns}
_SHARED = {
    name: metric
    for name, metric in shared_metrics.METRICS.items()
    if name not in OMITTED_SHARED_METRICS and not _KNOWN & {*metric.columns}
}
METRICS: tuple[Metric, ...] = (*HEXAPOD_METRICS.values(), *_SHARED.values())
CAUSES: tuple[Cause, ...] = tuple(cause for metric in METRICS for cause in metric.causes)


def applicable_metrics(case: Case) -> tuple[Metric, ...]:
    """Select the metrics that apply to this kind of obstacle and manoeuvre, whatever their numeric values."""
    return select_metrics(METRICS, AVAILABLE_PARTS, case)
