"""Drift of the robot at rest after its plan, observed for `REST` seconds if the manoeuvre ends at rest."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sweep.core.metric import Cause, Metric
from sweep.core.rotations import matrix
from sweep.metrics.tick import REST_DURATION_S, MetricContext, RolloutStart


class PostPlanDrift(NamedTuple):
    """State of the rest metric: positions (m) of hips, knees and feet when the plan ended, and largest drift since."""

    has_plan_ended: Bool[Array, ""]
    plan_end_positions: Float[Array, "6 k 3"]  # in the axes of the base as it is told to be
    largest_drift: Float[Array, ""]


def begin(start: RolloutStart) -> PostPlanDrift:
    """Return the state of the rest metric while the plan still runs: no drift."""
    links = 3 if start.world.robot.legs == "two_link" else 4
    zero = jnp.zeros((), start.feet.dtype)
    return PostPlanDrift(jnp.asarray(False), jnp.zeros((6, links, 3), zero.dtype), zero)


def update(state: PostPlanDrift, ctx: MetricContext) -> PostPlanDrift:
    """Update how far hips, knees and feet have drifted since the plan ended, relative to the base's reference pose."""
    here = (ctx.report.joints - ctx.target.position) @ matrix(ctx.target.quat)
    place = jnp.where(state.has_plan_ended, state.plan_end_positions, here)
    drift = jnp.where(ctx.finished, jnp.max(jnp.linalg.norm(here - place, axis=-1)), 0.0)
    return PostPlanDrift(ctx.finished, place, jnp.maximum(state.largest_drift, drift))


METRIC = Metric(
    begin,
    update,
    lambda state, rollout: {"end_drift_m": state.largest_drift},
    {
        "end_drift_m": f"largest motion of a hip, knee or foot in the {REST_DURATION_S:g} s after the plan, "
        "relative to the "
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
