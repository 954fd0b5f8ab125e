"""How often rollouts succeed, and how sure that is."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from sweep.errors import InputError
from sweep.metrics.outcome import MEANING
from sweep.query import mask
from sweep.study import Expectation


@dataclass(frozen=True)
class Rate:
    """Successes among valid rollouts with the 95 % Wilson interval; invalid ones are counted apart."""

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
    def invalid_share(self) -> float:
        """Invalid rollouts over all."""
        return self.invalid / self.total if self.total else 0.0

    def __str__(self) -> str:
        if not self.valid:
            return f"no valid rollout among {self.total}"
        share, low, high, invalid = map(percent, (self.share, self.low, self.high, self.invalid_share))
        sure = f"{share}, 95 % interval {low} to {high}"
        return f"{self.success} of {self.valid} succeed ({sure}), {self.invalid} invalid ({invalid})"


def percent(share: float) -> str:
    """`0.123` -> `12.3 %`."""
    return f"{100 * share:.1f} %"


def rate(outcome: pd.Series) -> Rate:
    """Rate of a column of outcomes."""
    invalid, success = int((outcome == "invalid").sum()), int((outcome == "success").sum())
    valid = len(outcome) - invalid
    if not valid:
        return Rate(len(outcome), invalid, success, np.nan, np.nan)
    low, high = wilson(np.array(success), np.array(valid))
    return Rate(len(outcome), invalid, success, float(low), float(high))


def rates(rows: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Rate of success for each combination of values of the columns `by`, a row each, as `rate` gives for one."""
    flags = rows[by].assign(invalid=rows["outcome"] == "invalid", success=rows["outcome"] == "success")
    table = flags.groupby(by, sort=True, observed=True).agg(
        total=("success", "size"), invalid=("invalid", "sum"), success=("success", "sum")
    )
    valid = table["total"] - table["invalid"]
    low, high = wilson(table["success"].to_numpy(), valid.to_numpy())
    share = table["success"] / valid.where(valid > 0)
    return table.assign(valid=valid, share=share, low=low, high=high).reset_index()


def wilson(success: np.ndarray, valid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ends of the 95 % Wilson interval of `success` of `valid` trials; NaN without any."""
    z = 1.959963984540054  # the normal distribution's 97.5 % point
    n = np.where(valid > 0, valid, np.nan).astype(float)
    middle, half = success + z**2 / 2, z * np.sqrt(success * (n - success) / n + z**2 / 4)
    return np.maximum(middle - half, 0) / (n + z**2), np.minimum(middle + half, n + z**2) / (n + z**2)


def causes(cause: pd.Series) -> list[str]:
    """A line for each cause in a column of them, the most frequent first: how many rollouts, and what it means."""
    counts = cause[cause != ""].value_counts()
    return [f"{number} {name}: {MEANING[str(name)]}" for name, number in counts.items()]


def broken(expectations: tuple[Expectation, ...], rows: pd.DataFrame) -> list[str]:
    """One line for every expectation that `rows` do not meet. Raises `InputError` on a bad condition."""
    lines = []
    valid = rows[rows["outcome"] != "invalid"]
    for one in expectations:
        if one.at_least > one.at_most:
            raise InputError(f"expectation at_least = {one.at_least:g} is above at_most = {one.at_most:g}")
        among = valid[mask(valid, one.where)]
        what = f"share of {one.that}" + (f" where {one.where}" if one.where else "")
        if among.empty:
            lines.append(f"expected a {what}, but no valid rollout matches")
            continue
        share = float(mask(among, one.that).mean())
        if not one.at_least <= share <= one.at_most:
            lines.append(f"expected {what} from {one.at_least:g} to {one.at_most:g}, got {share:.4g} of {len(among)}")
    return lines
