"""Which rows of a study are worth a replay: typical ones, both sides of the boundary, extremes, then the others."""

from collections.abc import Iterator
from itertools import chain, zip_longest
from typing import Any

import numpy as np
import pandas as pd

from sweep.analysis.sample import some
from sweep.report.exhibits import judged_first
from sweep.report.labels import heading, unit_of
from sweep.report.tables import text
from sweep.report.typical import typical
from sweep.runs import audit
from sweep.runs.results import Results

SHORTEST = 0.2  # s, of a rollout that there is something to see of
MANY = 20_000  # rows that are searched for distant ones


def chosen(results: Results, number: int) -> pd.DataFrame:
    """At most `number` rows, the most telling first, with the reason for each as the column `why`."""
    rows = results.rows
    alike = [(rows.index.get_loc(one.row.name), f"typical of {one.kind.replace('_', ' ')}") for one in typical(results)]
    turns = zip_longest(boundary(results), extremes(results), spread(results))
    every = chain(alike, *([one for one in turn if one] for turn in turns))
    long = rows["duration_s"].to_numpy(dtype=float) >= SHORTEST if "duration_s" in rows else np.ones(len(rows), bool)
    found: dict[Any, str] = {}  # by place
    for index, why in every:
        if len(found) == number:
            break
        if long[index] and index not in found:
            found[index] = why
    return rows.iloc[list(found)].assign(why=list(found.values()))


def boundary(results: Results) -> Iterator[tuple[int, str]]:
    """Rows next to the boundary, far from each other, each followed by its nearest neighbour on the other side."""
    near = np.flatnonzero(audit.boundary(results))
    place, win = places(results)[near], (results.rows["outcome"] == "success").to_numpy()[near]
    for k in distant(place):
        others = np.flatnonzero(win != win[k])
        pair = (k, others[np.argmin(np.linalg.norm(place[others] - place[k], axis=1))])
        for one in pair:
            yield int(near[one]), f"next to the boundary, {'inside' if win[one] else 'outside'}"


def extremes(results: Results) -> Iterator[tuple[int, str]]:
    """Rows where a figure is largest or least, those that outcomes are judged by first."""
    for name in judged_first(results):
        values = results.rows[name].to_numpy(dtype=float)
        if np.isfinite(values).any():
            finite = np.where(np.isfinite(values), values, np.nan)
            for word, k in (("largest", np.nanargmax(finite)), ("least", np.nanargmin(finite))):
                unit = unit_of(name, results.exp)
                yield int(k), f"{word} {heading(name)}: {text(finite[k])}{' ' + unit if unit else ''}"


def spread(results: Results) -> Iterator[tuple[int, str]]:
    """All rows, or a sample, each as far as can be from those before it."""
    every = some(len(results.rows), MANY)
    yield from ((int(every[k]), "far from the others") for k in distant(places(results)[every]))


def places(results: Results) -> np.ndarray:
    """Rows (N, K) in units of the range of each number that was varied; of names, one apart where they differ."""
    columns = [pd.factorize(results.rows[c])[0].astype(float) for c in results.named]
    columns += [results.rows[c].to_numpy(dtype=float) for c in results.numeric]
    values = np.column_stack(columns) if columns else np.zeros((len(results.rows), 1))
    size = values.max(axis=0, initial=0) - values.min(axis=0, initial=0)
    return values / np.where(size > 0, size, 1.0)


def distant(places: np.ndarray) -> Iterator[int]:
    """Indices of points (N, K), each the farthest from all before it; the first is the one next to their mean."""
    if not len(places):
        return
    least = np.full(len(places), np.inf)
    k = int(np.argmin(np.linalg.norm(places - places.mean(axis=0), axis=1)))
    for _ in range(len(places)):
        yield k
        least = np.minimum(least, np.linalg.norm(places - places[k], axis=1))
        least[k] = -1.0
        k = int(np.argmax(least))
