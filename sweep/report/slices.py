"""Maps of a study of any number of parameters: sections through its points, with the intervals of noisy ones."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from sweep.analysis import sensitivity
from sweep.analysis.intervals import anytime, wilson
from sweep.analysis.stats import binned, rates
from sweep.core.plot_style import COLUMN, PAGE, new_figure, wrap_text
from sweep.core.spacing import evenly_spaced_indices
from sweep.report import limits
from sweep.report.cells import mark_values, place_cells
from sweep.report.labels import axis_words, beside_axis, with_value
from sweep.report.maps import categories, glyphed, kinds_in, legend, outlines, paint, split
from sweep.runs import refine
from sweep.runs.results import Results

MAPS = 6  # pairs of parameters, at most
PANELS = 4  # sections along a third parameter
BINNED = 320  # fewer draws than this leave bins empty
GRID = 400  # more values than this along an axis are no grid that a picture could show


@dataclass(frozen=True)
class Slice:
    """Rows near one section through the points, and what lies in the section's place of the other parameters."""

    x: str
    y: str
    beside: str | None  # parameter that the panels go through
    rows: pd.DataFrame
    note: str
    refined: bool = False  # whether rows without `known` are as their cell's corners


def slices(results: Results) -> Iterator[Slice]:
    """A section for each pair of parameters.

    A grid is cut: at a few values of a third parameter; with more parameters, at their values next to the nominal
    ones. Where such a section would be mostly empty, as among drawn points, all rows are counted in bins over the two
    parameters. Where two conditions or more were listed, the maps are over those.
    """
    conditions = [axis.column for axis in sensitivity.listed(results.rows, results.exp)]
    few = len(results.rows) < BINNED and len(conditions) < 2 and not results.exp.study.points
    if results.one_at_a_time or few or results.exp.study.is_adaptive:  # whose rows are no sample that has a rate
        return
    axes = results.listed
    if len(axes) < 2:  # numbers before names, which are read more easily as panels
        axes = sorted(conditions, key=results.named.__contains__) if len(conditions) > 1 else results.numeric
    if len(axes) < 2:
        axes = [*results.numeric, *results.named][:2]
    for x, y in list(combinations(axes, 2))[:MAPS]:
        others = [c for c in axes if c not in (x, y) and c in results.numeric]
        if results.exp.study.resolution and not others:
            note = f"each cell as its corners; {len(results.rows)} were run (dots), most of them next to the boundary"
            yield Slice(x, y, None, refine.paint_cells(results.exp, results.rows), note, refined=True)
            continue
        section = cut(results, x, y, others)
        yield section if filled(section) else counted(results, x, y, others)


def cut(results: Results, x: str, y: str, others: list[str]) -> Slice:
    """The section through the values of `others` next to the nominal ones; through a few values of a single other."""
    rows = results.rows
    if len(others) == 1:
        values = np.sort(rows[others[0]].unique())
        chosen = values[evenly_spaced_indices(len(values), PANELS)]
        note = f"at values of {axis_words(others[0], results.exp)}"
        return Slice(x, y, others[0], rows[rows[others[0]].isin(chosen)], note)
    fixed = {}
    for name in others:
        fixed[name] = nearest(rows[name], usual(results, name))
        rows = rows[rows[name] == fixed[name]]
    note = ", ".join(with_value(c, v, results.exp) for c, v in fixed.items())
    return Slice(x, y, None, rows, f"at {note}" if note else "")


def filled(section: Slice) -> bool:
    """Whether a section is a grid: few enough values for a picture, and rows in half of its cells at least."""
    by = [section.x, section.y, *([section.beside] if section.beside else [])]
    counts = [section.rows[c].nunique() for c in by]
    cells = len(section.rows[by].drop_duplicates())
    return min(counts[:2]) > 1 and max(counts[:2]) <= GRID and 2 * cells >= math.prod(counts)


def counted(results: Results, x: str, y: str, others: list[str]) -> Slice:
    """All rows, in bins over two parameters; a parameter of fewer values keeps them."""
    rows = results.rows
    most = int(np.clip(np.sqrt(len(rows) / 20), 4, 40))
    bins = {c: min(most, rows[c].nunique()) for c in (x, y)}
    note = f"{bins[x]} by {bins[y]} bins" + (", over all values of the other parameters" if others else "")
    return Slice(x, y, None, rows.assign(**{c: binned(rows[c], most) for c in (x, y)}), note)


def nearest(values: pd.Series, target: float) -> float:
    """The one of `values` that is nearest to `target`."""
    return float(values.iloc[int((values - target).abs().argmin())])


def usual(results: Results, column: str) -> float:
    """The nominal value of a parameter; the middle one of a number that parameters are made from."""
    if column.startswith("axis."):
        return float(results.rows[column].median())
    return float(results.exp.system.nominal(column, results.exp.settings))


def draw(results: Results, chosen: Slice) -> Figure:
    """Outcomes of single rollouts; of several in a cell the rate of success between the ends of its interval."""
    x, y = chosen.x, chosen.y
    rows, cells = place_cells(chosen.rows, x, y)
    panels = list(split(rows, x, y, (chosen.beside,) if chosen.beside else (), exp=results.exp))
    tables = [cells_of(results, panel, ["x", "y"]) for _, panel in panels]
    single = max(table["total"].max() for table in tables) == 1
    shown = [""] if single else ["low", "share", "high"]
    columns = min(len(panels), 2) if single else 3
    lines = -(-len(panels) * len(shown) // columns)
    figure = new_figure(2.2 * lines + 0.6, PAGE if columns > 1 else COLUMN)
    axes = figure.subplots(lines, columns, squeeze=False, sharex=True, sharey=True).ravel()
    spots = iter(axes)
    for (title, panel), table in zip(panels, tables, strict=True):
        for kind in shown:
            ax = next(spots)
            if single:
                categories(ax, panel, cells)
            else:
                broken = table[table["invalid"] > 0].assign(outcome="invalid")
                whole = table[table["valid"] > 0].assign(outcome="")
                values = pd.concat([whole.assign(value=whole[kind]), broken.assign(value=np.nan)])
                paint(ax, values, cells, cmap="cividis", vmin=0, vmax=1)
            word = {"low": "lower end", "share": "rate of success", "high": "upper end"}.get(kind, "")
            if chosen.refined:
                outlines(ax, results.exp, panel, x, y, cells)
            room = 72 * (PAGE - 1) / 3 - 10  # titles side by side stay apart
            ax.set_title(wrap_text(", ".join([*title, word] if word else title), room))
            mark_values(ax, cells)
            limits.draw(ax, results.exp, panel, x, y, cells)
    for ax in spots:
        ax.set_visible(False)
    for k, ax in enumerate(axes):
        if k % columns == 0:
            ax.set_ylabel(beside_axis(y, results.exp))
        if k >= len(axes) - columns:
            ax.set_xlabel(beside_axis(x, results.exp))
    legend(
        figure,
        kinds_in(chosen.rows, results.exp) if single else [],
        glyphed(cells),
        bool((chosen.rows["outcome"] == "invalid").any()),
        axes[0].get_legend_handles_labels()[0],
    )
    if not single:
        figure.colorbar(ScalarMappable(Normalize(0, 1), "cividis"), ax=axes, shrink=0.8)
    return figure


def cells_of(results: Results, rows: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Rate of success of each cell; where cells were repeated until decided, the intervals hold whenever one stops."""
    return rates(rows, by, anytime if results.exp.study.budget else wilson)


def data(results: Results, chosen: Slice) -> pd.DataFrame:
    """The numbers behind the map, a row for each cell."""
    rows = chosen.rows
    named = [c for c in rows if "." in str(c) and rows[c].dtype.kind not in "fi" and rows[c].nunique() > 1]
    named = [c for c in named if c not in (chosen.x, chosen.y)]
    by = [*named, *([chosen.beside] if chosen.beside else []), chosen.x, chosen.y]
    table = cells_of(results, rows, by)
    if (table["total"] > 1).any():
        return table
    return rows[[*by, "outcome", "cause", "point_id"]].sort_values(by, ignore_index=True)
