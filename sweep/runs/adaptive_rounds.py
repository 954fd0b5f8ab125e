"""Run a design of adaptive sampling: each round is drawn from a proposal fitted to the rows of earlier rounds.

The next round depends on the stored rows only, so an interrupted study resumes where it stopped.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pandas as pd

from sweep.config.experiment import Experiment
from sweep.core.errors import InputError
from sweep.runs import store
from sweep.runs.runner import Job, prepare_job
from sweep.study.adaptive_sampling import RoundDraws
from sweep.study.study import make_points


def iter_jobs(exp: Experiment, folder: Path) -> Iterator[Job]:
    """Yield the job (batches to simulate) of each round of adaptive sampling; run each job before asking for the next.

    All rounds use one batch width, the best one for the smallest round, so that the engine compiles once.

    Args:
        exp: Experiment of a study with an adaptive design.
        folder: Folder of the study, whose finished rows decide the next round.

    Yields:
        The job of the next round, until the design's stopping rule holds.

    Raises:
        InputError: Rounds in the folder were drawn from other outcomes than its rows have now.
    """
    study, design = exp.study, exp.study.adaptive_design
    search = design.start_search(study.draw_context)
    draws: RoundDraws = next(search)
    while True:
        table = make_points(study, exp.system, exp.settings, round_=draws)
        planned = store.read_points(folder)
        _refuse_other_rounds(folder, planned, table)
        if not exp.settings.width:
            first = planned if len(planned) else prepare_job(exp, folder, table.head(design.min_round_size)).table
            exp = replace(exp, settings=replace(exp.settings, width=int(first["width"].iloc[-1])))
        yield prepare_job(exp, folder, table)
        try:
            draws = search.send(design.summarize_finished_round(store.read_rows(folder), draws))
        except StopIteration:
            return


def _refuse_other_rounds(folder: Path, planned: pd.DataFrame, table: pd.DataFrame) -> None:
    if not len(planned):
        return
    stored = planned[planned["replicate"].isin(table["replicate"])]
    if not set(stored["point_id"]) <= set(table["point_id"]):
        raise InputError(f"{folder} holds rounds of another search or other thresholds: give out=DIR")
