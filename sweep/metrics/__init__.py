"""Metrics of a rollout, and the causes of failure that follow from them."""

from sweep.metrics import (
    attitude,
    calibration,
    calibration_poses,
    clearance,
    depth,
    drives,
    edges,
    footholds,
    free_bodies,
    landing,
    ledges,
    load,
    planned_forces,
    progress,
    raft,
    reach,
    replanning,
    rest,
    shins,
    slip,
    solver,
    support,
    touch,
    two_balls,
)
from sweep.metrics.metric import Cause, Metric
from sweep.models.case import Case

METRICS: tuple[Metric, ...] = tuple(
    module.METRIC
    for module in (
        progress,
        attitude,
        rest,
        slip,
        depth,
        reach,
        replanning,
        shins,
        clearance,
        planned_forces,
        free_bodies,
        raft,
        ledges,
        two_balls,
        drives,
        footholds,
        landing,
        edges,
        support,
        load,
        calibration,
        calibration_poses,
        touch,
        solver,
    )
)
CAUSES: tuple[Cause, ...] = tuple(cause for metric in METRICS for cause in metric.causes)


def applicable_metrics(case: Case) -> tuple[Metric, ...]:
    """Select the metrics that apply to a kind of world; numbers of the world do not matter."""
    return tuple(metric for metric in METRICS if metric.applies(case))
