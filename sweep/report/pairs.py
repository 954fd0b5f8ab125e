"""`sweep report A B`: the same points of two studies on one page, each pair a row, with what became of it in both."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from sweep.analysis import compare
from sweep.analysis.compare import SECOND
from sweep.analysis.stats import binned
from sweep.core.outcomes import FAILURE, INVALID, SUCCESS
from sweep.core.plot_style import PAGE, new_figure, wrap_text
from sweep.core.spacing import evenly_spaced_indices
from sweep.report import maps, replays
from sweep.report.cells import Cells, mark_values
from sweep.report.comparison import default_regions, paired_by
from sweep.report.exhibit import Exhibit
from sweep.report.labels import axis_words, beside_axis
from sweep.report.page.stage import Shown
from sweep.runs.results import Results

BOTH_FAIL, ONLY_A, ONLY_B, DOUBTED = "both_fail", "only_A_succeeds", "only_B_succeeds", "invalid_in_one"
BINS = 20  # along an axis of more values than this
LISTED = 25  # pairs that differ, in the table
RATE = {"cmap": "cividis", "vmin": 0, "vmax": 1}
CHANGE = {"cmap": "RdBu", "vmin": -1, "vmax": 1}  # blue as success is where B gains


def joined(a: Results, b: Results) -> tuple[Results, pd.DataFrame]:
    """The rows of A that have a pair in B, their cause being what came of both, and the pairs. Raises `InputError`."""
    pairs = compare.pair(a.rows, b.rows)
    one, other = pairs["outcome"], pairs[f"outcome{SECOND}"]
    choices = [(one == INVALID) | (other == INVALID), (one == SUCCESS) & (other == SUCCESS), one == SUCCESS]
    cause = np.select([*choices, other == SUCCESS], [DOUBTED, "", ONLY_A, ONLY_B], BOTH_FAIL)
    rows = pairs[list(a.rows.columns)].assign(cause=cause, outcome=np.where(cause == "", SUCCESS, FAILURE))
    return replace(a, rows=rows), pairs


def headline(pairs: pd.DataFrame, a: Path, b: Path) -> str:
    """How many outcomes differ, and whether that is more than chance, in a sentence."""
    return f"A is {a}, B is {b}: {len(pairs):,} pairs{paired_by(pairs)}. {compare.flips(pairs)}."


def tables(pairs: pd.DataFrame) -> Iterator[tuple[str, pd.DataFrame]]:
    """By region, by cause, and the pairs that differ."""
    if not compare.changed(pairs).any():
        return
    if axes := default_regions(pairs):
        words = " and ".join(map(axis_words, axes))
        yield f"Flips by region of {words} (McNemar's p, and corrected for so many)", compare.regions(pairs, axes)
    yield "What became what", compare.causes(pairs)
    yield "Pairs that differ", compare.differences(pairs).head(LISTED)


def simulated(a: Results, b: Results, number: int, progress: Callable[[int, int], None]) -> None:
    """Keep replays, in both folders, of at most `number` pairs of which one succeeds alone, evenly over all of them."""
    found, pairs = joined(a, b)
    flipped = np.flatnonzero(found.rows["cause"].isin([ONLY_A, ONLY_B]))
    some = flipped[evenly_spaced_indices(len(flipped), number)]
    for side, names in ((a, identity(pairs, "")), (b, identity(pairs, SECOND))):
        rows = side.rows[identity(side.rows, "").isin(names.iloc[some])]
        replays.make(side, rows.assign(why="one succeeds, the other fails"), progress)


def shown(a: Results, b: Results) -> Iterator[Shown]:
    """The kept replays of pairs: that of A by its place, and that of B by the same point and no place."""
    found, pairs = joined(a, b)
    of_b = {name: kept for place, kept in replays.kept(b) for name in identity(b.rows.iloc[[place]], "")}
    names = identity(pairs, SECOND)
    for place, kept in replays.kept(replace(a, rows=found.rows)):
        row, pair = found.rows.iloc[place], pairs.iloc[place]
        for side, mark, replay in (("A", "", kept), ("B", SECOND, of_b.get(names.iloc[place]))):
            if replay:
                came = (pair[f"cause{mark}"] or SUCCESS).replace("_", " ")
                yield Shown(-1 if mark else place, row, replay, f"{side} {came}, {row['point_id'][:6]}")


def identity(rows: pd.DataFrame, mark: str) -> pd.Series:
    """What names a rollout and its replay, of the columns that have this mark."""
    point = rows[f"point_id{mark}"] if f"point_id{mark}" in rows else rows["point_id"]
    return rows[f"run_id{mark}"].astype(str) + "-" + point.astype(str)


def exhibits(found: Results, pairs: pd.DataFrame) -> Iterator[Exhibit]:
    """Where each succeeds and where they differ, on the same axes."""
    axes = default_regions(pairs)
    if len(axes) == 2:
        x, y = axes
        valid = (pairs["outcome"] != INVALID) & (pairs[f"outcome{SECOND}"] != INVALID)
        data = pairs.loc[valid, [x, y, "outcome", f"outcome{SECOND}"]].reset_index(drop=True)
        title = f"{axis_words(y, found.exp)} by {axis_words(x, found.exp)}"
        caption = "Rate of success of A, of B, and B's less A's, of the pairs that are valid in both."
        yield Exhibit("difference", title, caption, data, lambda: draw(found, data, x, y))


def draw(found: Results, data: pd.DataFrame, x: str, y: str) -> Figure:
    """Three maps of the same cells: A, B, the difference."""
    places = {"x": binned(data[x], BINS), "y": binned(data[y], BINS)}
    won, won_b = (data[f"outcome{mark}"] == SUCCESS for mark in ("", SECOND))
    own = data.assign(**places, a=won.astype(float), b=won_b.astype(float), change=won_b.astype(float) - won)
    cells = Cells(np.sort(own["x"].unique()), np.sort(own["y"].unique()))
    figure = new_figure(2.4)
    spots = figure.subplots(1, 3, sharex=True, sharey=True)
    looks = {"a": ("A", RATE), "b": ("B", RATE), "change": ("B less A", CHANGE)}
    for ax, (column, (title, look)) in zip(spots, looks.items(), strict=True):
        maps.coloured(ax, maps.means(own, cells, column), cells, **look)
        mark_values(ax, cells)
        ax.set_title(title)
        ax.set_xlabel(wrap_text(beside_axis(x, found.exp), 72 * PAGE / 4))
    spots[0].set_ylabel(beside_axis(y, found.exp))
    for ax, look, label in ((spots[1], RATE, "rate of success"), (spots[2], CHANGE, "difference of rates")):
        scale = ScalarMappable(Normalize(look["vmin"], look["vmax"]), look["cmap"])
        figure.colorbar(scale, ax=ax, label=label, shrink=0.8)
    return figure
