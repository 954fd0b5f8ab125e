"""Simulate stored rows again and compare them, for `sweep reproduce` and `sweep verify --simulate`."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from sweep.cli.exits import DONE, UNEXPECTED
from sweep.contract.engine import same_bits
from sweep.core.progress import show_elapsed_time
from sweep.report import replays
from sweep.runs import device_choice, store
from sweep.runs.results import Results
from sweep.study.columns import metric_columns

DEFAULT_TOLERANCE = 1e-3  # relative, within which metrics count as reproduced
MAX_SHOWN_METRICS = 3  # metrics of a row that are named


def report_resimulation(results: Results, number: int, seed: int = 0, tolerance: float = DEFAULT_TOLERANCE) -> int:
    """Simulate stored rows again, print which are equal and which differ, and return the exit code.

    Args:
        results: The stored rows.
        number: How many rows are drawn, without replacement; all where there are fewer.
        seed: Seed of the draw.
        tolerance: Relative difference within which a metric counts as reproduced.

    Returns:
        4 where an outcome or a metric changed, else 0.
    """
    device_choice.choose_device_for_folder(results.folder)
    number = min(number, len(results.rows))
    rows = results.rows.sample(number, random_state=seed)
    lines: list[dict[str, Any]] = []
    with show_elapsed_time(lambda: f"{len(lines)} of {number} rollouts simulated again"):
        for row, trace, labels in replays.simulate_again(results.exp, rows, store.read_points(results.folder)):
            lines.append(compare_row(row, trace.metrics, labels, tolerance))
    table = pd.DataFrame(lines)
    print(format_summary(table, tolerance))
    for one in table.to_dict("records"):
        if one["flips"]:
            print(f"  {one['point_id']}: {one['was']} there, {one['now']} here")
        if one["changed"]:
            print(f"  {one['point_id']}: {one['changed']}")
    return UNEXPECTED if (table["flips"] | (table["changed"] != "")).any() else DONE


def compare_row(
    row: pd.Series, metrics: Mapping[str, Any], labels: Mapping[str, Any], tolerance: float
) -> dict[str, Any]:
    """Compare a stored row with the same rollout simulated again.

    Args:
        row: The stored row.
        metrics: Metrics of the new rollout, by column.
        labels: Outcome and cause of the new rollout.
        tolerance: Relative difference within which a metric counts as reproduced.

    Returns:
        `point_id`; outcome and cause before (`was`) and `now`; whether the outcome `flips`; whether all metrics are
        `equal` to the last bit; which of them `changed` beyond the tolerance, in words.
    """
    names = [name for name in metric_columns(pd.DataFrame([row])) if isinstance(row[name], float)]
    both = {name: (row[name], float(metrics.get(name, np.nan))) for name in names}
    changed = [
        f"{name} {a:g} there, {b:g} here"
        for name, (a, b) in both.items()
        if not np.isclose(a, b, rtol=tolerance, atol=tolerance * 1e-3, equal_nan=True)
    ]
    more = f"; and {len(changed) - MAX_SHOWN_METRICS} more" if len(changed) > MAX_SHOWN_METRICS else ""
    was, now = (" ".join(filter(None, (one["outcome"], one["cause"]))) for one in (row, labels))
    return {
        "point_id": row["point_id"],
        "was": was,
        "now": now,
        "flips": row["outcome"] != labels["outcome"],
        "equal": all(same_bits(a, b) for a, b in both.values()),
        "changed": "; ".join(changed[:MAX_SHOWN_METRICS]) + more,
    }


def format_summary(table: pd.DataFrame, tolerance: float) -> str:
    """Summarise comparisons of `compare_row` in a sentence."""
    equal, changed = int(table["equal"].sum()), int((table["changed"] != "").sum())
    return (
        f"{len(table)} rollouts simulated again: {equal} equal to the last bit, {len(table) - equal - changed} within "
        f"{tolerance:g} in every metric, {changed} not; {int(table['flips'].sum())} have another outcome"
    )
