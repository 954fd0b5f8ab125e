"""Metrics: numbers of a rollout that are accumulated once a control tick, and causes of failure that follow from them.

Each module of this folder is one metric. To add one, write its module and name it in `sweep.metrics.METRICS`: columns,
thresholds, outcomes and the tables that explain them follow.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sweep.controllers.frames import Stance
from sweep.controllers.observation import Observation
from sweep.controllers.plan import Plan
from sweep.core.parameters import UNITS, quantity
from sweep.estimation.belief_update import LearnedState
from sweep.models.case import Case
from sweep.models.obstacles.surface import BodyPoses, FreeState

# s; a rollout continues for this time after its plan has ended, and nothing may change then
REST = 1.0
# a rollout is stopped when this multiple of its plan's duration has passed
GRACE = 1.2
GOAL = "goal_missed"  # the name of all causes that are parts of a manoeuvre's goal
# s; forces are averaged over it, so that a bounce of the feet is neither a fall nor a slip
BRIEF = 0.05
# the accumulating function of a metric by a word of its name, and its initial value
BEST = {"max": (jnp.maximum, 0.0), "min": (jnp.minimum, math.inf)}


class Tick(NamedTuple):
    """An engine's report of one control tick. World axes; k points along a leg."""

    torque_peak: Float[Array, "6 3"]  # N m, absolute
    saturated: Float[Array, "6 3"]  # share of the tick
    force: Float[Array, "6 3"]  # N, mean, on the feet
    normal: Float[Array, " 6"]  # N, mean
    tangential: Float[Array, " 6"]  # N, size of the mean
    residual: Float[Array, ""]  # N, largest of the solver
    work: Float[Array, ""]  # J, of drives and pushes
    effort: Float[Array, ""]  # J, positive drive work only
    power: Float[Array, "6 3"]  # W, of the drives, mean
    energy: Float[Array, ""]  # J, kinetic and potential, at the end
    truth: Observation  # of exact sensors, at the end
    centre_of_mass: Float[Array, " 3"]  # m, of the robot
    joints: Float[Array, "6 k 3"]  # m, along each leg: hip, ..., knee, foot
    bodies: BodyPoses


class RolloutStart(NamedTuple):
    """A rollout before its first tick; engines make it, and metrics begin with it."""

    world: Case
    plan: Plan
    position: Float[Array, " 3"]  # m, of the base
    quat: Float[Array, " 4"]
    feet: Float[Array, "6 3"]  # m, actual positions
    free: FreeState
    energy: Float[Array, ""]  # J
    learned: LearnedState = LearnedState()


class MetricTick(NamedTuple):
    """The context in which metrics are updated: the control tick that has just passed; engines make it."""

    world: Case
    plan: Plan
    stage: Int[Array, ""]
    phase: Float[Array, ""]  # of the stage, 0 to 1
    finished: Bool[Array, ""]  # the plan
    stage_start: Float[Array, " 3"]  # m, planned base when the stage began, in its frame
    target: Stance  # that the tracker commanded
    reference: Stance  # `target` with the base where exact sensors would have it: the true command, see `Command`
    shortfall: Float[Array, ""]  # m, of targets beyond the legs' reach
    tick: Tick
    period: float  # s, of a tick
    time: Float[Array, ""]  # s, at its end
    learned: LearnedState = LearnedState()


def time_left(ctx: MetricTick) -> Float[Array, ""]:
    """Remaining duration of the plan (s); stages may have ended before their time."""
    duration = ctx.plan.duration
    later = jnp.sum(jnp.where(jnp.arange(len(duration)) > ctx.stage, duration, 0.0))
    return later + (1 - ctx.phase) * duration[ctx.stage]


class PlanTail(NamedTuple):
    """Positions (m) and time (s) at the start of the plan's last part, for mean velocities since then."""

    place: Float[Array, "*k 3"]
    time: Float[Array, ""]

    def update(self, ctx: MetricTick, place: Float[Array, "*k 3"], length: float) -> "PlanTail":
        """Follow positions until the last `length` seconds of the plan begin.

        Args:
            ctx: The tick.
            place: Positions at its end (m).
            length: Duration of the last part (s).
        """
        before = time_left(ctx) > length
        return PlanTail(jnp.where(before, place, self.place), jnp.where(before, ctx.time, self.time))

    def mean_velocity(self, place: Float[Array, "*k 3"], time: Array) -> Float[Array, "*k 3"]:
        """Mean velocity (m/s) from the start of the last part to positions `place` (m) at `time` (s)."""
        return (place - self.place) / jnp.maximum(time - self.time, 1e-9)


class Rollout(NamedTuple):
    """A rollout up to the last tick, from which metrics are computed."""

    world: Case
    plan: Plan
    time: Float[Array, ""]  # s
    stage: Int[Array, ""]


class ContinuousTwin(NamedTuple):
    """A continuous metric that crosses its limit when a count is missed, and so gives the count a smooth margin."""

    metric: str
    limit: float
    scale: float  # in which its margin is counted


class LeadingMetric(NamedTuple):
    """A metric that shrinks to zero before the metric of a cause can grow; at zero nothing has failed yet."""

    metric: str
    scale: float  # in which its margin is counted


@dataclass(frozen=True)
class Cause:
    """A metric beyond its threshold makes a rollout a failure, or invalid; modules of metrics define causes.

    With `default` None the threshold is part of the manoeuvre's `goal`; `default_for` gives it for a kind of world if
    the goal does not.
    """

    name: str
    sentence: str
    metric: str  # a column of the metric
    default: float | None
    key: str | None = None  # the threshold's in `outcome`, if it has a name of its own; an empty one nobody can change
    below: bool = False  # it holds where the figure is below the threshold, not above
    # When it is known: in the tick that crosses it; from the start, in the stage that the figure `NAME_stage` tells; at
    # the end. Of those known in a tick each has a name of its own.
    known_at: str = "tick"
    invalid: bool = False
    scale: float | None = None  # in which its margin is counted; the threshold's size by default
    is_count: bool = False  # a count, which is enough or not
    twin: ContinuousTwin | None = None  # of a count
    lead: LeadingMetric | None = None  # where there is one, in such a world
    default_for: Callable[[Case], float | None] = lambda case: None

    @property
    def threshold(self) -> str:
        """The threshold's key in `outcome`: the metric's name, with `min` or `max` before the unit."""
        words = self.metric.split("_")
        if self.key is not None or {"min", "max"} & {*words}:
            return self.metric if self.key is None else self.key
        unit = words[-1:] if words[-1] in UNITS else []
        return "_".join([*words[: len(words) - len(unit)], "min" if self.below else "max", *unit])

    def quantity(self) -> Any:
        """Make the threshold's parameter, in the metric's unit."""
        unit = UNITS.get(self.metric.rpartition("_")[2], "-")
        return quantity(self.default, unit, at_least=-math.inf if self.below else 0.0)

    def holds(self, value: Any, limit: Any) -> Any:
        """Whether values of the metric (numbers or arrays, NumPy or JAX) are beyond `limit`."""
        return value < limit if self.below else value > limit

    @property
    def companion(self) -> str:
        """Name of the second metric of the margin, the twin or the lead; empty if there is none."""
        other = self.twin or self.lead
        return other.metric if other else ""

    def margin(self, value: Any, limit: float, companion: Any = None) -> Any:
        """Distance of the metric from its threshold in units of `scale`, at most 1; negative where the cause holds.

        A count takes the distance of its `twin` where both agree. With a `lead` the margin is at most the distance of
        the lead from zero, and negative only where the cause holds.

        Args:
            value: Values of the metric.
            limit: The threshold.
            companion: Values of the `companion`, if there is one.
        """
        left = value - limit if self.below else limit - value
        if self.is_count:
            count = np.where(left < 0, left, 1.0)
            if self.twin is None or companion is None:
                return count
            smooth = ((self.twin.limit - companion) / self.twin.scale).clip(max=1.0)
            return np.where((smooth < 0) == (left < 0), smooth, count)
        size = abs(limit) if self.scale is None else self.scale
        left = (left / size if size else left).clip(max=1.0)
        if self.lead is None or companion is None:
            return left
        return np.where(left > 0, np.fmin(left, (companion / self.lead.scale).clip(min=0.0)), left)


def goal_cause(sentence: str, metric: str, **options: Any) -> Cause:
    """Make a cause for a part of the goal, judged at the end, if the manoeuvre's goal has a threshold for it.

    Args:
        sentence: What happened, for messages.
        metric: Name of the metric.
        options: Fields of `Cause`.
    """
    return Cause(GOAL, sentence, metric, None, known_at="end", **options)


class Metric[S](NamedTuple):
    """Numbers of a rollout that share a state `S`, a pytree; each module of this package defines one as `METRIC`."""

    begin: Callable[[RolloutStart], S]
    update: Callable[[S, MetricTick], S]
    compute: Callable[[S, Rollout], dict[str, Array]]  # by column name, the unit at its end
    columns: Mapping[str, str]  # what each figure means
    causes: tuple[Cause, ...] = ()
    applies: Callable[[Case], bool] = lambda case: True  # to what kind of world; not by numbers
    interval: float = 0.0  # s, between updates, of a metric that is dear and would not miss anything shorter


def initial_state[S](kind: Callable[..., S], *values: Any) -> Callable[[RolloutStart], S]:
    """Make a `begin` that returns a constant state in the rollout's precision.

    Args:
        kind: Class of the state.
        values: Its fields.
    """

    def begin(start: RolloutStart) -> S:
        floats = (np.asarray(value).dtype.kind == "f" for value in values)
        return kind(*(jnp.asarray(x, start.feet.dtype if f else None) for x, f in zip(values, floats, strict=True)))

    return begin


def extremes(
    values: Callable[[MetricTick], Iterator[Array]],
    columns: Mapping[str, str],
    causes: tuple[Cause, ...] = (),
    **options: Any,
) -> Metric[tuple[Array, ...]]:
    """Make a metric of the largest or least values of quantities over all ticks.

    Args:
        values: The quantities of a tick, in the order of `columns`.
        columns: Meanings by column; a name with `max` (of a non-negative quantity) or `min` says which value counts.
        causes: Causes that follow from them.
        options: Further fields of `Metric`.
    """
    kinds = [next(BEST[word] for word in name.split("_") if word in BEST) for name in columns]

    def update(state: tuple[Array, ...], ctx: MetricTick) -> tuple[Array, ...]:
        return tuple(best(old, new) for (best, _), old, new in zip(kinds, state, values(ctx), strict=True))

    def compute(state: tuple[Array, ...], rollout: Rollout) -> dict[str, Array]:
        return dict(zip(columns, state, strict=True))

    begin = initial_state(lambda *found: found, *(start for _, start in kinds))
    return Metric(begin, update, compute, columns, causes, **options)
