"""Static stability: position of the mass centre over the support polygon."""

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.core.constants import FOOT_LOAD_THRESHOLD_N
from sweep.core.metric import Metric, make_begin_with_constants
from sweep.metrics.tick import FORCE_FILTER_TIME_S, MetricContext
from sweep.models.geometry import support_margin


class StabilityMargin(NamedTuple):
    """State of the stability metric: filtered foot loads (N), and least margin (m) to the support polygon's border."""

    filtered_load: Float[Array, " 6"]
    least_margin: Float[Array, ""]


def update(state: StabilityMargin, ctx: MetricContext) -> StabilityMargin:
    """Update the least horizontal distance (m) from the mass centre to the border of the support polygon."""
    tick = ctx.report
    load = state.filtered_load + min(1.0, ctx.period / FORCE_FILTER_TIME_S) * (tick.normal - state.filtered_load)
    margin = support_margin(tick.joints[:, -1, :2], load > FOOT_LOAD_THRESHOLD_N, tick.centre_of_mass[:2])
    return StabilityMargin(load, jnp.minimum(state.least_margin, margin))


METRIC = Metric(
    make_begin_with_constants(StabilityMargin, np.full(6, 2 * FOOT_LOAD_THRESHOLD_N), math.inf),  # all feet carry
    update,
    lambda state, rollout: {"stability_margin_min_m": state.least_margin},
    {
        "stability_margin_min_m": "least distance of the centre of mass, seen from above, to the border of the convex "
        "hull of the feet that carry load (5 N over 50 ms), negative outside"
    },
)
