"""What `from sweep import load, run` offers to notebooks; behind it is the machinery of the command line."""

from os import PathLike
from pathlib import Path

import pandas as pd

from sweep.core.expressions import mask
from sweep.report.labels import unit_of
from sweep.runs import store
from sweep.study.config import Experiment, compose, experiment


def run(overrides: list[str]) -> pd.DataFrame:
    """See `sweep.run`."""
    from sweep.cli import run as app
    from sweep.runs import runner

    exp = compose(overrides)
    if exp.study.single and not exp.out:
        return _tidy(runner.run_single(exp), exp)
    app.execute(exp, app.Flags())
    return load(exp.folder)


def load(folder: str | PathLike[str], where: str | None = None) -> pd.DataFrame:
    """See `sweep.load`."""
    folder = Path(folder)
    stored, rows = store.read_study(folder), store.read_rows(folder)
    if where:
        rows = rows[mask(rows, where)].reset_index(drop=True)
    return _tidy(rows, experiment(stored["config"]))


def _tidy(rows: pd.DataFrame, exp: Experiment) -> pd.DataFrame:
    rows.attrs = {"study": exp.study.name, "units": {c: unit for c in rows if (unit := unit_of(str(c), exp))}}
    return rows
