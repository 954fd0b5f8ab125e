"""Which axes of a study changed nothing, judged from its rows."""

from typing import NamedTuple

import pandas as pd

from sweep.config.experiment import Experiment
from sweep.core.distinct_values import are_all_different
from sweep.study.columns import LABEL_COLUMNS, metric_columns
from sweep.study.designs import Axis


class AxisEffectCheck(NamedTuple):
    """Whether rows that differ in one varied parameter alone are equal in all metrics, and how many such rows exist."""

    rollouts: int  # rows that have such a partner
    are_equal: bool  # whether partners are equal in all metrics and labels, to the last bit


def check_axis_effects(rows: pd.DataFrame, exp: Experiment) -> dict[str, AxisEffectCheck]:
    """Test for each axis of a study whether rows that differ in this axis alone have equal metrics and labels.

    Args:
        rows: rows of the study.
        exp: its experiment.

    Returns:
        By the axis' name; axes without such rows, as where all are drawn at once, are left out.
    """
    if exp.study.points or exp.study.is_adaptive or rows.empty:
        return {}
    axes = [axis for axis in exp.study.axes if axis.column in rows]
    draws = rows["replicate"].where(exp.system.find_stochastic_rows(rows, exp.settings), 0)
    groups = {axis.name: _group_along(axis, axes, rows, draws) for axis in axes}
    groups = {name: group for name, group in groups.items() if len(group)}
    if not groups:
        return {}
    results = rows[[*metric_columns(rows), *(name for name in LABEL_COLUMNS if name in rows)]]
    measured = pd.Series(pd.util.hash_pandas_object(results, index=False).to_numpy())
    return {
        name: AxisEffectCheck(len(group), bool(measured[group.index].groupby(group).nunique().max() == 1))
        for name, group in groups.items()
    }


def _group_along(axis: Axis, axes: list[Axis], rows: pd.DataFrame, draws: pd.Series) -> pd.Series:
    """Group the rows that are equal in all axes but one, and but those that go along with it.

    Args:
        axis: The axis in which the rows of a group differ.
        axes: All axes with a column.
        rows: Rows of the study.
        draws: Number of the draw of each row; 0 where it draws no random numbers.

    Returns:
        The group of each row that has such a partner, by the row's number.
    """
    leader = axis.along or axis.name
    others = [a.column for a in axes if leader not in (a.name, a.along)]
    key = pd.util.hash_pandas_object(rows[others].assign(draws=draws), index=False).to_numpy()
    repeated = pd.Series(key) if not are_all_different(key) else pd.Series(key[:0])
    repeated = repeated[repeated.duplicated(keep=False)]
    value = pd.Series(pd.factorize(rows[axis.column].iloc[repeated.index])[0], repeated.index)
    return repeated[value.groupby(repeated).transform("nunique") > 1]
