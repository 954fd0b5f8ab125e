"""Commands of a controller that change during a rollout: steps and ramps from a scenario or from a file."""

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sweep.contract.system import Parameter
from sweep.core.errors import InputError, require_choice
from sweep.core.parameters import quantity

FACTOR: Parameter = quantity(1.0, "")  # of all values of a schedule
FILE, TIME = "file", "time"
EARLY = 1e-9  # s by which a tick counts as later, so that rounding delays no step


class Schedule(NamedTuple):
    """Values over time of one parameter of a controller: linear between points, constant before and after them."""

    name: str
    points: tuple[tuple[float, float], ...]  # time (s) and value; two points of one time are a step


def parse_schedules(given: Any, names: Sequence[str], folder: Path) -> tuple[tuple[Schedule, ...], dict[str, Any]]:
    """Return the schedules in a configuration, and their numeric parameters by path. Raises `InputError`.

    Args:
        given: For each name a list of times and values, or a mapping with `points` and `factor`; or `file`, a table
            with the column `time` and a column for each name.
        names: Numbers of the controller.
        folder: Folder that the file's path is relative to.
    """
    if not isinstance(given, Mapping):
        such = "times and values by name, such as {velocity_x: [[0, 0], [1, 0.5]]}"
        raise InputError(f"schedule = {given!r:.80} is not allowed: {such}")
    given = dict(given)
    if FILE in given:
        file = given.pop(FILE)
        table = _read_table(folder / str(file), f"schedule.{FILE} = {file}")
        for name in table:
            require_choice(name, names, f"schedule.{FILE} = {file}: column {name}")
            own = given.get(name, {})
            if not isinstance(own, Mapping) or "points" in own:
                raise InputError(f"schedule.{name} is not allowed: {file} has a column {name}")
            given[name] = {**own, "points": table[name]}
    schedules, numbers = [], {}
    for name, said in given.items():
        require_choice(name, names, f"schedule.{name}")
        said = said if isinstance(said, Mapping) else {"points": said}
        for key in said:
            require_choice(key, ("points", "factor"), f"schedule.{name}: {key}")
        schedules.append(Schedule(str(name), _check_points(f"schedule.{name}", said.get("points"))))
        numbers |= {f"schedule.{name}.factor": said["factor"]} if "factor" in said else {}
    return tuple(schedules), numbers


def _check_points(error_prefix: str, given: Any) -> tuple[tuple[float, float], ...]:
    """Return points as plain numbers. Raises `InputError`."""
    pairs: Sequence[Any] = given if isinstance(given, list | tuple) and given else [None]
    for one in pairs:
        is_pair = isinstance(one, list | tuple) and len(one) == 2
        if not is_pair or not all(type(x) in (int, float) and math.isfinite(x) for x in one):
            such = "a list of times (s) and values, such as [[0, 0], [1, 0.5]]"
            raise InputError(f"{error_prefix} = {given!r:.80} is not allowed: {such}")
    times = [time for time, _ in pairs]
    if times[0] < 0 or times != sorted(times):
        raise InputError(f"{error_prefix} is not allowed: its times begin at 0 or later, and do not go back")
    return tuple((float(time), float(value)) for time, value in pairs)


def _read_table(file: Path, error_prefix: str) -> dict[str, list[list[float]]]:
    """Read the points of each column of a CSV file. Raises `InputError`."""
    if not file.is_file():
        raise InputError(f"{error_prefix} is not a file")
    with file.open(encoding="utf-8", newline="") as lines:
        rows = list(csv.DictReader(lines, skipinitialspace=True))
    if not rows or TIME not in rows[0] or len(rows[0]) < 2:
        wanted = f"a table (CSV) with the column {TIME} and one for each command"
        raise InputError(f"{error_prefix} is not allowed: {wanted}")
    found: dict[str, list[list[float]]] = {name: [] for name in rows[0] if name != TIME}
    for number, row in enumerate(rows, 2):
        for name, points in found.items():
            try:
                points.append([float(row[TIME]), float(row[name])])
            except (TypeError, ValueError):
                raise InputError(f"{error_prefix}: line {number} has no number for {name} or {TIME}") from None
    return found


def tabulate_schedule(schedule: Schedule, ticks: int, period: float) -> np.ndarray:
    """Return the value of a schedule at each control tick, (ticks,).

    Args:
        schedule: The schedule.
        ticks: Number of ticks.
        period: Duration of a tick (s).
    """
    times, values = np.array(schedule.points).T
    now = period * np.arange(ticks) + EARLY
    right = np.searchsorted(times, now, side="right")
    left, right = np.clip(right - 1, 0, None), np.clip(right, None, len(times) - 1)
    span = times[right] - times[left]
    share = np.clip((now - times[left]) / np.where(span > 0, span, 1.0), 0, 1)
    found = values[left] + share * (values[right] - values[left])
    return np.where(now < times[0], values[0], found)
