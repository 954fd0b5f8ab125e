"""Choose the rows of a study that are worth a replay.

In this order: the nominal rollout, a typical success, one of each main cause, a pair across the boundary, one of each
further cause, then by turns further pairs, extreme values of metrics, and rows far from all others.
"""

from collections.abc import Iterator
from itertools import chain, islice, zip_longest
from typing import Any

import numpy as np
import pandas as pd

from sweep.analysis.sample import random_subset_indices
from sweep.core.outcomes import SUCCESS
from sweep.report.figures import metrics_with_threshold_first
from sweep.report.labels import column_unit, label_with_unit
from sweep.report.representative import find_representatives
from sweep.report.tables import format_value
from sweep.runs import audit
from sweep.runs.results import Results

MAIN_CAUSES = 2  # causes, the most frequent ones, that come before the boundary
MIN_DURATION_S = 0.2  # s, of a rollout that there is something to see of
MAX_SEARCHED_ROWS = 20_000  # rows that a choice looks at, drawn at random from larger studies


def choose_replays(results: Results, number: int) -> pd.DataFrame:
    """Choose rows for replays, the most informative first.

    Args:
        results: study with its rows.
        number: how many rows at most.

    Returns:
        The rows, with the reason for each in the column `why`.
    """
    rows = results.rows
    kinds = sorted(find_representatives(results), key=lambda one: (one.kind != SUCCESS, -one.number))
    alike = [(rows.index.get_loc(one.row.name), f"typical of {one.kind.replace('_', ' ')}") for one in kinds]
    pairs = choose_boundary_rows(results)
    first = [*choose_nominal_row(results), *alike[: 1 + MAIN_CAUSES], *islice(pairs, 2), *alike[1 + MAIN_CAUSES :]]
    turns = zip_longest(pairs, choose_extreme_rows(results), choose_spread_rows(results))
    every = chain(first, *([one for one in turn if one] for turn in turns))
    long = (
        rows["duration_s"].to_numpy(dtype=float) >= MIN_DURATION_S if "duration_s" in rows else np.ones(len(rows), bool)
    )
    found: dict[Any, str] = {}  # by place
    for index, why in every:
        if len(found) == number:
            break
        if long[index] and index not in found:
            found[index] = why
    return rows.iloc[list(found)].assign(why=list(found.values()))


def choose_nominal_row(results: Results) -> Iterator[tuple[int, str]]:
    """Yield the index of the row nearest to nominal parameters, with a reason; nothing without nominal values."""
    columns = [c for c in (*results.categorical_columns, *results.numeric_columns) if not c.startswith("axis.")]
    if not columns or results.rows.empty:
        return
    away = np.zeros(len(results.rows))
    for column in columns:
        values, nominal = results.rows[column], results.exp.system.nominal_parameter_value(column, results.exp.settings)
        if column in results.numeric_columns:
            numbers = values.to_numpy(dtype=float)
            away += ((numbers - float(nominal)) / np.ptp(numbers)) ** 2
        else:
            away += (values.astype(str) != str(nominal)).to_numpy()
    nearest = int(np.argmin(away))
    yield nearest, "nominal parameters" if away[nearest] == 0 else "nearest to the nominal parameters"


def choose_boundary_rows(results: Results) -> Iterator[tuple[int, str]]:
    """Yield indices of rows next to the boundary of success, each with its nearest row of opposite outcome."""
    near = np.flatnonzero(audit.boundary_mask(results))
    place, win = scaled_parameters(results)[near], (results.rows["outcome"] == "success").to_numpy()[near]
    for k in farthest_point_order(place):
        others = np.flatnonzero(win != win[k])
        pair = (k, others[np.argmin(np.linalg.norm(place[others] - place[k], axis=1))])
        for one in pair:
            yield int(near[one]), f"next to the boundary, {'inside' if win[one] else 'outside'}"


def choose_extreme_rows(results: Results) -> Iterator[tuple[int, str]]:
    """Yield indices of rows with the largest or smallest value of a metric; metrics with a threshold come first."""
    for name in metrics_with_threshold_first(results):
        values = results.rows[name].to_numpy(dtype=float)
        if np.isfinite(values).any():
            finite = np.where(np.isfinite(values), values, np.nan)
            for word, k in (("largest", np.nanargmax(finite)), ("least", np.nanargmin(finite))):
                unit = column_unit(name, results.exp)
                yield int(k), f"{word} {label_with_unit(name)}: {format_value(finite[k])}{' ' + unit if unit else ''}"


def choose_spread_rows(results: Results) -> Iterator[tuple[int, str]]:
    """Yield indices of rows, each as far in parameter space as possible from those before it."""
    every = random_subset_indices(len(results.rows), MAX_SEARCHED_ROWS)
    yield from ((int(every[k]), "far from all others") for k in farthest_point_order(scaled_parameters(results)[every]))


def scaled_parameters(results: Results) -> np.ndarray:
    """Return the parameters of each row (N, K), scaled by their ranges; names are numbered before scaling."""
    columns = [pd.factorize(results.rows[c])[0].astype(float) for c in results.categorical_columns]
    columns += [results.rows[c].to_numpy(dtype=float) for c in results.numeric_columns]
    values = np.column_stack(columns) if columns else np.zeros((len(results.rows), 1))
    size = values.max(axis=0, initial=0) - values.min(axis=0, initial=0)
    return values / np.where(size > 0, size, 1.0)


def farthest_point_order(places: np.ndarray) -> Iterator[int]:
    """Order points (N, K) so that each is the farthest from all earlier ones; the first is closest to the mean."""
    if not len(places):
        return
    least = np.full(len(places), np.inf)
    k = int(np.argmin(np.linalg.norm(places - places.mean(axis=0), axis=1)))
    for _ in range(len(places)):
        yield k
        least = np.minimum(least, np.linalg.norm(places - places[k], axis=1))
        least[k] = -1.0
        k = int(np.argmax(least))
