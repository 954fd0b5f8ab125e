"""Maps of outcomes over two parameters, with a panel for each combination of categorical parameters."""

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

from sweep.analysis.sample import pooled_success_rate
from sweep.config.experiment import Experiment, build_experiment
from sweep.core.distinct_values import has_several_values
from sweep.core.expressions import find_column
from sweep.core.outcomes import SUCCESS
from sweep.core.parameters import InputError
from sweep.core.plot_style import FONT_SIZE_PT, PAGE_WIDTH_IN, add_legend_below, wrap_text
from sweep.report import analytic_curves
from sweep.report.cells import MapCells, axis_positions, cell_edges, label_axis_values, lay_out_cells
from sweep.report.headline import describe_adaptive_rollouts
from sweep.report.labels import axis_title, label_with_value
from sweep.report.outcome_style import INVALID_CELL_COLOUR, find_style, glyph_colour, marker_path
from sweep.runs import refine

# cells, with more of which outlines would cover the colours; cells along a panel that have room for a glyph; boxes that
# hatching may be cut into
MAX_OUTLINED_CELLS, MAX_GLYPH_CELLS, MAX_BOXES = 4000, 40, 20_000
GLYPH_SIZE_PT = 3.2  # points across, of a glyph whose radius is one


def success_map(rows: pd.DataFrame, stored: Mapping[str, Any], chosen: tuple[str, ...] = (), title: str = "") -> Figure:
    """Draw a map of outcomes or success rates over two parameters.

    With one rollout a cell, colours are outcomes and causes; with more, the rate of success.

    Args:
        rows: rows of the study.
        stored: content of its study.yaml.
        chosen: names of the two parameters; those that are missing are chosen automatically.
        title: of the figure; the study's name by default.

    Raises:
        InputError: fewer than two parameters vary.
    """
    x, y = choose_map_axes(rows, chosen)
    exp = build_experiment(stored["config"])
    guessed = exp.study.resolution > 0 and {x, y} == {a.column for a in refine.make_lattice(exp.study).axes}
    rows = refine.add_inferred_rows(exp, rows) if guessed else rows.assign(known=True)
    rows, cells = lay_out_cells(rows, x, y)
    panels = list(split_panels(rows, x, y, exp=exp))
    counts = [panel.groupby([x, y]).size() for _, panel in panels]
    most = max(int(count.max()) for count in counts)
    measured = analytic_curves.analytic_limit_metrics(exp, rows)
    columns = len(panels) * (1 + len(measured))
    figure, axes = plt.subplots(
        1,
        columns,
        figsize=(max(PAGE_WIDTH_IN, 0.6 + 3 * columns), 3.6),
        squeeze=False,
        sharey=True,
        layout="constrained",
    )
    plt.close(figure)  # else a notebook shows it once more at the end of the cell
    room = 72 * (figure.get_size_inches()[0] - 1) / columns
    for ax, (measure, (heads, panel)) in zip(axes[0], product([None, *measured], panels), strict=True):
        if measure:
            draw_metric(ax, panel, cells, measure)
        else:
            (draw_outcomes if most == 1 else draw_success_rates)(ax, panel, cells)
            text = (
                describe_adaptive_rollouts(panel)
                if exp.study.is_adaptive
                else str(pooled_success_rate(panel, exp)).replace(" (", "\n(", 1)
            )
            if guessed:  # the share of rollouts that succeed says nothing where they were placed near the boundary
                draw_refined_cells(ax, exp, panel, x, y, cells)
                text = f"{panel['known'].sum()} rollouts (dots); each cell as its corners"
            heads = [*heads, text]
        label_axis_values(ax, cells)
        ax.set_title("\n".join(wrap_text(one, room) for one in heads))
        ax.set_xlabel(axis_title(x, exp))
        analytic_curves.draw_limit_curves(ax, exp, panel, x, y, cells)
    axes[0, 0].set_ylabel(axis_title(y, exp))
    lines, _ = axes[0, 0].get_legend_handles_labels()
    invalid = bool((rows["outcome"] == "invalid").any())
    draw_legend(figure, list_outcome_kinds(rows, exp) if most == 1 else [], has_room_for_glyphs(cells), invalid, lines)
    if most > 1:
        scale = ScalarMappable(Normalize(0, 1), "cividis")
        figure.colorbar(
            scale, ax=axes, label=f"rate of success, n = {rollouts_per_cell_range(counts)} a cell", shrink=0.8
        )
    name = title or stored["config"]["study"]["name"] or stored["config"]["scenario"]["name"]
    figure.suptitle(wrap_text(name.replace("_", " "), 72 * figure.get_size_inches()[0] - 2 * FONT_SIZE_PT))
    return figure


def choose_map_axes(rows: pd.DataFrame, chosen: tuple[str, ...]) -> tuple[str, str]:
    """Choose the horizontal and vertical parameter of a map.

    Args:
        rows: rows of the study.
        chosen: names of parameters that the user asks for, at most two.

    Raises:
        InputError: fewer than two parameters vary, or a chosen column is no parameter.
    """
    found = independent_parameters(rows, chosen)
    if len(set(found)) < 2:
        raise InputError(f"a map needs two varied parameters, here: {', '.join(found) or 'none'}")
    if words := [one for one in found if rows[one].dtype.kind not in "fi" and "." not in one]:
        raise InputError(f"a map over {words[0]} is not allowed: its axes are numbers or parameters")
    return found[0], found[1]


def independent_parameters(rows: pd.DataFrame, chosen: tuple[str, ...] = ()) -> list[str]:
    """Return at most two parameters of which neither determines the other.

    Args:
        rows: rows of the study.
        chosen: names of parameters that come first.

    Returns:
        Columns: the chosen ones, then numbers, then names. In a table of points that are all different, each parameter
        determines all others.
    """
    varied = [c for c in rows.columns if "." in c and has_several_values(rows[c])]
    found = [find_column(rows, name) for name in chosen]
    for one in sorted(varied, key=lambda c: rows[c].dtype.kind not in "fi"):  # numbers first, then names
        if len(found) < 2 and not any((rows.groupby(known)[one].nunique() == 1).all() for known in found):
            found.append(one)
    return found[:2]


def split_panels(
    rows: pd.DataFrame, x: str, y: str, also: tuple[str, ...] = (), exp: Experiment | None = None
) -> Iterator[tuple[list[str], pd.DataFrame]]:
    """Yield titles and rows of the panels of a map, one for each combination of names and of values of `also`."""
    named = [c for c in rows.columns if "." in c and c not in (x, y) and rows[c].dtype.kind not in "fi"]
    named = [*(c for c in named if has_several_values(rows[c])), *also]
    if not named:
        yield [], rows
        return
    for values, panel in rows.groupby(named, sort=False):
        yield [label_with_value(str(c), v, exp) for c, v in zip(named, values, strict=True)], panel


def list_outcome_kinds(rows: pd.DataFrame, exp: Experiment) -> list[str]:
    """Return the outcome kinds that occur in `rows`, success and causes, in the order of their definition."""
    found = set(rows["cause"])
    causes = [cause for cause in exp.system.cause_names if cause in found and cause not in exp.system.invalid_causes]
    return [SUCCESS] * bool((rows["outcome"] == SUCCESS).any()) + causes


def rollouts_per_cell_range(counts: list[pd.Series]) -> str:
    """Return smallest and largest number of rollouts in a map's cells."""
    low, high = min(int(c.min()) for c in counts), max(int(c.max()) for c in counts)
    return str(low) if low == high else f"{low}-{high}"


def draw_outcomes(ax: Axes, rows: pd.DataFrame, cells: MapCells) -> None:
    """Colour the cells of a map by outcome and failure cause."""
    kind = pd.Categorical(rows["cause"].where(rows["outcome"] == "failure", "success"))
    palette = ListedColormap([find_style(one).colour for one in kind.categories])
    draw_cell_values(
        ax, rows.assign(value=kind.codes.astype(float)), cells, cmap=palette, vmin=-0.5, vmax=palette.N - 0.5
    )
    if has_room_for_glyphs(cells):
        draw_glyphs(ax, rows[rows["outcome"] == "failure"], cells)


def has_room_for_glyphs(cells: MapCells) -> bool:
    """Whether cells are large enough for a glyph."""
    return max(len(cells.x), len(cells.y)) <= MAX_GLYPH_CELLS


def draw_glyphs(ax: Axes, failed: pd.DataFrame, cells: MapCells) -> None:
    """Draw the glyph of its cause in each failed cell, for readers who cannot distinguish the colours."""
    middles = [(cell_edges(values)[1:] + cell_edges(values)[:-1]) / 2 for values in cells[:2]]
    for cause, part in failed.groupby("cause"):
        up, across = cell_indices(part, cells)
        draw_glyph_at(ax, str(cause), middles[0][across], middles[1][up])


def draw_glyph_at(ax: Axes, cause: str, x: np.ndarray, y: np.ndarray) -> None:
    """Draw the glyph of a cause at several places."""
    look = cause_glyph(cause)
    style: dict[str, Any] = {"marker": look.get_marker(), "color": look.get_color(), "linewidths": 0}
    ax.scatter(x, y, s=look.get_markersize() ** 2, rasterized=True, **style)


def cause_glyph(cause: str) -> Line2D:
    """Return the glyph (marker) of a cause, in a colour that contrasts with its cell."""
    look = find_style(cause)
    style: dict[str, Any] = {"marker": marker_path(cause), "markersize": GLYPH_SIZE_PT * np.abs(look.shape).max()}
    return Line2D([], [], linestyle="", color=glyph_colour(look.colour), markeredgewidth=0, **style)


def equal_cell_runs(
    grid: np.ndarray, cells: MapCells
) -> Iterator[tuple[tuple[tuple[float, float], float, float], Any]]:
    """Yield runs of neighbouring cells with equal values in each line of a grid: corner, width, height and value."""
    x, y = cell_edges(cells.x).tolist(), cell_edges(cells.y).tolist()
    for j, line in enumerate(grid):
        starts = np.flatnonzero(np.r_[True, line[1:] != line[:-1]]).tolist()
        for start, end in zip(starts, [*starts[1:], len(line)], strict=True):
            yield ((x[start], y[j]), x[end] - x[start], y[j + 1] - y[j]), line[start]


def cell_indices(rows: pd.DataFrame, cells: MapCells) -> tuple[np.ndarray, np.ndarray]:
    """Return line and column of the cell of each row."""
    return np.searchsorted(cells.y, rows["y"]), np.searchsorted(cells.x, rows["x"])


def cell_means(rows: pd.DataFrame, cells: MapCells, name: str) -> np.ma.MaskedArray:
    """Return the mean of a column over the rows of each cell, masked where no row has a number."""
    own = rows[rows[name].notna()]
    at = np.ravel_multi_index(cell_indices(own, cells), (len(cells.y), len(cells.x)))
    size = len(cells.x) * len(cells.y)
    number = np.bincount(at, minlength=size)
    total = np.bincount(at, own[name].to_numpy(dtype=float), minlength=size)
    mean = np.ma.masked_array(total / np.maximum(number, 1), number == 0)
    return mean.reshape(len(cells.y), len(cells.x))


def draw_success_rates(ax: Axes, rows: pd.DataFrame, cells: MapCells) -> None:
    """Colour a map's cells by the success rate of valid rollouts."""
    draw_cell_values(
        ax, rows.assign(value=(rows["outcome"] == "success").astype(float)), cells, cmap="cividis", vmin=0, vmax=1
    )


def draw_cell_values(ax: Axes, rows: pd.DataFrame, cells: MapCells, **style: Any) -> None:
    """Colour a map's cells by the mean of the column `value` of valid rows, and hatch cells with invalid ones."""
    invalid = rows["outcome"] == "invalid"
    draw_cells(ax, cell_means(rows[~invalid], cells, "value"), cells, **style)
    doubtful = np.zeros((len(cells.y), len(cells.x)), dtype=bool)
    doubtful[cell_indices(rows[invalid], cells)] = True
    boxes = [box for box, broken in equal_cell_runs(doubtful, cells) if broken] if invalid.any() else []
    if doubtful.size <= MAX_OUTLINED_CELLS:
        for box in boxes:
            ax.add_patch(Rectangle(*box, fill=False, hatch="////", linewidth=0.4))
    elif 0 < len(boxes) <= MAX_BOXES:
        turns = (Affine2D().scale(width, height).translate(*corner) for corner, width, height in boxes)
        path = Path.make_compound_path(*map(Path.unit_rectangle().transformed, turns))
        ax.add_patch(PathPatch(path, fill=False, hatch="////", linewidth=0))


def draw_cells(ax: Axes, values: np.ma.MaskedArray, cells: MapCells, **style: Any) -> Any:
    """Draw cells coloured by value, with outlines; many cells become one image."""
    x, y = cell_edges(cells.x), cell_edges(cells.y)
    if values.size > MAX_OUTLINED_CELLS:
        return ax.pcolorfast(x, y, values, **style)
    return ax.pcolormesh(x, y, values, edgecolors="white", linewidth=0.4, **style)


def draw_refined_cells(ax: Axes, exp: Experiment, painted: pd.DataFrame, x: str, y: str, cells: MapCells) -> None:
    """Outline the cells of a refined map, and mark the rows that were simulated with dots."""
    rows = painted[painted["known"]]
    for panel in refine.summarize_panels(exp, rows):
        columns = [a.column for a in panel.lattice.axes]
        for power, corners in enumerate(panel.cells if panel.rollouts else ()):
            (left, right), (low, high) = (
                [axis_positions(panel.lattice.values[k][corners[:, k] + step], values) for step in (0, 2**power)]
                for k, values in zip(map(columns.index, (x, y)), cells[:2], strict=True)
            )
            boxes = np.stack([[left, low], [right, low], [right, high], [left, high]]).transpose(2, 0, 1)
            ax.add_collection(PolyCollection(list(boxes), facecolor="none", edgecolor="0.35", linewidth=0.3))
    dots = [axis_positions(rows[c].to_numpy(), values) for c, values in zip((x, y), cells[:2], strict=True)]
    ax.plot(*dots, ".", markersize=1.5, color="black")


def draw_metric(ax: Axes, rows: pd.DataFrame, cells: MapCells, name: str) -> None:
    """Colour a map's cells by a metric of the successful rollouts."""
    colours = draw_cells(ax, cell_means(rows[rows["outcome"] == "success"], cells, name), cells)
    ax.figure.colorbar(colours, ax=ax, label=f"{axis_title(name)}, where it succeeds", shrink=0.8)


def draw_legend(figure: Figure, kinds: Sequence[str], shaped: bool, invalid: bool, lines: Sequence[Artist]) -> None:
    """Draw a legend of colours, glyphs, hatching and curves below a map."""
    glyphs = {kind: kind if shaped and kind != SUCCESS else "" for kind in kinds}
    handles: list[Any] = [legend_cell(kind.replace("_", " "), find_style(kind).colour, glyphs[kind]) for kind in kinds]
    if invalid:
        handles.append(Patch(facecolor=INVALID_CELL_COLOUR, edgecolor="black", hatch="////", label="invalid"))
    add_legend_below(figure, [*handles, *lines])


def legend_cell(label: str, colour: str, cause: str = "") -> tuple[Line2D, ...]:
    """Return the legend entry of a map cell, with the glyph of its cause."""
    square = Line2D([], [], linestyle="", marker="s", markersize=FONT_SIZE_PT, color=colour, label=label)
    return (square, cause_glyph(cause)) if cause else (square,)
