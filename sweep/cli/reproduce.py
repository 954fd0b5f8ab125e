"""`sweep reproduce CRATE`: rows of a published study simulated again, here."""

import argparse
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from sweep.cli.exits import DONE, UNEXPECTED
from sweep.core.errors import InputError
from sweep.core.waiting import waiting
from sweep.engines.base import same_bits
from sweep.report import crate, replays
from sweep.runs import place, repair, results, store


def run(given: argparse.Namespace) -> int:
    """Simulate some rows again and say what is equal; exit code 4 where an outcome flips. Raises `InputError`."""
    if given.rows < 1:
        raise InputError(f"--rows = {given.rows} is not allowed: at least 1")
    if not given.tolerance >= 0:
        raise InputError(f"--tolerance = {given.tolerance:g} is not allowed: at least 0")
    if not 0 <= given.seed < 2**32:
        raise InputError(f"--seed = {given.seed} is not allowed: at least 0 and below 2^32")
    with crate.opened(given.crate) as folder:
        if problems := repair.verify(folder)[0]:
            raise InputError(problems[0])
        found = results.read(folder)
        place.like_rows_of(folder)
        number = min(given.rows, len(found.rows))
        rows = found.rows.sample(number, random_state=given.seed)
        lines: list[dict[str, Any]] = []
        with waiting(lambda: f"{len(lines)} of {number} rollouts simulated again"):
            for row, trace, labels in replays.again(found.exp, rows, store.read_points(folder)):
                lines.append(compared(row, trace.figures, labels, given.tolerance))
    table = pd.DataFrame(lines)
    print(told(table, given.tolerance))
    for one in table[table["flips"]].to_dict("records"):
        print(f"  {one['point_id']}: {one['was']} there, {one['now']} here")
    return UNEXPECTED if table["flips"].any() else DONE


def compared(row: pd.Series, figures: Mapping[str, Any], labels: Mapping[str, Any], tolerance: float) -> dict[str, Any]:
    """What became of a row: its outcome and cause before and now, whether its figures are equal, or nearly."""
    common = {name: (row[name], value) for name, value in figures.items() if name in row}
    was, now = (" ".join(filter(None, (one["outcome"], one["cause"]))) for one in (row, labels))
    return {
        "point_id": row["point_id"],
        "was": was,
        "now": now,
        "flips": row["outcome"] != labels["outcome"],
        "equal": all(same_bits(a, b) for a, b in common.values()),
        "near": all(
            np.isclose(a, b, rtol=tolerance, atol=tolerance * 1e-3, equal_nan=True) for a, b in common.values()
        ),
    }


def told(table: pd.DataFrame, tolerance: float) -> str:
    """The sums in a sentence."""
    equal, near = int(table["equal"].sum()), int((table["near"] & ~table["equal"]).sum())
    other = len(table) - equal - near
    return (
        f"{len(table)} rollouts simulated again: {equal} equal to the last bit, {near} within {tolerance:g} in every "
        f"figure, {other} not; {int(table['flips'].sum())} end otherwise"
    )
