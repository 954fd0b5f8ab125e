"""Replays for a study's page: rollouts simulated again in their own batches, stored in `replays/`."""

import json
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from sweep.backends import devices
from sweep.config.experiment import Experiment
from sweep.contract.engine import MissingTrace, Trace, is_bitwise_equal
from sweep.contract.system import judge_rollout
from sweep.contract.trace_frames import base_pose, count_finite_frames
from sweep.core.errors import InputError
from sweep.core.files import path_inside_folder, read_bytes_limited, write_atomically
from sweep.replay.motion import MAX_RATE, describe_bodies, encode_motion
from sweep.runs import batches, store
from sweep.runs.results import Results

REPLAYS_FOLDER = "replays"  # folder beside the study's parts
NUMBER_TYPES = int | float
REPLAY_KEYS = {"states": str, "frames": int, "step": NUMBER_TYPES, "scales": list, "force_scale": NUMBER_TYPES,
               "stages": list, "bodies": dict, "equal": int, "of": int, "why": str}  # of a replay file  # fmt: skip
LATER_KEYS = ("signals", "pushes")  # lists of a replay file, which earlier versions did not write
STATES_PATTERN, MAX_FRAMES = re.compile("[A-Za-z0-9+/]*=*"), 1_000_000  # base64


def make_replays(
    results: Results, rows: pd.DataFrame, progress: Callable[[int, int], None] = lambda done, of: None
) -> int:
    """Simulate rows that have no replay yet, and store their replays.

    Args:
        results: study with its folder.
        rows: rows to simulate, with the reason in the column `why`.
        progress: called with rollouts done and in all.

    Returns:
        How many rollouts were simulated.
    """
    missing = [not replay_path(results.folder, row).exists() for _, row in rows.iterrows()]
    wanted = rows[np.array(missing, dtype=bool)]
    done = 0
    if wanted.empty:
        return done
    for row, trace, labels in resimulate_rows(results.exp, wanted, store.read_points(results.folder)):
        if (labels["outcome"], labels["cause"]) != (row["outcome"], row["cause"]):
            print(
                f"sweep: no replay of {row['point_id']}: on this machine the rollout ends with another outcome",
                file=sys.stderr,
            )
        elif len(trace.time):
            write_replay(results.folder, row, trace)
        done += 1
        progress(done, len(wanted))
    return done


def resimulate_rows(
    exp: Experiment, rows: pd.DataFrame, planned: pd.DataFrame, rate: float = MAX_RATE
) -> Iterator[tuple[pd.Series, Trace, dict[str, Any]]]:
    """Simulate stored rows again and record their replays.

    A line on the standard error names each rollout whose model cannot be drawn; it is left out.

    Args:
        exp: experiment of the study.
        rows: rows with the batch slots that they were simulated in.
        planned: all points of the study.
        rate: frames a second.

    Yields:
        Row, recorded rollout, and the labels and `run_id` that it gets here.
    """
    devices.configure_jax()  # the CPU counts as several devices from then on
    exp = batches.allocate_delay_buffers(exp, planned)
    for _, part in pack_rows_into_batches(rows, devices.default_batch_width()).groupby(["group", "batch", "width"]):
        order = np.zeros(int(part["width"].iloc[0]), dtype=int)
        order[part["slot"]] = np.arange(len(part))
        full = part.iloc[order]
        task, start = batches.make_batch(exp, full), batches.make_nominal_batch(exp, full, len(full))
        engine, run_id = batches.make_engine(exp, start), exp.system.run_id(task.settings)
        every = max(1, round(1 / rate / task.settings.control_period))
        traces = engine.traces(task.world, task.belief, task.streams, every)
        for _, row in part.iterrows():
            trace = traces[row["slot"]]
            if isinstance(trace, MissingTrace):
                print(f"sweep: no replay of {row['point_id']}: {trace.reason}", file=sys.stderr)
                continue
            labels = judge_rollout(exp.system, trace.metrics, exp.thresholds, engine.stages)
            yield row, trace, {**labels, "run_id": run_id}


def pack_rows_into_batches(rows: pd.DataFrame, widest: int) -> pd.DataFrame:
    """Distribute rows over as few batches as possible, none wider than `widest`.

    A rollout has the same bits in the same slot of a batch of the same width, whatever its neighbours are. Where the
    study's batches are too wide for this machine, rows take new slots.
    """
    table = rows.copy()
    wide = table["width"] > widest
    together = table[wide].groupby("group")
    width = np.minimum(together["slot"].transform("size"), widest)
    table.loc[wide, "slot"], table.loc[wide, "width"] = together.cumcount() % width, width
    table["batch"] = table.groupby(["group", "width", "slot"]).cumcount()
    return table


def write_replay(folder: Path, row: pd.Series, trace: Trace) -> None:
    """Store the replay of a row in the study's folder."""
    file = replay_path(folder, row)
    file.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(file, json.dumps(replay_content(row, trace)).encode())


def replay_content(row: pd.Series, trace: Trace) -> dict[str, Any]:
    """Return the content of a replay file: motion, bodies and stages of a rollout as plain values for JSON.

    Args:
        row: row of the study.
        trace: its recorded rollout.
    """
    same = [name for name, value in trace.metrics.items() if name in row and is_bitwise_equal(row[name], value)]
    return {
        **encode_motion(trace),
        "bodies": describe_bodies(
            trace.model, trace.foot_position.shape[1], base_pose(trace)[: count_finite_frames(trace), :3]
        ),
        "stages": list(trace.stages),
        "equal": len(same),  # figures that are the row's to the last bit
        "of": len([name for name in trace.metrics if name in row]),
        "why": str(row.get("why", "")),
    }


def read_replay(folder: Path, row: pd.Series) -> dict[str, Any] | None:
    """Read the stored replay of a row; None without one.

    Args:
        folder: folder of the study.
        row: row of the study.
    """
    file = replay_path(folder, row)
    return load_replay(file) if file.exists() else None


def read_replays(results: Results) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yield the index of each row that has a replay, and the replay."""
    folder = path_inside_folder(results.folder, REPLAYS_FOLDER)
    there = (
        {file.stem: path_inside_folder(folder, file.name) for file in folder.glob("*.json")} if folder.is_dir() else {}
    )
    if not there:
        return
    names = results.rows["run_id"].astype(str) + "-" + results.rows["point_id"].astype(str)
    for place in np.flatnonzero(names.isin(there)):
        yield int(place), load_replay(there[names.iloc[place]])


def load_replay(file: Path) -> dict[str, Any]:
    """Load a replay file, which may be untrusted, and check its content.

    Raises:
        InputError: It is no replay.
    """
    try:
        replay = json.loads(read_bytes_limited(file))
        whole = all(isinstance(replay[name], kind) for name, kind in REPLAY_KEYS.items())
        whole = whole and all(isinstance(replay.get(name, []), list) for name in LATER_KEYS)
        if not whole or not STATES_PATTERN.fullmatch(replay["states"]) or not 1 <= replay["frames"] <= MAX_FRAMES:
            raise ValueError
    except (ValueError, KeyError, TypeError, RecursionError):
        raise InputError(f"{file} is no replay: remove it, and `sweep report --replays` makes it again") from None
    return replay


def replay_path(folder: Path, row: pd.Series) -> Path:
    """Return the path of a row's replay file, which need not exist.

    Args:
        folder: folder of the study.
        row: row of the study.
    """
    return path_inside_folder(folder, f"{REPLAYS_FOLDER}/{row['run_id']}-{row['point_id']}.json")
