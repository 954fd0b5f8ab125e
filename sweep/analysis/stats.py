"""How often rollouts succeed, and how sure that is."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from sweep.analysis.intervals import Interval, anytime, korn_graubard, wilson


@dataclass(frozen=True)
class Rate:
    """Successes among valid rollouts with the 95 % Wilson interval, NaN where none is meant; invalid ones apart."""

    total: int
    invalid: int
    success: int
    low: float
    high: float

    @property
    def valid(self) -> int:
        """Rollouts that can be trusted."""
        return self.total - self.invalid

    @property
    def share(self) -> float:
        """Successes over valid rollouts; NaN without any."""
        return self.success / self.valid if self.valid else np.nan

    @property
    def sure(self) -> bool:
        """Whether its interval says anything: one rollout is no sample."""
        return self.valid > 1 and not np.isnan(self.low)

    @property
    def invalid_share(self) -> float:
        """Invalid rollouts over all."""
        return self.invalid / self.total if self.total else 0.0

    @property
    def broken(self) -> str:
        """Invalid rollouts in words: `3 invalid (1.2 %)`."""
        return f"{self.invalid:,} invalid ({percent(self.invalid_share)})"

    def __str__(self) -> str:
        if not self.valid:
            return f"no valid rollout among {self.total:,}"
        sure = "" if not self.sure else f", 95 % interval {percent(self.low)} to {percent(self.high)}"
        return f"{self.success:,} of {self.valid:,} succeed ({percent(self.share)}{sure}), {self.broken}"


def percent(share: float) -> str:
    """A share in words: `0.123` -> `12.3 %`."""
    return f"{100 * share:.1f} %"


def rate(outcome: pd.Series) -> Rate:
    """Rate of a column of outcomes."""
    invalid, success = int((outcome == "invalid").sum()), int((outcome == "success").sum())
    valid = len(outcome) - invalid
    if not valid:
        return Rate(len(outcome), invalid, success, np.nan, np.nan)
    low, high = map(float, wilson(success, valid))
    return Rate(len(outcome), invalid, success, low, high)


def rates(
    rows: pd.DataFrame,
    by: list[str],
    interval: Callable[[ArrayLike, ArrayLike], Interval] = wilson,
    unit: np.ndarray | None = None,
) -> pd.DataFrame:
    """Rate of success for each combination of values of some columns, with its 95 % interval.

    Args:
        rows: Rows of a study (n).
        by: Columns that form the groups; one group without any.
        interval: From successes and trials to the interval, where rows are independent.
        unit: Independent unit of each row (n,), see `sampling_units`. Where a group has several valid rows of a unit,
            its interval is Korn and Graubard's, or of `anytime` that of the units' shares. None: rows are independent.

    Returns:
        A row for each group: the columns `by`, `total`, `invalid`, `success`, `valid`, `share`, `low`, `high`.
    """
    flags = rows[by].assign(invalid=rows["outcome"] == "invalid", success=rows["outcome"] == "success")
    columns = {"total": ("success", "size"), "invalid": ("invalid", "sum"), "success": ("success", "sum")}
    table = flags.groupby(by or (lambda _: 0), sort=True, observed=True).agg(**columns).reset_index(drop=not by)
    valid = table["total"] - table["invalid"]
    share = table["success"] / valid.where(valid > 0)
    ends = interval(table["success"], valid)
    if unit is not None:
        here = ~flags["invalid"].to_numpy()
        group = flags.groupby(by, sort=True, observed=True).ngroup().to_numpy() if by else np.zeros(len(flags), int)
        ends = _ends_by_unit(group[here], np.asarray(unit)[here], flags["success"].to_numpy()[here], interval, ends)
    low, high = (end.where(valid > 0) for end in map(pd.Series, ends))
    return table.assign(valid=valid, share=share, low=low, high=high)


def _ends_by_unit(
    group: np.ndarray,
    unit: np.ndarray,
    success: np.ndarray,
    interval: Callable[[ArrayLike, ArrayLike], Interval],
    ends: Interval,
) -> Interval:
    """The intervals of groups, with those whose rows depend on each other by their independent units.

    Args:
        group: Number of the group of each valid row (n,).
        unit: Number of its independent unit (n,).
        success: Whether it succeeded (n,).
        interval: From successes and trials to the interval, where rows are independent.
        ends: That interval of each group (g,).
    """
    number = len(ends.low)
    _, codes = np.unique(unit, return_inverse=True)
    pair, place = np.unique(group * (codes.max(initial=0) + 1) + codes, return_inverse=True)
    size, won = np.bincount(place), np.bincount(place, success)
    if size.max(initial=0) <= 1:
        return ends
    of = pair // (codes.max() + 1)

    def total(values: np.ndarray) -> np.ndarray:
        return np.bincount(of, values, number)

    units, trials, successes = total(np.ones(len(of))), total(size), total(won)
    if interval is anytime:
        own = anytime(total(won / size), units)
    else:
        share = successes / np.maximum(trials, 1)
        telling = np.minimum(total(won > 0), total(won < size))
        own = korn_graubard(successes, trials, total((won - share[of] * size) ** 2), units, telling)
    clustered = trials > units
    return Interval(np.where(clustered, own.low, ends.low), np.where(clustered, own.high, ends.high))


def causes(cause: pd.Series, meanings: Mapping[str, str]) -> list[str]:
    """A line for each cause in a column of them, the most frequent first: how many rollouts, and what it means."""
    counts = cause[cause != ""].value_counts()
    return [f"{number:,} {name}: {meanings[str(name)]}" for name, number in counts.items()]


def binned(values: pd.Series, most: int) -> pd.Series:
    """The values where there are at most `most`; else the middles of `most` equal intervals that they lie in."""
    if values.dtype.kind not in "fi" or values.nunique() <= most:
        return values
    low, high = values.min(), values.max()
    width = (high - low) / most
    index = np.minimum(((values - low) / width).astype(int), most - 1)
    return low + (index + 0.5) * width
