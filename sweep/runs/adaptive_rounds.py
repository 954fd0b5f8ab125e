"""Draws that are sought where failures are, in rounds: each by what the rows of those before it showed.

What to draw next is a function of the rows there are, so that an interrupted study goes on where it was.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pandas as pd

from sweep.core.errors import InputError
from sweep.runs import store
from sweep.runs.runner import Job, prepare_job
from sweep.study import adaptive_designs
from sweep.study.adaptive_sampling import Draws, summarize_round
from sweep.study.config import Experiment
from sweep.study.study import points


def iter_jobs(exp: Experiment, folder: Path) -> Iterator[Job]:
    """Jobs to be run one after the other.

    All have batches of one width, the best for the smallest rounds, so that the engine compiles once. Raises
    `InputError` where rounds that are there were drawn by other outcomes than there are now.
    """
    study, search = exp.study, adaptive_designs.make_search(exp.study.axes, exp.study.design, exp.study.seed)
    draws: Draws = next(search)
    while True:
        table = points(study, exp.system, exp.settings, round_=draws)
        planned = store.read_points(folder)
        _check(folder, planned, table)
        if not exp.settings.width:
            design = study.design  # whose smallest round in which all runs go on is
            least = table.head(design.runs * design.levels.chains if design.kind == "subset" else design.num)
            first = planned if len(planned) else prepare_job(exp, folder, least).table
            exp = replace(exp, settings=replace(exp.settings, width=int(first["width"].iloc[-1])))
        yield prepare_job(exp, folder, table)
        try:
            draws = search.send(summarize_round(store.read_rows(folder), draws, study.design.lead))
        except StopIteration:
            return


def _check(folder: Path, planned: pd.DataFrame, table: pd.DataFrame) -> None:
    if not len(planned):
        return
    there = planned[planned["replicate"].isin(table["replicate"])]
    if not set(there["point_id"]) <= set(table["point_id"]):
        raise InputError(f"{folder} has rounds that were drawn otherwise, or by other thresholds: give out=DIR")
