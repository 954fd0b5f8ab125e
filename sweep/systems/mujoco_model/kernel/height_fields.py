"""Contacts of spheres with height fields, as MuJoCo computes them.

MuJoCo splits each cell of the grid into two triangles, and takes the ground below a triangle as a prism. Each prism
that a sphere overlaps has a contact of its own, at the point of the prism nearest to the sphere's centre.
"""

from itertools import pairwise
from typing import Any, NamedTuple

import mujoco
import numpy as np

from sweep.systems.mujoco_model.kernel.numbers import ModelFieldValues
from sweep.systems.mujoco_model.kernel.scalars import (
    ONE,
    ZERO,
    Scalar,
    Vector,
    choose,
    clip,
    keep_nearest,
    round_down,
    round_up,
    smallest,
    where,
)

FAR_SQUARE = 1e12  # m^2, of a prism that does not count
MOST_PRISMS = 6  # that a sphere touches at once: as many meet in a point of the grid


class FieldContact(NamedTuple):
    """Nearest point of a prism to a sphere's centre."""

    square: Scalar  # m^2, of the distance
    gap: Vector  # from the point to the centre, in the field's axes


class FieldGrid(NamedTuple):
    """Grid of a height field, and the cells near a sphere."""

    half: np.ndarray  # (2,) m, half sizes along x and y
    step: np.ndarray  # (2,) m, between neighbouring points
    counts: np.ndarray  # (2,) number of points
    cells: np.ndarray  # (2,) number that the square around a sphere can overlap, at most


def find_field_grid(model: mujoco.MjModel, geom: int, radius: float) -> FieldGrid:
    """Return the grid of a height field, and how many of its cells the square around a sphere can overlap at most.

    Args:
        model: The model.
        geom: Id of the height field's geom.
        radius: Of the sphere, m.
    """
    field = int(model.geom_dataid[geom])
    half = model.hfield_size[field, :2].copy()
    counts = np.array([model.hfield_ncol[field], model.hfield_nrow[field]], int)
    step = 2 * half / (counts - 1)
    return FieldGrid(half, step, counts, np.floor(2 * radius / step).astype(int) + 2)


def find_field_contacts(
    numbers: ModelFieldValues, geom: int, centre: Vector, radius: Scalar
) -> tuple[list[FieldContact], Any]:
    """Find the prisms of a height field that are nearest to spheres.

    Args:
        numbers: Numbers of the rollout's model.
        geom: Id of the height field's geom.
        centre: Centres of the spheres, in the field's axes.
        radius: Radii of the spheres, m, known when the kernel is compiled.

    Returns:
        The nearest prisms, `MOST_PRISMS` at most; and whether a sphere overlaps more, or has its centre in one.
    """
    grid = find_field_grid(numbers.model, geom, float(np.max(radius.value)))
    firsts, inside = [], []  # first cell along each axis; whether each of the cells counts, from there
    for k, x in enumerate((centre.x, centre.y)):
        low, high = ((x + radius * sign + float(grid.half[k])) * float(1 / grid.step[k]) for sign in (-1.0, 1.0))
        low, high = round_down(low), round_up(high)
        last = float(grid.counts[k] - 1)
        firsts.append(low)
        inside.append([~(low + i < ZERO) & (low + i < high) & (low + i < last) for i in range(grid.cells[k])])
    x = [centre.x + float(grid.half[0]) - (firsts[0] + i) * float(grid.step[0]) for i in range(grid.cells[0] + 1)]
    y = [centre.y + float(grid.half[1]) - (firsts[1] + j) * float(grid.step[1]) for j in range(grid.cells[1] + 1)]
    above = [
        [centre.z - _read_height(numbers, geom, grid, firsts[1] + j, firsts[0] + i) for i in range(grid.cells[0] + 1)]
        for j in range(grid.cells[1] + 1)
    ]
    # vectors from the points of the grid to the centre
    arms = [[Vector(x[i], y[j], above[j][i]) for i in range(grid.cells[0] + 1)] for j in range(grid.cells[1] + 1)]
    sides: dict[tuple, FieldContact] = {}

    def side(*ends: tuple[int, int]) -> FieldContact:
        if ends not in sides:
            (j, i), (m, n) = ends
            sides[ends] = _nearest_of_side(arms[j][i], arms[m][n], (n - i) * grid.step[0], (m - j) * grid.step[1])
        return sides[ends]

    kept: list[FieldContact] = []
    left, buried = Scalar(FAR_SQUARE), []
    for j in range(grid.cells[1]):
        for i in range(grid.cells[0]):
            a, b, c, d = (j, i), (j + 1, i), (j + 1, i + 1), (j, i + 1)
            for corners in ((a, b, c), (a, d, c)):
                edges = [side(*both) for both in pairwise(corners)] + [side(a, c)]
                one, is_inside = _nearest_of_prism([arms[j][i] for j, i in corners], edges, grid, corners[1] == b)
                counts = inside[0][i] & inside[1][j]
                buried.append(is_inside & counts)
                rest = one._replace(square=where(counts, one.square, FAR_SQUARE))
                dropped = keep_nearest(kept, rest, MOST_PRISMS)
                left = left if dropped is None else smallest(left, dropped)
    unsure = left < radius * radius
    for flag in buried:
        unsure = unsure | flag
    return kept, unsure.any()


def _read_height(numbers: ModelFieldValues, geom: int, grid: FieldGrid, row: Scalar, column: Scalar) -> Scalar:
    """Heights of points of the grid, m; those beside it have that of the nearest one."""
    model = numbers.model
    field = int(model.geom_dataid[geom])
    row, column = (clip(one, 0.0, float(n - 1)) for one, n in ((row, grid.counts[1]), (column, grid.counts[0])))
    place = row * float(grid.counts[0]) + column + float(model.hfield_adr[field])
    return numbers.look_up("hfield_data", place) * float(model.hfield_size[field, 2])


def _nearest_of_side(start: Vector, end: Vector, dx: float, dy: float) -> FieldContact:
    """Nearest point of the vertical side below an edge.

    Args:
        start: From one end of the edge to the centre.
        end: From the other end to the centre.
        dx: Length of the edge along x, m.
        dy: Length along y, m.
    """
    rise = start.z - end.z
    level = dx * dx + dy * dy
    flat = start.x * dx + start.y * dy
    share = clip(flat * (1 / level), 0.0, 1.0)
    beside = ~(start.z - share * rise > ZERO)  # the centre is lower than the edge there
    slanted = clip((flat + start.z * rise) / (level + rise * rise), 0.0, 1.0)
    share = where(beside, share, slanted)
    gap = Vector(start.x - share * dx, start.y - share * dy, where(beside, ZERO, start.z - share * rise))
    return FieldContact(gap.dot(gap), gap)


def _nearest_of_prism(
    arms: list[Vector], sides: list[FieldContact], grid: FieldGrid, is_upper: bool
) -> tuple[FieldContact, Any]:
    """Nearest point of the prism below a triangle, and whether the centre is in it.

    Args:
        arms: From the corners to the centre: that of the lowest row and column, a neighbour, the opposite one.
        sides: Nearest points of the vertical sides.
        grid: The grid.
        is_upper: Whether the neighbour is in the next row, and not in the next column.
    """
    first, second, third = arms
    one, other = first.z - second.z, second.z - third.z  # rises from corner to corner
    along_x, along_y = (other, one) if is_upper else (one, other)
    along_x, along_y = along_x * float(1 / grid.step[0]), along_y * float(1 / grid.step[1])
    height = first.z - along_x * first.x - along_y * first.y
    share = height / (1 + along_x * along_x + along_y * along_y)

    def is_within(x: Scalar, y: Scalar) -> Any:
        u, v = x * float(1 / grid.step[0]), y * float(1 / grid.step[1])
        u, v = (v, u) if is_upper else (u, v)
        return ~(u > ONE) & ~(v < ZERO) & ~(u < v)

    gap = Vector(-(along_x * share), -(along_y * share), share)
    is_face = is_within(first.x - gap.x, first.y - gap.y)
    best = FieldContact(where(is_face, gap.dot(gap), FAR_SQUARE), gap)
    for side in sides:
        best = choose(side.square < best.square, side, best)
    return best, is_within(first.x, first.y) & ~(height > ZERO)
