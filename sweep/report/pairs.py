"""Comparison page of `sweep report A B` about the points that two studies share; each row is a pair of rollouts."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from sweep.analysis import compare
from sweep.analysis.compare import SECOND_RUN_MARK
from sweep.analysis.stats import bin_values
from sweep.core.outcomes import FAILURE, INVALID, SUCCESS
from sweep.core.plot_style import PAGE_WIDTH_IN, new_figure, wrap_text
from sweep.core.spacing import evenly_spaced_indices
from sweep.report import maps, replays
from sweep.report.cells import MapCells, label_axis_values
from sweep.report.comparison import default_region_parameters, describe_pair_columns
from sweep.report.figure import StudyFigure
from sweep.report.labels import axis_title, axis_words
from sweep.report.page.replay_data import ShownReplay
from sweep.runs.results import Results

BOTH_FAIL, ONLY_A, ONLY_B, INVALID_IN_ONE = "both_fail", "only_A_succeeds", "only_B_succeeds", "invalid_in_one"
BINS_PER_AXIS = 20  # along an axis of more values than this
MAX_LISTED_PAIRS = 25  # pairs that differ, in the table
RATE_COLOURS = {"cmap": "cividis", "vmin": 0, "vmax": 1}
CHANGE_COLOURS = {"cmap": "RdBu", "vmin": -1, "vmax": 1}  # blue as success is where B gains


def join_pairs(a: Results, b: Results) -> tuple[Results, pd.DataFrame]:
    """Pair the rows of two studies that have equal points.

    Args:
        a: first study.
        b: second study.

    Returns:
        The rows of A that have a pair, whose cause is what became of both; and the pairs, see `compare.pair`.

    Raises:
        InputError: the studies share no points.
    """
    pairs = compare.pair_rows(a.rows, b.rows)
    one, other = pairs["outcome"], pairs[f"outcome{SECOND_RUN_MARK}"]
    choices = [(one == INVALID) | (other == INVALID), (one == SUCCESS) & (other == SUCCESS), one == SUCCESS]
    cause = np.select([*choices, other == SUCCESS], [INVALID_IN_ONE, "", ONLY_A, ONLY_B], BOTH_FAIL)
    rows = pairs[list(a.rows.columns)].assign(cause=cause, outcome=np.where(cause == "", SUCCESS, FAILURE))
    return replace(a, rows=rows), pairs


def split_sides(pairs: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Return outcome and cause of the rollout of A and of that of B of each pair, by the name of the side."""
    return {
        side: pairs[[f"outcome{mark}", f"cause{mark}"]].set_axis(["outcome", "cause"], axis="columns")
        for side, mark in (("A", ""), ("B", SECOND_RUN_MARK))
    }


def pairs_headline(pairs: pd.DataFrame, unit: np.ndarray | None = None) -> str:
    """State in a sentence how many outcomes differ between two studies, and whether chance explains it.

    Args:
        pairs: paired rows.
        unit: independent unit of each pair (n,); None where pairs are no sample.
    """
    return f"{compare.count_flips(pairs, unit)}."


def describe_pair_origin(pairs: pd.DataFrame, a: Path, b: Path) -> str:
    """Say in a sentence which studies the pairs come from.

    Args:
        pairs: paired rows.
        a: folder of the first study.
        b: folder of the second study.
    """
    return f"A is {a}, B is {b}: {len(pairs):,} pairs{describe_pair_columns(pairs)}."


def pairs_tables(pairs: pd.DataFrame, unit: np.ndarray | None = None) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield titled tables of paired rollouts: changes by region of the parameters, by cause, and the pairs that differ.

    Args:
        pairs: paired rows, see `compare.pair`.
        unit: independent unit of each pair (n,), for p-values; None where pairs are no sample.

    Returns:
        Title and table of each; nothing if all outcomes agree.
    """
    if not compare.outcome_change_mask(pairs).any():
        return
    if axes := default_region_parameters(pairs):
        words = " and ".join(map(axis_words, axes))
        test = "" if unit is None else " (McNemar's p, and corrected for so many)"
        yield f"Flips by region of {words}{test}", compare.flips_by_region(pairs, axes, unit)
    yield "What became what", compare.count_cause_transitions(pairs)
    yield "Pairs that differ", compare.changed_pairs(pairs).head(MAX_LISTED_PAIRS)


def replay_flipped_pairs(a: Results, b: Results, number: int, progress: Callable[[int, int], None]) -> None:
    """Simulate again pairs of which only one rollout succeeds, and store their replays in both folders.

    Args:
        a: first study.
        b: second study.
        number: how many pairs at most, evenly over all that differ.
        progress: called with rollouts done and in all.
    """
    found, pairs = join_pairs(a, b)
    flipped = np.flatnonzero(found.rows["cause"].isin([ONLY_A, ONLY_B]))
    some = flipped[evenly_spaced_indices(len(flipped), number)]
    for side, names in ((a, replay_file_names(pairs, "")), (b, replay_file_names(pairs, SECOND_RUN_MARK))):
        rows = side.rows[replay_file_names(side.rows, "").isin(names.iloc[some])]
        replays.make_replays(side, rows.assign(why="one succeeds, the other fails"), progress)


def read_pair_replays(a: Results, b: Results) -> Iterator[ShownReplay]:
    """Yield the stored replays of pairs, each rollout of A before that of B.

    Args:
        a: first study.
        b: second study.
    """
    found, pairs = join_pairs(a, b)
    of_b = {
        name: kept for place, kept in replays.read_replays(b) for name in replay_file_names(b.rows.iloc[[place]], "")
    }
    names = replay_file_names(pairs, SECOND_RUN_MARK)
    for place, kept in replays.read_replays(replace(a, rows=found.rows)):
        row, pair = found.rows.iloc[place], pairs.iloc[place]
        for side, mark, replay in (("A", "", kept), ("B", SECOND_RUN_MARK, of_b.get(names.iloc[place]))):
            if replay:
                came = (pair[f"cause{mark}"] or SUCCESS).replace("_", " ")
                yield ShownReplay(-1 if mark else place, row, replay, f"{side} {came}, {row['point_id'][:6]}")


def replay_file_names(rows: pd.DataFrame, mark: str) -> pd.Series:
    """Return the name of each row's replay file, from the columns whose names end in `mark`."""
    point = rows[f"point_id{mark}"] if f"point_id{mark}" in rows else rows["point_id"]
    return rows[f"run_id{mark}"].astype(str) + "-" + point.astype(str)


def difference_figure(difference: Results, pairs: pd.DataFrame) -> Iterator[StudyFigure]:
    """Yield the figure with maps of the success rates of studies A and B and of their difference.

    Args:
        found: rows of A that have a pair, see `join_pairs`.
        pairs: paired rows.
    """
    axes = default_region_parameters(pairs)
    if len(axes) == 2:
        x, y = axes
        valid = (pairs["outcome"] != INVALID) & (pairs[f"outcome{SECOND_RUN_MARK}"] != INVALID)
        data = pairs.loc[valid, [x, y, "outcome", f"outcome{SECOND_RUN_MARK}"]].reset_index(drop=True)
        title = f"{axis_words(y, difference.exp)} by {axis_words(x, difference.exp)}"
        caption = "Rate of success of A, of B, and B's less A's, of the pairs that are valid in both."
        yield StudyFigure("difference", title, caption, data, lambda: draw_difference(difference, data, x, y))


def draw_difference(difference: Results, data: pd.DataFrame, x: str, y: str) -> Figure:
    """Draw maps of the success rates of studies A and B and of their difference over the same cells."""
    places = {"x": bin_values(data[x], BINS_PER_AXIS), "y": bin_values(data[y], BINS_PER_AXIS)}
    won, won_b = (data[f"outcome{mark}"] == SUCCESS for mark in ("", SECOND_RUN_MARK))
    own = data.assign(**places, a=won.astype(float), b=won_b.astype(float), change=won_b.astype(float) - won)
    cells = MapCells(np.sort(own["x"].unique()), np.sort(own["y"].unique()))
    figure = new_figure(2.4)
    spots = figure.subplots(1, 3, sharex=True, sharey=True)
    looks = {"a": ("A", RATE_COLOURS), "b": ("B", RATE_COLOURS), "change": ("B less A", CHANGE_COLOURS)}
    for ax, (column, (title, look)) in zip(spots, looks.items(), strict=True):
        maps.draw_cells(ax, maps.cell_means(own, cells, column), cells, **look)
        label_axis_values(ax, cells)
        ax.set_title(title)
        ax.set_xlabel(wrap_text(axis_title(x, difference.exp), 72 * PAGE_WIDTH_IN / 4))
    spots[0].set_ylabel(axis_title(y, difference.exp))
    for ax, look, label in (
        (spots[1], RATE_COLOURS, "rate of success"),
        (spots[2], CHANGE_COLOURS, "difference of rates"),
    ):
        scale = ScalarMappable(Normalize(look["vmin"], look["vmax"]), look["cmap"])
        figure.colorbar(scale, ax=ax, label=label, shrink=0.8)
    return figure
