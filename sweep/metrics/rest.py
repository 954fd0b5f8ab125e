"""Rest of the robot after its plan: it is observed for `REST` seconds more, if the manoeuvre ends at rest."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sweep.core.metric import Cause, Metric
from sweep.core.rotations import matrix
from sweep.metrics.tick import REST, MetricTick, RolloutStart


class Resting(NamedTuple):
    """Positions of hips, knees and feet at the end of the plan (m), and their largest displacement since."""

    ended: Bool[Array, ""]
    place: Float[Array, "6 k 3"]  # in the axes of the base as it is told to be
    drift: Float[Array, ""]


def begin(start: RolloutStart) -> Resting:
    """Initial state, before the plan has ended."""
    links = 3 if start.world.robot.legs == "two_link" else 4
    zero = jnp.zeros((), start.feet.dtype)
    return Resting(jnp.asarray(False), jnp.zeros((6, links, 3), zero.dtype), zero)


def update(state: Resting, ctx: MetricTick) -> Resting:
    """Update displacements relative to the base's reference: a robot at rest on a moving body is at rest."""
    here = (ctx.tick.joints - ctx.target.position) @ matrix(ctx.target.quat)
    place = jnp.where(state.ended, state.place, here)
    drift = jnp.where(ctx.finished, jnp.max(jnp.linalg.norm(here - place, axis=-1)), 0.0)
    return Resting(ctx.finished, place, jnp.maximum(state.drift, drift))


METRIC = Metric(
    begin,
    update,
    lambda state, rollout: {"end_drift_m": state.drift},
    {
        "end_drift_m": f"largest motion of a hip, knee or foot in the {REST:g} s after the plan, relative to the "
        "reference of the base"
    },
    (
        Cause(
            "restless",
            "the robot was not at rest after its plan: some part moved by more than end_drift_max_m",
            "end_drift_m",
            5e-3,
        ),
    ),
)
