"""`sweep replay DIR POINT`: simulate one stored rollout again and show it."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from tabulate import tabulate

from sweep.config.experiment import build_experiment
from sweep.contract.engine import Trace, is_bitwise_equal
from sweep.contract.engine_settings import EngineSettings
from sweep.contract.system import System, judge_rollout
from sweep.runs import store
from sweep.runs.batches import allocate_delay_buffers, make_engine, make_nominal_batch
from sweep.runs.runner import load_stored_rollout
from sweep.study.columns import LABEL_COLUMNS
from sweep.study.study import parameter_columns


@dataclass(frozen=True)
class Replay:
    """A stored rollout together with its trace from simulating it again."""

    stored: pd.Series  # row of the stored rollout
    again: Mapping[str, Any]  # metrics and outcome of the new rollout
    trace: Trace  # states, forces, torques and stages of the new rollout over time
    settings: EngineSettings  # settings of the engine
    config: dict[str, Any]  # resolved configuration of the study, and the point's own values
    other_run: str | None  # a note where code, libraries or device differ from those of the stored row


def replay_rollout(folder: Path, point: str) -> Replay:
    """Simulate a stored rollout again and record its trace.

    Its whole batch runs, because equal bits need equal neighbours in equal slots.

    Args:
        folder: Folder of the study.
        point: Row number, or the beginning of a point id.

    Returns:
        The stored row, the new one, and the trace.

    Raises:
        InputError: No row, or more than one, is meant; or the folder is damaged.
    """
    task, slot, row = load_stored_rollout(folder, point)
    table, stored = store.read_points(folder), store.read_study(folder)
    config = stored["config"]
    exp = allocate_delay_buffers(build_experiment(config), table)
    start = make_nominal_batch(exp, table.loc[table["batch"] == row["batch"]], len(task.streams))
    engine = make_engine(exp, start)
    trace = engine.trace(task.world, task.belief, task.streams, slot)
    again = {**judge_rollout(exp.system, trace.metrics, exp.thresholds, engine.stages), **trace.metrics}
    values = {name: row[name] for name in (*parameter_columns(table), "replicate", "stream")}
    other_run = None
    if str(row["run_id"]) != exp.system.run_id(task.settings):
        then, here = " or ".join(stored["devices"]), exp.system.device(task.settings)
        other_run = f"the row was simulated with other code or libraries, or on another device ({then}; here {here})"
    return Replay(row, again, trace, task.settings, {**config, "point": values}, other_run)


def state_table(system: System, trace: Trace) -> pd.DataFrame:
    """Return a trace as a table: a row for each control tick, a column for each number of the state.

    Args:
        system: The system that was simulated.
        trace: The rollout.
    """
    columns = system.state_values_by_column(trace)
    return pd.DataFrame({"time_s": trace.time, "stage": [trace.stages[k] for k in trace.stage], **columns})


def format_comparison_with_stored(result: Replay) -> str:
    """Return a text that compares the stored outcome with the new one, and lists all metrics that differ."""
    stored, again = result.stored, result.again
    figures = [name for name in result.trace.metrics if name in stored]
    changed = [name for name in figures if not is_bitwise_equal(stored[name], again[name])]
    rows = [(name, _format_value(stored[name]), _format_value(again[name])) for name in (*LABEL_COLUMNS[:4], *changed)]
    lines = [
        f"point {stored['point_id']}",
        tabulate(rows, headers=("", "stored", "replayed"), disable_numparse=True),
        f"{len(figures) - len(changed)} of {len(figures)} metrics are equal to the last bit",
    ]
    if result.other_run:
        lines.append(f"{result.other_run}: bits may differ")
    return "\n".join(lines)


def _format_value(value: Any) -> str:
    return value if isinstance(value, str) else f"{value:.9g}"
