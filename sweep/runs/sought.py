"""Importance sampling in rounds: each is drawn where the rows of those before it failed.

What to draw next is a function of the rows there are, so that an interrupted study goes on where it was.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from sweep.core.errors import InputError
from sweep.runs import store
from sweep.runs.runner import Job, lay_out
from sweep.study import importance
from sweep.study.config import Experiment
from sweep.study.study import points


def rounds(exp: Experiment, folder: Path, first: pd.DataFrame) -> Iterator[Job]:
    """Jobs to be run one after the other: the `first` round, then those that its rows ask for.

    Raises `InputError` where rounds that are there were drawn by other outcomes than there are now.
    """
    study, design = exp.study, exp.study.design
    drawn = sum(axis.distribution is not None for axis in study.axes)
    draws, u = importance.first(drawn, design.num, design.wide, study.seed)
    wanted, normals, weights = first, [u], [draws.weight]
    for number in range(1, design.rounds + 2):
        yield lay_out(exp, folder, wanted)
        if number > design.rounds:
            return
        failed = _failed(store.read_rows(folder), number * design.num)
        so_far = np.concatenate(normals), np.concatenate(weights), failed
        draws, u = importance.next_round(*so_far, design.num, design.wide, study.seed, number)
        table = points(study, exp.system, exp.settings, round_=draws)
        _check(folder, store.read_points(folder), table, number)
        normals, weights = [*normals, u], [*weights, draws.weight]
        wanted = pd.concat([wanted, table], ignore_index=True)


def _failed(rows: pd.DataFrame, draws: int) -> np.ndarray:
    """Which of the first draws did not succeed, invalid ones among them."""
    failed = np.zeros(draws, dtype=bool)
    here = rows[rows["replicate"] < draws]
    failed[here["replicate"]] = here["outcome"] != "success"
    return failed


def _check(folder: Path, planned: pd.DataFrame, table: pd.DataFrame, number: int) -> None:
    there = planned[planned["axis.round"] == number]
    if len(there) and not set(there["point_id"]) <= set(table["point_id"]):
        raise InputError(f"{folder} has rounds that were drawn by other thresholds than those asked for: give out=DIR")
