"""Maps of studies with many parameters: sections through the points at two parameters, with confidence intervals."""

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
from sweep.analysis.intervals import confidence_sequence, wilson
from sweep.analysis.sample import is_random_sample
from sweep.analysis.sampling_units import confidence_interval_unit_ids
from sweep.analysis.stats import bin_values, success_rates
from sweep.core.distinct_values import count_distinct, has_several_values
from sweep.core.plot_style import COLUMN_WIDTH_IN, PAGE_WIDTH_IN, new_figure, wrap_text
from sweep.core.spacing import evenly_spaced_indices
from sweep.report import analytic_curves
from sweep.report.cells import label_axis_values, lay_out_cells
from sweep.report.labels import axis_title, axis_words, label_with_value
from sweep.report.maps import (
    draw_cell_values,
    draw_legend,
    draw_outcomes,
    draw_refined_cells,
    has_room_for_glyphs,
    list_outcome_kinds,
    split_panels,
)
from sweep.runs import refine
from sweep.runs.results import Results

MAX_MAPS = 6  # pairs of parameters, at most
MAX_PANELS = 4  # sections along a third parameter
MIN_BINNED_DRAWS = 320  # fewer draws than this leave bins empty
MAX_GRID_VALUES = 400  # more values than this along an axis are no grid that a picture could show


@dataclass(frozen=True)
class MapSection:
    """Rows of one map: those on a section through the parameter space, or all rows in bins."""

    x: str
    y: str
    panel_parameter: str | None  # parameter that the panels go through
    rows: pd.DataFrame
    note: str
    refined: bool = False  # whether rows without `known` are as their cell's corners


def list_sections(results: Results) -> Iterator[MapSection]:
    """Yield the rows of a map for each pair of varied parameters.

    A grid is cut at a few values of a third parameter; with more parameters, next to their nominal values. Where such a
    cut would be mostly empty, as among drawn points, all rows are counted in bins. Where two conditions or more were
    listed, maps are over those.
    """
    conditions = [axis.column for axis in sensitivity.listed_value_axes(results.rows, results.exp)]
    few = len(results.rows) < MIN_BINNED_DRAWS and len(conditions) < 2 and not results.exp.study.points
    if results.is_one_at_a_time or few or results.exp.study.is_adaptive:  # whose rows are no sample that has a rate
        return
    axes = results.numeric_grid_columns
    if len(axes) < 2:  # numbers before names, which are read more easily as panels
        axes = (
            sorted(conditions, key=results.categorical_columns.__contains__)
            if len(conditions) > 1
            else results.numeric_columns
        )
    if len(axes) < 2:
        axes = [*results.numeric_columns, *results.categorical_columns][:2]
    for x, y in list(combinations(axes, 2))[:MAX_MAPS]:
        others = [c for c in axes if c not in (x, y) and c in results.numeric_columns]
        if results.exp.study.resolution and not others:
            note = f"each cell as its corners; {len(results.rows)} were run (dots), most of them next to the boundary"
            yield MapSection(x, y, None, refine.add_inferred_rows(results.exp, results.rows), note, refined=True)
            continue
        section = cut_section(results, x, y, others)
        yield section if is_section_filled(section) else bin_rows(results, x, y, others)


def cut_section(results: Results, x: str, y: str, remaining: list[str]) -> MapSection:
    """Return the rows of a map over `x` and `y`, at nominal values of `remaining` or a few values of a single one."""
    rows = results.rows
    if len(remaining) == 1:
        values = np.sort(rows[remaining[0]].unique())
        chosen = values[evenly_spaced_indices(len(values), MAX_PANELS)]
        note = f"at values of {axis_words(remaining[0], results.exp)}"
        return MapSection(x, y, remaining[0], rows[rows[remaining[0]].isin(chosen)], note)
    fixed = {}
    for name in remaining:
        fixed[name] = nearest_value(rows[name], nominal_value(results, name))
        rows = rows[rows[name] == fixed[name]]
    note = ", ".join(label_with_value(c, v, results.exp) for c, v in fixed.items())
    return MapSection(x, y, None, rows, f"at {note}" if note else "")


def is_section_filled(section: MapSection) -> bool:
    """Return whether a section is a grid of few enough values with rows in at least half of its cells."""
    by = [section.x, section.y, *([section.panel_parameter] if section.panel_parameter else [])]
    counts = [section.rows[c].nunique() for c in by]
    cells = len(section.rows[by].drop_duplicates())
    return min(counts[:2]) > 1 and max(counts[:2]) <= MAX_GRID_VALUES and 2 * cells >= math.prod(counts)


def bin_rows(results: Results, x: str, y: str, remaining: list[str]) -> MapSection:
    """Bin all rows over two parameters; a parameter with few values keeps them."""
    rows = results.rows
    most = int(np.clip(np.sqrt(len(rows) / 20), 4, 40))
    bins = {c: min(most, count_distinct(rows[c], most)) for c in (x, y)}
    note = f"{bins[x]} by {bins[y]} bins" + (", over all values of the other parameters" if remaining else "")
    return MapSection(x, y, None, rows.assign(**{c: bin_values(rows[c], most) for c in (x, y)}), note)


def nearest_value(values: pd.Series, target: float) -> float:
    """Return the value nearest to `target`."""
    return float(values.iloc[int((values - target).abs().argmin())])


def nominal_value(results: Results, column: str) -> float:
    """Return the nominal value of a parameter; the median for a number from which parameters are computed."""
    if column.startswith("axis."):
        return float(results.rows[column].median())
    return float(results.exp.system.nominal_parameter_value(column, results.exp.settings))


def draw_section(results: Results, chosen: MapSection) -> Figure:
    """Draw the map of a section: outcomes of single rollouts, or success rates with the ends of their intervals."""
    x, y = chosen.x, chosen.y
    rows, cells = lay_out_cells(chosen.rows, x, y)
    panels = list(
        split_panels(rows, x, y, (chosen.panel_parameter,) if chosen.panel_parameter else (), exp=results.exp)
    )
    tables = [cell_success_rates(results, panel, ["x", "y"], [x, y]) for _, panel in panels]
    single = max(table["total"].max() for table in tables) == 1
    sample = any(table["low"].notna().any() for table in tables)
    shown = [""] if single else ["low", "share", "high"] if sample else ["share"]
    columns = min(len(panels), 2) if len(shown) == 1 else 3
    lines = -(-len(panels) * len(shown) // columns)
    figure = new_figure(2.2 * lines + 0.6, PAGE_WIDTH_IN if columns > 1 else COLUMN_WIDTH_IN)
    axes = figure.subplots(lines, columns, squeeze=False, sharex=True, sharey=True).ravel()
    spots = iter(axes)
    for (title, panel), table in zip(panels, tables, strict=True):
        for kind in shown:
            ax = next(spots)
            if single:
                draw_outcomes(ax, panel, cells)
            else:
                broken = table[table["invalid"] > 0].assign(outcome="invalid")
                whole = table[table["valid"] > 0].assign(outcome="")
                values = pd.concat([whole.assign(value=whole[kind]), broken.assign(value=np.nan)])
                draw_cell_values(ax, values, cells, cmap="cividis", vmin=0, vmax=1)
            word = {"low": "lower end", "share": "rate of success", "high": "upper end"}.get(kind, "")
            if chosen.refined:
                draw_refined_cells(ax, results.exp, panel, x, y, cells)
            room = 72 * (PAGE_WIDTH_IN - 1) / 3 - 10  # titles side by side stay apart
            ax.set_title(wrap_text(", ".join([*title, word] if word else title), room))
            label_axis_values(ax, cells)
            analytic_curves.draw_limit_curves(ax, results.exp, panel, x, y, cells)
    for ax in spots:
        ax.set_visible(False)
    for k, ax in enumerate(axes):
        if k % columns == 0:
            ax.set_ylabel(axis_title(y, results.exp))
        if k >= len(axes) - columns:
            ax.set_xlabel(axis_title(x, results.exp))
    draw_legend(
        figure,
        list_outcome_kinds(chosen.rows, results.exp) if single else [],
        has_room_for_glyphs(cells),
        bool((chosen.rows["outcome"] == "invalid").any()),
        axes[0].get_legend_handles_labels()[0],
    )
    if not single:
        figure.colorbar(ScalarMappable(Normalize(0, 1), "cividis"), ax=axes, shrink=0.8)
    return figure


def cell_success_rates(results: Results, rows: pd.DataFrame, by: list[str], axes: list[str]) -> pd.DataFrame:
    """Compute the success rate in each cell, with the confidence interval that suits the study's design.

    Args:
        results: The study.
        rows: Its rows, or those of a refined map: cells that were filled in have no draw.
        by: Columns of the cells.
        axes: Columns of the axes that these are made from.

    Returns:
        The table of `stats.success_rates`; `low` and `high` are NaN where the rows of a cell are no sample.
    """
    study = results.exp.study
    unit = confidence_interval_unit_ids(rows, results.exp) if rows["replicate"].notna().all() else None
    table = success_rates(rows, by, confidence_sequence if study.budget else wilson, unit)
    return table if is_random_sample(rows, results.exp, axes) else table.assign(low=np.nan, high=np.nan)


def section_data(results: Results, chosen: MapSection) -> pd.DataFrame:
    """Return the numbers that a map shows, a row for each cell."""
    rows = chosen.rows
    named = [c for c in rows if "." in str(c) and rows[c].dtype.kind not in "fi" and has_several_values(rows[c])]
    named = [c for c in named if c not in (chosen.x, chosen.y)]
    by = [*named, *([chosen.panel_parameter] if chosen.panel_parameter else []), chosen.x, chosen.y]
    table = cell_success_rates(results, rows, by, by)
    if (table["total"] > 1).any():
        return table
    return rows[[*by, "outcome", "cause", "point_id"]].sort_values(by, ignore_index=True)
