"""The functions `sweep.load` and `sweep.run`, and the accessor `rows.sweep`, for notebooks and scripts."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd
from matplotlib.figure import Figure

from sweep.analysis.sample import drop_repeated_rollouts
from sweep.config.experiment import Experiment, compose
from sweep.core.errors import InputError
from sweep.core.expressions import AXIS_NAMES_KEY, condition_columns, condition_mask, find_column
from sweep.core.plot_style import plot_style
from sweep.report import draws, maps, page, time_series_plots
from sweep.report.labels import column_unit
from sweep.runs import results, store
from sweep.study.study import attach_axis_names

if TYPE_CHECKING:
    import xarray

    from sweep.replay.replay import Replay


def run(overrides: list[str]) -> pd.DataFrame:
    """Run the study that `overrides` select, as `sweep run` does, and return its finished rows as a data frame."""
    from sweep.cli.execution import RunFlags, execute_experiment
    from sweep.runs import runner

    exp = compose(overrides)
    if exp.study.single and not exp.out:
        return _tidy(runner.run_single_batch(exp), exp)
    execute_experiment(exp, RunFlags())
    return load(exp.folder)


def load(folder: str | PathLike[str], where: str | None = None, columns: Sequence[str] | None = None) -> pd.DataFrame:
    """Return the finished rows of a study's folder as a data frame, a row for each rollout.

    Args:
        folder: folder of the study.
        where: condition on the rows, in which axes can be used by name; None for all rows.
        columns: columns to read; None for all.

    Returns:
        A row for each rollout, with the columns of axes under their names, too.
    """
    folder = Path(folder)
    exp = results.load_experiment(folder)
    if columns is not None:
        return _load_columns(folder, exp, where, columns)
    rows = attach_axis_names(store.read_rows(folder), exp.study.axes)
    if where:
        rows = rows[condition_mask(rows, where)].reset_index(drop=True)
    aliases = {name: rows[column] for name, column in rows.attrs[AXIS_NAMES_KEY].items() if name not in rows}
    rows = _tidy(rows.assign(**aliases), exp)
    rows.attrs["axes"] = [*aliases]
    rows.attrs["folder"] = str(folder)
    return rows


def _load_columns(folder: Path, exp: Experiment, where: str | None, columns: Sequence[str]) -> pd.DataFrame:
    if isinstance(columns, str) or not columns:
        raise InputError(f"columns = {columns!r} is not allowed: a list of names, such as ['outcome', 'slip_max_m']")
    empty = results.make_empty_row_table(folder, exp)
    names = {name: find_column(empty, name) for name in columns}
    wanted = [*dict.fromkeys([*names.values(), *condition_columns(empty, where)])]
    rows = attach_axis_names(store.read_rows(folder, wanted), exp.study.axes)
    chosen = rows[condition_mask(rows, where)].reset_index(drop=True) if where else rows
    return _tidy(pd.DataFrame({name: chosen[own] for name, own in names.items()}), exp)


@dataclass(frozen=True)
class HtmlPage:
    """A page of HTML that a notebook shows in a frame, so that the styles of page and notebook do not mix."""

    html: str

    def __str__(self) -> str:
        return self.html

    def _repr_html_(self) -> str:
        return f'<iframe srcdoc="{escape(self.html)}" style="width: 100%; height: 70vh; border: 0"></iframe>'


@pd.api.extensions.register_dataframe_accessor("sweep")
class RowsAccessor:
    """The accessor `rows.sweep` of a data frame: draws figures of its rows, and simulates their rollouts again."""

    def __init__(self, rows: pd.DataFrame):
        if "folder" not in rows.attrs:
            raise AttributeError("only rows of a study's folder with all their columns have pictures: see sweep.load")
        names = [name for name in rows.attrs["axes"] if name in rows]
        self._rows, self._folder = rows.drop(columns=names), Path(rows.attrs["folder"])

    def map(self, x: str = "", y: str = "") -> Figure:
        """Draw the map of success over two parameters, by default the first two that vary. Raises `InputError`."""
        found = self._results()
        with plot_style():
            return maps.success_map(found.rows, found.stored, tuple(name for name in (x, y) if name))

    def draws(self) -> Figure:
        """Draw the overview of random draws: every draw, the importance of each parameter, margins to failure. Raises
        `InputError`."""
        found = self._results()
        if not draws.numeric_drawn_columns(found):
            raise InputError(f"{self._folder} has no axis with a distribution of numbers: use `map` instead")
        with plot_style():
            return draws.draw_overview(found)

    def histories(self) -> pd.DataFrame:
        """Return the stored time series of these rows, one sample a line: `point_id`, `outcome`, `time_s` and the
        recorded columns. Raises `InputError`."""
        return time_series_plots.load_time_series(self._results())

    def to_xarray(self) -> "xarray.Dataset":
        """Convert these rows to an xarray dataset with a dimension for each listed axis, and `replicate` where points
        repeat.

        Points that were not run are NaN; `attrs` hold units. Raises `InputError` where there is no grid or no xarray.
        """
        found = self._results()
        axes = found.numeric_grid_columns + [name for name in found.categorical_columns if name in self._rows]
        if not axes:
            raise InputError(f"{self._folder} has no grid: no axis with listed values varies")
        try:
            import xarray  # noqa: F401  # which pandas asks for in words of its own
        except ImportError:
            raise InputError("to_xarray needs the package xarray: pip install 'insect-sweep[xarray]'") from None
        keys = axes if not self._rows.duplicated(axes).any() else [*axes, "replicate"]
        if self._rows.duplicated(keys).any():
            raise InputError(f"{self._folder} is not a grid: several rows share a point of {', '.join(axes)}")
        grid = self._rows.set_index(keys).to_xarray()
        for name, unit in self._rows.attrs["units"].items():
            if name in grid.variables:
                grid[name].attrs["units"] = unit
        return grid

    def report(self) -> HtmlPage:
        """Return the HTML page that `sweep report` writes; `str()` of it gives the text."""
        return HtmlPage(page.render_page(self._results()))

    def replay(self, row: Any = 0) -> "Replay":
        """Simulate the rollout in the row with index label `row` again, and return the replay.

        `trace` has what was recorded, `again` its figures and labels, `stored` those of the row. Raises `InputError`.
        """
        from sweep.replay.replay import replay_rollout

        if row not in self._rows.index:
            raise InputError(f"row {row} is not among the rows of {self._folder}: give a label of their index")
        return replay_rollout(self._folder, str(self._rows.loc[row, "point_id"]))

    def _results(self) -> results.Results:
        if self._rows.empty:
            raise InputError(f"no row of {self._folder} is selected")
        stored = store.read_study(self._folder)
        exp = results.load_experiment(self._folder)
        rows, copies = drop_repeated_rollouts(attach_axis_names(self._rows, exp.study.axes), exp)
        return results.Results(self._folder, stored, exp, rows, None, len(self._rows), copies)


def _tidy(rows: pd.DataFrame, exp: Experiment) -> pd.DataFrame:
    rows.attrs = {"study": exp.study.name, "units": {c: unit for c in rows if (unit := column_unit(str(c), exp))}}
    return rows
