"""The cells of a map over two parameters: where values lie, which may be unevenly spaced."""

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes


class Cells(NamedTuple):
    """The values of both parameters, in order."""

    x: np.ndarray
    y: np.ndarray


def evenly_spaced(values: np.ndarray) -> bool:
    """Whether cells can have the width of their values' distance without some being too thin to see."""
    gaps = np.diff(values)
    return len(gaps) == 0 or float(gaps.max()) < 3 * float(gaps.min())


def edges(values: np.ndarray) -> np.ndarray:
    """Cell borders: half-way between values, or counted where the values are uneven."""
    if not evenly_spaced(values):
        return np.arange(len(values) + 1) - 0.5
    half = np.diff(values) / 2 if len(values) > 1 else np.array([0.5 * abs(values[0]) or 0.5])
    return np.concatenate([[values[0] - half[0]], values[:-1] + half[: len(values) - 1], [values[-1] + half[-1]]])


def mark_values(ax: Axes, cells: Cells) -> None:
    """Name the values of uneven axes, cell by cell."""
    for axis, values in ((ax.xaxis, cells.x), (ax.yaxis, cells.y)):
        if not evenly_spaced(values):
            axis.set_ticks(np.arange(len(values)), [f"{v:.4g}" for v in values])


def places(numbers: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Where `numbers` lie on an axis with cells of `values`; nan outside those that are uneven."""
    if evenly_spaced(values):
        return numbers
    return np.interp(numbers, values, np.arange(len(values)), left=np.nan, right=np.nan)
