"""What came of draws: every drawn parameter beside the others, which of them matter, and how near to failure it was.

Lines and dots are one picture inside the figure, of a sample where there are many, so that 12 draws and a million of
them take the same room.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from sweep.analysis import sensitivity
from sweep.analysis.sample import pooled
from sweep.core.errors import InputError
from sweep.metrics.outcome import MEANING
from sweep.report.cells import not_below_zero
from sweep.report.labels import CAUSE_COLOURS, axis_words, heading, kind_of
from sweep.runs.results import Results
from sweep.study.columns import LABELS

LINES, DOTS, AXES = 600, 20_000, 12  # that are drawn at most: of each kind of outcome, in all, and of parameters
GOOD, DOUBTFUL = "#56B4E9", "0.55"  # on white, where the pale blue of maps could not be seen
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


def write(results: Results, folder: Path) -> list[Path]:
    """Write draws.png and draws.svg."""
    folder.mkdir(parents=True, exist_ok=True)
    figure = draw(results)
    paths = [folder / f"draws.{form}" for form in ("png", "svg")]
    with mpl.rc_context({"svg.hashsalt": "sweep", "svg.fonttype": "none"}):
        for path in paths:
            figure.savefig(path, dpi=150, metadata={"Date": None} if path.suffix == ".svg" else None)
    return paths


def data(results: Results) -> pd.DataFrame:
    """What is drawn, a row for each rollout."""
    return results.rows[[*columns_of(results), *LABELS, "point_id"]]


def caption(results: Results) -> str:
    """The figure in words."""
    columns, size = columns_of(results), len(results.rows)
    lines = sum(min(len(part), LINES) for _, part in kinds(results.rows))
    text = "Above: a line for each rollout through its drawn values, each axis from the least to the largest. "
    if lines < size or len(columns) > AXES:
        text += f"{lines} of {size} lines and {min(len(columns), AXES)} of {len(columns)} parameters are shown. "
    if not {"success", "failure"} <= set(results.rows["outcome"]):
        return text + "Below: the rollouts over the first parameters."
    text += "Below: how differently each parameter is distributed among successes and failures (Kolmogorov and "
    return text + "Smirnov's distance; grey where p > 0.05), and the rollouts over the parameters that matter most."


def kinds(rows: pd.DataFrame) -> Iterator[tuple[str, pd.DataFrame]]:
    """Successes, then each cause, the most frequent first: rarer ones are drawn over them."""
    kind = kind_of(rows)
    order = sorted(kind.unique(), key=lambda one: (one != "success", -int((kind == one).sum())))
    for one in order:
        yield str(one), rows[(kind == one).to_numpy()]


def colour(kind: str) -> str:
    """Of a success or of a cause, doubts in grey."""
    if kind == "success":
        return GOOD
    found = CAUSE_COLOURS.get(kind, DOUBTFUL)
    return DOUBTFUL if found.upper() == "#FFFFFF" else found


def draw(results: Results) -> Figure:
    """The figure."""
    rows, ranked = results.rows, importance(results)
    columns = list(ranked["axis"]) or columns_of(results)
    panels = [*(["rank"] if len(ranked) else []), "pair", "margin"]
    wide = len(columns) > 1
    figure = Figure(figsize=(9.5, 7.4 if wide else 4.2), layout="constrained")
    mosaic: list[Any] = [["lines"] * len(panels), panels] if wide else [panels]
    axes = figure.subplot_mosaic(mosaic)
    if wide:
        parallel(axes["lines"], results, columns[:AXES])
    if "rank" in axes:
        bars(axes["rank"], ranked.head(AXES), results)
    pair(axes["pair"], results, columns)
    if "margin" in axes:
        margins(axes["margin"], results, columns[0])
    handles = [
        Line2D([], [], color=colour(kind), marker="o", label=f"{kind.replace('_', ' ')} ({len(part)})")
        for kind, part in kinds(rows)
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 5), fontsize=8)
    figure.suptitle(f"{results.name}: {pooled(rows, results.exp)}", fontsize=10)
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
            LineCollection(list(lines), colors=colour(kind), alpha=strength, linewidths=0.8, rasterized=True)
        )
    for place in range(len(columns)):
        ax.plot([place, place], [0, 1], color="0.3", linewidth=0.8)
        for at, value, side in ((-0.02, low[place], "top"), (1.02, high[place], "bottom")):
            ax.text(place, at, f"{value:.3g}", ha="center", va=side, fontsize=7)
    names = [heading(name, results.exp).replace(" (", "\n(").replace(" [", "\n[") for name in columns]
    ax.set_xticks(places, names, fontsize=8 if len(columns) < 8 else 7)
    ax.tick_params(axis="x", length=0, pad=12)
    ax.set(xlim=(-0.3, len(columns) - 0.7), ylim=(-0.1, 1.1), yticks=[])
    ax.spines[:].set_visible(False)


def bars(ax: Axes, ranked: pd.DataFrame, results: Results) -> None:
    """How much each parameter has to do with failure."""
    names = [axis_words(name, results.exp) for name in ranked["axis"]]
    ax.barh(names, ranked["distance"], color=["#0072B2" if p <= 0.05 else "0.75" for p in ranked["p"]])
    ax.invert_yaxis()
    ax.set_xlim(0, 1)
    ax.set_xlabel("distance of successes\nand failures", fontsize=8)
    ax.tick_params(labelsize=8)
    ax.spines[["top", "right"]].set_visible(False)


def pair(ax: Axes, results: Results, columns: list[str]) -> None:
    """The rollouts over the two parameters that matter most; over a single one, a line for each kind of outcome."""
    every = list(kinds(results.rows))
    for place, (kind, part) in enumerate(every):
        x = part[columns[0]]
        y = part[columns[1]] if len(columns) > 1 else pd.Series(float(place), index=part.index)
        dots(ax, x, y, kind, len(results.rows))
    ax.set_xlabel(heading(columns[0], results.exp), fontsize=8)
    if len(columns) > 1:
        ax.set_ylabel(heading(columns[1], results.exp), fontsize=8)
    else:
        ax.set_yticks(range(len(every)), [kind.replace("_", " ") for kind, _ in every])
    ax.tick_params(labelsize=8)
    if len(columns) > 1:
        not_below_zero(ax)


def margins(ax: Axes, results: Results, column: str) -> None:
    """How far from their nearest limit the rollouts stay, over the parameter that matters most."""
    for kind, part in kinds(results.rows):
        dots(ax, part[column], part[MARGIN], kind, len(results.rows))
    ax.axhline(0, color="0.3", linewidth=0.8, linestyle="--")
    ax.set_xlabel(heading(column, results.exp), fontsize=8)
    ax.set_ylabel("margin to the nearest limit", fontsize=8)
    ax.tick_params(labelsize=8)


def dots(ax: Axes, x: pd.Series, y: pd.Series, kind: str, total: int) -> None:
    """A share of the rollouts of a kind, so that `DOTS` are drawn in all; smaller ones the more there are."""
    number = max(1, round(len(x) * min(1.0, DOTS / total)))
    chosen = x.sample(number, random_state=0).index
    size = np.clip(600 / np.sqrt(total), 1.5, 40)
    edge: dict[str, Any] = {"edgecolors": "black", "linewidths": 0.3} if total < 500 else {"linewidths": 0}
    mark = "o" if kind == "success" else "s" if kind in MEANING else "x"
    ax.scatter(x[chosen], y[chosen], s=size, c=colour(kind), marker=mark, rasterized=True, **edge)
