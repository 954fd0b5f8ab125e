"""Push map: the largest push that a robot survives in each direction, drawn around the robot."""

from collections.abc import Iterator
from typing import cast

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from matplotlib.projections.polar import PolarAxes
from matplotlib.ticker import MaxNLocator

from sweep.analysis import push_map
from sweep.core.plot_style import COLUMN_WIDTH_IN, PAGE_WIDTH_IN, add_legend_below, new_figure, wrap_text
from sweep.replay.outline import outlines_from_above
from sweep.report.figure import StudyFigure
from sweep.report.labels import axis_title, axis_words, label_with_value
from sweep.report.outcome_style import FAILURE_COLOUR, SUCCESS_COLOUR
from sweep.runs.results import Results

MAX_PANELS = 6  # combinations of the conditions beside the direction, at most
HOLE_SHARE = 0.4  # of the largest push that was tried: radius of the hole in which the robot stands
ROBOT_SHARE = 0.8  # of the hole's radius, up to which the robot reaches
CLOSED_GAP = 1.5  # of the usual gap between directions: at a smaller one the curve is closed


def push_map_figure(results: Results) -> Iterator[StudyFigure]:
    """Yield the push map of a study that varies size and direction of a push."""
    selected = push_map.select_push_rows(results.rows, results.exp)
    if selected is None:
        return
    rows, size = selected
    table = push_map.threshold_table(rows)
    yield StudyFigure(
        "push_map",
        f"Push map: {axis_words(size, results.exp)} by direction",
        describe_push_map(results, rows, table, size),
        table,
        lambda: _draw_push_map(results, rows, table, size),
    )


def describe_push_map(results: Results, rows: push_map.PushRows, table: pd.DataFrame, size: str) -> str:
    """Describe what the curves of a push map mean, and how islands were decided.

    Args:
        results: The study.
        rows: Its rollouts with pushes.
        table: Thresholds, from `threshold_table`.
        size: Column of the push's size.

    Returns:
        Caption of the figure.
    """
    several = int(table["threshold"].eq(np.inf).sum())
    islands = int(table["fails_at"].notna().sum())
    text = (
        f"Largest {axis_words(size, results.exp)} that is survived, by the direction in which the robot (grey, at its "
        "start) is pushed, from a fit of the success rate that falls with the size. "
    )
    if rows.unit is None:
        text += "Band: from the last size below every failure to the first above every success. "
        text += f"In {islands} of {len(table)} directions a push is survived above one that is not (crosses)."
    else:
        text += "Band: 95 % interval. Crosses: islands, where more rollouts succeed than at a smaller size "
        text += f"(p < 0.05, Holm over all pairs of sizes): in {islands} of {len(table)} directions."
    if several:
        text += f" In {several} directions the largest size (dotted) is survived."
    panels = table.groupby(_panel_columns(rows), observed=True).ngroups if _panel_columns(rows) else 1
    if panels > MAX_PANELS:
        text += f" The first {MAX_PANELS} of {panels} conditions are drawn."
    return text


def _panel_columns(rows: push_map.PushRows) -> list[str]:
    return [*map(str, rows.conditions)][1:]


def _draw_push_map(results: Results, rows: push_map.PushRows, table: pd.DataFrame, size: str) -> Figure:
    direction, *others = map(str, rows.conditions)
    parts = list(table.groupby(others, observed=True, sort=True))[:MAX_PANELS] if others else [((), table)]
    columns = len(parts) if len(parts) <= 3 else 2 if len(parts) == 4 else 3
    lines = -(-len(parts) // columns)
    width = COLUMN_WIDTH_IN if columns == 1 else PAGE_WIDTH_IN
    figure = new_figure(lines * (width / columns + 0.15) + 0.35, width)
    largest = float(rows.size.max() + rows.bin_width / 2)
    outlines = outlines_from_above(*results.exp.system.start_pose())
    drawn = []
    for number, (values, part) in enumerate(parts, 1):
        ax = cast(PolarAxes, figure.add_subplot(lines, columns, number, projection="polar"))
        words = [label_with_value(c, v, results.exp) for c, v in zip(others, values, strict=True)]
        drawn.append(_draw_panel(ax, part.sort_values(direction), largest, axis_title(size, results.exp)))
        _draw_robot(ax, outlines)
        if words:
            ax.set_title(wrap_text(", ".join(words), 72 * width / columns - 10))
    shown = {line.get_label(): line for ax_lines in drawn for line in ax_lines}
    add_legend_below(figure, list(shown.values()))
    return figure


def _draw_panel(ax: PolarAxes, table: pd.DataFrame, largest: float, size: str) -> list[Artist]:
    """Draw the thresholds of one condition over the direction, its first column; return what the legend names."""
    angle = table.iloc[:, 0].to_numpy(float)
    curve, low, high = (table[c].clip(upper=largest).to_numpy(float) for c in ("threshold", "low", "high"))
    gap = np.diff(angle).min() if len(angle) > 1 else np.inf
    if angle[0] + 2 * np.pi - angle[-1] < CLOSED_GAP * gap and angle[-1] - angle[0] < 2 * np.pi - 1e-6:
        angle = np.append(angle, angle[0] + 2 * np.pi)
        curve, low, high = (np.append(values, values[0]) for values in (curve, low, high))
    ax.set_rlim(0, largest * 1.08)
    ax.set_rorigin(-HOLE_SHARE * largest)
    ax.set_rlabel_position(45)
    ax.set_thetagrids([0, 90, 180, 270])
    ax.yaxis.set_major_locator(MaxNLocator(3))
    ax.grid(linewidth=0.3)
    turn = np.linspace(0, 2 * np.pi, 181)
    limit = ax.plot(turn, np.full(181, largest), ":", color="0.3", label="largest size tried")
    band = ax.fill_between(angle, low, high, color=SUCCESS_COLOUR, alpha=0.3, linewidth=0, label="interval")
    line = ax.plot(angle, curve, "-", marker=".", markersize=3, color=SUCCESS_COLOUR, label=f"threshold, {size}")
    islands = table[table["fails_at"].notna()]
    at = islands.iloc[:, 0].to_numpy(float)
    crosses = ax.plot(at, islands["survives_at"], "x", color=FAILURE_COLOUR, label="island") if len(islands) else []
    return [*line, band, *limit, *crosses]


def _draw_robot(ax: Axes, outlines: list[np.ndarray]) -> None:
    """Draw the outlines of the robot's parts in the hole in the middle of a polar plot, in world axes."""
    half = 0.5 * ROBOT_SHARE * HOLE_SHARE / (1.08 + HOLE_SHARE)
    inset = ax.inset_axes((0.5 - half, 0.5 - half, 2 * half, 2 * half))
    inset.set_axis_off()
    reach = max((float(np.hypot(*outline.T).max()) for outline in outlines), default=1.0)
    inset.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
    for outline in outlines:
        inset.add_patch(Polygon(outline, facecolor="0.75", edgecolor="0.35", linewidth=0.3, clip_on=False))
