"""Time series of stored rollouts: columns by `study.keep`, and last states of the first invalid rows.

Each batch's histories are one file, and so are the last states of each invalid row; the manifest lists them like parts.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from sweep.config.experiment import Experiment
from sweep.contract.engine import Engine, TimeSeriesRequest
from sweep.contract.engine_settings import EngineSettings
from sweep.core.errors import InputError
from sweep.core.outcomes import INVALID
from sweep.runs import store
from sweep.runs.batches import Batch, make_engine, make_nominal_batch
from sweep.runs.manifest import ManifestEntry
from sweep.study.study import rollout_id_columns

MAX_INVALID_ROWS = 10  # of a folder, whose last states are stored
LAST_STATES_DURATION_S = 1.0  # of such a row that are stored, s
MAX_NUMBERS = 500_000_000  # of 4 bytes, in the histories of a study


def make_time_series_request(exp: Experiment, settings: EngineSettings) -> TimeSeriesRequest:
    """Return which columns the engine should record and how often, as the study's `keep` demands."""
    every = max(1, round(1 / (exp.study.keep_rate * settings.control_period)))
    return TimeSeriesRequest(exp.study.keep, every, exp.study.keep_rows)


def find_recorded_slots(exp: Experiment, rows: pd.DataFrame) -> np.ndarray:
    """Return the slots (positions in a batch) of the rollouts whose time series the study keeps."""
    return np.flatnonzero(rows.index < exp.study.keep_rows) if exp.study.keep else np.zeros(0, int)


def check_history_size(exp: Experiment, table: pd.DataFrame) -> int:
    """Estimate how many numbers the time series of a study contain, and raise `InputError` if too many.

    Args:
        exp: Experiment of the study.
        table: All its points, with groups and batch widths.

    Returns:
        The estimate; 0 where the study keeps no histories.

    Raises:
        InputError: There are more than `MAX_NUMBERS`.
    """
    if not exp.study.keep:
        return 0
    start = make_nominal_batch(exp, table.iloc[:1], int(table["width"].iloc[0]))
    samples = int(make_engine(exp, start).duration * exp.study.keep_rate)
    rollouts = min(exp.study.keep_rows, len(table))
    count = rollouts * samples * (len(exp.study.keep) + 1)
    if count > MAX_NUMBERS:
        what = f"{rollouts} rollouts, {samples} samples each, {len(exp.study.keep)} columns"
        raise InputError(
            f"study.keep is not allowed with {what}: at most {MAX_NUMBERS} numbers; lower keep_rows or keep_rate"
        )
    return count


def time_series_table(
    rows: pd.DataFrame, samples: np.ndarray, time: np.ndarray, until: np.ndarray, columns: Sequence[str]
) -> pd.DataFrame:
    """Return the time series of n rows as a table, one rollout below the other.

    Args:
        rows: The n rows.
        samples: Recorded values (F, n, c).
        time: Times (F,) of the samples, s.
        until: End (n,) of each rollout, s; later samples are left out.
        columns: Names of the c values.

    Returns:
        A row for each sample: columns that identify the rollout, `time_s`, and the values.
    """
    within = (time[None] <= until[:, None]).ravel()
    number = np.repeat(np.arange(len(rows)), len(time))[within]
    named = rows[rollout_id_columns(rows.columns)].iloc[number].reset_index(drop=True)
    values = np.moveaxis(samples, 0, 1).reshape(-1, len(columns))[within].astype(np.float32)
    clock = np.tile(time, len(rows))[within]
    return pd.concat([named.assign(time_s=clock), pd.DataFrame(values, columns=list(columns))], axis=1)


def histories_table(
    finished: pd.DataFrame, slots: np.ndarray, samples: np.ndarray, watched: TimeSeriesRequest, period: float
) -> pd.DataFrame:
    """Return the time series of a batch as a table with a row for each sample.

    Args:
        finished: Finished rows of the batch.
        slots: Slots that were recorded.
        samples: Recorded values (F, slots, columns).
        watched: What was recorded, and how often.
        period: Control period, s.
    """
    rows = finished.iloc[slots]
    time = period * watched.every * (1 + np.arange(len(samples)))
    return time_series_table(rows, samples, time, rows["duration_s"].to_numpy() + period / 2, watched.columns)


def record_ends_of_invalid_rollouts(
    exp: Experiment, engine: Engine, task: Batch, finished: pd.DataFrame, limit: int
) -> list[pd.DataFrame]:
    """Simulate a batch again and record every control tick of the last second of its invalid rollouts.

    The batch is simulated once more for it, so that batches without invalid rows take no longer.

    Args:
        exp: Experiment of the study.
        engine: Engine of the batch.
        task: The batch.
        finished: Its finished rows.
        limit: Largest number of rows to record.

    Returns:
        A table for each recorded row, see `time_series_table`.
    """
    slots = np.flatnonzero(finished["outcome"] == INVALID)[:limit]
    watched = TimeSeriesRequest(tuple(exp.system.recordable_columns), 1, MAX_INVALID_ROWS)
    _, samples = engine.run_with_time_series(task.world, task.belief, task.streams, slots, watched)
    period = task.settings.control_period
    time, tables = period * (1 + np.arange(len(samples))), []
    for k, slot in enumerate(slots):
        row = finished.iloc[[slot]]
        end = row["t_cause_s"].fillna(row["duration_s"]).to_numpy() + period / 2
        chosen = time > end - LAST_STATES_DURATION_S
        tables.append(time_series_table(row, samples[chosen, k : k + 1], time[chosen], end + period, watched.columns))
    return tables


def read_histories(folder: Path) -> pd.DataFrame:
    """Return the time series in a folder: columns that identify a row, `time_s`, and the columns of the study's `keep`.

    Raises:
        InputError: The folder holds no histories, or a file is damaged.
    """
    entries = store.list_recordings(folder, store.HISTORIES_FOLDER)
    if not entries:
        raise InputError(f"{folder} holds no time series: run the study with study.keep=[tilt_deg]")
    planned = store.count_planned_rollouts(folder)
    return pd.concat([store.read_part(folder, entry, planned) for entry in entries], ignore_index=True)


def write_recordings(
    folder: Path, study: str, batch: int, table: pd.DataFrame | None, states: Sequence[pd.DataFrame]
) -> tuple[ManifestEntry, ...]:
    """Write the time series and last states of a batch to files; return their manifest entries.

    Args:
        folder: Folder of the study.
        study: Digest of the study.
        batch: Number of the batch.
        table: Its histories, or None.
        states: Last states, a table for each invalid row.

    Raises:
        Fault: The disk refuses the write.
    """
    entries: list[ManifestEntry] = []
    if table is not None:
        entries.append(store.write_recording(folder, f"{store.HISTORIES_FOLDER}/batch-{batch:06d}", table, study))
    for one in states:
        name = f"{store.LAST_STATES_FOLDER}/{one['point_id'].iloc[0]}"
        entries.append(store.write_recording(folder, name, one, study))
    return tuple(entries)
