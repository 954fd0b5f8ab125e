"""A study's folder as its reports see it."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from sweep.analysis import sensitivity
from sweep.analysis.sample import drop_copies
from sweep.core.errors import InputError
from sweep.core.expressions import mask
from sweep.runs import store
from sweep.study.config import Experiment, experiment
from sweep.study.study import name_axes, parameter_columns


@dataclass(frozen=True)
class Results:
    """Finished rows of a study, and what is known of how they came about."""

    folder: Path
    stored: dict[str, Any]  # study.yaml
    exp: Experiment
    rows: pd.DataFrame
    where: str | None  # the condition that chose them
    done: int = 0  # rows of the folder
    copies: str = ""  # a sentence about rows that are left out because they repeat others

    @cached_property
    def axes(self) -> list[str]:
        """What was varied: the columns of the study's axes, or of its table of points, with more than one value."""
        listed = [] if self.exp.study.points else [axis.column for axis in self.exp.study.axes]
        every = listed or parameter_columns(self.rows)
        return [c for c in every if c in self.rows and self.rows[c].nunique() > 1]

    @cached_property
    def numeric(self) -> list[str]:
        """Those that are numbers."""
        return [c for c in self.axes if self.rows[c].dtype.kind in "fi"]

    @cached_property
    def categorical(self) -> list[str]:
        """Those that are names, such as an engine."""
        return [c for c in self.axes if c not in self.numeric]

    @cached_property
    def listed_numeric(self) -> list[str]:
        """Numbers that were listed; of a table of points all of them."""
        if self.exp.study.points:
            return self.numeric
        own = [a.column for a in sensitivity.listed_axes(self.rows, self.exp)]
        return [c for c in self.numeric if c in own]

    @property
    def one_at_a_time(self) -> bool:
        """Whether every parameter was varied with the others at their nominal values."""
        return self.exp.study.design.grid == "one_at_a_time" and not self.exp.study.points

    @property
    def name(self) -> str:
        """The name that its study has."""
        return self.exp.study.name

    @cached_property
    def stages(self) -> list[str]:
        """Names of the plan's stages, in its order; of several plans one after the other."""
        return list(dict.fromkeys(name for names in self.stored["stages"].values() for name in names))

    @cached_property
    def causes_seen(self) -> dict[str, str]:
        """Causes that occur and what they mean, in the order of their definition."""
        found = set(self.rows["cause"].unique())
        meanings = self.exp.system.cause_meanings(self.exp.thresholds)
        return {cause: words for cause, words in meanings.items() if cause in found}


def load_experiment(folder: Path) -> Experiment:
    """The experiment of `folder`. Raises `InputError`, which names the version of one that this one cannot read."""
    stored = store.read_study(folder)
    try:
        return experiment(stored["config"])
    except InputError as error:
        raise InputError(f"{folder}, by version {stored['commit'] or stored['code']}: {error}") from None


def read(folder: Path, where: str | None = None) -> Results:
    """Finished rows of `folder` that match `where`, copies of noise-free ones left out. Raises `InputError`."""
    stored, exp = store.read_study(folder), load_experiment(folder)
    rows = name_axes(store.read_rows(folder), exp.study.axes)
    done = len(rows)
    if where:
        rows = rows[mask(rows, where)].reset_index(drop=True)
        if rows.empty:
            raise InputError(f"no row of {folder} matches where = {where!r}")
    chosen, copies = drop_copies(rows, exp)
    return Results(folder, stored, exp, chosen, where, done, copies)
