"""Representative rollouts: the medoid of each outcome, and its pictures."""

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from sweep.core.files import path_inside_folder
from sweep.core.outcomes import SUCCESS
from sweep.report import replays
from sweep.report.labels import explain_outcome_kind, outcome_kind
from sweep.runs.results import Results
from sweep.study.columns import metric_columns

MAX_CANDIDATE_ROLLOUTS = 1000  # rollouts of a kind that are looked at
PICTURES_FOLDER = "pictures"  # folder beside the study's parts
FRAMES_PER_PICTURE, TIME_AFTER_CAUSE_S = 4, 1.0  # of a picture: how many, and how long after the cause (s)


@dataclass(frozen=True)
class Representative:
    """The most representative rollout (medoid) of an outcome kind."""

    kind: str  # success, or a cause
    number: int  # rollouts of the kind
    row: pd.Series
    meaning: str  # of the kind, in a sentence
    picture: Path  # where its picture is, or would be


def find_representatives(results: Results) -> Iterator[Representative]:
    """Yield the most typical rollout (medoid) of each failure cause, then that of the successes.

    The rollout with the least distance to all others in its metrics.
    """
    rows = results.rows
    kinds = outcome_kind(rows)
    columns = [
        c for c in metric_columns(rows) if c not in results.exp.system.bookkeeping_metrics and rows[c].dtype.kind == "f"
    ]
    for kind in [*results.occurring_causes, SUCCESS]:
        own = pd.Series(np.flatnonzero(kinds == kind))
        if len(own):
            sample = rows.iloc[np.sort(own.sample(min(len(own), MAX_CANDIDATE_ROLLOUTS), random_state=0))]
            row = sample.iloc[medoid(standardize(sample[columns].to_numpy(dtype=float)))]
            picture = path_inside_folder(results.folder, f"{PICTURES_FOLDER}/{row['run_id']}-{row['point_id']}.png")
            yield Representative(kind, len(own), row, explain_outcome_kind(kind, results.exp), picture)


def standardize(values: np.ndarray) -> np.ndarray:
    """Scale the columns of `values` (N, K) by their spread about the median; missing values become 0."""
    values = np.where(np.isfinite(values), values, np.nan)
    values = values[:, ~np.isnan(values).all(axis=0)]
    if not values.shape[1]:
        return np.zeros((len(values), 1))
    low, middle, high = np.nanpercentile(values, [25, 50, 75], axis=0)
    spread = np.where(high > low, high - low, np.nanstd(values, axis=0))
    return np.nan_to_num((values - middle) / np.where(spread > 0, spread, 1.0))


def medoid(values: np.ndarray) -> int:
    """Return the index of the row of `values` (N, K) with the smallest sum of distances to all rows."""
    square = np.sum(values**2, axis=1)
    distance = np.sqrt(np.maximum(square[:, None] + square - 2 * values @ values.T, 0))
    return int(np.argmin(distance.sum(axis=1)))


def draw_pictures(results: Results) -> list[Path]:
    """Simulate the representative rollouts again and write the pictures that are missing.

    They run in a batch of their own, so that any machine can draw them. A rollout that ends differently gets no
    picture, but a line on the standard error. Raises `InputError` without OpenGL.
    """
    from sweep.contract.trace_frames import frames_at_times
    from sweep.replay.rendering import write_filmstrip

    wanted = {one.row.name: one for one in find_representatives(results) if not one.picture.exists()}
    rows, drawn = pd.DataFrame([one.row for one in wanted.values()]).infer_objects(), []
    if rows.empty:
        return drawn
    groups = rows.groupby("group")["group"]
    rows = rows.assign(width=groups.transform("size"), slot=groups.cumcount())
    for row, trace, labels in replays.resimulate_rows(results.exp, rows, results.rows, np.inf):
        one = wanted[row.name]
        if (labels["outcome"], labels["cause"]) != (row["outcome"], row["cause"]):
            print(
                f"sweep: no picture of {row['point_id']}: on this machine the rollout ends with another outcome",
                file=sys.stderr,
            )
            continue
        end = np.fmin(row["t_cause_s"] + TIME_AFTER_CAUSE_S, trace.time[-1])
        one.picture.parent.mkdir(exist_ok=True)
        shown = frames_at_times(trace, np.linspace(trace.time[0], end, FRAMES_PER_PICTURE))
        write_filmstrip(one.picture, trace, shown, one.kind.replace("_", " "))
        drawn.append(one.picture)
    return drawn
