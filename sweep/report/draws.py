"""Overview figure of a study of random draws: all draws as lines, the importance of parameters, and margins to failure.

Lines and dots are one raster image inside the figure, of a sample where there are many, so that a million draws take as
much space as twelve.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from sweep.analysis import sensitivity
from sweep.core.plot_style import PAGE_WIDTH_IN, add_legend_below, limit_x_ticks, new_figure, wrap_text
from sweep.report.cells import clip_axes_at_zero
from sweep.report.figure import StudyFigure
from sweep.report.headline import study_headline
from sweep.report.labels import axis_title, axis_words, outcome_kind
from sweep.report.outcome_style import find_style, kinds_by_frequency, legend_handle, marker_path
from sweep.runs.results import Results
from sweep.study.columns import LABEL_COLUMNS

MAX_LINES_PER_KIND, MAX_DOTS, MAX_AXES = (
    600,
    20_000,
    12,
)  # that are drawn at most: of each kind of outcome, in all, and of parameters
LINEAR_MARGIN_RANGE = 0.1  # margins within which the axis is even, in units of the limit
MARGIN_COLUMN = "margin"  # column: how far a rollout stayed from its nearest limit, negative beyond it


def has_draws_figure(results: Results) -> bool:
    """Return whether the study draws parameters at random and lists fewer than the two that a map needs."""
    return bool(numeric_drawn_columns(results)) and len(results.numeric_grid_columns) < 2


def numeric_drawn_columns(results: Results) -> list[str]:
    """Return the columns of randomly drawn parameters."""
    return [
        a.column
        for a in sensitivity.numeric_axes(results.rows, sensitivity.randomly_drawn_axes(results.rows, results.exp))
    ]


def draws_figure(results: Results) -> Iterator[StudyFigure]:
    """Yield the overview figure of a study of draws; its data have a row for each rollout."""
    if not has_draws_figure(results):
        return
    columns, size = numeric_drawn_columns(results), len(results.rows)
    lines = sum(min(len(part), MAX_LINES_PER_KIND) for _, part in rows_by_outcome_kind(results.rows, ["outcome"]))
    text = "Above: a line for each rollout through its drawn values, on axes from the smallest to the largest. "
    if lines < size or len(columns) > MAX_AXES:
        text += f"{lines} of {size} lines and {min(len(columns), MAX_AXES)} of {len(columns)} parameters are shown. "
    if not {"success", "failure"} <= set(results.rows["outcome"].unique()):
        text += "Below: the rollouts over the first parameters."
    else:
        grey = "; grey where p > 0.05" if results.regional_sensitivity["p"].notna().any() else ""
        text += "Below: how differently successes and failures are distributed along each parameter "
        text += f"(Kolmogorov-Smirnov distance{grey}), and the rollouts over the two with the largest distance."
    if results.exp.study.is_adaptive:
        text += " The search placed these rollouts where it expected failures: they are no sample of the distributions."
    table = results.rows[[*columns, *LABEL_COLUMNS, "point_id"]]
    yield StudyFigure("draws", "Draws", text, table, lambda: draw_overview(results))


def rows_by_outcome_kind(rows: pd.DataFrame, columns: Sequence[str]) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield the rows of successes, then of each cause, the most frequent first, so that rarer ones are drawn on top.

    Args:
        rows: rows of a study.
        columns: columns to yield; to copy all of many rows takes long.
    """
    kind, shown = outcome_kind(rows), rows[[*dict.fromkeys(columns)]]
    for one in kinds_by_frequency(kind):
        yield one, shown[(kind == one).to_numpy()]


def draw_overview(results: Results) -> Figure:
    """Draw the overview figure of a study with randomly drawn parameters."""
    rows, ranked = results.rows, results.regional_sensitivity
    columns = list(ranked["axis"]) or numeric_drawn_columns(results)
    panels = [*(["rank"] if len(ranked) else []), "pair", "margin"]
    wide = len(columns) > 1
    figure = new_figure(5.6 if wide else 3.2)
    mosaic: list[Any] = [["lines"] * len(panels), panels] if wide else [panels]
    axes = figure.subplot_mosaic(mosaic)
    if wide:
        draw_parallel_axes(axes["lines"], results, columns[:MAX_AXES])
    if "rank" in axes:
        draw_importance_ranking(axes["rank"], ranked.head(MAX_AXES), results)
    scatter_over_two_parameters(axes["pair"], results, columns)
    draw_margins(axes["margin"], results, columns[0])
    for name in panels[-2:]:
        limit_x_ticks(axes[name], len(panels))
    handles = [
        legend_handle(kind, f"{kind.replace('_', ' ')} ({len(part):,})")
        for kind, part in rows_by_outcome_kind(rows, ["outcome"])
    ]
    add_legend_below(figure, handles)
    figure.suptitle(wrap_text(f"{results.name}: {study_headline(rows, results.exp)}", 72 * PAGE_WIDTH_IN - 20))
    return figure


def draw_parallel_axes(ax: Axes, results: Results, columns: list[str]) -> None:
    """Draw a parallel-coordinates plot: a line for each rollout across the parameter axes."""
    values = results.rows[columns].to_numpy(dtype=float)
    low, high = values.min(axis=0), values.max(axis=0)
    places = np.arange(len(columns))
    for kind, part in rows_by_outcome_kind(results.rows, columns):
        chosen = part.sample(min(len(part), MAX_LINES_PER_KIND), random_state=0).sort_index()
        shares = (chosen[columns].to_numpy(dtype=float) - low) / (high - low)
        lines = np.stack(np.broadcast_arrays(places, shares), axis=-1)
        strength = np.clip(30 / np.sqrt(len(chosen)) / 4, 0.15, 0.8)
        ax.add_collection(
            LineCollection(list(lines), colors=find_style(kind).colour, alpha=strength, linewidths=0.8, rasterized=True)
        )
    for place in range(len(columns)):
        ax.plot([place, place], [0, 1], color="0.3", linewidth=0.8)
        for at, value, side in ((-0.02, low[place], "top"), (1.02, high[place], "bottom")):
            ax.text(place, at, f"{value:.3g}", ha="center", va=side)
    room = 0.75 * 72 * PAGE_WIDTH_IN / len(columns)  # the names of the bars below have the rest
    ax.set_xticks(places, [wrap_text(axis_title(name, results.exp), room) for name in columns])
    ax.xaxis.tick_top()  # below they would be titles of the panels there
    ax.tick_params(axis="x", length=0)
    ax.set(xlim=(-0.3, len(columns) - 0.7), ylim=(-0.1, 1.1), yticks=[])
    ax.spines[:].set_visible(False)


def draw_importance_ranking(ax: Axes, ranked: pd.DataFrame, results: Results) -> None:
    """Draw how strongly each parameter is related to failure."""
    names = [axis_words(name, results.exp) for name in ranked["axis"]]
    ax.barh(names, ranked["distance"], color=["0.75" if p > 0.05 else "#00649E" for p in ranked["p"]])
    ax.invert_yaxis()
    ax.set_xlim(0, 1)
    ax.set_xlabel("distance of successes\nand failures")
    ax.spines[["top", "right"]].set_visible(False)


def scatter_over_two_parameters(ax: Axes, results: Results, columns: list[str]) -> None:
    """Scatter the rollouts over the two most important parameters; over one parameter, by outcome."""
    every = list(rows_by_outcome_kind(results.rows, columns[:2]))
    for place, (kind, part) in enumerate(every):
        x = part[columns[0]]
        y = part[columns[1]] if len(columns) > 1 else pd.Series(float(place), index=part.index)
        draw_rollout_dots(ax, x, y, kind, len(results.rows))
    ax.set_xlabel(axis_title(columns[0], results.exp))
    if len(columns) > 1:
        ax.set_ylabel(axis_title(columns[1], results.exp))
        clip_axes_at_zero(ax)
    else:
        ax.set_yticks(range(len(every)), [kind.replace("_", " ") for kind, _ in every])


def draw_margins(ax: Axes, results: Results, column: str) -> None:
    """Draw the margin of each rollout to its nearest threshold over the parameter that matters most."""
    for kind, part in rows_by_outcome_kind(results.rows, [column, MARGIN_COLUMN]):
        draw_rollout_dots(ax, part[column], part[MARGIN_COLUMN], kind, len(results.rows))
    ax.set_yscale("symlog", linthresh=LINEAR_MARGIN_RANGE)
    ax.axhline(0, color="0.3", linewidth=0.8, linestyle="--")
    ax.set_xlabel(axis_title(column, results.exp))
    ax.set_ylabel("margin to the nearest limit")


def draw_rollout_dots(ax: Axes, x: pd.Series, y: pd.Series, kind: str, total: int) -> None:
    """Draw the rollouts of one outcome kind as dots; a random part if the plot would exceed `MAX_DOTS` in total.

    More rollouts get smaller dots.
    """
    number = max(1, round(len(x) * min(1.0, MAX_DOTS / total)))
    chosen = x.sample(number, random_state=0).index
    size = np.clip(600 / np.sqrt(total), 1.5, 40)
    edge: dict[str, Any] = {"edgecolors": "white", "linewidths": 0.2} if total < 500 else {"linewidths": 0}
    ax.scatter(
        x[chosen], y[chosen], s=size, c=find_style(kind).colour, marker=marker_path(kind), rasterized=True, **edge
    )
