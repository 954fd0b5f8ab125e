"""Study axes without effect, found from the program that simulates them and from finished rows."""

import numpy as np
import pandas as pd

from sweep.analysis.axis_effects import check_axis_effects
from sweep.config.experiment import Experiment
from sweep.core.distinct_values import has_several_values
from sweep.runs.batches import allocate_delay_buffers, make_engine, make_nominal_batch, static_parameter_values
from sweep.study.study import parameter_columns


def find_inactive_parameters(exp: Experiment, table: pd.DataFrame) -> set[str]:
    """Find varied parameters that no compiled program of a study reads, so that they cannot change any row.

    Args:
        exp: the experiment.
        table: points or rows of the study, with `width`.

    Raises:
        InputError: there is no engine for the points.
    """
    exp = allocate_delay_buffers(exp, table)
    static = [*static_parameter_values(exp, table)]
    unread = {c for c in parameter_columns(table) if c not in static and has_several_values(table[c])}
    first_rows: list[int] = np.flatnonzero(~table.duplicated(static)).tolist() if static else [0]
    for rows in (table.iloc[[k]] for k in first_rows):  # one row of each group
        if not unread:
            break
        fixed = static_parameter_values(exp, rows)
        engine = make_engine(exp, make_nominal_batch(exp, rows, int(rows["width"].iloc[0])))
        ends = {c: (float(table[c].min()), float(table[c].max())) for c in sorted(unread)}
        unread &= engine.find_inactive_parameters(
            lambda values, fixed=fixed: exp.system.make_world_and_belief({**fixed, **values}), ends
        )
    return unread


def describe_unread_axes(exp: Experiment, table: pd.DataFrame) -> list[str]:
    """List the axes that cannot change any metric, because no compiled program of the study reads their parameter.

    Args:
        exp: the experiment.
        table: points of the study.

    Returns:
        A sentence for each such axis.
    """
    unread = find_inactive_parameters(exp, table)
    return [
        f"axis {axis.name} changes no metric: {axis.parameter_column} does not enter the simulation"
        for axis in exp.study.axes
        if axis.parameter_column in unread
    ]


def describe_ineffective_axes(exp: Experiment, rows: pd.DataFrame) -> list[str]:
    """List the axes (varied parameters) whose variation changed no metric in finished rows.

    Rows that differ in one axis alone decide; if there are none, as among draws, the traced program does.

    Args:
        exp: the experiment.
        rows: finished rows of the study.

    Returns:
        A sentence for each such axis.
    """
    pairs = check_axis_effects(rows, exp)
    lines = [
        f"axis {name} changed no metric in {one.rollouts:,} rollouts" for name, one in pairs.items() if one.are_equal
    ]
    open_ones = {
        axis.parameter_column: axis.name
        for axis in exp.study.axes
        if axis.name not in pairs and axis.parameter_column in rows
    }
    if open_ones:
        unread = find_inactive_parameters(exp, rows)
        lines += [
            f"axis {name} changed no metric in {len(rows):,} rollouts: {column} does not enter the simulation"
            for column, name in open_ones.items()
            if column in unread
        ]
    return lines
