"""Finished rows of a study's folder, as reports and analyses read them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from sweep.analysis import sensitivity
from sweep.analysis.axis_effects import check_axis_effects
from sweep.analysis.sample import drop_repeated_rollouts
from sweep.config.experiment import Experiment, build_experiment
from sweep.core.distinct_values import has_several_values
from sweep.core.errors import InputError
from sweep.core.expressions import condition_columns, condition_mask
from sweep.runs import store
from sweep.study.study import attach_axis_names, parameter_columns


@dataclass(frozen=True)
class Results:
    """Finished rows of a study with its experiment and the content of its `study.yaml`."""

    folder: Path
    stored: dict[str, Any]  # study.yaml
    exp: Experiment
    rows: pd.DataFrame
    where: str | None  # condition that chose the rows
    finished_count: int = 0  # number of finished rows in the folder
    duplicates_note: str = ""  # sentence about rows left out because they repeat others

    @cached_property
    def axes(self) -> list[str]:
        """Names of the columns that vary: those of the study's axes, or of its CSV table of points."""
        listed = [] if self.exp.study.points else [axis.column for axis in self.exp.study.axes]
        every = listed or parameter_columns(self.rows)
        return [c for c in every if c in self.rows and has_several_values(self.rows[c])]

    @cached_property
    def numeric_columns(self) -> list[str]:
        """Names of the varied columns that hold numbers."""
        return [c for c in self.axes if self.rows[c].dtype.kind in "fi"]

    @cached_property
    def categorical_columns(self) -> list[str]:
        """Names of the varied columns that hold words, such as the name of an engine."""
        return [c for c in self.axes if c not in self.numeric_columns]

    @cached_property
    def numeric_grid_columns(self) -> list[str]:
        """Names of the varied columns with listed numbers, as in a grid; all numeric ones for a CSV table of points."""
        if self.exp.study.points:
            return self.numeric_columns
        own = [a.column for a in sensitivity.listed_value_axes(self.rows, self.exp)]
        return [c for c in self.numeric_columns if c in own]

    @property
    def is_one_at_a_time(self) -> bool:
        """Whether every parameter is varied alone, with all others at their nominal values."""
        return self.exp.study.design.is_one_at_a_time and not self.exp.study.points

    @property
    def name(self) -> str:
        """Name of the study, or of its scenario."""
        return self.exp.study.name

    @cached_property
    def stages(self) -> list[str]:
        """Names of the plan's stages in their order; stages of further plans follow."""
        return list(dict.fromkeys(name for names in self.stored["stages"].values() for name in names))

    @cached_property
    def regional_sensitivity(self) -> pd.DataFrame:
        """Parameters ranked by how much their distributions differ between successes and failures; empty if all
        outcomes agree."""
        try:
            return sensitivity.regional_sensitivity(self.rows, self.exp)
        except InputError:
            return pd.DataFrame({"axis": [], "distance": [], "p": []})

    @cached_property
    def occurring_causes(self) -> dict[str, str]:
        """Causes that occur in the rows, with their meanings, in the order of their definition."""
        seen = set(self.rows["cause"].unique())
        meanings = self.exp.system.cause_meanings(self.exp.thresholds)
        return {cause: words for cause, words in meanings.items() if cause in seen}


def load_experiment(folder: Path) -> Experiment:
    """Return the experiment (system, study and settings) that a study's folder stores.

    Raises:
        InputError: The folder is not a study's, or this version cannot read its configuration.
    """
    stored = store.read_study(folder)
    try:
        return build_experiment(stored["config"])
    except InputError as error:
        raise InputError(f"{folder}, by version {stored['commit'] or stored['code']}: {error}") from None


def make_empty_row_table(folder: Path, exp: Experiment) -> pd.DataFrame:
    """Return a table without rows that has the columns and types of a folder's rows; conditions may use names of axes.

    Args:
        folder: Folder of the study.
        exp: Its experiment.

    Raises:
        InputError: There are no rows yet, or a part is damaged.
    """
    return attach_axis_names(store.read_column_types(folder), exp.study.axes)


def iterate_matching_rows(
    folder: Path, exp: Experiment, columns: Sequence[str], where: str | None = None
) -> Iterator[tuple[pd.DataFrame, int]]:
    """Yield the finished rows that meet a condition, file by file to limit memory.

    Args:
        folder: Folder of the study.
        exp: Its experiment.
        columns: Columns to yield, in this order.
        where: Condition on columns; None for all rows.

    Yields:
        Rows of a part, and the number of those that were read.

    Raises:
        InputError: The folder is damaged, or the condition names no column.
    """
    wanted = [*dict.fromkeys([*columns, *condition_columns(make_empty_row_table(folder, exp), where)])]
    for part in store.iterate_parts(folder, wanted):
        rows = attach_axis_names(
            part.to_pandas().reindex(columns=wanted), exp.study.axes
        )  # a group may lack others' metrics
        yield rows.loc[condition_mask(rows, where), list(columns)], len(rows)


def read_results(folder: Path, where: str | None = None, with_bookkeeping: bool = True) -> Results:
    """Read the finished rows of a study's folder, with its experiment.

    Rollouts without noise that repeat others are left out.

    Args:
        folder: Folder of the study.
        where: Condition on columns that chooses rows; None for all.
        with_bookkeeping: Whether to read `System.bookkeeping_metrics`, too, about half of the robot's metrics. They
            are read in any case where a condition or an adaptive design may need them, or where all others are equal
            along an axis.

    Raises:
        InputError: The folder is not a study's, is damaged, or no row matches.
    """
    stored, exp = store.read_study(folder), load_experiment(folder)
    columns = None if with_bookkeeping or exp.study.is_adaptive else _columns_without_bookkeeping(folder, exp, where)
    rows = attach_axis_names(store.read_rows(folder, columns), exp.study.axes)
    if columns and any(pairs.are_equal for pairs in check_axis_effects(rows, exp).values()):
        rows = attach_axis_names(store.read_rows(folder), exp.study.axes)
    done = len(rows)
    if where:
        rows = rows[condition_mask(rows, where)].reset_index(drop=True)
        if rows.empty:
            raise InputError(f"no row of {folder} matches where = {where!r}")
    chosen, copies = drop_repeated_rollouts(rows, exp)
    return Results(folder, stored, exp, chosen, where, done, copies)


def _columns_without_bookkeeping(folder: Path, exp: Experiment, where: str | None) -> list[str]:
    empty = make_empty_row_table(folder, exp)
    conditions = [where, *(text for one in exp.study.expect for text in (one.where, one.that))]
    named = {column for text in conditions if text for column in condition_columns(empty, text)}
    return [c for c in empty.columns if c in named or c not in exp.system.bookkeeping_metrics]
