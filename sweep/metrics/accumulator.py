"""Accumulation of all metrics of a rollout, updated once per control tick from the reports of both engines."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from sweep import metrics
from sweep.controllers.plan import Plan
from sweep.core.metric import Cause, Metric, compute_columns
from sweep.metrics import solver
from sweep.metrics.outcome import OutcomeThresholds, threshold_value
from sweep.metrics.tick import MetricContext, RolloutEnd, RolloutStart
from sweep.models.case import Case

OVERTURNED_TILT_DEG = 60.0  # deg of tilt: nothing after it tells anything of the manoeuvre


class RunningMetrics(NamedTuple):
    """States of all metrics of a rollout, and when each cause of failure first occurred; carried from tick to tick."""

    time: Float[Array, ""]  # s
    time_since_plan_end: Float[Array, ""]  # s, since the plan has ended
    is_over: Bool[Array, ""]  # overturned or not finite: metrics are frozen
    states: tuple[Any, ...]
    cause_time: Float[Array, " c"]  # s, first crossing of each threshold, NaN before
    cause_stage: Int[Array, " c"]


def causes_judged_each_tick(world: Case) -> tuple[Cause, ...]:
    """Return the causes of failure that are checked in every tick, so that their first occurrence gets a time."""
    return tuple(
        cause for metric in metrics.applicable_metrics(world) for cause in metric.causes if cause.known_at == "tick"
    )


def metrics_computed_each_tick(world: Case) -> tuple[str, ...]:
    """Return the names of the metrics that are computed in every tick, since causes of failure are checked by them."""
    causes = causes_judged_each_tick(world)
    there = {name for metric in metrics.applicable_metrics(world) for name in metric.columns}
    return (
        *(c.metric for c in causes),
        *(c.margin_companion_metric for c in causes if c.margin_companion_metric in there),
    )


def begin(start: RolloutStart) -> RunningMetrics:
    """Return the states of all metrics that apply to a rollout, before its first tick."""
    dtype, n = start.plan.duration.dtype, len(causes_judged_each_tick(start.world))
    return RunningMetrics(
        time=jnp.zeros((), dtype),
        time_since_plan_end=jnp.zeros((), dtype),
        is_over=jnp.asarray(False),
        states=tuple(metric.begin(start) for metric in metrics.applicable_metrics(start.world)),
        cause_time=jnp.full(n, jnp.nan, dtype),
        cause_stage=jnp.full(n, -1, jnp.int32),
    )


def set_start_energy(world: Case, running: RunningMetrics, energy: Array) -> RunningMetrics:
    """Return the metric states with the mechanical energy (J) at the start, the reference for growth of energy.

    Args:
        world: The world.
        running: The rollout's metrics.
        energy: Energy at the start (J).
    """
    states = zip(metrics.applicable_metrics(world), running.states, strict=True)
    return running._replace(
        states=tuple(s._replace(start_energy=energy) if metric is solver.METRIC else s for metric, s in states)
    )


def update(
    running: RunningMetrics, ctx: MetricContext, limits: OutcomeThresholds, number: Array
) -> tuple[RunningMetrics, Float[Array, " w"]]:
    """Update the states of all metrics of a rollout after a control tick.

    Args:
        running: The rollout's metrics before the tick.
        ctx: The tick.
        limits: Thresholds; they only decide when the time of a cause is recorded.
        number: Number of the tick, the same for all rollouts; metrics with an interval skip ticks by it.

    Returns:
        The metrics after the tick, and the values (w,) of `metrics_computed_each_tick`.
    """
    world, time = ctx.world, ctx.time
    states = tuple(
        _update_metric(m, s, ctx, number)
        for m, s in zip(metrics.applicable_metrics(world), running.states, strict=True)
    )
    found = _compute_metrics(RolloutEnd(world, ctx.plan, time, ctx.stage), states)
    crossed = [c.holds(found[c.metric], threshold_value(c, limits)) for c in causes_judged_each_tick(world)]
    first = jnp.stack(crossed) & jnp.isnan(running.cause_time)
    new = RunningMetrics(
        time=time,
        time_since_plan_end=running.time_since_plan_end + ctx.period * ctx.finished,
        is_over=(found["tilt_max_deg"] > OVERTURNED_TILT_DEG) | ~found["finite"],
        states=states,
        cause_time=jnp.where(first, time, running.cause_time),
        cause_stage=jnp.where(first, ctx.stage, running.cause_stage),
    )
    kept = jax.tree.map(lambda old, fresh: jnp.where(running.is_over, old, fresh), running, new)
    return kept, jnp.stack([jnp.asarray(found[name], time.dtype) for name in metrics_computed_each_tick(world)])


def _update_metric(metric: Metric, state: Any, ctx: MetricContext, number: Array) -> Any:
    every = max(1, int(metric.interval / ctx.period + 1e-6))
    if every == 1:
        return metric.update(state, ctx)
    return jax.lax.cond(number % every == 0, lambda: metric.update(state, ctx), lambda: state)


def compute_metrics(world: Case, plan: Plan, running: RunningMetrics, stage: Int[Array, ""]) -> dict[str, Array]:
    """Compute all metrics of a rollout at its end, by column of its row in the results.

    Args:
        world: The world.
        plan: The executed plan.
        running: The rollout's metrics.
        stage: Number of the last stage.

    Returns:
        Values by column, whose name has the unit, and times and stages of `causes_judged_each_tick`.
    """
    out = _compute_metrics(RolloutEnd(world, plan, running.time, stage), running.states)
    for k, cause in enumerate(causes_judged_each_tick(world)):
        out[f"{cause.name}_time_s"] = running.cause_time[k]
        out[f"{cause.name}_stage"] = running.cause_stage[k]
    return out


def _compute_metrics(rollout: RolloutEnd, states: tuple[Any, ...]) -> dict[str, Array]:
    return compute_columns(metrics.applicable_metrics(rollout.world), states, rollout)
