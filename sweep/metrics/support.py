"""Static stability: position of the mass centre over the support polygon."""

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.core.constants import LOADED
from sweep.core.metric import Metric, initial_state
from sweep.metrics.tick import BRIEF, MetricTick
from sweep.models.geometry import support_margin


class Stability(NamedTuple):
    """Filtered normal forces of the feet (N), and the least margin so far (m)."""

    load: Float[Array, " 6"]
    margin: Float[Array, ""]


def update(state: Stability, ctx: MetricTick) -> Stability:
    """Update the distance of the mass centre, seen from above, to the border of the support polygon."""
    tick = ctx.tick
    load = state.load + min(1.0, ctx.period / BRIEF) * (tick.normal - state.load)
    margin = support_margin(tick.joints[:, -1, :2], load > LOADED, tick.centre_of_mass[:2])
    return Stability(load, jnp.minimum(state.margin, margin))


METRIC = Metric(
    initial_state(Stability, np.full(6, 2 * LOADED), math.inf),  # all feet carry
    update,
    lambda state, rollout: {"stability_margin_min_m": state.margin},
    {
        "stability_margin_min_m": "least distance of the centre of mass, seen from above, to the border of the convex "
        "hull of the feet that carry load (5 N over 50 ms), negative outside"
    },
)
