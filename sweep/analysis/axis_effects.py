"""Which axes changed nothing, as far as the rows of a study tell."""

from typing import NamedTuple

import numpy as np
import pandas as pd

from sweep.config.experiment import Experiment
from sweep.study.columns import LABELS, metric_columns
from sweep.study.designs import Axis


class AxisPairs(NamedTuple):
    """Rows that differ in one axis alone."""

    rollouts: int  # rows that have such a partner
    same: bool  # whether partners are equal in all metrics and labels, to the last bit


def compare_along_axes(rows: pd.DataFrame, exp: Experiment) -> dict[str, AxisPairs]:
    """Compare rows that differ in one axis and in nothing else, for each axis of a study.

    Args:
        rows: rows of the study.
        exp: its experiment.

    Returns:
        By the axis' name; axes without such rows, as where all are drawn at once, are left out.
    """
    if exp.study.points or exp.study.is_adaptive or rows.empty:
        return {}
    axes = [axis for axis in exp.study.axes if axis.column in rows]
    results = rows[[*metric_columns(rows), *(name for name in LABELS if name in rows)]]
    measured = pd.util.hash_pandas_object(results, index=False).to_numpy()
    draws = rows["replicate"].where(exp.system.find_random_rows(rows, exp.settings), 0)
    found = {axis.name: _compare_along(axis, axes, rows, draws, measured) for axis in axes}
    return {name: pairs for name, pairs in found.items() if pairs.rollouts}


def _compare_along(
    axis: Axis, axes: list[Axis], rows: pd.DataFrame, draws: pd.Series, measured: np.ndarray
) -> AxisPairs:
    """Compare rows that are equal in all axes but one, and but those that go along with it."""
    leader = axis.along or axis.name
    others = [a.column for a in axes if leader not in (a.name, a.along)]
    key = pd.util.hash_pandas_object(rows[others].assign(draws=draws), index=False).to_numpy()
    value = pd.factorize(rows[axis.column])[0]
    table = pd.DataFrame({"key": key, "value": value, "measured": measured}).groupby("key")
    several = table["value"].transform("nunique").to_numpy() > 1
    differ = table["measured"].transform("nunique").to_numpy() > 1
    return AxisPairs(int(several.sum()), not (several & differ).any())
