"""Success rates and their confidence intervals."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from sweep.analysis.intervals import Interval, confidence_sequence, korn_graubard_by_group, wilson
from sweep.core.distinct_values import count_distinct, rank_distinct_values


@dataclass(frozen=True)
class SuccessRate:
    """Number of successes among valid rollouts, with a 95 % interval (NaN without one); invalid rollouts are counted
    separately."""

    total: int
    invalid: int
    successes: int
    low: float
    high: float

    @property
    def valid_count(self) -> int:
        """Number of valid rollouts."""
        return self.total - self.invalid

    @property
    def share(self) -> float:
        """Share of the valid rollouts that succeed; NaN without a valid rollout."""
        return self.successes / self.valid_count if self.valid_count else np.nan

    @property
    def has_interval(self) -> bool:
        """Whether there are enough valid rollouts (two or more) for a confidence interval."""
        return self.valid_count > 1 and not np.isnan(self.low)

    @property
    def invalid_share(self) -> float:
        """Share of all rollouts that are invalid."""
        return self.invalid / self.total if self.total else 0.0

    @property
    def invalid_rollouts_text(self) -> str:
        """Text with the count and share of invalid rollouts, such as `3 invalid (1.2 %)`."""
        return f"{self.invalid:,} invalid ({format_percent(self.invalid_share)})"

    def __str__(self) -> str:
        if not self.valid_count:
            return f"no valid rollout among {self.total:,}"
        sure = (
            ""
            if not self.has_interval
            else f", 95 % interval {format_percent(self.low)} to {format_percent(self.high)}"
        )
        share = f"{format_percent(self.share)}{sure}"
        return f"{self.successes:,} of {self.valid_count:,} succeed ({share}), {self.invalid_rollouts_text}"


def format_percent(share: float) -> str:
    """Write a share as text: `0.123` -> `12.3 %`."""
    return f"{100 * share:.1f} %"


def success_rate(outcome: pd.Series) -> SuccessRate:
    """Compute the success rate of a column of outcomes, with Wilson's interval for independent rows."""
    invalid, success = int((outcome == "invalid").sum()), int((outcome == "success").sum())
    valid = len(outcome) - invalid
    if not valid:
        return SuccessRate(len(outcome), invalid, success, np.nan, np.nan)
    low, high = map(float, wilson(success, valid))
    return SuccessRate(len(outcome), invalid, success, low, high)


def success_rates(
    rows: pd.DataFrame,
    by: list[str],
    interval: Callable[[ArrayLike, ArrayLike], Interval] = wilson,
    unit: np.ndarray | None = None,
) -> pd.DataFrame:
    """Compute the success rate for each combination of values of some columns, with its 95 % interval.

    Args:
        rows: Rows of a study (n).
        by: Columns that form the groups; one group without any.
        interval: Function of successes and trials to the interval, for independent rows.
        unit: Independent unit of each row (n,), see `sampling_units`. Where a group has several valid rows of a unit,
            its interval is Korn and Graubard's, or for `confidence_sequence` that of the units' success rates. None:
            rows are independent.

    Returns:
        A row for each group: the columns `by`, `total`, `invalid`, `success`, `valid`, `share`, `low`, `high`.
    """
    flags = rows[by].assign(invalid=rows["outcome"] == "invalid", success=rows["outcome"] == "success")
    columns = {"total": ("success", "size"), "invalid": ("invalid", "sum"), "success": ("success", "sum")}
    table = (
        flags.groupby(by or np.zeros(len(flags), int), sort=True, observed=True).agg(**columns).reset_index(drop=not by)
    )
    valid = table["total"] - table["invalid"]
    share = table["success"] / valid.where(valid > 0)
    ends = interval(table["success"], valid)
    if unit is not None:
        here = ~flags["invalid"].to_numpy()
        group = flags.groupby(by, sort=True, observed=True).ngroup().to_numpy() if by else np.zeros(len(flags), int)
        ends = _ends_by_unit(group[here], np.asarray(unit)[here], flags["success"].to_numpy()[here], interval, ends)
    low, high = (end.where(valid > 0) for end in map(pd.Series, ends))
    return table.assign(valid=valid, share=share, low=low, high=high)


def sum_by_independent_unit(values: np.ndarray, unit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sum values over the rows of each independent unit (group of dependent rows).

    Args:
        values: Values of each row, (n,) or (n, k).
        unit: Independent unit of each row (n,).

    Returns:
        Sums (u,) or (u, k), and the number of rows (u,) of each unit.
    """
    _, place = np.unique(unit, return_inverse=True)
    sizes = np.bincount(place)
    columns = values.reshape(len(values), -1).T
    sums = np.stack([np.bincount(place, one, len(sizes)) for one in columns], axis=1)
    return sums.reshape(len(sizes), *values.shape[1:]), sizes


def _ends_by_unit(
    group: np.ndarray,
    unit: np.ndarray,
    success: np.ndarray,
    interval: Callable[[ArrayLike, ArrayLike], Interval],
    ends: Interval,
) -> Interval:
    """Replace the intervals of groups whose rows depend on each other by cluster intervals.

    Args:
        group: Number of the group of each valid row (n,).
        unit: Number of its independent unit (n,).
        success: Whether it succeeded (n,).
        interval: Function of successes and trials to the interval, for independent rows.
        ends: That interval of each group (g,).
    """
    number = len(ends.low)
    codes = rank_distinct_values(unit)
    if codes.max(initial=-1) + 1 == len(codes):  # no two rows share a unit
        return ends
    pair, place = np.unique(group * (codes.max(initial=0) + 1) + codes, return_inverse=True)
    size, won = np.bincount(place), np.bincount(place, success)
    if size.max(initial=0) <= 1:
        return ends
    of = pair // (codes.max() + 1)

    def total(values: np.ndarray) -> np.ndarray:
        return np.bincount(of, values, number)

    units = total(np.ones(len(of)))
    own = (
        confidence_sequence(total(won / size), units)
        if interval is confidence_sequence
        else korn_graubard_by_group(of, won, size, number)
    )
    clustered = total(size) > units
    return Interval(np.where(clustered, own.low, ends.low), np.where(clustered, own.high, ends.high))


def format_cause_counts(cause: pd.Series, meanings: Mapping[str, str]) -> list[str]:
    """Describe each failure cause in a column in one line, the most frequent first: number of rollouts, name and
    meaning.

    Args:
        cause: Name of the cause of each row; empty for successes.
        meanings: Meaning of each cause.
    """
    counts = cause[cause != ""].value_counts()
    return [f"{number:,} {name}: {meanings[str(name)]}" for name, number in counts.items()]


def bin_values(values: pd.Series, most: int) -> pd.Series:
    """Replace values by the midpoints of at most `most` equal bins; few distinct values stay as they are.

    Args:
        values: Values (n,); names stay as they are.
        most: Largest number of distinct values that stay, and number of bins.
    """
    if values.dtype.kind not in "fi" or count_distinct(values, most) <= most:
        return values
    low, high = values.min(), values.max()
    width = (high - low) / most
    index = np.minimum(((values - low) / width).astype(int), most - 1)
    return low + (index + 0.5) * width
