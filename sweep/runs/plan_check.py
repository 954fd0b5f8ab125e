"""Compare finished rows with the planned points, as a folder may come from a stranger or have been edited."""

from collections.abc import Collection

import numpy as np
import pandas as pd

PLACE = ["batch", "slot"]  # columns that identify a row of the plan


def plan_differences(planned: pd.DataFrame, rows: pd.DataFrame, batches: Collection[int]) -> list[str]:
    """List the differences between finished rows and the planned points.

    Args:
        planned: The plan, `points.parquet`: one row for each rollout.
        rows: Finished rows, with all columns of the plan at least.
        batches: Numbers of the batches that `rows` should hold in full.

    Returns:
        A phrase for each of: missing columns, repeated, surplus and missing rows, inputs that differ; empty where the
        rows are as planned.
    """
    if lacking := [name for name in planned.columns if name not in rows]:
        return [f"column {lacking[0]} is missing"]
    expected = planned[planned["batch"].isin(list(batches))]
    there, wanted = _row_keys(rows), _row_keys(expected)
    repeated, surplus, missing = rows[there.duplicated()], rows[~there.isin(wanted)], expected[~wanted.isin(there)]
    differences = []
    for part, words in ((repeated, "repeated"), (surplus, "not planned"), (missing, "missing")):
        if len(part):
            verb = "row is" if len(part) == 1 else "rows are"
            differences.append(f"{len(part)} {verb} {words}, such as {_describe_row(part.iloc[0])}")
    both = rows[there.isin(wanted) & ~there.duplicated()]
    match = expected.iloc[wanted.get_indexer(_row_keys(both))] if wanted.is_unique else expected.iloc[:0]
    for name in planned.columns if len(match) else ():
        a, b = both[name].to_numpy(), match[name].to_numpy()
        differ = np.flatnonzero((a != b) & ~(pd.isna(a) & pd.isna(b)))
        if len(differ):
            number, point = differ[0], _describe_row(match.iloc[differ[0]])
            differences.append(
                f"{name} differs in {len(differ)} rows, such as {point}: {a[number]} instead of {b[number]}"
            )
    return differences


def _row_keys(rows: pd.DataFrame) -> pd.MultiIndex:
    return pd.MultiIndex.from_frame(rows[PLACE])


def _describe_row(row: pd.Series) -> str:
    return f"point {row['point_id']} (batch {row['batch']}, slot {row['slot']})"
