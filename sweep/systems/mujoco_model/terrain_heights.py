"""Height fields by kind: level, slope, stairs, rough ground, gaps, stepping stones, and images.

All heights are functions of a place and of numbers. Random ones are drawn for each place from the seed alone, so that
neither the size nor the resolution of a field changes what stands where.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from sweep.contract.system import Parameter
from sweep.core.parameters import choice, quantity

NUMBERS: Mapping[str, Parameter] = {  # of a terrain, by key; each kind uses some of them: `KINDS`
    "slope": quantity(0.2, "-", at_least=-2, at_most=2),  # rise over run
    "rise": quantity(0.1, "m", at_least=-1, at_most=1),  # height of each stair; below 0 they go down
    "run": quantity(0.3, "m", at_least=0.01),  # length of each stair
    "steps": quantity(10.0, "steps", at_least=0, at_most=1000),  # number of stairs
    "height": quantity(0.1, "m", at_least=0, at_most=8),  # range of random heights, or of an image's brightness
    "spacing": quantity(0.2, "m", at_least=0.01),  # distance between random heights
    "gap": quantity(0.1, "m", at_least=0),  # width of gaps
    "land": quantity(0.4, "m", at_least=0.01),  # length of the ground between gaps, side of a stepping stone
    "depth": quantity(0.5, "m", at_least=0, at_most=8),  # depth of gaps
    "start": quantity(0.5, "m"),  # how far the ground is level from the middle on
    "heading": quantity(0.0, "rad"),  # direction of the ascent and of the way over gaps, from the x axis
    "seed": quantity(0.0, "index", at_least=0, at_most=2**31),  # of random heights
}
ROUNDING = 1e-9  # of a cell, within which a place counts as on its edge


class GridPoints(NamedTuple):
    """Points of a height field (m): x and y, and their coordinates along and across the terrain's heading."""

    x: np.ndarray  # (rows, columns) m
    y: np.ndarray
    along: np.ndarray
    across: np.ndarray


def random_lattice(seed: int, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """Return uniform random numbers from 0 to 1 that are a function of a seed and of whole numbers i and j."""
    with np.errstate(over="ignore"):
        bits = np.asarray(i, np.int64).astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        bits += np.asarray(j, np.int64).astype(np.uint64) * np.uint64(0xC2B2AE3D27D4EB4F)
        bits += np.uint64(seed + 1) * np.uint64(0x165667B19E3779F9)
        for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB), (31, 1)):  # finalizer of SplitMix64
            bits = (bits ^ (bits >> np.uint64(shift))) * np.uint64(factor)
    return (bits >> np.uint64(11)).astype(float) / 2**53


def _interpolate(values: Callable[[np.ndarray, np.ndarray], np.ndarray], u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Interpolate values at whole numbers (i, j) linearly in both directions at (u, v)."""
    i, j = np.floor(u).astype(int), np.floor(v).astype(int)
    a, b = u - i, v - j
    low, high = ((1 - a) * values(i, k) + a * values(i + 1, k) for k in (j, j + 1))
    return (1 - b) * low + b * high


def _flat(at: GridPoints, numbers: Mapping[str, float], image: np.ndarray | None) -> np.ndarray:
    return np.zeros_like(at.x)


def _slope(at: GridPoints, numbers: Mapping[str, float], image: np.ndarray | None) -> np.ndarray:
    return numbers["slope"] * np.maximum(at.along - numbers["start"], 0)


def _stairs(at: GridPoints, numbers: Mapping[str, float], image: np.ndarray | None) -> np.ndarray:
    number = np.floor((at.along - numbers["start"]) / numbers["run"] + ROUNDING) + 1
    return numbers["rise"] * np.clip(number, 0, np.rint(numbers["steps"]))


def _rough(at: GridPoints, numbers: Mapping[str, float], image: np.ndarray | None) -> np.ndarray:
    seed, spacing = int(np.rint(numbers["seed"])), numbers["spacing"]
    rough = _interpolate(lambda i, j: random_lattice(seed, i, j), at.x / spacing, at.y / spacing)
    return numbers["height"] * rough


def _within_gap(distance: np.ndarray, numbers: Mapping[str, float]) -> np.ndarray:
    """Return where a distance from the level start lies in a gap: first comes a gap, then ground, and so on."""
    period = numbers["gap"] + numbers["land"]
    place = np.mod(distance + ROUNDING, period)
    return (distance > ROUNDING) & (place > 2 * ROUNDING) & (place < numbers["gap"])


def _gaps(at: GridPoints, numbers: Mapping[str, float], image: np.ndarray | None) -> np.ndarray:
    return np.where(_within_gap(at.along - numbers["start"], numbers), -numbers["depth"], 0.0)


def _stones(at: GridPoints, numbers: Mapping[str, float], image: np.ndarray | None) -> np.ndarray:
    start, period = numbers["start"], numbers["gap"] + numbers["land"]
    far = np.maximum(np.abs(at.along), np.abs(at.across))
    cells, lost = [], np.zeros(at.x.shape, bool)
    for place in (at.along, at.across):  # stones and gaps alternate from the middle of a stone in the middle on
        shifted = place + numbers["land"] / 2 + ROUNDING
        cells.append(np.floor(shifted / period))
        lost |= np.mod(shifted, period) > numbers["land"] + 2 * ROUNDING
    tops = numbers["height"] * random_lattice(int(np.rint(numbers["seed"])), *cells)
    return np.where(far <= start + ROUNDING, 0.0, np.where(lost, -numbers["depth"], tops))


def _image(at: GridPoints, numbers: Mapping[str, float], image: np.ndarray | None) -> np.ndarray:
    if image is None:
        raise ValueError("an image is needed")
    rows, columns = image.shape
    u, v = (_shares(place) * (count - 1) for place, count in ((at.x, columns), (at.y, rows)))
    pixels = image[::-1]  # its last row is that of the least y
    found = _interpolate(lambda i, j: pixels[np.minimum(j, rows - 1), np.minimum(i, columns - 1)], u, v)
    return numbers["height"] * found


def _shares(place: np.ndarray) -> np.ndarray:
    return (place - place.min()) / np.ptp(place)


class TerrainKind(NamedTuple):
    """A generator of terrain heights, with the parameters that it uses."""

    heights: Callable[[GridPoints, Mapping[str, float], np.ndarray | None], np.ndarray]
    uses: tuple[str, ...]


KINDS: Mapping[str, TerrainKind] = {
    "flat": TerrainKind(_flat, ()),
    "slope": TerrainKind(_slope, ("slope", "start", "heading")),
    "stairs": TerrainKind(_stairs, ("rise", "run", "steps", "start", "heading")),
    "rough": TerrainKind(_rough, ("height", "spacing", "seed")),
    "gaps": TerrainKind(_gaps, ("gap", "land", "depth", "start", "heading")),
    "stones": TerrainKind(_stones, ("gap", "land", "depth", "height", "seed", "start", "heading")),
    "image": TerrainKind(_image, ("height",)),
}
KIND: Parameter = choice("flat", *KINDS)


def compute_heights(
    kind: str, numbers: Mapping[str, float], x: np.ndarray, y: np.ndarray, image: np.ndarray | None = None
) -> np.ndarray:
    """Compute the heights of a terrain on a grid.

    Args:
        kind: One of `KINDS`.
        numbers: Its numbers by name, see `NUMBERS`.
        x: Coordinates (columns,) of the grid in m, from the middle of the field.
        y: Coordinates (rows,) likewise.
        image: Brightness (., .) from 0 to 1 of the kind `image`.

    Returns:
        Heights (rows, columns) in m.
    """
    cos, sin = np.cos(numbers["heading"]), np.sin(numbers["heading"])
    u, v = np.meshgrid(x, y)
    return KINDS[kind].heights(GridPoints(u, v, cos * u + sin * v, cos * v - sin * u), numbers, image)


def height_upper_bound(kind: str, numbers: Mapping[str, Any], reach: float) -> Any:
    """Return an upper bound (m) on the absolute heights of a terrain.

    Args:
        kind: One of `KINDS`.
        numbers: Its numbers by name, which may be arrays of one shape.
        reach: Distance in m of the farthest place from the middle.

    Returns:
        The bound in m.
    """
    match kind:
        case "slope":
            return np.abs(numbers["slope"]) * np.maximum(reach - np.asarray(numbers["start"]), 0)
        case "stairs":
            return np.abs(numbers["rise"]) * numbers["steps"]
        case _:
            return np.maximum(numbers["height"], numbers["depth"])
