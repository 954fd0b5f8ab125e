"""`sweep run --check`: does every axis act, and does a rollout come out alike twice?

An axis that changes no bit of any figure is dead, whatever a map of it shows. Each is moved alone along its own levels,
about the nominal point and about a row in the study's middle, on every engine that the study has, by what varies there.
Only the same place in batches of one width is compared, as an engine may give other last bits elsewhere; a row with all
axes at their first levels, and one at their last, stand in every batch, so that all of them vary the same parameters.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from sweep.core.errors import InputError
from sweep.core.spacing import evenly_spaced_indices
from sweep.engines.base import Figures
from sweep.runs.batches import forget_engine, make_batch, make_engine, make_nominal_batch, with_delay_buffer
from sweep.study.config import Experiment
from sweep.study.study import is_static, parameter_columns

MAX_LEVELS = 9  # levels of an axis that are tried
ENGINE = "engine.name"
Levels = Mapping[str, Sequence[Any]]  # by column


class InactiveStretch(NamedTuple):
    """A stretch of an axis along which nothing changes."""

    column: str
    first: Any
    last: Any
    is_entire_axis: bool


@dataclass
class AxisCheckReport:
    """What the check of a controller tells."""

    axes: int
    engines: list[str]
    rollouts: int = 0
    inactive: dict[InactiveStretch, list[str]] = field(default_factory=dict)  # with the engines on which it is
    irreproducible: list[str] = field(default_factory=list)  # figures that differ when a batch is simulated twice

    @property
    def is_sound(self) -> bool:
        """Whether every axis acts somewhere on every engine, and a rollout comes out alike."""
        return not self.irreproducible and not any(one.is_entire_axis for one in self.inactive)

    def format_lines(self, exp: Experiment) -> Iterator[str]:
        """What is to be told, each a line."""
        if self.irreproducible:
            yield (
                f"two runs of one batch differ ({', '.join(self.irreproducible[:3])}): the controller is not a function "
                "of its arguments, or the engine sums in any order; no rollout can be repeated, no inactive axis be found"
            )
        for (column, first, last, whole), engines in self.inactive.items():
            why = exp.system.inactive_reason(column, replace(exp.settings, name=engines[0]))
            between = f"from {_said(first)} to {_said(last)}"
            says = f"{column} changes nothing" + (
                f" on {' and '.join(engines)}" if len(engines) < len(self.engines) else ""
            )
            says += "" if whole else f" {between}"
            yield f"{says}: {why or ('no figure differs by a bit' + (f' {between}' if whole else ''))}"


def run(
    exp: Experiment, table: pd.DataFrame, on_progress: Callable[[int], None] = lambda rollouts: None
) -> AxisCheckReport:
    """Try every axis of the points `table`; nothing is written. Raises `InputError` where there is none.

    `told` is called with the rollouts that are done.
    """
    exp = with_delay_buffer(exp, table)
    varied = [c for c in parameter_columns(table) if table[c].nunique() > 1]
    if not varied:
        raise InputError(f"--check: {exp.study.name} varies nothing")
    each = dict(iter(table.groupby(ENGINE, sort=False))) if ENGINE in varied else {exp.settings.name: table}
    found = AxisCheckReport(len(varied), [*map(str, each)])
    for engine, rows in zip(found.engines, each.values(), strict=True):
        levels = {c: _levels(rows[c]) for c in varied if rows[c].nunique() > 1}
        for dead in _tried(exp, rows, levels, found, on_progress):
            found.inactive.setdefault(dead, []).append(engine)
    return found


def _tried(
    exp: Experiment, table: pd.DataFrame, levels: Levels, found: AxisCheckReport, told: Callable[[int], None]
) -> Iterator[InactiveStretch]:
    """What does not act at points that share an engine."""
    static = [c for c in levels if is_static(c, exp.system, exp.settings)]
    moving = {c: values for c, values in levels.items() if c not in static}
    middle = table.iloc[len(table) // 2]
    usual = {c: exp.system.nominal(c, exp.settings) for c in parameter_columns(table)}
    usual |= {c: middle[c] for c in usual if c == ENGINE}
    acts = {c: np.zeros(len(values) - 1, dtype=bool) for c, values in levels.items()}

    def simulate(base: Mapping[str, Any], k: int) -> Figures:
        rows = _rows(table, base, moving, k)
        task = make_batch(exp, rows)
        figures = make_engine(exp, make_nominal_batch(exp, rows, len(rows))).run(task.world, task.belief, task.streams)
        found.rollouts += len(rows)
        told(found.rollouts)
        return figures

    for base in (usual, {c: middle[c] for c in usual}):
        before = first = simulate(base, 0)
        for k in range(1, max(map(len, moving.values()), default=1)):
            now = simulate(base, k)
            changed = _changed(before, now)
            for place, c in enumerate(moving):
                if k < len(levels[c]):
                    acts[c][k - 1] |= changed[place]
            before = now
        for c in static:
            each = [simulate({**base, c: value}, 0) for value in levels[c]]
            for k, (a, b) in enumerate(pairwise(each)):
                acts[c][k] |= _changed(a, b).any()
        if base is usual:
            forget_engine()
            again = simulate(base, 0)
            found.irreproducible += [name for name in first if _changed({name: first[name]}, {name: again[name]}).any()]
    for c, moved in acts.items():
        yield from _stretches(c, levels[c], moved)


def _levels(values: pd.Series) -> Sequence[Any]:
    """An axis' own values in their order, at most `MOST` of them, its ends among them."""
    every = np.sort(values.unique()) if values.dtype.kind in "fi" else values.unique()
    return every[evenly_spaced_indices(len(every), MAX_LEVELS)].tolist()


def _rows(table: pd.DataFrame, base: Mapping[str, Any], levels: Levels, k: int) -> pd.DataFrame:
    """A row for each axis, at its level `k` or its last, the others as in `base`; then all at their first, and last."""
    n = max(len(levels), 1)
    columns: dict[str, Any] = {
        c: pd.Series([value] * (n + 2)).astype(table[c].dtype).array for c, value in base.items()
    }
    for place, (c, values) in enumerate(levels.items()):
        columns[c][[place, n, n + 1]] = values[min(k, len(values) - 1)], values[0], values[-1]
    return pd.DataFrame({**columns, "stream": table["stream"].iloc[0], "width": n + 2})


def _changed(a: Figures, b: Figures) -> np.ndarray:
    """Which rows (n,) of two batches differ by a bit in any figure."""
    pairs = [(np.asarray(a[name], float), np.asarray(b[name], float)) for name in a.keys() & b.keys()]
    differ = [(x != y) & ~(np.isnan(x) & np.isnan(y)) for x, y in pairs]
    return np.any(differ, axis=0) | (a.keys() != b.keys())


def _stretches(column: str, levels: Sequence[Any], moved: np.ndarray) -> Iterator[InactiveStretch]:
    """The longest stretches along which a column did not act."""
    edges = np.flatnonzero(np.diff(np.concatenate([[True], moved, [True]]).astype(int)))
    for first, last in edges.reshape(-1, 2):
        yield InactiveStretch(column, levels[first], levels[last], not moved.any())


def _said(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
