"""`sweep run --check`: find axes without effect, and rollouts that do not repeat.

An axis has no effect where no metric changes by a single bit when its value does. The check moves each axis alone along
its own levels, once about the nominal point and once about a point in the middle of the study, on every engine of the
study. Engines may give other last bits at another slot or batch width, so only equal slots of batches of one width are
compared. Every batch also holds a row with all axes at their first levels and one with all at their last, so that all
batches vary the same parameters and use one compiled program.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from sweep.config.experiment import Experiment
from sweep.contract.engine import Metrics
from sweep.core.errors import InputError
from sweep.core.spacing import evenly_spaced_indices
from sweep.runs.axis_effects import find_inactive_parameters
from sweep.runs.batches import allocate_delay_buffers, clear_engine_cache, make_batch, make_engine, make_nominal_batch
from sweep.study.study import needs_recompilation, parameter_columns

MAX_LEVELS_PER_AXIS = 9  # tried on an axis
ENGINE_COLUMN = "engine.name"
Levels = Mapping[str, Sequence[Any]]  # by column


class InactiveInterval(NamedTuple):
    """Interval of a varied parameter within which no metric changes."""

    column: str
    first: Any
    last: Any
    is_entire_axis: bool


@dataclass
class AxisCheckReport:
    """Result of `sweep run --check`: parameters without effect, and metrics that differ when a rollout is repeated."""

    axes: int  # number of axes that were tried
    engines: list[str]
    rollouts: int = 0  # simulated for the check
    inactive: dict[InactiveInterval, list[str]] = field(default_factory=dict)  # each with the engines that show it
    unread: set[str] = field(default_factory=set)  # columns that no program of the study reads
    irreproducible: list[str] = field(default_factory=list)  # metrics that differ when a batch is simulated twice

    @property
    def is_sound(self) -> bool:
        """Whether every axis has an effect somewhere on every engine, and rollouts repeat bit for bit."""
        return not self.irreproducible and not any(one.is_entire_axis for one in self.inactive)

    def format_lines(self, exp: Experiment) -> Iterator[str]:
        """Yield a line for each finding of the check, for the user."""
        if self.irreproducible:
            yield (
                f"two runs of one batch differ ({', '.join(self.irreproducible[:3])}): the controller is not a "
                "function of its arguments, or the engine adds up in any order; no rollout can be repeated, and axes "
                "without effect cannot be found"
            )
        for (column, first, last, whole), engines in self.inactive.items():
            why = exp.system.explain_inactive_column(column, replace(exp.settings, name=engines[0]), (first, last))
            why = why or ("it does not enter the simulation" if column in self.unread else "")
            between = f"from {_format_value(first)} to {_format_value(last)}"
            says = f"{column} changes nothing" + (
                f" on {' and '.join(engines)}" if len(engines) < len(self.engines) else ""
            )
            says += "" if whole else f" {between}"
            yield f"{says}: {why or ('no figure differs by a bit' + (f' {between}' if whole else ''))}"


def run_axis_check(
    exp: Experiment, table: pd.DataFrame, on_progress: Callable[[int], None] = lambda rollouts: None
) -> AxisCheckReport:
    """Check that every axis of a study has an effect and that rollouts repeat; writes nothing.

    Args:
        exp: Experiment of the study.
        table: Points of the study, a row for each rollout.
        on_progress: Receives the number of rollouts that are done, after every batch.

    Returns:
        The axes, or parts of axes, without effect, and the metrics that do not repeat.

    Raises:
        InputError: The study varies nothing.
    """
    exp = allocate_delay_buffers(exp, table)
    varied = [c for c in parameter_columns(table) if table[c].nunique() > 1]
    if not varied:
        raise InputError(f"--check: {exp.study.name} varies nothing")
    by_engine = (
        dict(iter(table.groupby(ENGINE_COLUMN, sort=False))) if ENGINE_COLUMN in varied else {exp.settings.name: table}
    )
    report = AxisCheckReport(len(varied), [*map(str, by_engine)])
    for engine, rows in zip(report.engines, by_engine.values(), strict=True):
        levels = {c: _levels(rows[c]) for c in varied if rows[c].nunique() > 1}
        for stretch in _find_inactive(exp, rows, levels, report, on_progress):
            report.inactive.setdefault(stretch, []).append(engine)
    if any(one.is_entire_axis for one in report.inactive):
        report.unread = find_inactive_parameters(exp, table.assign(width=1))
    return report


def _find_inactive(
    exp: Experiment, table: pd.DataFrame, levels: Levels, report: AxisCheckReport, on_progress: Callable[[int], None]
) -> Iterator[InactiveInterval]:
    """Yield the stretches of axes without effect on one engine, whose points are `table`."""
    static = [c for c in levels if needs_recompilation(c, exp.system, exp.settings)]
    swept = {c: values for c, values in levels.items() if c not in static}
    middle = table.iloc[len(table) // 2]
    nominal = {c: exp.system.nominal_parameter_value(c, exp.settings) for c in parameter_columns(table)}
    nominal |= {c: middle[c] for c in nominal if c == ENGINE_COLUMN}
    acts = {c: np.zeros(len(values) - 1, dtype=bool) for c, values in levels.items()}

    def simulate(base: Mapping[str, Any], k: int) -> Metrics:
        rows = _rows(table, base, swept, k)
        task = make_batch(exp, rows)
        metrics = make_engine(exp, make_nominal_batch(exp, rows, len(rows))).run(task.world, task.belief, task.streams)
        report.rollouts += len(rows)
        on_progress(report.rollouts)
        return metrics

    for base in (nominal, {c: middle[c] for c in nominal}):
        previous = first = simulate(base, 0)
        for k in range(1, max(map(len, swept.values()), default=1)):
            metrics = simulate(base, k)
            changed = _changed_rows(previous, metrics)
            for slot, c in enumerate(swept):
                if k < len(levels[c]):
                    acts[c][k - 1] |= changed[slot]
            previous = metrics
        for c in static:
            by_level = [simulate({**base, c: value}, 0) for value in levels[c]]
            for k, (a, b) in enumerate(pairwise(by_level)):
                acts[c][k] |= _changed_rows(a, b).any()
        if base is nominal:
            clear_engine_cache()
            again = simulate(base, 0)
            report.irreproducible += [
                name for name in first if _changed_rows({name: first[name]}, {name: again[name]}).any()
            ]
    for c, active in acts.items():
        yield from _inactive_stretches(c, levels[c], active)


def _levels(values: pd.Series) -> Sequence[Any]:
    """Up to `MAX_LEVELS_PER_AXIS` values of an axis in their order, both ends among them."""
    every = np.sort(values.unique()) if values.dtype.kind in "fi" else values.unique()
    return every[evenly_spaced_indices(len(every), MAX_LEVELS_PER_AXIS)].tolist()


def _rows(table: pd.DataFrame, base: Mapping[str, Any], levels: Levels, k: int) -> pd.DataFrame:
    """One row for each of n axes, with that axis at its level `k` (or its last) and all others as in `base`.

    Two more rows follow: all axes at their first levels, and all at their last.
    """
    n = max(len(levels), 1)
    columns: dict[str, Any] = {
        c: pd.Series([value] * (n + 2)).astype(table[c].dtype).array for c, value in base.items()
    }
    for slot, (c, values) in enumerate(levels.items()):
        columns[c][[slot, n, n + 1]] = values[min(k, len(values) - 1)], values[0], values[-1]
    return pd.DataFrame({**columns, "stream": table["stream"].iloc[0], "width": n + 2})


def _changed_rows(a: Metrics, b: Metrics) -> np.ndarray:
    """Mask (n,) of the rows of two batches that differ by a bit in any metric."""
    pairs = [(np.asarray(a[name], float), np.asarray(b[name], float)) for name in a.keys() & b.keys()]
    differ = [(x != y) & ~(np.isnan(x) & np.isnan(y)) for x, y in pairs]
    return np.any(differ, axis=0) | (a.keys() != b.keys())


def _inactive_stretches(column: str, levels: Sequence[Any], active: np.ndarray) -> Iterator[InactiveInterval]:
    """Longest intervals without effect; `active` says it of each interval between neighbouring levels."""
    edges = np.flatnonzero(np.diff(np.concatenate([[True], active, [True]]).astype(int)))
    for first, last in edges.reshape(-1, 2):
        yield InactiveInterval(column, levels[first], levels[last], not active.any())


def _format_value(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
