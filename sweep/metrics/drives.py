"""What the drives do: torques, how long they are at their limit, their work."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.metrics.metric import Begin, Cause, Elapsed, Metric, Moment

JOINTS = ("alpha", "beta", "gamma")


class Drives(NamedTuple):
    """By kind of joint the largest torque (N m) and the time at the limit (s); the positive work (J)."""

    torque: Float[Array, " 3"]
    saturated: Float[Array, " 3"]
    effort: Float[Array, ""]


def begin(start: Begin) -> Drives:
    """At rest."""
    zero = jnp.zeros((), start.feet.dtype)
    three = jnp.zeros(3, start.feet.dtype)
    return Drives(three, three, zero)


def update(so_far: Drives, now: Moment) -> Drives:
    """Peaks over the legs, shares averaged over them."""
    tick = now.tick
    return Drives(
        jnp.maximum(so_far.torque, jnp.max(tick.torque_peak, axis=0)),
        so_far.saturated + now.period * jnp.mean(tick.saturated, axis=0),
        so_far.effort + tick.effort,
    )


def figures(found: Drives, at: Elapsed) -> dict[str, Array]:
    """See `METRIC`."""
    share = found.saturated / jnp.maximum(at.time, 1e-9)
    torques = {f"torque_peak_{joint}_nm": found.torque[k] for k, joint in enumerate(JOINTS)}
    shares = {f"saturation_share_{joint}": share[k] for k, joint in enumerate(JOINTS)}
    return {"energy_j": found.effort, **torques, **shares, "saturation_share_max": jnp.max(share)}


METRIC = Metric(
    begin,
    update,
    figures,
    {
        "energy_j": "positive work of the drives",
        **{f"torque_peak_{joint}_nm": f"largest torque of a {joint} joint" for joint in JOINTS},
        **{f"saturation_share_{joint}": f"share of time at the torque limit of {joint} joints" for joint in JOINTS},
        "saturation_share_max": "largest of the three",
    },
    (
        Cause(
            "overload",
            "a kind of joint was saturated for more than saturation_share_max of the time",
            "saturation_share_max",
            "saturation_share_max",
            1.0,
            known="end",
        ),
    ),
)
