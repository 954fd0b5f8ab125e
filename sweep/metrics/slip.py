"""Slip: distance of loaded feet from the points where they touched down."""

from sweep.core.metric import Cause, PrecursorMetric
from sweep.core.shared_metrics import slip
from sweep.models.case import Case
from sweep.models.obstacles.ball import Ball
from sweep.models.obstacles.raft import Raft


def slip_threshold(case: Case) -> float:
    """Return the default slip threshold (m) on an obstacle: half the distance after which a foot would lose its hold.

    Rungs are 40 mm wide. On a ball plans have footholds at up to 37.8 degrees, and friction 1 holds up to 45 degrees,
    106 mm farther. Footholds keep 105 mm from the edges of raft and banks.
    """
    return 0.05 if isinstance(case.obstacle, Ball | Raft) else 0.02


METRIC = slip.METRIC._replace(
    causes=(
        Cause(
            "slipped",
            "a standing foot slipped by more than slip_max_m",
            "slip_max_m",
            None,
            lead=PrecursorMetric("edge_reserve_min_m", 0.02),
            default_for=slip_threshold,
        ),
    ),
)
