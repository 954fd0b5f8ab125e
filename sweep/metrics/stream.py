"""Running figures of a rollout: updated once a control tick, from the same summary for both engines."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from sweep import metrics
from sweep.controllers.plan import Plan
from sweep.metrics import solver
from sweep.metrics.metric import Begin, Cause, Elapsed, Metric, Moment
from sweep.metrics.outcome import Thresholds, limit_of
from sweep.models.case import Case

OVERTURNED = 60.0  # deg of tilt: nothing after it tells anything of the manoeuvre


class Running(NamedTuple):
    """Every metric's state, and when causes were met; c causes that are known in a tick."""

    time: Float[Array, ""]  # s
    rested: Float[Array, ""]  # s, since the plan has ended
    over: Bool[Array, ""]  # overturned or not finite: figures are frozen
    states: tuple[Any, ...]
    cause_time: Float[Array, " c"]  # s, first crossing of each threshold, NaN before
    cause_stage: Int[Array, " c"]


def timed(world: Case) -> tuple[Cause, ...]:
    """The causes whose moment is noted."""
    return tuple(cause for metric in metrics.of(world) for cause in metric.causes if cause.known == "tick")


def watched(world: Case) -> tuple[str, ...]:
    """The figures by which a rollout is judged in every tick: those of the `timed` causes, and such as lead to them."""
    causes = timed(world)
    there = {name for metric in metrics.of(world) for name in metric.columns}
    return (*(c.figure for c in causes), *(c.beside for c in causes if c.beside in there))


def begin(start: Begin) -> Running:
    """Nothing has happened yet."""
    dtype, n = start.plan.duration.dtype, len(timed(start.world))
    return Running(
        time=jnp.zeros((), dtype),
        rested=jnp.zeros((), dtype),
        over=jnp.asarray(False),
        states=tuple(metric.begin(start) for metric in metrics.of(start.world)),
        cause_time=jnp.full(n, jnp.nan, dtype),
        cause_stage=jnp.full(n, -1, jnp.int32),
    )


def with_energy(world: Case, running: Running, energy: Array) -> Running:
    """`running` with another energy at the start (J)."""
    states = zip(metrics.of(world), running.states, strict=True)
    return running._replace(
        states=tuple(s._replace(energy=energy) if metric is solver.METRIC else s for metric, s in states)
    )


def update(running: Running, now: Moment, limits: Thresholds, number: Array) -> tuple[Running, Float[Array, " w"]]:
    """Control tick `number` on, which all rollouts share, and the figures so far that are `watched`.

    `limits` only say when the moment of a cause is noted.
    """
    world, time = now.world, now.time
    states = tuple(_updated(m, s, now, number) for m, s in zip(metrics.of(world), running.states, strict=True))
    found = _figures(Elapsed(world, now.plan, time, now.stage), states)
    crossed = [c.holds(found[c.figure], limit_of(c, limits)) for c in timed(world)]
    first = jnp.stack(crossed) & jnp.isnan(running.cause_time)
    new = Running(
        time=time,
        rested=running.rested + now.period * now.finished,
        over=(found["tilt_max_deg"] > OVERTURNED) | ~found["finite"],
        states=states,
        cause_time=jnp.where(first, time, running.cause_time),
        cause_stage=jnp.where(first, now.stage, running.cause_stage),
    )
    kept = jax.tree.map(lambda old, fresh: jnp.where(running.over, old, fresh), running, new)
    return kept, jnp.stack([jnp.asarray(found[name], time.dtype) for name in watched(world)])


def _updated(metric: Metric, state: Any, now: Moment, number: Array) -> Any:
    every = max(1, int(metric.interval / now.period + 1e-6))
    if every == 1:
        return metric.update(state, now)
    return jax.lax.cond(number % every == 0, lambda: metric.update(state, now), lambda: state)


def figures(world: Case, plan: Plan, running: Running, stage: Int[Array, ""]) -> dict[str, Array]:
    """The row's figures by column name, units in the name, and when the causes known in a tick were met."""
    out = _figures(Elapsed(world, plan, running.time, stage), running.states)
    for k, cause in enumerate(timed(world)):
        out[f"{cause.name}_time_s"] = running.cause_time[k]
        out[f"{cause.name}_stage"] = running.cause_stage[k]
    return out


def _figures(at: Elapsed, states: tuple[Any, ...]) -> dict[str, Array]:
    parts = (metric.figures(state, at) for metric, state in zip(metrics.of(at.world), states, strict=True))
    return {name: value for part in parts for name, value in part.items()}
