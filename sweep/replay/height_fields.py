"""Height fields of a MuJoCo model, sampled with few enough points for drawing."""

from typing import NamedTuple

import mujoco
import numpy as np

MARGIN = 1.5  # m of ground around a way that is drawn
MOST_POINTS = 48  # along each side


class HeightGrid(NamedTuple):
    """A part of a height field as a grid of heights, in the axes of its geom (m)."""

    x: np.ndarray  # (columns,)
    y: np.ndarray  # (rows,)
    heights: np.ndarray  # (rows, columns)


def sample_height_field(
    model: mujoco.MjModel, geom: int, way: np.ndarray | None = None, most: int = MOST_POINTS
) -> HeightGrid:
    """Sample the height field of a geom along the robot's way, or as a whole.

    Args:
        model: The MuJoCo model.
        geom: Id of the geom.
        way: Positions (n, 2) in m in the axes of the geom, around which ground is drawn; None for all of it.
        most: Largest number of points along a side.

    Returns:
        Points of the height field, with equal strides.
    """
    field = int(model.geom_dataid[geom])
    rows, columns = int(model.hfield_nrow[field]), int(model.hfield_ncol[field])
    half_x, half_y, scale, _ = model.hfield_size[field]
    start = int(model.hfield_adr[field])
    heights = scale * np.asarray(model.hfield_data[start : start + rows * columns], float).reshape(rows, columns)
    chosen = []
    for k, (half, count) in enumerate(((half_x, columns), (half_y, rows))):
        axis = np.linspace(-half, half, count)
        ends = (axis[0], axis[-1]) if way is None else (way[:, k].min() - MARGIN, way[:, k].max() + MARGIN)
        first, last = np.searchsorted(axis, ends[0]), np.searchsorted(axis, ends[1])
        first, last = max(min(first, count - 2), 0), min(max(last, 1), count - 1)
        every = -(-(last - first) // (most - 1)) or 1
        chosen.append((axis, np.arange(first, last + 1, every)))
    (x, i), (y, j) = chosen
    return HeightGrid(x[i], y[j], heights[np.ix_(j, i)])
