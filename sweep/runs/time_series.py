"""What is recorded over time: of a study's first rows by `study.keep`, and how the first invalid rows came to be so.

Each batch's histories are a file, each invalid row's last states too; they count as parts do, see `manifest`.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from sweep.core.errors import InputError
from sweep.core.outcomes import INVALID
from sweep.engines.base import Engine, Watch
from sweep.engines.settings import EngineSettings
from sweep.runs import store
from sweep.runs.batches import Batch, make_engine, make_nominal_batch
from sweep.runs.manifest import Entry
from sweep.study.config import Experiment
from sweep.study.study import identity_columns

INVALID_ROWS, LAST_SECONDS = 10, 1.0  # rows of a folder whose last states are kept, and how much of them (s)
MAX_NUMBERS = 500_000_000  # numbers that a study may keep, of 4 bytes


def make_watch(exp: Experiment, settings: EngineSettings) -> Watch:
    """What the study keeps over time."""
    every = max(1, round(1 / (exp.study.keep_rate * settings.control_period)))
    return Watch(exp.study.keep, every, exp.study.keep_rows)


def recorded_slots(exp: Experiment, rows: pd.DataFrame) -> np.ndarray:
    """The slots of those of a batch's planned `rows`, numbered as in the plan, that the study keeps histories of."""
    return np.flatnonzero(rows.index < exp.study.keep_rows) if exp.study.keep else np.zeros(0, int)


def check_size(exp: Experiment, table: pd.DataFrame) -> int:
    """About how many numbers are kept of the planned rows `table`. Raises `InputError` where they are too many."""
    if not exp.study.keep:
        return 0
    first = table[table["group"] == table["group"].iloc[0]]
    start = make_nominal_batch(exp, first, int(first["width"].iloc[0]))
    samples = int(make_engine(exp, start).duration * exp.study.keep_rate)
    rollouts = min(exp.study.keep_rows, len(table))
    count = rollouts * samples * (len(exp.study.keep) + 1)
    if count > MAX_NUMBERS:
        what = f"{rollouts} rollouts, {samples} samples each, {len(exp.study.keep)} columns"
        raise InputError(
            f"study.keep is not allowed with {what}: at most {MAX_NUMBERS} numbers; lower keep_rows or keep_rate"
        )
    return count


def to_table(
    rows: pd.DataFrame, samples: np.ndarray, time: np.ndarray, until: np.ndarray, columns: Sequence[str]
) -> pd.DataFrame:
    """`samples` (F, n, c) at `time` (F,) of the n `rows`, one below the other, each up to its end `until` (n,) s."""
    within = (time[None] <= until[:, None]).ravel()
    number = np.repeat(np.arange(len(rows)), len(time))[within]
    named = rows[identity_columns(rows.columns)].iloc[number].reset_index(drop=True)
    values = np.moveaxis(samples, 0, 1).reshape(-1, len(columns))[within].astype(np.float32)
    clock = np.tile(time, len(rows))[within]
    return pd.concat([named.assign(time_s=clock), pd.DataFrame(values, columns=list(columns))], axis=1)


def histories_table(
    finished: pd.DataFrame, slots: np.ndarray, samples: np.ndarray, watched: Watch, period: float
) -> pd.DataFrame:
    """The histories of the rows of a batch in `slots`, by the control `period` (s)."""
    rows = finished.iloc[slots]
    time = period * watched.every * (1 + np.arange(len(samples)))
    return to_table(rows, samples, time, rows["duration_s"].to_numpy() + period / 2, watched.columns)


def simulate_last_states(
    exp: Experiment, engine: Engine, task: Batch, finished: pd.DataFrame, limit: int
) -> list[pd.DataFrame]:
    """How the first `room` invalid rows of a batch ended: every control tick of the last second before their cause.

    The batch is simulated once more, so that a batch without such rows takes no longer for it.
    """
    slots = np.flatnonzero(finished["outcome"] == INVALID)[:limit]
    watched = Watch(tuple(exp.system.history_columns), 1, INVALID_ROWS)
    _, samples = engine.histories(task.world, task.belief, task.streams, slots, watched)
    period = task.settings.control_period
    time, tables = period * (1 + np.arange(len(samples))), []
    for k, slot in enumerate(slots):
        row = finished.iloc[[slot]]
        end = row["t_cause_s"].fillna(row["duration_s"]).to_numpy() + period / 2
        chosen = time > end - LAST_SECONDS
        after = end + period  # one tick more
        tables.append(to_table(row, samples[chosen, k : k + 1], time[chosen], after, watched.columns))
    return tables


def read(folder: Path) -> pd.DataFrame:
    """The histories kept in `folder`: which row (`point_id`), `time_s`, the study's columns. Raises `InputError`."""
    entries = store.list_recordings(folder, store.HISTORIES)
    if not entries:
        raise InputError(f"{folder} holds no time histories: run the study with study.keep=[tilt_deg]")
    return pd.concat([store.read_part(folder, entry) for entry in entries], ignore_index=True)


def write(
    folder: Path, study: str, batch: int, table: pd.DataFrame | None, states: Sequence[pd.DataFrame]
) -> tuple[Entry, ...]:
    """Files of what a batch recorded. Raises `Fault`."""
    entries: list[Entry] = []
    if table is not None:
        entries.append(store.write_recording(folder, f"{store.HISTORIES}/batch-{batch:06d}", table, study))
    for one in states:
        name = f"{store.LAST_STATES}/{one['point_id'].iloc[0]}"
        entries.append(store.write_recording(folder, name, one, study))
    return tuple(entries)
