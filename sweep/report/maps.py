"""Where it succeeds: a map over two parameters, one panel for each combination of the named alternatives."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, PathPatch, Rectangle
from matplotlib.path import Path
from matplotlib.transforms import Affine2D

from sweep.analysis.sample import pooled
from sweep.core.expressions import column
from sweep.core.outcomes import SUCCESS
from sweep.core.parameters import InputError
from sweep.core.plot_style import LETTERS, PAGE, legend_below, wrap_text
from sweep.report import limits
from sweep.report.cells import Cells, edges, mark_values, place_cells, places
from sweep.report.headline import count_placed
from sweep.report.labels import beside_axis, with_value
from sweep.report.looks import INVALID, ink_on, look_of, marker
from sweep.runs import refine
from sweep.study.config import Experiment, experiment

# cells, with more of which outlines would cover the colours; cells along a panel that have room for a glyph; boxes that
# hatching may be cut into
OUTLINED, GLYPHS, BOXES = 4000, 40, 20_000
GLYPH = 3.2  # points across, of a glyph whose radius is one


def success_map(
    rows: pd.DataFrame, stored: Mapping[str, Any], chosen: tuple[str, ...] = (), called: str = ""
) -> Figure:
    """The figure, its title `called` or the study's name; `chosen` names the two parameters. Raises `InputError`.

    With one rollout a cell its colour is the outcome or the cause of failure, with more it is the rate of success.
    """
    x, y = map_axes(rows, chosen)
    exp = experiment(stored["config"])
    guessed = exp.study.resolution > 0 and {x, y} == {a.column for a in refine.lattice(exp.study).axes}
    rows = refine.paint_cells(exp, rows) if guessed else rows.assign(known=True)
    rows, cells = place_cells(rows, x, y)
    panels = list(split(rows, x, y, exp=exp))
    counts = [panel.groupby([x, y]).size() for _, panel in panels]
    most = max(int(count.max()) for count in counts)
    measured = limits.measured(exp, rows)
    columns = len(panels) * (1 + len(measured))
    figure, axes = plt.subplots(
        1, columns, figsize=(max(PAGE, 0.6 + 3 * columns), 3.6), squeeze=False, sharey=True, layout="constrained"
    )
    plt.close(figure)  # else a notebook shows it once more at the end of the cell
    room = 72 * (figure.get_size_inches()[0] - 1) / columns
    for ax, (measure, (title, panel)) in zip(axes[0], product([None, *measured], panels), strict=True):
        if measure:
            beside(ax, panel, cells, measure)
        else:
            (categories if most == 1 else shares)(ax, panel, cells)
            text = count_placed(panel) if exp.study.is_adaptive else str(pooled(panel, exp)).replace(" (", "\n(", 1)
            if guessed:  # the share of rollouts that succeed says nothing where they were placed near the boundary
                outlines(ax, exp, panel, x, y, cells)
                text = f"{panel['known'].sum()} rollouts (dots); each cell as its corners"
            title = [*title, text]
        mark_values(ax, cells)
        ax.set_title("\n".join(wrap_text(one, room) for one in title))
        ax.set_xlabel(beside_axis(x, exp))
        limits.draw(ax, exp, panel, x, y, cells)
    axes[0, 0].set_ylabel(beside_axis(y, exp))
    lines, _ = axes[0, 0].get_legend_handles_labels()
    invalid = bool((rows["outcome"] == "invalid").any())
    legend(figure, kinds_in(rows, exp) if most == 1 else [], glyphed(cells), invalid, lines)
    if most > 1:
        scale = ScalarMappable(Normalize(0, 1), "cividis")
        figure.colorbar(scale, ax=axes, label=f"rate of success, n = {spread(counts)} a cell", shrink=0.8)
    name = called or stored["config"]["study"]["name"] or stored["config"]["scenario"]["name"]
    figure.suptitle(wrap_text(name.replace("_", " "), 72 * figure.get_size_inches()[0] - 2 * LETTERS))
    return figure


def map_axes(rows: pd.DataFrame, chosen: tuple[str, ...]) -> tuple[str, str]:
    """The two parameters of a map: the chosen ones, then the first `independent` ones. Raises `InputError`."""
    found = independent(rows, chosen)
    if len(set(found)) < 2:
        raise InputError(f"a map needs two varied parameters, here: {', '.join(found) or 'none'}")
    if words := [one for one in found if rows[one].dtype.kind not in "fi" and "." not in one]:
        raise InputError(f"a map over {words[0]} is not allowed: its axes are numbers or parameters")
    return found[0], found[1]


def independent(rows: pd.DataFrame, chosen: tuple[str, ...] = ()) -> list[str]:
    """At most two parameters that do not follow from one another: the chosen ones, then numbers, then names.

    Of points of a table that are all alone, each parameter follows from any.
    """
    varied = [c for c in rows.columns if "." in c and rows[c].nunique() > 1]
    found = [column(rows, name) for name in chosen]
    for one in sorted(varied, key=lambda c: rows[c].dtype.kind not in "fi"):  # numbers first, then names
        if len(found) < 2 and not any((rows.groupby(known)[one].nunique() == 1).all() for known in found):
            found.append(one)
    return found[:2]


def split(
    rows: pd.DataFrame, x: str, y: str, also: tuple[str, ...] = (), exp: Experiment | None = None
) -> Iterator[tuple[list[str], pd.DataFrame]]:
    """Panels, with their titles: one for each combination of varied names and values of `also`."""
    named = [c for c in rows.columns if "." in c and c not in (x, y) and rows[c].dtype.kind not in "fi"]
    named = [*(c for c in named if rows[c].nunique() > 1), *also]
    if not named:
        yield [], rows
        return
    for values, panel in rows.groupby(named, sort=False):
        yield [with_value(str(c), v, exp) for c, v in zip(named, values, strict=True)], panel


def kinds_in(rows: pd.DataFrame, exp: Experiment) -> list[str]:
    """Success and causes of failure among `rows`, in the order of their definition."""
    found = set(rows["cause"])
    causes = [cause for cause in exp.system.causes if cause in found and cause not in exp.system.invalid_causes]
    return [SUCCESS] * bool((rows["outcome"] == SUCCESS).any()) + causes


def spread(counts: list[pd.Series]) -> str:
    """Smallest and largest number of rollouts in a cell."""
    low, high = min(int(c.min()) for c in counts), max(int(c.max()) for c in counts)
    return str(low) if low == high else f"{low}-{high}"


def categories(ax: Axes, rows: pd.DataFrame, cells: Cells) -> None:
    """Cells coloured by outcome and cause."""
    kind = pd.Categorical(rows["cause"].where(rows["outcome"] == "failure", "success"))
    palette = ListedColormap([look_of(one).colour for one in kind.categories])
    paint(ax, rows.assign(value=kind.codes.astype(float)), cells, cmap=palette, vmin=-0.5, vmax=palette.N - 0.5)
    if glyphed(cells):
        glyphs(ax, rows[rows["outcome"] == "failure"], cells)


def glyphed(cells: Cells) -> bool:
    """Whether cells have room for a glyph."""
    return max(len(cells.x), len(cells.y)) <= GLYPHS


def glyphs(ax: Axes, failed: pd.DataFrame, cells: Cells) -> None:
    """The shape of its cause in each cell, for those who cannot tell the colours."""
    middles = [(edges(values)[1:] + edges(values)[:-1]) / 2 for values in cells[:2]]
    for cause, part in failed.groupby("cause"):
        up, across = places_in(part, cells)
        stamp(ax, str(cause), middles[0][across], middles[1][up])


def stamp(ax: Axes, cause: str, x: np.ndarray, y: np.ndarray) -> None:
    """The glyph of a cause at places of the axes."""
    look = glyph(cause)
    style: dict[str, Any] = {"marker": look.get_marker(), "color": look.get_color(), "linewidths": 0}
    ax.scatter(x, y, s=look.get_markersize() ** 2, rasterized=True, **style)


def glyph(cause: str) -> Line2D:
    """The shape of a cause as legends show it, in the ink that is seen on its colour."""
    look = look_of(cause)
    style: dict[str, Any] = {"marker": marker(cause), "markersize": GLYPH * np.abs(look.shape).max()}
    return Line2D([], [], linestyle="", color=ink_on(look.colour), markeredgewidth=0, **style)


def runs(grid: np.ndarray, cells: Cells) -> Iterator[tuple[tuple[tuple[float, float], float, float], Any]]:
    """Corner, width and height of each run of equal cells of a line, and what they hold."""
    x, y = edges(cells.x).tolist(), edges(cells.y).tolist()
    for j, line in enumerate(grid):
        starts = np.flatnonzero(np.r_[True, line[1:] != line[:-1]]).tolist()
        for start, end in zip(starts, [*starts[1:], len(line)], strict=True):
            yield ((x[start], y[j]), x[end] - x[start], y[j + 1] - y[j]), line[start]


def places_in(rows: pd.DataFrame, cells: Cells) -> tuple[np.ndarray, np.ndarray]:
    """Line and column of the cell of each row."""
    return np.searchsorted(cells.y, rows["y"]), np.searchsorted(cells.x, rows["x"])


def means(rows: pd.DataFrame, cells: Cells, name: str) -> np.ma.MaskedArray:
    """The mean of a column over the rows of each cell that have a number, masked where none has."""
    own = rows[rows[name].notna()]
    at = np.ravel_multi_index(places_in(own, cells), (len(cells.y), len(cells.x)))
    size = len(cells.x) * len(cells.y)
    number = np.bincount(at, minlength=size)
    total = np.bincount(at, own[name].to_numpy(dtype=float), minlength=size)
    mean = np.ma.masked_array(total / np.maximum(number, 1), number == 0)
    return mean.reshape(len(cells.y), len(cells.x))


def shares(ax: Axes, rows: pd.DataFrame, cells: Cells) -> None:
    """Cells coloured by the share of successes among valid rollouts."""
    paint(ax, rows.assign(value=(rows["outcome"] == "success").astype(float)), cells, cmap="cividis", vmin=0, vmax=1)


def paint(ax: Axes, rows: pd.DataFrame, cells: Cells, **style: Any) -> None:
    """The mean value of the valid rows of each cell; hatching where there are invalid ones."""
    invalid = rows["outcome"] == "invalid"
    coloured(ax, means(rows[~invalid], cells, "value"), cells, **style)
    doubtful = np.zeros((len(cells.y), len(cells.x)), dtype=bool)
    doubtful[places_in(rows[invalid], cells)] = True
    boxes = [box for box, broken in runs(doubtful, cells) if broken] if invalid.any() else []
    if doubtful.size <= OUTLINED:
        for box in boxes:
            ax.add_patch(Rectangle(*box, fill=False, hatch="////", linewidth=0.4))
    elif 0 < len(boxes) <= BOXES:
        turns = (Affine2D().scale(width, height).translate(*corner) for corner, width, height in boxes)
        path = Path.make_compound_path(*map(Path.unit_rectangle().transformed, turns))
        ax.add_patch(PathPatch(path, fill=False, hatch="////", linewidth=0))


def coloured(ax: Axes, values: np.ma.MaskedArray, cells: Cells, **style: Any) -> Any:
    """Cells by their values: drawn one by one with white outlines, or where they are many as one image."""
    x, y = edges(cells.x), edges(cells.y)
    if values.size > OUTLINED:
        return ax.pcolorfast(x, y, values, **style)
    return ax.pcolormesh(x, y, values, edgecolors="white", linewidth=0.4, **style)


def outlines(ax: Axes, exp: Experiment, painted: pd.DataFrame, x: str, y: str, cells: Cells) -> None:
    """The cells that refinement ended with, over a map of `painted` rows (see `refine.painted`); those run as dots."""
    rows = painted[painted["known"]]
    for panel in refine.summarize_panels(exp, rows):
        columns = [a.column for a in panel.grid.axes]
        for power, corners in enumerate(panel.cells if panel.rollouts else ()):
            (left, right), (low, high) = (
                [places(panel.grid.values[k][corners[:, k] + step], values) for step in (0, 2**power)]
                for k, values in zip(map(columns.index, (x, y)), cells[:2], strict=True)
            )
            boxes = np.stack([[left, low], [right, low], [right, high], [left, high]]).transpose(2, 0, 1)
            ax.add_collection(PolyCollection(list(boxes), facecolor="none", edgecolor="0.35", linewidth=0.3))
    dots = [places(rows[c].to_numpy(), values) for c, values in zip((x, y), cells[:2], strict=True)]
    ax.plot(*dots, ".", markersize=1.5, color="black")


def beside(ax: Axes, rows: pd.DataFrame, cells: Cells, name: str) -> None:
    """A measured figure in the same cells, of rollouts that succeed."""
    colours = coloured(ax, means(rows[rows["outcome"] == "success"], cells, name), cells)
    ax.figure.colorbar(colours, ax=ax, label=f"{beside_axis(name)}, where it succeeds", shrink=0.8)


def legend(figure: Figure, kinds: Sequence[str], shaped: bool, invalid: bool, lines: Sequence[Artist]) -> None:
    """What the colours and glyphs of cells, the hatching and the lines mean; `shaped` where cells have glyphs."""
    glyphs = {kind: kind if shaped and kind != SUCCESS else "" for kind in kinds}
    handles: list[Any] = [cell(kind.replace("_", " "), look_of(kind).colour, glyphs[kind]) for kind in kinds]
    if invalid:
        handles.append(Patch(facecolor=INVALID, edgecolor="black", hatch="////", label="invalid"))
    legend_below(figure, [*handles, *lines])


def cell(label: str, colour: str, cause: str = "") -> tuple[Line2D, ...]:
    """A cell of a map in a legend, and the glyph of its cause over it."""
    square = Line2D([], [], linestyle="", marker="s", markersize=LETTERS, color=colour, label=label)
    return (square, glyph(cause)) if cause else (square,)
