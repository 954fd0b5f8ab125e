"""Where the time series of the same rollouts in two folders begin to differ."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

TIME, POINT = "time_s", "point_id"


def find_time_series_differences(
    a: pd.DataFrame, b: pd.DataFrame, columns: Sequence[str], share: float
) -> pd.DataFrame:
    """Find for each rollout recorded in two folders the first sample and column at which the two recordings differ.

    Args:
        a: Time series, a row for each sample: `point_id`, `time_s` and the columns.
        b: Time series of the other folder.
        columns: Columns to compare.
        share: Largest difference that counts as equal, over the range of the column in both.

    Returns:
        A row for each rollout that both have: `point_id`, `time_s`, `column`, and the values `a` and `b`; without a
        difference the time is infinite.
    """
    keys = [POINT, TIME]
    both = a.assign(**{TIME: a[TIME].round(6)}).merge(
        b.assign(**{TIME: b[TIME].round(6)}), on=keys, suffixes=("", " B")
    )
    both = both.sort_values(keys, kind="stable", ignore_index=True)
    here, there = (both[[f"{name}{end}" for name in columns]].to_numpy(float) for end in ("", " B"))
    low, high = np.fmin(here, there).min(axis=0, initial=np.inf), np.fmax(here, there).max(axis=0, initial=-np.inf)
    off = np.abs(here - there) / np.where(high > low, high - low, 1.0)
    off = np.where(np.isnan(here) & np.isnan(there), 0.0, np.nan_to_num(off, nan=np.inf))
    found = []
    for point, rows in both.groupby(POINT, sort=False).indices.items():
        differs = off[rows].max(axis=1, initial=0.0) > share
        if not differs.any():
            found.append((point, np.inf, "", np.nan, np.nan))
            continue
        first = int(rows[int(np.argmax(differs))])
        column = int(np.argmax(off[first] > share))
        found.append((point, both[TIME][first], columns[column], here[first, column], there[first, column]))
    return pd.DataFrame(found, columns=[POINT, TIME, "column", "a", "b"]).astype({TIME: float})
