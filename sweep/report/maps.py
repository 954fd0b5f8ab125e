"""Where it succeeds: a map over two parameters, one panel for each combination of the named alternatives."""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from sweep.analysis.stats import rate
from sweep.core.expressions import column
from sweep.core.files import write_whole
from sweep.core.parameters import InputError
from sweep.metrics.outcome import CAUSES
from sweep.report import limits, mesh
from sweep.report.cells import Cells, edges, mark_values
from sweep.report.labels import CAUSE_COLOURS, CAUSE_HATCHES, INVALID, SUCCESS, axis_words, heading
from sweep.report.tables import text
from sweep.runs import refine
from sweep.study.config import experiment

KINDS = ["success", *CAUSES]
OUTLINED, HATCHED = 4000, 200  # cells, and rows of them: with more, outlines and patterns would cover the colours
PALETTE = ListedColormap([SUCCESS, *(CAUSE_COLOURS[c] for c in CAUSES)])


def draw(rows: pd.DataFrame, stored: Mapping[str, Any], folder: Path, chosen: tuple[str, ...] = ()) -> list[Path]:
    """Write map.png and map.svg into `folder`; `chosen` names the two parameters. Raises `InputError`.

    With one rollout a cell its colour is the outcome or the cause of failure, with more it is the rate of success.
    """
    folder.mkdir(parents=True, exist_ok=True)
    figure = success_map(rows, stored, chosen)
    paths = [folder / f"map.{form}" for form in ("png", "svg")]
    with plt.rc_context({"svg.hashsalt": "sweep", "svg.fonttype": "none"}):
        for path in paths:
            metadata = {"Date": None} if path.suffix == ".svg" else None
            write_whole(path, partial(figure.savefig, dpi=150, metadata=metadata))
    plt.close(figure)
    return paths


def success_map(rows: pd.DataFrame, stored: Mapping[str, Any], chosen: tuple[str, ...] = ()) -> Figure:
    """The figure that `draw` writes."""
    x, y = map_axes(rows, chosen)
    exp = experiment(stored["config"])
    guessed = exp.study.resolution > 0 and {x, y} == {a.column for a in refine.lattice(exp.study).axes}
    rows = refine.painted(exp, rows) if guessed else rows.assign(known=True)
    panels = list(split(rows, x, y))
    counts = [panel.groupby([x, y]).size() for _, panel in panels]
    most = max(int(count.max()) for count in counts)
    measured = limits.measured(exp, rows)
    columns = len(panels) * (1 + len(measured))
    figure, axes = plt.subplots(
        1, columns, figsize=(1.8 + 4.6 * columns, 4.6), squeeze=False, sharey=True, layout="constrained"
    )
    cells = Cells(np.sort(rows[x].unique()), np.sort(rows[y].unique()))
    for ax, (title, panel) in zip(axes[0, : len(panels)], panels, strict=True):
        (categories if most == 1 else shares)(ax, panel.assign(x=panel[x], y=panel[y]), cells)
        mark_values(ax, cells)
        text = str(rate(panel["outcome"])).replace(" (", "\n(", 1)
        if guessed:  # the share of rollouts that succeed says nothing where they were placed near the boundary
            mesh.draw(ax, exp, panel, x, y, cells)
            text = f"{panel['known'].sum()} rollouts (dots); each cell as its corners"
        ax.set_title("\n".join([*title, text]), fontsize=8)
        ax.set_xlabel(heading(x, exp))
        limits.draw(ax, exp, panel, x, y, cells)
    for ax, (title, panel), figure_name in zip(
        axes[0, len(panels) :], panels * len(measured), np.repeat(measured, len(panels)), strict=True
    ):
        beside(ax, panel.assign(x=panel[x], y=panel[y]), cells, figure_name)
        mark_values(ax, cells)
        ax.set_title("\n".join(title), fontsize=8)
        ax.set_xlabel(heading(x, exp))
        limits.draw(ax, exp, panel, x, y, cells)
    axes[0, 0].set_ylabel(heading(y, exp))
    seen = [cause for cause in CAUSES if (rows["cause"] == cause).any()] if most == 1 else []
    lines, _ = axes[0, 0].get_legend_handles_labels()
    legend(figure, seen, bool((rows["outcome"] == "invalid").any()), most, lines)
    if most > 1:
        scale = ScalarMappable(Normalize(0, 1), "cividis")
        figure.colorbar(scale, ax=axes, label=f"rate of success, n = {spread(counts)} a cell", shrink=0.8)
    figure.suptitle(stored["config"]["study"]["name"] or stored["config"]["scenario"]["name"])
    return figure


def map_axes(rows: pd.DataFrame, chosen: tuple[str, ...]) -> tuple[str, str]:
    """The two parameters of a map: the chosen ones, then the first ones that do not follow from one another."""
    numeric = [c for c in rows.columns if "." in c and rows[c].dtype.kind in "fi" and rows[c].nunique() > 1]
    found = [column(rows, name) for name in chosen]
    for one in numeric:
        if len(found) < 2 and not any((rows.groupby(known)[one].nunique() == 1).all() for known in found):
            found.append(one)
    found = found[:2]
    if len(set(found)) < 2:
        raise InputError(f"a map needs two varied parameters, here: {', '.join(found) or 'none'}")
    return found[0], found[1]


def split(rows: pd.DataFrame, x: str, y: str, also: tuple[str, ...] = ()) -> Iterator[tuple[list[str], pd.DataFrame]]:
    """Panels, with their titles: one for each combination of varied names and values of `also`."""
    named = [c for c in rows.columns if "." in c and c not in (x, y) and rows[c].dtype.kind not in "fi"]
    named = [*(c for c in named if rows[c].nunique() > 1), *also]
    if not named:
        yield [], rows
        return
    for values, panel in rows.groupby(named, sort=False):
        yield [f"{axis_words(c)} {text(v)}" for c, v in zip(named, values, strict=True)], panel


def spread(counts: list[pd.Series]) -> str:
    """Smallest and largest number of rollouts in a cell."""
    low, high = min(int(c.min()) for c in counts), max(int(c.max()) for c in counts)
    return str(low) if low == high else f"{low}-{high}"


def categories(ax: Axes, rows: pd.DataFrame, cells: Cells) -> None:
    """Cells coloured by outcome and cause."""
    kind = rows["cause"].where(rows["outcome"] == "failure", "success").map(KINDS.index).astype(float)
    paint(ax, rows.assign(value=kind), cells, cmap=PALETTE, vmin=-0.5, vmax=len(KINDS) - 0.5)
    if len(cells.y) <= HATCHED:
        hatch(ax, rows[rows["outcome"] == "failure"], cells)


def hatch(ax: Axes, failed: pd.DataFrame, cells: Cells) -> None:
    """A pattern for each cause, for those who cannot tell the colours: one patch for each run of equal cells."""
    cause_of = failed.astype({"cause": object}).pivot(index="y", columns="x", values="cause")
    grid = cause_of.reindex(index=cells.y, columns=cells.x).astype(object).fillna("")
    x, y = edges(cells.x), edges(cells.y)
    for j, line in enumerate(grid.to_numpy(dtype=str)):
        starts = np.flatnonzero(np.r_[True, line[1:] != line[:-1]])
        for start, end in zip(starts, [*starts[1:], len(line)], strict=True):
            if cause := str(line[start]):
                size = x[end] - x[start], y[j + 1] - y[j]
                ax.add_patch(Rectangle((x[start], y[j]), *size, fill=False, linewidth=0, **pattern(cause)))


def pattern(cause: str) -> dict[str, Any]:
    """Hatching of a cause, dark on light colours and light on dark ones."""
    red, green, blue = to_rgb(CAUSE_COLOURS[cause])
    dark = 0.299 * red + 0.587 * green + 0.114 * blue < 0.5
    return {"hatch": CAUSE_HATCHES[cause], "edgecolor": "white" if dark else "black"}


def shares(ax: Axes, rows: pd.DataFrame, cells: Cells) -> None:
    """Cells coloured by the share of successes among valid rollouts."""
    paint(ax, rows.assign(value=(rows["outcome"] == "success").astype(float)), cells, cmap="cividis", vmin=0, vmax=1)


def paint(ax: Axes, rows: pd.DataFrame, cells: Cells, **style: Any) -> None:
    """The mean value of the valid rows of each cell; hatching where there are invalid ones."""
    invalid = rows["outcome"] == "invalid"
    grid = rows[~invalid].pivot_table(index="y", columns="x", values="value").reindex(index=cells.y, columns=cells.x)
    x, y = edges(cells.x), edges(cells.y)
    values = np.ma.masked_invalid(grid.to_numpy(dtype=float))
    many = values.size > OUTLINED  # a vector picture of so many cells is slow to show
    outline = {} if many else {"edgecolors": "white", "linewidth": 0.4}
    ax.pcolormesh(x, y, values, rasterized=many, **outline, **style)
    for at_x, at_y in rows.loc[invalid, ["x", "y"]].drop_duplicates().itertuples(index=False):
        i, j = int(np.searchsorted(cells.x, at_x)), int(np.searchsorted(cells.y, at_y))
        (left, right), (low, high) = x[i : i + 2].tolist(), y[j : j + 2].tolist()
        cell = Rectangle((left, low), right - left, high - low, fill=False, hatch="////", linewidth=0.4)
        ax.add_patch(cell)


def beside(ax: Axes, rows: pd.DataFrame, cells: Cells, name: str) -> None:
    """A measured figure in the same cells, of rollouts that succeed."""
    done = rows[rows["outcome"] == "success"]
    grid = done.pivot_table(index="y", columns="x", values=name).reindex(index=cells.y, columns=cells.x)
    colours = ax.pcolormesh(edges(cells.x), edges(cells.y), np.ma.masked_invalid(grid.to_numpy(dtype=float)))
    ax.figure.colorbar(colours, ax=ax, label=f"{heading(name)}, where it succeeds", shrink=0.8)


def legend(figure: Figure, causes: list[str], invalid: bool, most: int, lines: Sequence[Artist]) -> None:
    """What the colours, the hatching and the lines mean."""
    patches: list[Any] = [Patch(facecolor=SUCCESS, edgecolor="grey", label="success")] if most == 1 else []
    patches += [Patch(facecolor=CAUSE_COLOURS[c], label=c.replace("_", " "), **pattern(c)) for c in causes]
    if invalid:
        patches.append(Patch(facecolor=INVALID, edgecolor="black", hatch="////", label="invalid"))
    patches += lines
    if patches:
        figure.legend(handles=patches, loc="outside lower center", ncols=min(len(patches), 5), fontsize=8)
