"""Metrics and causes of failure: the interfaces that all simulated systems share.

A metric turns a rollout into numbers, each of which becomes a column. It declares

- its columns: the name, whose end is the unit (see `column_unit`), and the meaning in one line;
- `begin`, the state before the first report; `update`, the state after one more; `compute`, the columns at the end;
- the causes of failure or invalidity that follow from its columns.

A system reports what its engines have simulated: once a control tick, or once a physics step. `CommonTick` lists what
every system reports, so that a metric which uses nothing else (`sweep.core.shared_metrics`) is written once and
computed for all of them. Metrics of one system use that system's own report as well.

Arrays are NumPy's or JAX's (see `array_namespace`). They may begin with an axis of rollouts: index them from the end.
"""

import importlib
import math
import pkgutil
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import jax
import numpy as np

from sweep.core.parameters import UNIT_BY_SUFFIX, quantity

Array = Any  # of NumPy or JAX
EVERY_COLUMN = "*"  # in `Metric.reads`
# the accumulating function of a metric by a word of its name, and its initial value
EXTREME_ACCUMULATORS = {"max": ("maximum", 0.0), "min": ("minimum", math.inf)}


def array_namespace(array: Array) -> Any:
    """Return the module, NumPy or jax.numpy, to which an array belongs."""
    return array.__array_namespace__()


class CommonStart(Protocol):
    """State of a rollout before its first tick, as every system gives it to `Metric.begin`."""

    @property
    def base_position(self) -> Array:
        """Position of the base (..., 3) in m, world axes."""
        ...

    @property
    def base_quat(self) -> Array:
        """Orientation of the base (..., 4), body to world."""
        ...

    @property
    def command_direction_varies(self) -> bool:
        """Whether the commanded direction of motion changes during the rollout."""
        ...

    @property
    def torque_groups(self) -> int:
        """Number k of joint groups for which torques are reported."""
        ...

    def constant_state(self, value: Any) -> Array:
        """Return a constant as a metric's initial state, in the simulation's precision, for each rollout of a batch."""
        ...

    def init_touchdown_points(self) -> "TouchdownPoints":
        """Return the touchdown points before any foot is loaded."""
        ...


class CommonTick(Protocol):
    """The s samples of the robot's motion since the previous report, as every system passes them to `Metric.update`.

    The hexapod reports one sample at the end of each control tick. MuJoCo models report every physics step: `native`
    all those of a tick at once, `mjx` one at a time. A metric must not depend on how samples are grouped.
    """

    @property
    def sample_period(self) -> float:
        """Time between two samples (s)."""
        ...

    @property
    def base_position(self) -> Array:
        """Positions of the base (..., s, 3) in m, world axes."""
        ...

    @property
    def base_quat(self) -> Array:
        """Orientations of the base (..., s, 4), body to world."""
        ...

    @property
    def base_velocity(self) -> Array:
        """Velocities of the base (..., s, 3) in m/s, world axes."""
        ...

    @property
    def tilt_deg(self) -> Array:
        """Largest angle (...) in degrees between the upward axes of the base and of its reference.

        The reference is the commanded orientation, or that of the start where nothing commands one.
        """
        ...

    @property
    def joint_rates(self) -> Array:
        """Rates of hinge joints (..., v, k) in rad/s: v values of each of k groups of joints."""
        ...

    @property
    def joint_torques(self) -> Array:
        """Absolute torques (..., v, k) of hinge-joint drives in N m, for k groups of joints with v values each."""
        ...

    @property
    def positive_work(self) -> Array:
        """Positive work (...) of the drives in J, or positive power in W summed over samples.

        `CommonRollout.integrate_sum` converts the sum over all ticks to J.
        """
        ...

    def motion_along_command(self, before: Array) -> tuple[Array | None, Array]:
        """Return distance and duration of the base's motion along the commanded direction since the previous report.

        Args:
            before: Position of the base (..., 3) at the report before.

        Returns:
            The way (...) in m, None where the direction never changes; and the time (...), as
            `CommonRollout.integrate_sum` takes it.
        """
        ...


class CommonRollout(Protocol):
    """State of a rollout after its last tick, as every system gives it to `Metric.compute`."""

    @property
    def columns(self) -> Mapping[str, Array]:
        """Metrics that were computed before, by column; at least the columns that `Metric.reads` names."""
        ...

    @property
    def time(self) -> Array:
        """Simulated time (...) of the rollout in s."""
        ...

    @property
    def weight(self) -> Array:
        """Weight of the robot (...) in N."""
        ...

    def integrate_sum(self, total: Array) -> Array:
        """Convert a sum over samples, as metrics accumulate it, into an integral over time in SI units."""
        ...

    def displacement_along_command(self, displacement: Array) -> Array:
        """Return the component of displacements (..., 3) along the commanded direction, which must be constant."""
        ...


class TouchdownPoints(Protocol):
    """Points at which loaded feet touched down; the state (a pytree) of the slip metric."""

    def update(self, ctx: Any) -> tuple["TouchdownPoints", Array]:
        """Return the touchdown points after a report, and for each loaded foot its largest slip (..., feet) in m."""
        ...


class SmoothMarginMetric(NamedTuple):
    """A continuous metric that crosses its limit exactly when an integer metric does, and gives it a smooth margin."""

    metric: str
    limit: float
    scale: float  # in which its margin is counted


class PrecursorMetric(NamedTuple):
    """A metric that reaches zero before another one starts to grow; gives margins to rows that are far from failing."""

    metric: str
    scale: float  # in which its margin is counted


@dataclass(frozen=True)
class Cause:
    """A cause of failure or invalidity: a metric beyond its threshold. Metric modules define causes.

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
    twin: SmoothMarginMetric | None = None  # of a count
    lead: PrecursorMetric | None = None  # where there is one, in such a world
    default_for: Callable[[Any], float | None] = lambda world: None

    @property
    def threshold(self) -> str:
        """Configuration key of the cause's threshold, the metric's name with `min` or `max` before the unit."""
        words = self.metric.split("_")
        if self.key is not None or {"min", "max"} & {*words}:
            return self.metric if self.key is None else self.key
        unit = words[-1:] if words[-1] in UNIT_BY_SUFFIX else []
        return "_".join([*words[: len(words) - len(unit)], "min" if self.below else "max", *unit])

    def threshold_parameter(self) -> Any:
        """Make the configuration parameter of the cause's threshold, in the unit of its metric."""
        return quantity(self.default, column_unit(self.metric), at_least=-math.inf if self.below else 0.0)

    def limit(self, value: float | None) -> float:
        """Return a threshold as a number; None becomes infinity, so that the cause never applies."""
        return (-math.inf if self.below else math.inf) if value is None else value

    def holds(self, value: Any, limit: Any) -> Any:
        """Return whether values of the metric (numbers or arrays, NumPy or JAX) are beyond the threshold `limit`."""
        return value < limit if self.below else value > limit

    @property
    def margin_companion_metric(self) -> str:
        """Name of a second metric that the margin of the cause also uses; empty if there is none."""
        other = self.twin or self.lead
        return other.metric if other else ""

    def margin(self, value: Any, limit: float, companion: Any = None) -> Any:
        """Return the distance of a metric from its threshold in units of `scale`, at most 1; negative beyond it.

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


class Metric[S](NamedTuple):
    """A group of metrics that share a state `S`, a pytree of arrays; each metric module defines one as `METRIC`.

    `begin(start)` returns the state before the first report, `update(state, ctx)` the state after one more, and
    `compute(state, rollout)` the values by column.
    """

    begin: Callable[[Any], S]
    update: Callable[[S, Any], S]
    compute: Callable[[S, Any], dict[str, Array]]
    columns: Mapping[str, str]  # the meaning of each column; the end of its name is the unit
    causes: tuple[Cause, ...] = ()
    needs: tuple[str, ...] = ()  # parts that a system must have, see `select_metrics`
    reads: tuple[str, ...] = ()  # columns of other metrics that `compute` reads; `EVERY_COLUMN` for all of them
    applies: Callable[[Any], bool] = lambda world: True  # to what kind of world; not by numbers
    interval: float = 0.0  # s, between updates, of a metric that is dear and would not miss anything shorter


def column_unit(column: str) -> str:
    """Return the unit at the end of a column's name, such as `m` of `slip_max_m`; `-` if it names none."""
    return UNIT_BY_SUFFIX.get(column.rpartition("_")[2], "-")


def merge_columns(metrics: Iterable[Metric[Any]]) -> dict[str, str]:
    """Return the columns of several metrics and what they mean, by column name."""
    return {name: meaning for metric in metrics for name, meaning in metric.columns.items()}


def make_begin_with_constants[S](kind: Callable[..., S], *values: Any) -> Callable[[CommonStart], S]:
    """Make a metric's `begin` that returns constant values in the rollout's precision.

    Args:
        kind: Class of the state.
        values: Its fields.
    """

    def begin(start: CommonStart) -> S:
        return kind(*map(start.constant_state, values))

    return begin


def make_end_metric(
    compute: Callable[[tuple[()], Any], dict[str, Array]], columns: Mapping[str, str], **options: Any
) -> Metric[tuple[()]]:
    """Make a metric without state, whose columns are computed once at the end of the rollout.

    Args:
        compute: See `Metric`; its state is empty.
        columns: Meanings by column.
        options: Further fields of `Metric`.
    """
    return Metric(make_begin_with_constants(tuple), lambda state, ctx: state, compute, columns, **options)


def make_extremes_metric(
    values: Callable[[Any], Iterator[Array]],
    columns: Mapping[str, str],
    causes: tuple[Cause, ...] = (),
    **options: Any,
) -> Metric[tuple[Array, ...]]:
    """Make a metric whose columns are the largest or smallest values of quantities over all reports.

    Args:
        values: The quantities of a report, in the order of `columns`.
        columns: Meanings by column; a name with `max` (of a non-negative quantity) or `min` says which value counts.
        causes: Causes that follow from them.
        options: Further fields of `Metric`.
    """
    kinds = [
        next(EXTREME_ACCUMULATORS[word] for word in name.split("_") if word in EXTREME_ACCUMULATORS) for name in columns
    ]

    def update(state: tuple[Array, ...], ctx: Any) -> tuple[Array, ...]:
        news = zip(kinds, state, values(ctx), strict=True)
        return tuple(getattr(array_namespace(new), best)(old, new) for (best, _), old, new in news)

    def compute(state: tuple[Array, ...], rollout: Any) -> dict[str, Array]:
        return dict(zip(columns, state, strict=True))

    begin = make_begin_with_constants(lambda *found: found, *(start for _, start in kinds))
    return Metric(begin, update, compute, columns, causes, **options)


def find_metrics(package: str, first: Collection[str] = (), others: Collection[str] = ()) -> dict[str, Metric[Any]]:
    """Import the modules of a package and return the metrics that they define as `METRIC`.

    Args:
        package: Name of the package.
        first: Names of modules that come first, in this order; the rest follows by name.
        others: Names of modules that define no metric.

    Returns:
        Metrics by name of their module.
    """
    path = importlib.import_module(package).__path__
    names = {module.name for module in pkgutil.iter_modules(path)} - {*others}
    ordered = [*first, *sorted(names - {*first})]
    return {name: importlib.import_module(f"{package}.{name}").METRIC for name in ordered}


def select_metrics(metrics: Iterable[Metric[Any]], parts: Collection[str], world: Any) -> tuple[Metric[Any], ...]:
    """Select the metrics that apply to a system, by what it has (such as feet or hinges) and by its world.

    A metric that reads columns which no other one has is left out.

    Args:
        metrics: Metrics to choose from.
        parts: What the system has, of what `Metric.needs` names: `base`, `hinges`, `hinge_drives`, `feet`, ...
        world: The system's world, for `Metric.applies`.
    """
    found = [metric for metric in metrics if {*metric.needs} <= {*parts} and metric.applies(world)]
    columns = {EVERY_COLUMN, *(column for metric in found for column in metric.columns)}
    return tuple(metric for metric in found if {*metric.reads} <= columns)


def compute_columns(metrics: Iterable[Metric[Any]], states: Iterable[Any], rollout: Any) -> dict[str, Array]:
    """Compute the columns of all metrics at the end of a rollout; metrics that read other columns come last.

    Args:
        metrics: The metrics.
        states: Their states.
        rollout: The system's `CommonRollout`, a named tuple.
    """
    columns: dict[str, Array] = {}
    pairs = zip(metrics, states, strict=True)
    for metric, state in sorted(pairs, key=lambda pair: (EVERY_COLUMN in pair[0].reads, len(pair[0].reads) > 0)):
        columns |= metric.compute(state, rollout._replace(columns=columns))
    return columns


def freeze_ended_states(going: Array, new: Any, old: Any) -> Any:
    """Return the new states of rollouts that are still running, and the old states of rollouts that have ended.

    Args:
        going: Which of the n rollouts go on (n,), or whether a single one does ().
        new: States, a pytree of numbers (n, ...), of a single rollout (...).
        old: States before.

    Returns:
        New states for the rollouts that go on, and old ones for the others.
    """

    def choose(fresh: Array, kept: Array) -> Array:
        mask = going.reshape((*going.shape, *[1] * (np.ndim(fresh) - going.ndim)))
        return array_namespace(going).where(mask, fresh, kept)

    return jax.tree.map(choose, new, old)
