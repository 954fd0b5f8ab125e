"""Grid cells of a map over two parameters, whose values may be unevenly spaced, or names."""

from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from sweep.core.spacing import evenly_spaced_indices
from sweep.report.labels import shorten_file_names

MAX_LABELLED_VALUES, MAX_HORIZONTAL_LABELS = (
    12,
    6,
)  # values of an uneven axis that have a label; that have room beside each other


class MapCells(NamedTuple):
    """Values of a map's cells along both axes, in order; the values of an axis with names are 1, 2, ... instead."""

    x: np.ndarray
    y: np.ndarray
    x_names: tuple[str, ...] = ()
    y_names: tuple[str, ...] = ()


def lay_out_cells(rows: pd.DataFrame, x: str, y: str) -> tuple[pd.DataFrame, MapCells]:
    """Arrange rows in grid cells over two parameters, of numbers or names.

    Args:
        rows: rows of a study.
        x: column of the parameter across.
        y: column of the parameter upwards.

    Returns:
        The rows with columns `x` and `y`, the number of each row's cell, and all the cells.
    """
    placed, cells = {}, {}
    for axis, name in (("x", x), ("y", y)):
        values = rows[name]
        if values.dtype.kind in "fi":
            placed[axis], cells[axis] = values, np.sort(values.unique())
            continue
        codes, names = pd.factorize(values)
        placed[axis], cells[axis] = codes + 1.0, np.arange(1.0, len(names) + 1)
        cells[f"{axis}_names"] = tuple(shorten_file_names([*map(str, names)]))
    return rows.assign(**placed), MapCells(**cells)


def is_evenly_spaced(values: np.ndarray) -> bool:
    """Return whether values are so evenly spaced that cells can reach half-way to their neighbours."""
    gaps = np.diff(values)
    return len(gaps) == 0 or float(gaps.max()) < 3 * float(gaps.min())


def cell_edges(values: np.ndarray) -> np.ndarray:
    """Return the borders of cells: half-way between values, or of equal width for uneven values."""
    if not is_evenly_spaced(values):
        return np.arange(len(values) + 1) - 0.5
    half = np.diff(values) / 2 if len(values) > 1 else np.array([0.5 * abs(values[0]) or 0.5])
    first = values[0] - half[0]
    if len(values) > 1 and values[0] >= 0:  # such as friction, which is never below zero
        first = max(first, 0.0)
    return np.concatenate([[first], values[:-1] + half[: len(values) - 1], [values[-1] + half[-1]]])


def clip_axes_at_zero(ax: Axes) -> None:
    """Limit both axes of a plot to non-negative values if no value is negative."""
    for low, start, set_limit in (
        (ax.dataLim.x0, ax.get_xlim()[0], ax.set_xlim),
        (ax.dataLim.y0, ax.get_ylim()[0], ax.set_ylim),
    ):
        if low >= 0 > start:
            set_limit(0)


def label_axis_values(ax: Axes, cells: MapCells) -> None:
    """Put a tick label at each cell, for axes with uneven values or names."""
    for axis, values, names in ((ax.xaxis, cells.x, cells.x_names), (ax.yaxis, cells.y, cells.y_names)):
        if names:
            axis.set_ticks(values, [name.replace("_", " ") for name in names])
        elif not is_evenly_spaced(values):
            named = evenly_spaced_indices(len(values), MAX_LABELLED_VALUES)
            axis.set_ticks(named, [format_number(float(values[k])) for k in named])
    if len(cells.x) > MAX_HORIZONTAL_LABELS and (cells.x_names or not is_evenly_spaced(cells.x)):
        ax.tick_params(axis="x", labelrotation=60)


def format_number(value: float, size: int = 4) -> str:
    """Format a number for axes and LaTeX with `size` digits: `0.125`, `20,000`, `$2.5·10^{-7}$`."""
    digits, _, power = f"{value:.{size}g}".partition("e")
    if not power:
        return digits
    return f"{value:,.0f}" if 0 < int(power) < 6 else rf"${digits}\cdot10^{{{int(power)}}}$"


def axis_positions(numbers: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the positions of numbers along an axis with cells of `values`; NaN for numbers without a cell."""
    if is_evenly_spaced(values):
        return numbers
    return np.interp(numbers, values, np.arange(len(values)), left=np.nan, right=np.nan)
