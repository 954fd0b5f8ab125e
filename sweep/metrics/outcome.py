"""From a row's figures to its outcome: success, failure with a cause, or invalid."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sweep.parameters import parameters, quantity


@parameters
class Thresholds:
    """When a rollout counts as failed or as not to be trusted."""

    tilt_max_deg: float = quantity(20.0, "deg", above=0)
    slip_max_m: float = quantity(np.inf, "m", at_least=0)
    clearance_min_m: float = quantity(-5e-3, "m")
    leg_gap_min_m: float = quantity(-5e-3, "m")
    reach_shortfall_max_m: float = quantity(5e-3, "m", at_least=0)
    saturation_share_max: float = quantity(1.0, "-", at_least=0, at_most=1)
    progress_min: float = quantity(0.9, "-")
    heading_error_max_deg: float = quantity(5.0, "deg", above=0)
    solver_residual_max_n: float = quantity(100.0, "N", above=0)
    energy_gain_max_j: float = quantity(1.0, "J", above=0)
