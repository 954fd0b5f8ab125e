"""What came of draws: every drawn parameter beside the others, which of them matter, and how near to failure it was.

Lines and dots are one picture inside the figure, of a sample where there are many, so that 12 draws and a million of
them take the same room.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from sweep.analysis import sensitivity
from sweep.core.errors import InputError
from sweep.core.plot_style import PAGE, fit_ticks, legend_below, new_figure, wrap_text
from sweep.report.cells import not_below_zero
from sweep.report.exhibit import Exhibit
from sweep.report.headline import headline
from sweep.report.labels import axis_words, beside_axis, kind_of
from sweep.report.looks import handle, kinds_by_number, look_of, marker
from sweep.runs.results import Results
from sweep.study.columns import LABELS

LINES, DOTS, AXES = 600, 20_000, 12  # that are drawn at most: of each kind of outcome, in all, and of parameters
LINEAR = 0.1  # margins within which the axis is even, in units of the limit
MARGIN = "margin"  # column: how far a rollout stayed from its nearest limit, negative beyond it


def shown(results: Results) -> bool:
    """Whether the study is one of draws: with fewer than two listed numbers that a map could be drawn over."""
    return bool(columns_of(results)) and len(results.listed) < 2


def columns_of(results: Results) -> list[str]:
    """The columns of drawn numbers."""
    return [a.column for a in sensitivity.numeric(results.rows, sensitivity.drawn(results.rows, results.exp))]


def importance(results: Results) -> pd.DataFrame:
    """Regional sensitivity (see `sensitivity.regional`); empty where all draws succeed or all fail."""
    try:
        return sensitivity.regional(results.rows, results.exp)
    except InputError:
        return pd.DataFrame({"axis": [], "distance": [], "p": []})


def exhibits(results: Results) -> Iterator[Exhibit]:
    """What came of draws, parameter by parameter, with a row for each rollout."""
    if not shown(results):
        return
    columns, size = columns_of(results), len(results.rows)
    lines = sum(min(len(part), LINES) for _, part in kinds(results.rows))
    text = "Above: a line for each rollout through its drawn values, each axis from the least to the largest. "
    if lines < size or len(columns) > AXES:
        text += f"{lines} of {size} lines and {min(len(columns), AXES)} of {len(columns)} parameters are shown. "
    if not {"success", "failure"} <= set(results.rows["outcome"]):
        text += "Below: the rollouts over the first parameters."
    else:
        text += "Below: how differently each parameter is distributed among successes and failures (Kolmogorov and "
        text += "Smirnov's distance; grey where p > 0.05), and the rollouts over the parameters that matter most."
    table = results.rows[[*columns, *LABELS, "point_id"]]
    yield Exhibit("draws", "Draws", text, table, lambda: draw(results))


def kinds(rows: pd.DataFrame) -> Iterator[tuple[str, pd.DataFrame]]:
    """Successes, then each cause, the most frequent first: rarer ones are drawn over them."""
    kind = kind_of(rows)
    for one in kinds_by_number(kind):
        yield one, rows[(kind == one).to_numpy()]


def draw(results: Results) -> Figure:
    """Draw what came of draws."""
    rows, ranked = results.rows, importance(results)
    columns = list(ranked["axis"]) or columns_of(results)
    panels = [*(["rank"] if len(ranked) else []), "pair", "margin"]
    wide = len(columns) > 1
    figure = new_figure(5.6 if wide else 3.2)
    mosaic: list[Any] = [["lines"] * len(panels), panels] if wide else [panels]
    axes = figure.subplot_mosaic(mosaic)
    if wide:
        parallel(axes["lines"], results, columns[:AXES])
    if "rank" in axes:
        bars(axes["rank"], ranked.head(AXES), results)
    pair(axes["pair"], results, columns)
    margins(axes["margin"], results, columns[0])
    for name in panels[-2:]:
        fit_ticks(axes[name], len(panels))
    handles = [handle(kind, f"{kind.replace('_', ' ')} ({len(part):,})") for kind, part in kinds(rows)]
    legend_below(figure, handles)
    figure.suptitle(wrap_text(f"{results.name}: {headline(rows, results.exp)}", 72 * PAGE - 20))
    return figure


def parallel(ax: Axes, results: Results, columns: list[str]) -> None:
    """A line for each rollout, from axis to axis."""
    values = results.rows[columns].to_numpy(dtype=float)
    low, high = values.min(axis=0), values.max(axis=0)
    places = np.arange(len(columns))
    for kind, part in kinds(results.rows):
        chosen = part.sample(min(len(part), LINES), random_state=0).sort_index()
        shares = (chosen[columns].to_numpy(dtype=float) - low) / (high - low)
        lines = np.stack(np.broadcast_arrays(places, shares), axis=-1)
        strength = np.clip(30 / np.sqrt(len(chosen)) / 4, 0.15, 0.8)
        ax.add_collection(
            LineCollection(list(lines), colors=look_of(kind).colour, alpha=strength, linewidths=0.8, rasterized=True)
        )
    for place in range(len(columns)):
        ax.plot([place, place], [0, 1], color="0.3", linewidth=0.8)
        for at, value, side in ((-0.02, low[place], "top"), (1.02, high[place], "bottom")):
            ax.text(place, at, f"{value:.3g}", ha="center", va=side)
    room = 0.75 * 72 * PAGE / len(columns)  # the names of the bars below have the rest
    ax.set_xticks(places, [wrap_text(beside_axis(name, results.exp), room) for name in columns])
    ax.xaxis.tick_top()  # below they would be titles of the panels there
    ax.tick_params(axis="x", length=0)
    ax.set(xlim=(-0.3, len(columns) - 0.7), ylim=(-0.1, 1.1), yticks=[])
    ax.spines[:].set_visible(False)


def bars(ax: Axes, ranked: pd.DataFrame, results: Results) -> None:
    """How much each parameter has to do with failure."""
    names = [axis_words(name, results.exp) for name in ranked["axis"]]
    ax.barh(names, ranked["distance"], color=["#00649E" if p <= 0.05 else "0.75" for p in ranked["p"]])
    ax.invert_yaxis()
    ax.set_xlim(0, 1)
    ax.set_xlabel("distance of successes\nand failures")
    ax.spines[["top", "right"]].set_visible(False)


def pair(ax: Axes, results: Results, columns: list[str]) -> None:
    """The rollouts over the two parameters that matter most; over a single one, a line for each kind of outcome."""
    every = list(kinds(results.rows))
    for place, (kind, part) in enumerate(every):
        x = part[columns[0]]
        y = part[columns[1]] if len(columns) > 1 else pd.Series(float(place), index=part.index)
        dots(ax, x, y, kind, len(results.rows))
    ax.set_xlabel(beside_axis(columns[0], results.exp))
    if len(columns) > 1:
        ax.set_ylabel(beside_axis(columns[1], results.exp))
        not_below_zero(ax)
    else:
        ax.set_yticks(range(len(every)), [kind.replace("_", " ") for kind, _ in every])


def margins(ax: Axes, results: Results, column: str) -> None:
    """How far from their nearest limit the rollouts stay, over the parameter that matters most."""
    for kind, part in kinds(results.rows):
        dots(ax, part[column], part[MARGIN], kind, len(results.rows))
    ax.set_yscale("symlog", linthresh=LINEAR)
    ax.axhline(0, color="0.3", linewidth=0.8, linestyle="--")
    ax.set_xlabel(beside_axis(column, results.exp))
    ax.set_ylabel("margin to the nearest limit")


def dots(ax: Axes, x: pd.Series, y: pd.Series, kind: str, total: int) -> None:
    """A share of the rollouts of a kind, so that `DOTS` are drawn in all; smaller ones the more there are."""
    number = max(1, round(len(x) * min(1.0, DOTS / total)))
    chosen = x.sample(number, random_state=0).index
    size = np.clip(600 / np.sqrt(total), 1.5, 40)
    edge: dict[str, Any] = {"edgecolors": "white", "linewidths": 0.2} if total < 500 else {"linewidths": 0}
    ax.scatter(x[chosen], y[chosen], s=size, c=look_of(kind).colour, marker=marker(kind), rasterized=True, **edge)
