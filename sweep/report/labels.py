"""Labels and units of result columns, for readers."""

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import PurePosixPath

import pandas as pd

from sweep.analysis.compare import SECOND_RUN_MARK
from sweep.config.experiment import Experiment
from sweep.contract.system import split_side_prefix
from sweep.core.outcomes import SUCCESS
from sweep.core.parameters import UNIT_BY_SUFFIX, format_unit
from sweep.study.designs import Axis
from sweep.study.study import unit_of_column

FILES = (".xml", ".urdf", ".mjb", ".onnx", ".pt", ".pt2", ".png")  # ends of files that axes name
READABLE_UNITS = {end: format_unit(unit) for end, unit in UNIT_BY_SUFFIX.items()} | {
    "deg": "°"
}  # units of figures as they are read


def outcome_kind(rows: pd.DataFrame) -> pd.Series:
    """Return the kind of each row: `success`, `invalid`, or the name of its failure cause."""
    cause = rows["cause"] if rows["cause"].dtype == "str" else rows["cause"].astype(object)
    return cause.where(rows["outcome"] != SUCCESS, SUCCESS).astype(str)


def explain_outcome_kind(kind: str, exp: Experiment) -> str:
    """Describe in a sentence what success, or a failure cause, means."""
    nothing = "no cause of failure or invalidity occurred"
    return exp.system.cause_meanings(exp.thresholds).get(kind, nothing)


def split_metric_column(column: str) -> tuple[str, str]:
    """Split a metric's column into words and unit: `slip_max_m` -> (`slip max`, `m`); the unit may be empty."""
    head, _, last = column.rpartition("_")
    return (
        (head.replace("_", " "), READABLE_UNITS[last])
        if head and last in READABLE_UNITS
        else (column.replace("_", " "), "")
    )


def axis_words(column: str, exp: Experiment | None = None) -> str:
    """Return the label of a parameter's column, without its unit.

    Args:
        column: such as `world.contact.friction`.
        exp: experiment of the study that has the column, if it is known.

    Returns:
        The name that the study gives to the axis, and its side: `grip (world)`. A ratio or a relative error says so:
        `radius / body length`. Without `exp`, or for a column of no axis, the last part of the path.
    """
    axis = next((axis for axis in exp.study.axes if axis.column == column), None) if exp else None
    return path_label(column) if axis is None else axis_name_label(axis)


def path_label(column: str, parts: int = 1) -> str:
    """Return the last `parts` of a parameter's path as a label: `world.contact.friction` -> `friction (world)`."""
    side, path = split_side_prefix(column)
    words = " ".join(path.removesuffix(".name").split(".")[-parts:]).replace("_", " ")
    return words if side == "both" else f"{words} ({side})"


def axis_name_label(axis: Axis) -> str:
    """Return the label of a varied parameter: its name, what its numbers mean, and its side (world or belief)."""
    words = axis.name.replace("_", " ")
    if axis.path and axis.times:
        words = f"{words} / {path_label(axis.times)}"
    elif axis.path and axis.relative is not None and axis.column.startswith("axis."):
        scale = axis.relative if isinstance(axis.relative, str) else f"{axis.relative:g}"
        words = f"{words}, relative error" + ("" if axis.relative == 1 else f" in units of {scale}")
    return words if axis.side == "both" or not axis.path or axis.side in words.split() else f"{words} ({axis.side})"


def unique_labels(columns: Iterable[str], exp: Experiment | None = None) -> dict[str, str]:
    """Return distinct labels, without units, for the columns of one table.

    Args:
        columns: parameters, figures and labels, as rows have them.
        exp: experiment of their study, if it is known: it names the axes.

    Returns:
        Label by column. Where several columns have the same words, those of parameters go back along their paths
        until they differ: `trunk mass (world)` beside `hip mass (world)`.
    """
    columns = list(columns)
    found = {column: label_and_unit(column, exp)[0] for column in columns}
    for parts in range(2, 2 + max((column.count(".") for column in columns), default=0)):
        counts = Counter(found.values())
        for column in columns:
            if "." in column and counts[found[column]] > 1:
                found[column] = path_label(column, parts)
    counts = Counter(found.values())
    return {c: words if counts[words] < 2 or "." not in c else f"{words}: {c}" for c, words in found.items()}


def unique_headings(columns: Iterable[str], exp: Experiment | None = None) -> dict[str, str]:
    """Return distinct headings, with units, for the columns of one table."""
    words = unique_labels(columns, exp)
    units = {column: label_and_unit(column, exp)[1] for column in words}
    return {column: f"{text} [{units[column]}]" if units[column] else text for column, text in words.items()}


def hover_text(column: str, exp: Experiment) -> str:
    """Return the text shown when the mouse is over a column: a parameter's full name and unit; empty for other
    columns."""
    if "." not in column:
        return ""
    unit = column_unit(column, exp)
    return f"{column} [{unit}]" if unit else column


def label_with_value(column: str, value: object, exp: Experiment | None = None) -> str:
    """Format a parameter with a value: `obstacle.mass` at 50.0 -> `mass 50 kg`."""
    shown = f"{value:.4g}" if isinstance(value, float) else shorten_file_names([str(value)])[0]
    unit_there = column_unit(column, exp) if exp else ""
    return " ".join(part for part in (axis_words(column, exp), shown, unit_there) if part)


def shorten_file_names(names: Sequence[str]) -> list[str]:
    """Shorten names of files to their stems, `worlds/hills.xml` to `hills`, where these stay distinct."""
    paths = [PurePosixPath(name) for name in names]
    stems = [path.stem if path.suffix in FILES else name for path, name in zip(paths, names, strict=True)]
    return stems if len({*stems}) == len({*names}) else [*names]


def axis_title(column: str, exp: Experiment | None = None) -> str:
    """Return the title of a plot axis for a column, with subscripts in symbols such as `c1` and `a_r`."""
    return re.sub(r"\b([a-z])(?:(\d)|_(\w))\b", r"$\1_\2\3$", label_with_unit(column, exp))


def column_unit(column: str, exp: Experiment) -> str:
    """Return the unit of a column as shown to readers.

    Args:
        column: a parameter, whose unit is its own, or a metric, whose unit is at the end of its name.
        exp: experiment of the study.

    Returns:
        The unit, such as `N·m`; empty for pure numbers and names.
    """
    if "." not in column:
        return split_metric_column(column)[1]
    return format_unit(unit_of_column(column, exp.system, exp.settings))


def label_with_unit(column: str, exp: Experiment | None = None) -> str:
    """Return the label of a column with its unit, for a table or plot axis. Without `exp`, units of parameters are
    unknown."""
    words, known = label_and_unit(column, exp)
    return f"{words} [{known}]" if known else words


def label_and_unit(column: str, exp: Experiment | None = None) -> tuple[str, str]:
    """Return the label of a column and its unit."""
    if column.endswith(SECOND_RUN_MARK):
        words, unit = label_and_unit(column.removesuffix(SECOND_RUN_MARK), exp)
        return f"{words}{SECOND_RUN_MARK}", unit
    if "." not in column:
        return split_metric_column(column)
    return axis_words(column, exp), column_unit(column, exp) if exp else ""
