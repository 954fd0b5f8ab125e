"""What a metric is: figures of a rollout, updated once a control tick, and the causes of failure that follow from them.

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

from sweep.controllers.belief_update import LearnedState
from sweep.controllers.frames import Stance
from sweep.controllers.observation import Observation
from sweep.controllers.plan import Plan
from sweep.core.parameters import UNITS, quantity
from sweep.models.case import Case
from sweep.models.obstacles.surface import BodyPoses, FreeState

REST = 1.0  # s, that a rollout goes on after its plan has ended, in which nothing may change
GRACE = 1.2  # a plan that is not finished at this multiple of its duration is given up
GOAL = "goal_missed"  # the name of all causes that are parts of a manoeuvre's goal
BRIEF = 0.05  # s, over which forces are averaged: a bounce of the feet is neither a fall nor a slip
# how a figure follows from the ticks, by a word of its name, and what it is before the first one
BEST = {"max": (jnp.maximum, 0.0), "min": (jnp.minimum, math.inf)}


class Tick(NamedTuple):
    """What an engine reports of one control tick. World axes; L links a leg, k free bodies."""

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
    truth: Observation  # what exact sensors would see at the end
    centre_of_mass: Float[Array, " 3"]  # m, of the robot
    joints: Float[Array, "6 k 3"]  # m, along each leg: hip, ..., knee, foot
    bodies: BodyPoses


class RolloutStart(NamedTuple):
    """A rollout before its first tick."""

    world: Case
    plan: Plan
    position: Float[Array, " 3"]  # m, of the base
    quat: Float[Array, " 4"]
    feet: Float[Array, "6 3"]  # m, where they really are
    free: FreeState
    energy: Float[Array, ""]  # J
    learned: LearnedState = LearnedState()


class MetricTick(NamedTuple):
    """The control tick that has just passed."""

    world: Case
    plan: Plan
    stage: Int[Array, ""]
    phase: Float[Array, ""]  # of the stage, 0 to 1
    finished: Bool[Array, ""]  # the plan
    stage_start: Float[Array, " 3"]  # m, planned base when the stage began, in its frame
    target: Stance  # what feet and base were told
    reference: Stance  # `target` with the base where exact sensors would have it: the true command, see `Command`
    shortfall: Float[Array, ""]  # m, of targets beyond the legs' reach
    tick: Tick
    period: float  # s, of a tick
    time: Float[Array, ""]  # s, at its end
    learned: LearnedState = LearnedState()


def time_left(ctx: MetricTick) -> Float[Array, ""]:
    """Of the plan (s), whose stages may have ended before their time."""
    duration = ctx.plan.duration
    later = jnp.sum(jnp.where(jnp.arange(len(duration)) > ctx.stage, duration, 0.0))
    return later + (1 - ctx.phase) * duration[ctx.stage]


class PlanTail(NamedTuple):
    """Where things were (m), and when (s), as the last part of the plan began."""

    place: Float[Array, "*k 3"]
    time: Float[Array, ""]

    def update(self, ctx: MetricTick, place: Float[Array, "*k 3"], length: float) -> "PlanTail":
        """The same a tick on; the part lasts `length` seconds of the plan."""
        before = time_left(ctx) > length
        return PlanTail(jnp.where(before, place, self.place), jnp.where(before, ctx.time, self.time))

    def mean_velocity(self, place: Float[Array, "*k 3"], time: Array) -> Float[Array, "*k 3"]:
        """Mean velocity since then (m/s)."""
        return (place - self.place) / jnp.maximum(time - self.time, 1e-9)


class Rollout(NamedTuple):
    """A rollout as far as it has come."""

    world: Case
    plan: Plan
    time: Float[Array, ""]  # s
    stage: Int[Array, ""]


class ContinuousTwin(NamedTuple):
    """A continuous figure that goes beyond its limit where a count is not enough, and shrinks towards it before."""

    metric: str
    limit: float
    scale: float  # in which its margin is counted


class LeadingMetric(NamedTuple):
    """A figure that shrinks to nought before that of a cause can grow: at nought nothing has failed yet."""

    metric: str
    scale: float  # in which its margin is counted


@dataclass(frozen=True)
class Cause:
    """A figure beyond its threshold, and what that means: a way to fail, or a reason not to trust the simulation.

    `default` None leaves the threshold to the manoeuvre, whose `goal` it is then part of; `otherwise` holds, for a kind
    of world, where that is silent.
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
        """Its key in `outcome`: the figure's name, with what it is of the figure, `min` or `max`, before the unit."""
        words = self.metric.split("_")
        if self.key is not None or {"min", "max"} & {*words}:
            return self.metric if self.key is None else self.key
        unit = words[-1:] if words[-1] in UNITS else []
        return "_".join([*words[: len(words) - len(unit)], "min" if self.below else "max", *unit])

    def quantity(self) -> Any:
        """The threshold as a parameter, in the figure's unit."""
        unit = UNITS.get(self.metric.rpartition("_")[2], "-")
        return quantity(self.default, unit, at_least=-math.inf if self.below else 0.0)

    def holds(self, value: Any, limit: Any) -> Any:
        """Whether figures (numbers or arrays, of numpy or JAX) are beyond `limit`."""
        return value < limit if self.below else value > limit

    @property
    def companion(self) -> str:
        """The figure that its margin is of, too: its twin or its lead; empty where it has neither."""
        other = self.twin or self.lead
        return other.metric if other else ""

    def margin(self, value: Any, limit: float, companion: Any = None) -> Any:
        """How far figures are from `limit`, in units of `scale`, at most 1; negative where the cause holds.

        Of a count it is how far its `twin` is from its own limit, where both say the same. With a `lead` it is no more
        than what that has left, but not below nought unless the cause holds.
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
    """The goal was missed by a figure at the end, if the manoeuvre aims at one; `how` is as in `Cause`."""
    return Cause(GOAL, sentence, metric, None, known_at="end", **options)


class Metric[S](NamedTuple):
    """Figures with a common state `S`, a pytree."""

    begin: Callable[[RolloutStart], S]
    update: Callable[[S, MetricTick], S]
    compute: Callable[[S, Rollout], dict[str, Array]]  # by column name, the unit at its end
    columns: Mapping[str, str]  # what each figure means
    causes: tuple[Cause, ...] = ()
    applies: Callable[[Case], bool] = lambda case: True  # to what kind of world; not by numbers
    interval: float = 0.0  # s, between updates, of a metric that is dear and would not miss anything shorter


def initial_state[S](kind: Callable[..., S], *values: Any) -> Callable[[RolloutStart], S]:
    """A state of plain numbers that every rollout begins in, in its own precision."""

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
    """A metric of what every tick gives, in the order of `columns`: of each the largest so far, or the least.

    Which of them says the figure's name: `max`, of what is not negative, or `min`; `how` is as in `Metric`.
    """
    kinds = [next(BEST[word] for word in name.split("_") if word in BEST) for name in columns]

    def update(state: tuple[Array, ...], ctx: MetricTick) -> tuple[Array, ...]:
        return tuple(best(old, new) for (best, _), old, new in zip(kinds, state, values(ctx), strict=True))

    def compute(state: tuple[Array, ...], rollout: Rollout) -> dict[str, Array]:
        return dict(zip(columns, state, strict=True))

    begin = initial_state(lambda *found: found, *(start for _, start in kinds))
    return Metric(begin, update, compute, columns, causes, **options)
