"""Colour and shape of each outcome, the same in every study, view, theme and figure.

Success is sky blue, which no failure comes near for any kind of colour blindness. Causes go by what fails: feet are
red, the body is orange, plans are yellow, drives are grey, goals are brown and wine-coloured. Within a family the shape
tells the cause, so that nobody has to tell some twenty colours apart.
"""

from typing import NamedTuple
from zlib import crc32

import numpy as np
import pandas as pd
from matplotlib.lines import Line2D
from matplotlib.path import Path

from sweep.core.outcomes import SUCCESS


class OutcomeStyle(NamedTuple):
    """Colour and shape with which rollouts of one outcome kind are drawn."""

    colour: str  # of marks, lines and cells; of doubts that of marks, as their cells are hatched
    shape: np.ndarray  # corners (N, 2) of a mark, x to the right and y up, its radius being about one
    family: str  # what fails


def star_polygon(points: int, inner: float = 1.0, turn: float = 0.0) -> np.ndarray:
    """Return a star polygon (2 N, 2) with inner corners at a share of the radius; at share 1 a regular polygon (N,
    2)."""
    count = points if inner == 1 else 2 * points
    angle = np.radians(90 + turn) + 2 * np.pi * np.arange(count) / count
    radius = np.where(np.arange(count) % 2 * (inner != 1), inner, 1.0)
    return np.stack([np.cos(angle), np.sin(angle)], axis=1) * radius[:, None]


def cross_polygon(half: float, turn: float = 0.0) -> np.ndarray:
    """Return the polygon of a cross of two bars of half width `half`."""
    arm = np.array([(half, 1.0), (half, half), (1.0, half)])
    return np.concatenate([arm @ polygon_rotation_matrix(-90 * k) for k in range(4)]) @ polygon_rotation_matrix(turn)


def chevron_polygon(turn: float = 0.0) -> np.ndarray:
    """Return the polygon (6, 2) of a thick arrowhead that points up."""
    return np.array([(-0.9, -0.9), (0, 0), (0.9, -0.9), (0.9, 0), (0, 0.9), (-0.9, 0)]) @ polygon_rotation_matrix(turn)


def hourglass_polygon(turn: float = 0.0) -> np.ndarray:
    """Return the polygon (6, 2) of two triangles that meet at their tips."""
    return np.array([(-0.9, 1), (0.9, 1), (0.2, 0), (0.9, -1), (-0.9, -1), (-0.2, 0)]) @ polygon_rotation_matrix(turn)


def dome_polygon(turn: float = 0.0) -> np.ndarray:
    """Return the polygon (13, 2) of half a disc with its flat side below."""
    angle = np.linspace(0, np.pi, 13)
    return np.stack([np.cos(angle), np.sin(angle) - 0.45], axis=1) @ polygon_rotation_matrix(turn)


def ring_polygon(hole: float) -> np.ndarray:
    """Return the polygon (50, 2) of a ring with a hole of the given radius."""
    angle = np.linspace(0, 2 * np.pi, 25)
    around = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.concatenate([around, hole * around[::-1]])


def bar_polygon(half: float, turn: float = 0.0) -> np.ndarray:
    """Return the polygon of a bar of half width `half`."""
    return np.array([(1.0, half), (1.0, -half), (-1.0, -half), (-1.0, half)]) @ polygon_rotation_matrix(turn)


def polygon_rotation_matrix(degrees: float) -> np.ndarray:
    """Return the matrix (2, 2) that turns corners (N, 2) of a polygon when multiplied from the right."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, s], [-s, c]])


def cause_family_styles(family: str, **kinds: tuple[str, np.ndarray]) -> dict[str, OutcomeStyle]:
    """Return the drawing styles of a family of failure causes, whose marker shapes have about equal area."""
    found = {}
    for kind, (colour, shape) in kinds.items():
        x, y = shape.T
        area = np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2
        found[kind] = OutcomeStyle(colour, shape * min(1.25 / np.hypot(x, y).max(), np.sqrt(2.6 / abs(area))), family)
    return found


INVALID_CAUSES = "sunk", "not_finite", "solver", "unsettled", "energy"
OUTCOME_STYLES = {
    **cause_family_styles("success", success=("#56B4E9", star_polygon(24))),
    **cause_family_styles(
        "foot", slipped=("#C8102E", star_polygon(3, turn=180)), slipped_on_deck=("#FF6367", chevron_polygon(180))
    ),
    **cause_family_styles(
        "body",
        fell=("#D55E00", star_polygon(4, turn=45)),
        fell_off=("#F28C28", bar_polygon(0.5, turn=90)),
        link_collision=("#6B2A00", cross_polygon(0.27, turn=45)),
        leg_crossing=("#FFB000", hourglass_polygon()),
        base_hit=("#C98500", cross_polygon(0.27)),
        folded=("#B97A3C", chevron_polygon(90)),
        shin_under_face=("#FFC79C", dome_polygon(180)),
    ),
    **cause_family_styles(
        "plan",
        unreachable=("#8F8600", star_polygon(4)),
        no_plan=("#D6C600", star_polygon(4, 0.4, turn=45)),
        infeasible=("#5F5A00", star_polygon(4) * (0.6, 1)),
        uncalibrated=("#BDB76B", dome_polygon(90)),
    ),
    **cause_family_styles(
        "drive",
        overload=("#5E5E5E", star_polygon(6, 0.5)),
        overturned_leg=("#A39A8C", star_polygon(5, turn=180)),
        overspeed=("#756C5E", chevron_polygon(-90)),
        overpower=("#8A7F72", dome_polygon()),
    ),
    **cause_family_styles(
        "goal",
        stalled=("#90115E", bar_polygon(0.35)),
        goal_missed=("#480037", star_polygon(3)),
        off_course=("#B01E58", star_polygon(3, turn=-90)),
        obstacle_moved=("#A65B45", star_polygon(5)),
        obstacle_shifted=("#D08D74", star_polygon(3, turn=90)),
        awash=("#7A1F1F", star_polygon(5, 0.4)),
        lifted=("#B0413E", chevron_polygon()),
        rolled_off=("#C9A27C", ring_polygon(0.45)),
        restless=("#7A3350", hourglass_polygon(90)),
        obstacle_turned=("#905F2E", star_polygon(4, 0.45)),
    ),
    **cause_family_styles(
        "doubt", **{doubt: ("#8A8C92", star_polygon(k, 0.3)) for k, doubt in enumerate(INVALID_CAUSES, 6)}
    ),
}
PAIR_STYLES = cause_family_styles(  # of the same point in two studies
    "pair",
    both_fail=("#5E5E5E", star_polygon(4, turn=45)),
    only_A_succeeds=("#C8102E", star_polygon(3, turn=180)),
    only_B_succeeds=("#FFB000", star_polygon(3)),
    invalid_in_one=("#8A8C92", star_polygon(6, 0.3)),
)
UNKNOWN_KIND_STYLE = cause_family_styles("", other=("#7F7F7F", dome_polygon(-90)))[
    "other"
]  # of a kind that is not known
FAILURE_COLOUR = "#3F444A"  # of all failures together: that of no cause
INVALID_CELL_COLOUR, DARK_INK = "#FFFFFF", "#1C2024"  # cells of doubts; glyphs
INVALID_MARK_COLOUR = "#8A8C92"
SUCCESS_COLOUR = OUTCOME_STYLES[SUCCESS].colour


def find_style(kind: str) -> OutcomeStyle:
    """Return the style of success, of a cause or of a pair's outcome; a user's cause gets one derived from its name."""
    spare = [one for one in OUTCOME_STYLES.values() if one.family not in ("success", "doubt")]
    known = OUTCOME_STYLES.get(kind) or PAIR_STYLES.get(kind)
    return known or (spare[crc32(kind.encode()) % len(spare)] if kind else UNKNOWN_KIND_STYLE)


def marker_path(kind: str) -> Path:
    """Return the shape of an outcome kind as a Matplotlib marker."""
    shape = find_style(kind).shape
    return Path(np.concatenate([shape, shape[:1]]), closed=True)


def glyph_colour(colour: str) -> str:
    """Return the colour of a glyph on a cell: dark on light colours, light on dark ones."""
    red, green, blue = (int(colour[k : k + 2], 16) for k in (1, 3, 5))
    return INVALID_CELL_COLOUR if 0.299 * red + 0.587 * green + 0.114 * blue < 110 else DARK_INK


def legend_handle(kind: str, label: str, **style: object) -> Line2D:
    """Return the legend entry for marks of an outcome kind."""
    return Line2D([], [], linestyle="", marker=marker_path(kind), color=find_style(kind).colour, label=label, **style)  # pyright: ignore[reportArgumentType]


def kinds_by_frequency(kinds: pd.Series) -> list[str]:
    """Return success, then causes, the most frequent first, so that rarer ones are drawn on top."""
    counts = kinds.value_counts()
    return sorted(map(str, counts.index), key=lambda one: (one != SUCCESS, -int(counts[one])))
