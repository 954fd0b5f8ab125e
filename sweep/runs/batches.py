"""Conversion of study points into engine inputs: groups that share a compiled engine, and batches of one width."""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import pandas as pd

from sweep.config.experiment import Experiment
from sweep.contract.engine import Engine
from sweep.contract.engine_settings import EngineSettings
from sweep.contract.system import Limits, System
from sweep.core.errors import Fault, InputError
from sweep.study.study import (
    extreme_points,
    needs_recompilation,
    parameter_columns,
    replace_settings,
    rollout_id_columns,
)


@dataclass(frozen=True)
class Batch:
    """Input of one engine call: `width` rollouts, with the last row repeated if there are fewer."""

    settings: EngineSettings
    world: Any  # the system's own type of parameters
    belief: Any
    streams: np.ndarray  # (width,)


def make_engine(exp: Experiment, nominal_batch: Batch) -> Engine:
    """Return the engine that simulates batches of the same static values and width as `nominal_batch`.

    The process keeps the last engine, so the batches of one group compile once.

    Args:
        exp: Experiment of the study, with its system and thresholds.
        nominal_batch: Engine settings and nominal world and belief, see `make_nominal_batch`.
    """
    return _engine(exp.system, nominal_batch.settings, nominal_batch.world, nominal_batch.belief, exp.thresholds)


@lru_cache(maxsize=1)
def _engine(system: System, settings: EngineSettings, world: Any, belief: Any, limits: Limits) -> Engine:
    return system.make_engine(settings, world, belief, limits)


def clear_engine_cache() -> None:
    """Release the engine that `make_engine` keeps, with its memory."""
    _engine.cache_clear()


def allocate_delay_buffers(exp: Experiment, table: pd.DataFrame) -> Experiment:
    """Return the experiment with sensor-delay buffers that are long enough for every point.

    The ends of all drawn axes count too, so that later draws of the same study use the same compiled program.

    Args:
        exp: Experiment of the study.
        table: Points, a row for each rollout.
    """
    study = exp.study
    if study.design.num and not study.points and not any(axis.values is not None for axis in study.axes):
        exp = replace(exp, system=exp.system.allocate_delay_buffers(extreme_points(study, exp.system, exp.settings)))
    return replace(exp, system=exp.system.allocate_delay_buffers(table))


def static_parameter_values(exp: Experiment, table: pd.DataFrame) -> dict[str, Any]:
    """Return the parameter values, by column, that rows share because they are compiled into one program."""
    static = [c for c in parameter_columns(table) if needs_recompilation(c, exp.system, exp.settings)]
    return {c: getattr(v := table[c].iloc[0], "item", lambda v=v: v)() for c in static}


def make_nominal_batch(exp: Experiment, rows: pd.DataFrame, width: int) -> Batch:
    """Return the nominal parameters from which the engine of a group (rows that share a program) is compiled.

    Args:
        exp: Experiment of the study.
        rows: Points of one group.
        width: Rollouts in a batch; 0 lets the engine choose.

    Returns:
        A batch without a batch axis and without random streams.
    """
    statics = static_parameter_values(exp, rows)
    settings = replace_settings(exp.settings, statics)
    return Batch(
        replace(settings, width=width), *exp.system.make_world_and_belief(statics), np.zeros(0, dtype=np.int64)
    )


def make_batch(exp: Experiment, rows: pd.DataFrame) -> Batch:
    """Return the engine input for the rows of one batch.

    Args:
        exp: Experiment of the study.
        rows: Points of one batch in the order of their slots, with `width` and `stream`.

    Returns:
        World and belief whose swept quantities are arrays (width,); slots beyond the rows repeat the last row.
    """
    width = int(rows["width"].iloc[0])
    slots = np.minimum(np.arange(width), len(rows) - 1)
    statics = static_parameter_values(exp, rows)
    swept = {c: rows[c].to_numpy(dtype=float)[slots] for c in parameter_columns(rows) if c not in statics}
    world, belief = exp.system.make_world_and_belief({**statics, **swept})
    streams = rows["stream"].to_numpy()[slots]
    return Batch(replace(replace_settings(exp.settings, statics), width=width), world, belief, streams)


def assign_batches(exp: Experiment, planned: pd.DataFrame, wanted: pd.DataFrame) -> pd.DataFrame:
    """Assign new points to batches, and to groups that share a compiled program; points that have a batch keep it.

    Args:
        exp: Experiment of the study.
        planned: Points that have a batch already; may be empty.
        wanted: Points to simulate; those that are also in `planned` are skipped.

    Returns:
        `planned` and then the new points, with `group`, `batch`, `slot` and `width`. A group shares a compiled engine.

    Raises:
        InputError: The nominal plan is impossible, or a cluster needs `engine.width`.
    """
    table = wanted
    if not planned.empty:
        table = pd.concat([planned, wanted[~point_membership_mask(wanted, planned)]], ignore_index=True)
    static = list(static_parameter_values(exp, table))
    table = table.assign(group=table.groupby(static, sort=False).ngroup() if static else 0)
    first = int(planned["batch"].max()) + 1 if len(planned) else 0
    for column in ("batch", "slot", "width"):
        table[column] = table[column].fillna(-1).astype("int64") if column in table else -1
    new = np.flatnonzero(table["batch"] < 0)
    numbers = table["group"].iloc[new].unique()
    for number in numbers:  # by their places, as copies of millions of rows take much memory
        places = new[table["group"].to_numpy()[new] == number] if len(numbers) > 1 else new
        first = _cut_into_batches(table, places, _even_width(exp, table.iloc[places[:1]], len(places)), first)
    return table


def halve_batches(table: pd.DataFrame, batches: list[int], devices: int) -> pd.DataFrame:
    """Assign the rows of some batches to new batches of half the width.

    Args:
        table: All points with their batches.
        batches: Numbers of the batches to split.
        devices: Number of devices that share a batch; the new width is a multiple of it where possible.

    Returns:
        A copy of `table` with new numbers, slots and widths for these rows.

    Raises:
        Fault: A batch has a single rollout.
    """
    table, first = table.copy(), int(table["batch"].max()) + 1
    for number in batches:
        rows = np.flatnonzero(table["batch"] == number)
        width = int(table["width"].iloc[rows[0]]) // 2
        if not width:
            raise Fault("a single rollout does not fit in the memory of the device")
        first = _cut_into_batches(table, rows, width // devices * devices or width, first)
    return table


def _cut_into_batches(table: pd.DataFrame, places: np.ndarray, width: int, first: int) -> int:
    """Assign rows of `table`, by their places, to batches of `width` from number `first`; return the number after."""
    numbers = np.arange(len(places))
    _set_cells(table, "batch", places, first + numbers // width)
    _set_cells(table, "slot", places, numbers % width)
    _set_cells(table, "width", places, width)
    return first + -(-len(places) // width)


def _set_cells(table: pd.DataFrame, column: str, places: np.ndarray, values: np.ndarray | int) -> None:
    cells = table[column].to_numpy(copy=True)  # as `DataFrame.loc` takes four times the memory of a column
    cells[places] = values
    table[column] = pd.Series(cells, table.index, copy=False)


def point_membership_mask(rows: pd.DataFrame, points: pd.DataFrame) -> np.ndarray:
    """Return the mask (rows,) of the rows whose point is also in `points`."""
    key = rollout_id_columns(rows.columns)
    return pd.MultiIndex.from_frame(rows[key]).isin(pd.MultiIndex.from_frame(points[key]))


def _even_width(exp: Experiment, rows: pd.DataFrame, count: int) -> int:
    """Return `engine.width`, else the device's best width, evened out so that the last batch is nearly full.

    Args:
        exp: Experiment of the study.
        rows: At least one row of the group.
        count: How many new rows the group has.

    Raises `InputError` where a cluster needs a width and none is set, and where the nominal plan is impossible.
    """
    start = make_nominal_batch(exp, rows, exp.settings.width)
    if exp.cluster.is_remote and not start.settings.width:
        raise InputError(
            f"cluster = {exp.cluster.kind} needs engine.width, the number of rollouts in a batch, such as 64 for two "
            "CPU cores or 32768 for a GPU: the devices of the workers are unknown here"
        )
    engine = make_engine(exp, start)  # refuses an impossible plan before anything is written
    if start.settings.width:
        return start.settings.width
    even = -(-count // -(-count // engine.width))
    return -(-even // engine.devices) * engine.devices
