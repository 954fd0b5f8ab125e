"""How often rollouts succeed, and how sure that is."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from sweep.analysis.intervals import Interval, wilson
from sweep.core.expressions import mask
from sweep.study.study import Expectation


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
    rows: pd.DataFrame, by: list[str], interval: Callable[[ArrayLike, ArrayLike], Interval] = wilson
) -> pd.DataFrame:
    """Rate of success for each combination of values of the columns `by`, a row each, as `rate` gives for one."""
    flags = rows[by].assign(invalid=rows["outcome"] == "invalid", success=rows["outcome"] == "success")
    columns = {"total": ("success", "size"), "invalid": ("invalid", "sum"), "success": ("success", "sum")}
    table = flags.groupby(by or (lambda _: 0), sort=True, observed=True).agg(**columns).reset_index(drop=not by)
    valid = table["total"] - table["invalid"]
    low, high = (end.where(valid > 0) for end in map(pd.Series, interval(table["success"], valid)))
    return table.assign(valid=valid, share=table["success"] / valid.where(valid > 0), low=low, high=high)


def causes(cause: pd.Series, meanings: Mapping[str, str]) -> list[str]:
    """A line for each cause in a column of them, the most frequent first: how many rollouts, and what it means."""
    counts = cause[cause != ""].value_counts()
    return [f"{number:,} {name}: {meanings[str(name)]}" for name, number in counts.items()]


def broken(expectations: tuple[Expectation, ...], rows: pd.DataFrame) -> list[str]:
    """One line for every expectation that `rows` do not meet. Raises `InputError` on a bad condition."""
    lines = []
    valid = rows[rows["outcome"] != "invalid"]
    for one in expectations:
        among = valid[mask(valid, one.where)]
        what = f"share of {one.that}" + (f" where {one.where}" if one.where else "")
        if among.empty:
            lines.append(f"expected a {what}, but no valid rollout matches")
            continue
        share = float(mask(among, one.that).mean())
        if not one.at_least <= share <= one.at_most:
            lines.append(f"expected {what} from {one.at_least:g} to {one.at_most:g}, got {share:.4g} of {len(among)}")
    return lines


def binned(values: pd.Series, most: int) -> pd.Series:
    """The values where there are at most `most`; else the middles of `most` equal intervals that they lie in."""
    if values.dtype.kind not in "fi" or values.nunique() <= most:
        return values
    low, high = values.min(), values.max()
    width = (high - low) / most
    index = np.minimum(((values - low) / width).astype(int), most - 1)
    return low + (index + 0.5) * width
