"""Record replays of a study's most informative rollouts at the end of its run, see `study.replays`."""

from collections.abc import Callable
from dataclasses import replace

import pandas as pd

from sweep.analysis.sample import random_subset_indices
from sweep.report import replay_selection, replays
from sweep.runs.results import Results


def choose_recorded_rows(results: Results) -> pd.DataFrame:
    """Choose the rows whose replays a run records, and assign them to batches of their own.

    The batch is as narrow as possible, so that recording takes no longer than a few rollouts. Its rollouts may differ
    from the stored rows in the last bits; the page says how many of a replay's metrics are equal.
    """
    number = min(len(results.rows), replay_selection.MAX_SEARCHED_ROWS)
    every = results.rows.iloc[random_subset_indices(len(results.rows), number)]
    rows = replay_selection.choose_replays(replace(results, rows=every), results.exp.study.replays)
    groups = rows.groupby("group")["group"]
    return rows.assign(width=groups.transform("size"), slot=groups.cumcount())


def record_replays(results: Results, progress: Callable[[int, int], None] = lambda done, of: None) -> int:
    """Simulate the chosen rows that have no replay yet, and store their replays in the study's folder.

    Args:
        results: study with its rows.
        progress: called with rollouts done and in all.

    Returns:
        How many rollouts were simulated.
    """
    return replays.make_replays(results, choose_recorded_rows(results), progress)
