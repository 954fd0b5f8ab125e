"""Simulate stored rows again and compare them, for `sweep reproduce` and `sweep verify --simulate`."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from sweep.cli.exits import DONE, UNEXPECTED
from sweep.contract.engine import is_bitwise_equal
from sweep.core.errors import InputError
from sweep.core.progress import show_elapsed_time
from sweep.report import replays
from sweep.runs import device_choice, store
from sweep.runs.results import Results
from sweep.study.columns import metric_columns

DEFAULT_TOLERANCE = 1e-3  # relative, within which metrics of another machine or version count as reproduced
MAX_SHOWN_METRICS = 3  # metrics of a row that are named


def report_resimulation(results: Results, number: int, seed: int = 0, tolerance: float = DEFAULT_TOLERANCE) -> int:
    """Simulate stored rows again, print which are equal and which differ, and return the exit code.

    Args:
        results: The stored rows.
        number: How many rows are drawn, without replacement; all where there are fewer.
        seed: Seed of the draw.
        tolerance: Relative difference within which a metric counts as reproduced, in rows of another `run_id`.

    Returns:
        4 where an outcome, a cause or a metric changed, else 0.

    Raises:
        InputError: None of the rows can be simulated again.
    """
    device_choice.choose_device_for_folder(results.folder)
    number = min(number, len(results.rows))
    rows = results.rows.sample(number, random_state=seed)
    lines: list[dict[str, Any]] = []
    with show_elapsed_time(lambda: f"{len(lines)} of {number} rollouts simulated again"):
        for row, trace, labels in replays.resimulate_rows(results.exp, rows, store.read_points(results.folder)):
            lines.append(compare_resimulated_row(row, trace.metrics, labels, tolerance))
    if not lines:
        raise InputError(f"none of {number} rollouts of {results.folder} can be simulated again")
    table = pd.DataFrame(lines)
    print(summarize_resimulated_rows(table, tolerance))
    if len(table) < number:
        print(f"{number - len(table)} rollouts are not compared: no replay of them can be made here")
    if others := int((~table["same_run"]).sum()):
        then, here = (
            " or ".join(store.read_study(results.folder)["devices"]),
            results.exp.system.device(results.exp.settings),
        )
        print(
            f"{others} were simulated before with other code, libraries, settings or batches, or on another device "
            f"({then}; here {here}): their metrics may differ by {tolerance:g}"
        )
    for one in table.to_dict("records"):
        if one["flips"]:
            print(f"  {one['point_id']}: {one['was']} there, {one['now']} here")
        if one["changed"]:
            print(f"  {one['point_id']}: {one['changed']}")
    return UNEXPECTED if (table["flips"] | (table["changed"] != "")).any() else DONE


def compare_resimulated_row(
    row: pd.Series, metrics: Mapping[str, Any], labels: Mapping[str, Any], tolerance: float
) -> dict[str, Any]:
    """Compare metrics and outcome of a stored row with those of the same rollout simulated again.

    Rows of one `run_id` are equal to the last bit, so that any difference between them is a change.

    Args:
        row: The stored row.
        metrics: Metrics of the new rollout, by column.
        labels: Outcome, cause and `run_id` of the new rollout.
        tolerance: Relative difference within which a metric counts as reproduced, in a row of another `run_id`.

    Returns:
        `point_id`; outcome and cause before (`was`) and `now`; whether these differ (`flips`); whether both are of the
        `same_run`; whether all metrics are `equal` to the last bit; which of them `changed`, in words.
    """
    same_run = row["run_id"] == labels["run_id"]
    names = [name for name in metric_columns(pd.DataFrame([row])) if isinstance(row[name], float)]
    if same_run:  # then both have the same columns
        names = [*dict.fromkeys([*names, *metrics])]
    both = {name: (float(row.get(name, np.nan)), float(metrics.get(name, np.nan))) for name in names}
    unequal = {name: values for name, values in both.items() if not is_bitwise_equal(*values)}
    changed = [
        f"{name} {_format_pair(a, b)}"
        for name, (a, b) in unequal.items()
        if same_run or not np.isclose(a, b, rtol=tolerance, atol=tolerance * 1e-3, equal_nan=True)
    ]
    more = f"; and {len(changed) - MAX_SHOWN_METRICS} more" if len(changed) > MAX_SHOWN_METRICS else ""
    was, now = (" ".join(filter(None, (one["outcome"], one["cause"]))) for one in (row, labels))
    return {
        "point_id": row["point_id"],
        "was": was,
        "now": now,
        "flips": was != now,
        "same_run": same_run,
        "equal": not unequal,
        "changed": "; ".join(changed[:MAX_SHOWN_METRICS]) + more,
    }


def _format_pair(there: float, here: float) -> str:
    """Format two numbers with as many digits as tell them apart."""
    short = [f"{value:g}" for value in (there, here)]
    there_text, here_text = short if short[0] != short[1] else [f"{value!r}" for value in (there, here)]
    return f"{there_text} there, {here_text} here"


def summarize_resimulated_rows(table: pd.DataFrame, tolerance: float) -> str:
    """Summarise in a sentence how many rows simulated again are equal to the stored ones and how many differ."""
    equal, changed = int(table["equal"].sum()), int((table["changed"] != "").sum())
    return (
        f"{len(table)} rollouts simulated again: {equal} equal to the last bit, {len(table) - equal - changed} within "
        f"{tolerance:g} in every metric, {changed} not; {int(table['flips'].sum())} have another outcome or cause"
    )
