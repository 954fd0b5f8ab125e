"""Rollouts of a study simulated again for its page, in batches of their own, and kept in the folder's `replays/`."""

import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from sweep.core.files import path_in, write_atomically
from sweep.engines import devices
from sweep.engines.base import NoTrace, Trace, same_bits
from sweep.runs import batches, store
from sweep.runs.results import Results
from sweep.study.config import Experiment
from sweep.systems.base import judge_one
from sweep.trace.motion import RATE, bodies, motion

REPLAYS = "replays"  # folder beside the study's parts


def make(results: Results, rows: pd.DataFrame, progress: Callable[[int, int], None] = lambda done, of: None) -> int:
    """Simulate `rows`, such as the `chosen` ones, again where no replay is kept yet; how many have run.

    A rollout that ends otherwise in its new batch is not kept, and a line on the standard error says so. `progress` is
    told how many of how many are done.
    """
    missing = [not path(results.folder, row).exists() for _, row in rows.iterrows()]
    wanted = rows[np.array(missing, dtype=bool)]
    done = 0
    if wanted.empty:
        return done
    for row, trace, labels in again(results.exp, wanted, store.read_points(results.folder)):
        if (labels["outcome"], labels["cause"]) != (row["outcome"], row["cause"]):
            print(f"sweep: no replay of {row['point_id']}: here it ends otherwise", file=sys.stderr)
        elif len(trace.time):
            keep(results.folder, row, trace)
        done += 1
        progress(done, len(wanted))
    return done


def again(
    exp: Experiment, rows: pd.DataFrame, planned: pd.DataFrame, rate: float = RATE
) -> Iterator[tuple[pd.Series, Trace, dict[str, Any]]]:
    """Each of `rows`, its rollout recorded `rate` times a second, and the labels that it has here.

    A line on the standard error names a rollout whose model cannot be drawn; it is left out.

    `planned` are all points of the study, `rows` some of them with the slots that they were simulated in.
    """
    devices.configure()  # the CPU counts as several devices from then on
    exp = batches.with_delay_buffer(exp, planned)
    for _, part in laid_out(rows, devices.default_width()).groupby(["group", "batch", "width"]):
        order = np.zeros(int(part["width"].iloc[0]), dtype=int)
        order[part["slot"]] = np.arange(len(part))
        full = part.iloc[order]
        task, start = batches.batch(exp, full), batches.nominal(exp, full, len(full))
        engine = batches.make_engine(exp, start)
        every = max(1, round(1 / rate / task.settings.control_period))
        traces = engine.traces(task.world, task.belief, task.streams, every)
        for _, row in part.iterrows():
            trace = traces[row["slot"]]
            if isinstance(trace, NoTrace):
                print(f"sweep: no replay of {row['point_id']}: {trace.reason}", file=sys.stderr)
                continue
            yield row, trace, judge_one(exp.system, trace.figures, exp.thresholds, engine.stages)


def laid_out(rows: pd.DataFrame, widest: int) -> pd.DataFrame:
    """`rows` in as few batches as there can be, no wider than `widest`.

    A rollout has the same bits in the same slot of a batch of the same width, whatever its neighbours. Where the
    study's batches are too wide here, rows take slots as they come.
    """
    table = rows.copy()
    wide = table["width"] > widest
    together = table[wide].groupby("group")
    width = np.minimum(together["slot"].transform("size"), widest)
    table.loc[wide, "slot"], table.loc[wide, "width"] = together.cumcount() % width, width
    table["batch"] = table.groupby(["group", "width", "slot"]).cumcount()
    return table


def keep(folder: Path, row: pd.Series, trace: Trace) -> None:
    """Write the replay of `row`."""
    file = path(folder, row)
    file.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(file, json.dumps(content(row, trace)).encode())


def content(row: pd.Series, trace: Trace) -> dict[str, Any]:
    """What is kept of the replay of `row`."""
    same = [name for name, value in trace.figures.items() if name in row and same_bits(row[name], value)]
    return {
        **motion(trace),
        "bodies": bodies(trace.model, trace.foot_position.shape[1]),
        "stages": list(trace.stages),
        "equal": len(same),  # figures that are the row's to the last bit
        "of": len([name for name in trace.figures if name in row]),
        "why": str(row.get("why", "")),
    }


def read(folder: Path, row: pd.Series) -> dict[str, Any] | None:
    """The replay of `row`, where one is kept."""
    file = path(folder, row)
    return json.loads(file.read_text(encoding="utf-8")) if file.exists() else None


def kept(results: Results) -> Iterator[tuple[int, dict[str, Any]]]:
    """Rows (their place among the results') that a replay is kept of, and the replays."""
    folder = path_in(results.folder, REPLAYS)
    there = {file.stem: path_in(folder, file.name) for file in folder.glob("*.json")} if folder.is_dir() else {}
    if not there:
        return
    names = results.rows["run_id"].astype(str) + "-" + results.rows["point_id"].astype(str)
    for place in np.flatnonzero(names.isin(there)):
        yield int(place), json.loads(there[names.iloc[place]].read_text(encoding="utf-8"))


def path(folder: Path, row: pd.Series) -> Path:
    """Where the replay of a row is, or would be."""
    return path_in(folder, f"{REPLAYS}/{row['run_id']}-{row['point_id']}.json")
