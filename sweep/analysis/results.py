"""A study's folder as its reports see it."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from sweep.analysis import sensitivity
from sweep.analysis.sample import distinct
from sweep.core.errors import InputError
from sweep.core.expressions import mask
from sweep.metrics.outcome import MEANING
from sweep.report import statistics
from sweep.report.labels import axis_words, heading, unit_of
from sweep.report.tables import text
from sweep.runs import store
from sweep.study.config import Experiment, experiment
from sweep.study.study import nominal, parameter_columns, side_and_path


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
    def named(self) -> list[str]:
        """Those that are names, such as an engine."""
        return [c for c in self.axes if c not in self.numeric]

    @cached_property
    def listed(self) -> list[str]:
        """Numbers that were listed; of a table of points all of them."""
        if self.exp.study.points:
            return self.numeric
        own = [a.column for a in sensitivity.listed(self.rows, self.exp)]
        return [c for c in self.numeric if c in own]

    @property
    def one_at_a_time(self) -> bool:
        """Whether every parameter was varied with the others at their nominal values."""
        return self.exp.study.design.grid == "one_at_a_time" and not self.exp.study.points

    @property
    def name(self) -> str:
        """The study's name."""
        return self.exp.study.name

    @cached_property
    def stages(self) -> list[str]:
        """Names of the plan's stages, in its order; of several plans one after the other."""
        return list(dict.fromkeys(name for names in self.stored["stages"].values() for name in names))

    @cached_property
    def causes_seen(self) -> list[str]:
        """Causes of failure and reasons for distrust that occur, in the order of their definition."""
        found = set(self.rows["cause"].unique())
        return [cause for cause in MEANING if cause in found]


def read(folder: Path, where: str | None = None) -> Results:
    """Finished rows of `folder` that match `where`, copies of noise-free ones left out. Raises `InputError`."""
    stored, rows = store.read_study(folder), store.read_rows(folder)
    done = len(rows)
    if where:
        rows = rows[mask(rows, where)].reset_index(drop=True)
        if rows.empty:
            raise InputError(f"no row of {folder} matches where = {where!r}")
    exp = experiment(stored["config"])
    chosen, copies = distinct(rows, exp)
    return Results(folder, stored, exp, chosen, where, done, copies)


def parameters(results: Results) -> Iterator[dict[str, Any]]:
    """What was varied."""
    for name in results.axes:
        values = results.rows[name]
        side, path = side_and_path(name)
        listed = [text(v) for v in sorted(values.unique())]
        extent = ", ".join(listed) if len(listed) <= 6 else f"{listed[0]} to {listed[-1]}"
        own = not name.startswith("axis.")  # else a number that parameters are made from
        usual = text(nominal(name, results.exp.case, results.exp.settings)) if own else ""
        about = {"words": axis_words(name, results.exp), "path": path, "on": side, "unit": unit_of(name, results.exp)}
        yield {**about, "values": extent, "number": len(listed), "nominal": usual}


def told(results: Results) -> Iterator[tuple[str, pd.DataFrame | str]]:
    """Titles and contents of the statistics of a study, parameters in words; of a table of points none are known."""
    if results.exp.study.points:
        return
    for title, content in list(statistics.sections(results.rows, results.exp))[1:]:  # the first is the headline
        if isinstance(content, pd.DataFrame) and "axis" in content:
            content = content.assign(axis=content["axis"].map(partial(heading, exp=results.exp)))
        yield title, content


def binned(values: pd.Series, most: int) -> pd.Series:
    """The values where there are at most `most`; else the middles of `most` equal intervals that they lie in."""
    if values.dtype.kind not in "fi" or values.nunique() <= most:
        return values
    low, high = values.min(), values.max()
    width = (high - low) / most
    index = np.minimum(((values - low) / width).astype(int), most - 1)
    return low + (index + 0.5) * width
