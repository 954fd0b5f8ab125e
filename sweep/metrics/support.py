"""Whether the mass centre is over the feet that carry."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.core.constants import LOADED
from sweep.metrics.geometry import support_margin
from sweep.metrics.metric import BRIEF, Begin, Elapsed, Metric, Moment


class Stability(NamedTuple):
    """Averaged normal forces of the feet (N), and the least margin so far (m)."""

    load: Float[Array, " 6"]
    margin: Float[Array, ""]


def begin(start: Begin) -> Stability:
    """The metric where all feet carry."""
    dtype = start.feet.dtype
    return Stability(jnp.full(6, 2 * LOADED, dtype), jnp.full((), jnp.inf, dtype))


def update(so_far: Stability, now: Moment) -> Stability:
    """Seen from above, the distance of the mass centre to the border of the feet that carry."""
    tick = now.tick
    load = so_far.load + min(1.0, now.period / BRIEF) * (tick.normal - so_far.load)
    margin = support_margin(tick.joints[:, -1, :2], load > LOADED, tick.centre_of_mass[:2])
    return Stability(load, jnp.minimum(so_far.margin, margin))


def figures(found: Stability, at: Elapsed) -> dict[str, Array]:
    """The least margin of the mass centre."""
    return {"stability_margin_min_m": found.margin}


METRIC = Metric(
    begin,
    update,
    figures,
    {
        "stability_margin_min_m": "least distance of the centre of mass, seen from above, to the border of the convex "
        "hull of the feet that carry load (5 N over 50 ms), negative outside"
    },
)
