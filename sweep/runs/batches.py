"""From the points table to the inputs of an engine: groups that share a compiled engine, batches of one width."""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import pandas as pd

from sweep.core.errors import Fault, InputError
from sweep.engines.base import Engine
from sweep.engines.settings import EngineSettings
from sweep.study.config import Experiment
from sweep.study.study import extreme_points, identity_columns, is_static, parameter_columns, replace_settings
from sweep.systems.base import Limits, System


@dataclass(frozen=True)
class Batch:
    """The input of one call of an engine; `width` rows, the last one repeated where there are fewer."""

    settings: EngineSettings
    world: Any  # of the system's own type
    belief: Any
    streams: np.ndarray  # (width,)


def make_engine(exp: Experiment, nominal_batch: Batch) -> Engine:
    """The engine for batches such as `start`.

    A process keeps the last one, so that the batches of a group, wherever they come from, compile once.
    """
    return _engine(exp.system, nominal_batch.settings, nominal_batch.world, nominal_batch.belief, exp.thresholds)


@lru_cache(maxsize=1)
def _engine(system: System, settings: EngineSettings, world: Any, belief: Any, limits: Limits) -> Engine:
    return system.engine(settings, world, belief, limits)


def forget_engine() -> None:
    """Give back the memory of the engine that is kept."""
    _engine.cache_clear()


def with_delay_buffer(exp: Experiment, table: pd.DataFrame) -> Experiment:
    """Its system with memory, such as a delay's, long enough for every point of `table`.

    And for whatever else may be drawn, so that more draws compile nothing anew.
    """
    study = exp.study
    if study.design.num and not study.points and not any(axis.values is not None for axis in study.axes):
        table = pd.concat([table, extreme_points(study, exp.system, exp.settings)])
    return replace(exp, system=exp.system.with_delay_buffer(table))


def static_values(exp: Experiment, table: pd.DataFrame) -> dict[str, Any]:
    """The values that all rows of one group share and that fix its compiled engine."""
    static = [c for c in parameter_columns(table) if is_static(c, exp.system, exp.settings)]
    return {c: getattr(v := table[c].iloc[0], "item", lambda v=v: v)() for c in static}


def make_nominal_batch(exp: Experiment, rows: pd.DataFrame, width: int) -> Batch:
    """What the engine of a group is made from: static values set, swept quantities at their nominal values."""
    statics = static_values(exp, rows)
    settings = replace_settings(exp.settings, statics)
    return Batch(replace(settings, width=width), *exp.system.sides(statics), np.zeros(0, dtype=np.int64))


def make_batch(exp: Experiment, rows: pd.DataFrame) -> Batch:
    """`rows` of one batch as arrays over its width."""
    width = int(rows["width"].iloc[0])
    slots = np.minimum(np.arange(width), len(rows) - 1)
    statics = static_values(exp, rows)
    swept = {c: rows[c].to_numpy(dtype=float)[slots] for c in parameter_columns(rows) if c not in statics}
    world, belief = exp.system.sides({**statics, **swept})
    streams = rows["stream"].to_numpy()[slots]
    return Batch(replace(replace_settings(exp.settings, statics), width=width), world, belief, streams)


def assign_batches(exp: Experiment, planned: pd.DataFrame, wanted: pd.DataFrame) -> pd.DataFrame:
    """`planned` rows as they are, then those of `wanted` that are new, in groups and batches of their own."""
    table = wanted
    if not planned.empty:
        table = pd.concat([planned, wanted[~isin_points(wanted, planned)]], ignore_index=True)
    static = list(static_values(exp, table))
    table = table.assign(group=table.groupby(static, sort=False).ngroup() if static else 0)
    first = int(planned["batch"].max()) + 1 if len(planned) else 0
    for column in ("batch", "slot", "width"):
        table[column] = table[column].fillna(-1).astype("int64") if column in table else -1
    for _, rows in table[table["batch"] < 0].groupby("group", sort=False):
        first = _cut(table, rows.index, _even_width(exp, rows), first)
    return table


def halve_batches(table: pd.DataFrame, batches: list[int], devices: int) -> pd.DataFrame:
    """`table` with the rows of `batches` planned anew, in batches half as wide. Raises `Fault` where none is left.

    A width that shares evenly among `devices` stays one where it can.
    """
    table, first = table.copy(), int(table["batch"].max()) + 1
    for number in batches:
        rows = table.index[table["batch"] == number]
        width = int(table["width"].loc[rows].iloc[0]) // 2
        if not width:
            raise Fault("a single rollout does not fit in the memory of the device")
        first = _cut(table, rows, width // devices * devices or width, first)
    return table


def _cut(table: pd.DataFrame, rows: pd.Index, width: int, first: int) -> int:
    """Put `rows` of `table` into batches of `width`, numbered from `first`; the number after the last."""
    batches, slots = np.divmod(np.arange(len(rows)), width)
    for column, values in (("batch", first + batches), ("slot", slots), ("width", width)):
        table.loc[rows, column] = values
    return first + -(-len(rows) // width)


def isin_points(rows: pd.DataFrame, points: pd.DataFrame) -> np.ndarray:
    """Which of `rows` are also in `others`."""
    key = identity_columns(rows.columns)
    return pd.MultiIndex.from_frame(rows[key]).isin(pd.MultiIndex.from_frame(points[key]))


def _even_width(exp: Experiment, rows: pd.DataFrame) -> int:
    """The width asked for; else the device's best, evened out so that the last batch is nearly full.

    Raises `InputError` where neither is known, and where the nominal plan is impossible.
    """
    start = make_nominal_batch(exp, rows, exp.settings.width)
    if exp.cluster.is_remote and not start.settings.width:
        raise InputError(
            f"cluster = {exp.cluster.kind} needs engine.width, as the workers' devices are not seen from here: "
            "rollouts in a batch, such as 64 for two CPU cores or 32768 for a GPU"
        )
    engine = make_engine(exp, start)  # refuses an impossible plan while nothing is written yet
    if start.settings.width:
        return start.settings.width
    even = -(-len(rows) // -(-len(rows) // engine.width))
    return -(-even // engine.devices) * engine.devices
