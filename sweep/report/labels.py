"""Words and units for columns."""

import re

import pandas as pd

from sweep.core.outcomes import SUCCESS
from sweep.core.parameters import UNITS, written
from sweep.study.config import Experiment
from sweep.study.designs import Axis
from sweep.study.study import unit

READ = {end: written(unit) for end, unit in UNITS.items()} | {"deg": "°"}  # units of figures as they are read


def kind_of(rows: pd.DataFrame) -> pd.Series:
    """What came of each row: `success`, or the cause."""
    return rows["cause"].astype(object).where(rows["outcome"] != SUCCESS, SUCCESS).astype(str)


def meaning(kind: str, exp: Experiment) -> str:
    """A cause, or success, in a sentence."""
    return exp.system.causes.get(kind, "no cause of failure or distrust was met")


def name_and_unit(column: str) -> tuple[str, str]:
    """`slip_max_m` -> (`slip max`, `m`); the unit is empty where the column has none."""
    head, _, last = column.rpartition("_")
    return (head.replace("_", " "), READ[last]) if head and last in READ else (column.replace("_", " "), "")


def axis_words(column: str, exp: Experiment | None = None) -> str:
    """`world.contact.friction` -> `friction (world)`, `engine.name` -> `engine`.

    Of numbers that parameters are made from `exp` tells how: `radius / body length`, `relative error of radius`.
    """
    if exp and column.startswith("axis."):
        return made_from(next((axis for axis in exp.study.axes if axis.column == column), None), column)
    side = column.partition(".")[0]
    words = column.removesuffix(".name").rpartition(".")[2].replace("_", " ")
    return f"{words} ({side})" if side in ("world", "belief") else words


def made_from(axis: Axis | None, column: str) -> str:
    """What the number of an axis is, in words."""
    if axis is None or axis.path is None:
        return axis_words(column)
    words = axis_words(axis.path)
    if axis.times:
        words = f"{words} / {axis_words(axis.times)}"
    elif axis.relative is not None:
        scale = axis.relative if isinstance(axis.relative, str) else f"{axis.relative:g}"
        words = f"{words}, relative error" + ("" if axis.relative == 1 else f" in units of {scale}")
    return words if axis.side == "both" else f"{words} ({axis.side})"


def with_value(column: str, value: object, exp: Experiment | None = None) -> str:
    """`obstacle.mass` at 50.0 -> `mass 50 kg`."""
    shown = f"{value:.4g}" if isinstance(value, float) else str(value)
    unit_there = unit_of(column, exp) if exp else ""
    return " ".join(part for part in (axis_words(column, exp), shown, unit_there) if part)


def beside_axis(column: str, exp: Experiment | None = None) -> str:
    """The heading of a column as a figure has it, `c1` and `a_r` with an index."""
    return re.sub(r"\b([a-z])(?:(\d)|_(\w))\b", r"$\1_\2\3$", heading(column, exp))


def unit_of(column: str, exp: Experiment) -> str:
    """Unit of a column: of an axis by its parameter, of a figure by the end of its name; empty where it has none."""
    if "." not in column:
        return name_and_unit(column)[1]
    return written(unit(column, exp.system, exp.settings))


def heading(column: str, exp: Experiment | None = None) -> str:
    """Words and unit, for a table or beside an axis; without `exp` the units of parameters are not known."""
    words, known = words_and_unit(column, exp)
    return f"{words} [{known}]" if known else words


def words_and_unit(column: str, exp: Experiment | None = None) -> tuple[str, str]:
    """Words for a column, and its unit apart."""
    if "." not in column:
        return name_and_unit(column)
    return axis_words(column, exp), unit_of(column, exp) if exp else ""
