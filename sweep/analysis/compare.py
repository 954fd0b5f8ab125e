"""Paired comparison of two runs of the same points: which outcomes changed, where, and whether beyond chance."""

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from sweep.analysis import sampling_units
from sweep.analysis.intervals import clopper_pearson
from sweep.analysis.stats import format_percent, success_rates, sum_by_independent_unit
from sweep.config.experiment import Experiment
from sweep.core.errors import InputError
from sweep.core.expressions import find_column
from sweep.study.columns import LABEL_COLUMNS, metric_columns
from sweep.study.study import rollout_id_columns

BINS_PER_AXIS = 3  # regions along an axis
SECOND_RUN_MARK = " (B)"  # marks the columns of the second run


@dataclass(frozen=True)
class OutcomeFlips:
    """Counts of paired outcomes of runs A and B. Pairs with an invalid rollout are counted separately and not
    tested."""

    pairs: int
    lost: int  # succeed in A, fail in B
    gained: int  # fail in A, succeed in B
    cause_changed: int  # fail in both, of another cause
    invalid_a: int  # in A alone
    invalid_b: int  # in B alone
    invalid_both: int
    p_value: float = np.nan  # McNemar's exact test, by independent unit; NaN where pairs are no sample
    low: float = np.nan  # of the 95 % interval of the share of flips among tested pairs
    high: float = np.nan

    @property
    def tested_pairs(self) -> int:
        """Number of pairs that are valid in both runs."""
        return self.pairs - self.invalid_a - self.invalid_b - self.invalid_both

    @property
    def flip_count(self) -> int:
        """Number of pairs that succeed in one run and fail in the other."""
        return self.lost + self.gained

    @property
    def changed_share(self) -> float:
        """Share of all pairs that flipped, or became valid or invalid."""
        return (self.flip_count + self.invalid_a + self.invalid_b) / self.pairs

    def __str__(self) -> str:
        if not self.tested_pairs:
            return f"none of {self.pairs} pairs is valid in both"
        sample = not np.isnan(self.p_value)
        interval = f", 95 % interval {format_percent(self.low)} to {format_percent(self.high)}" if sample else ""
        test = f" (McNemar p = {self.p_value:.2g})" if sample else ""
        share = format_percent(self.flip_count / self.tested_pairs)
        return (
            f"{self.flip_count} of {self.tested_pairs} flip ({share}{interval}): "
            f"{self.lost} succeed only in A, {self.gained} only in B{test}; "
            f"{self.cause_changed} fail of another cause; "
            f"invalid: {self.invalid_a} only in A, {self.invalid_b} only in B, {self.invalid_both} in both"
        )


def pair_rows(a: pd.DataFrame, b: pd.DataFrame, by: list[str] | None = None) -> pd.DataFrame:
    """Join the rows of run A with the matching rows of run B.

    The default key is `point_id`: equal physical inputs and replicate, whatever simulates them (and equal engines,
    where a study repeats its points on several engines). If no row of B has a `point_id` of A, for example because the
    controller differs, the key is the parameters that both runs vary and the replicate; `attrs["by"]` of the result
    names them.

    Args:
        a: Rows of run A.
        b: Rows of run B.
        by: Columns to pair by, instead of the default.

    Returns:
        A row for each pair: the columns of A, and those of B with the suffix `SECOND_RUN_MARK`.

    Raises:
        InputError: A column of `by` is missing, several rows share a key, or no row of A matches one of B.
    """
    varied: list[str] = []
    if not by:
        by = ["point_id"] if a["point_id"].is_unique else rollout_id_columns(a.columns)
        if not a["point_id"].isin(b["point_id"]).any() and _tell_apart(a, b, _varied(a, b)):
            by = varied = _varied(a, b)
    key = [find_column(a, name) for name in by]
    for side, rows in (("A", a), ("B", b)):
        if absent := [name for name in key if name not in rows]:
            raise InputError(f"{side} has no column {absent[0]} to pair by")
        if rows.duplicated(key).any():
            raise InputError(
                f"{side} has several rows of equal {', '.join(key)}: choose among them with --{side.lower()} CONDITION"
            )
    both = a.merge(b.rename(columns={c: f"{c}{SECOND_RUN_MARK}" for c in b if c not in key}), on=key)
    if both.empty:
        others = ", ".join(name for name in _varied(a, b) if name not in key)
        options = f"--by {others}" if others else "none that both vary"
        raise InputError(f"A and B have no rows with equal {', '.join(key)} (other columns to pair by: {options})")
    both.attrs["by"] = varied
    return both


def _varied(a: pd.DataFrame, b: pd.DataFrame) -> list[str]:
    """What both vary, engine settings apart, and the replicate, which tells draws and repetitions of that apart.

    Empty where they vary other things: the replicate alone would pair what has nothing in common.
    """
    first, second = ([c for c in rows.columns if "." in c and not c.startswith("engine.")] for rows in (a, b))
    both = [c for c in first if c in second]
    return [c for c in (*both, "replicate") if c in a and c in b] if both or not (first or second) else []


def _tell_apart(a: pd.DataFrame, b: pd.DataFrame, by: list[str]) -> bool:
    """Whether `by` names one row of each at most, and some rows of both."""
    return bool(by) and not any(rows.duplicated(by).any() for rows in (a, b)) and not a.merge(b, on=by).empty


def varied_axes(pairs: pd.DataFrame) -> list[str]:
    """Return the parameter columns that run A varies."""
    return [c for c in pairs.columns if "." in c and not c.endswith(SECOND_RUN_MARK)]


def pair_sampling_unit_ids(pairs: pd.DataFrame, exp: Experiment) -> np.ndarray | None:
    """Return for each pair the number of the independent unit (a draw or replicate) that it belongs to; None if pairs
    are no random sample.

    Args:
        pairs: Pairs of rows (n), see `pair_rows`.
        exp: Experiment of run A.

    Returns:
        Whole numbers (n,), equal for pairs that depend on each other; None for a grid.
    """
    return sampling_units.paired_comparison_unit_ids(
        pairs[[c for c in pairs if not str(c).endswith(SECOND_RUN_MARK)]], exp
    )


def count_flips(pairs: pd.DataFrame, unit: np.ndarray | None = None) -> OutcomeFlips:
    """Count how outcomes differ between two runs, and test whether either run succeeds more often.

    Args:
        pairs: Pairs of rows (n), see `pair_rows`.
        unit: Independent unit of each pair (n,), see `pair_sampling_unit_ids`; only pairs of different units are
            independent. None if the pairs are not a random sample, such as those of a grid: no p-value then.

    Returns:
        The counts; with `unit` also McNemar's exact p-value and the 95 % interval of the share of flips. If units have
        several pairs, the test flips the sign of each unit's difference, and the interval is Korn and Graubard's.
    """
    first, second = pairs["outcome"].to_numpy(), pairs[f"outcome{SECOND_RUN_MARK}"].to_numpy()
    invalid, invalid_b = first == "invalid", second == "invalid"
    won, won_b = first == "success", second == "success"
    fail = (first == "failure") & (second == "failure")
    other = pairs["cause"].to_numpy() != pairs[f"cause{SECOND_RUN_MARK}"].to_numpy()
    lost, gained = won & (second == "failure"), (first == "failure") & won_b
    counts = (lost, gained, fail & other, invalid & ~invalid_b, ~invalid & invalid_b, invalid & invalid_b)
    result = OutcomeFlips(len(pairs), *(int(np.sum(c)) for c in counts))
    valid = ~invalid & ~invalid_b
    if unit is None or not valid.any():
        return result
    outcome = np.where(lost | gained, "success", np.where(valid, "failure", "invalid"))  # a flip is what is counted
    ends = success_rates(pd.DataFrame({"outcome": outcome}), [], clopper_pearson, unit).iloc[0]
    difference, _ = sum_by_independent_unit(lost.astype(int) - gained.astype(int), unit)
    return replace(
        result, p_value=sign_flip_p_value(difference.astype(int)), low=float(ends["low"]), high=float(ends["high"])
    )


def sign_flip_p_value(differences: np.ndarray) -> float:
    """Return the exact two-sided p-value of a sum of independent integers, each as likely with either sign.

    With differences of -1, 0 and 1 it is McNemar's exact test.
    """
    sizes, counts = np.unique(np.abs(differences[differences != 0]), return_counts=True)
    if not len(sizes):
        return 1.0
    from scipy.stats import binom, binomtest

    if len(sizes) == 1:
        return float(binomtest(int((differences > 0).sum()), int(counts[0])).pvalue)
    law = np.ones(1)  # of the number of steps above the least sum, 2 each
    for size, count in zip(sizes, counts, strict=True):
        steps = np.zeros(size * count + 1)
        steps[::size] = binom.pmf(np.arange(count + 1), count, 0.5)
        law = np.convolve(law, steps)
    sums = 2 * np.arange(len(law)) - (len(law) - 1)
    return float(min(law[np.abs(sums) >= abs(differences.sum())].sum(), 1.0))


def outcome_change_mask(pairs: pd.DataFrame) -> np.ndarray:
    """Return which pairs (n,) have different outcomes in the two runs."""
    return (pairs["outcome"] != pairs[f"outcome{SECOND_RUN_MARK}"]).to_numpy()


def flips_by_region(
    pairs: pd.DataFrame, axes: list[str], unit: np.ndarray | None = None, bins: int = BINS_PER_AXIS
) -> pd.DataFrame:
    """Count flips in each region of the parameter space; regions are combinations of equal bins of the axes.

    Args:
        pairs: Pairs of rows (n), see `pair_rows`.
        axes: Columns of the varied parameters; an axis with at most `bins` values, or of names, is split by value.
        unit: Independent unit of each pair (n,), see `count_flips`; None if the pairs are not a random sample.
        bins: Regions along an axis.

    Returns:
        A row for each region. With `unit` also `p`, McNemar's exact test, and `p_holm`, corrected for the number of
        regions (Holm).
    """
    groups = [_binned(pairs[axis], bins) for axis in axes]
    table = []
    for _, places in pairs.groupby(groups, observed=True).indices.items():
        part = pairs.iloc[places]
        counts = count_flips(part, None if unit is None else unit[places])
        where = {axis: _extent(part[axis]) for axis in axes}
        invalid = counts.pairs - counts.tested_pairs
        table.append(
            {
                **where,
                "pairs": counts.pairs,
                "flips": counts.flip_count,
                "only_A_succeeds": counts.lost,
                "only_B_succeeds": counts.gained,
                "invalid": invalid,
                "p": counts.p_value,
            }
        )
    result = pd.DataFrame(table)
    return (
        result.drop(columns="p")
        if unit is None
        else result.assign(p_holm=holm_adjust(result["p"].fillna(1).to_numpy()))
    )


def _binned(values: pd.Series, bins: int) -> pd.Series:
    if values.dtype.kind not in "fi" or values.nunique() <= bins:
        return values
    return pd.cut(values, bins, labels=False)


def _extent(values: pd.Series) -> str:
    if values.nunique() == 1:
        return f"{values.iloc[0]:.4g}" if values.dtype.kind in "fi" else str(values.iloc[0])
    return f"{values.min():.4g} to {values.max():.4g}"


def holm_adjust(p: np.ndarray) -> np.ndarray:
    """Correct p-values (k,) for multiple tests, so that the smallest corrected ones hold together (Holm)."""
    order = np.argsort(p)
    adjusted = np.empty(len(p))
    adjusted[order] = np.maximum.accumulate((len(p) - np.arange(len(p))) * p[order])
    return np.minimum(adjusted, 1.0)


def count_cause_transitions(pairs: pd.DataFrame) -> pd.DataFrame:
    """Count the pairs that went from one outcome or cause in A to another in B, the most frequent first."""
    first, second = (_verdict(pairs, mark) for mark in ("", SECOND_RUN_MARK))
    moved = pd.DataFrame({"A": first, "B": second})[(first != second).to_numpy()]
    return moved.value_counts().rename("pairs").reset_index()


def _verdict(pairs: pd.DataFrame, mark: str) -> pd.Series:
    outcome, cause = pairs[f"outcome{mark}"], pairs[f"cause{mark}"]
    return outcome.where(outcome == "success", outcome + " (" + cause + ")")


def relative_metric_changes(pairs: pd.DataFrame) -> pd.Series:
    """Return the typical relative change of each metric between the runs: the median of abs(B - A) over that of abs(A).

    Only pairs that are valid in both runs count. A metric that is typically 0 in both runs changes by 0, one that is
    typically 0 only in A by infinity.
    """
    valid = (pairs["outcome"] != "invalid") & (pairs[f"outcome{SECOND_RUN_MARK}"] != "invalid")
    changes = {}
    for name in _metrics_of_both(pairs):
        a, b = pairs.loc[valid, name], pairs.loc[valid, f"{name}{SECOND_RUN_MARK}"]
        if not (both := a.notna() & b.notna()).any():
            continue
        change, scale = (b[both] - a[both]).abs().median(), a[both].abs().median()
        changes[name] = change / scale if scale else (np.inf if change else 0.0)
    return pd.Series(changes, dtype=float).sort_values(ascending=False)


def bit_equal_mask(pairs: pd.DataFrame) -> np.ndarray:
    """Return which pairs (n,) have equal metrics, to the last bit; NaN equals NaN."""
    same = np.ones(len(pairs), dtype=bool)
    for name in _metrics_of_both(pairs):
        a, b = pairs[name].to_numpy(), pairs[f"{name}{SECOND_RUN_MARK}"].to_numpy()
        same &= (a == b) | (np.isnan(a) & np.isnan(b))
    return same


def _metrics_of_both(pairs: pd.DataFrame) -> list[str]:
    """Metrics that are numbers and that both runs have."""
    own = pairs[[c for c in pairs.columns if not c.endswith(SECOND_RUN_MARK)]]
    return [c for c in metric_columns(own) if own[c].dtype.kind == "f" and f"{c}{SECOND_RUN_MARK}" in pairs]


def changed_pairs(pairs: pd.DataFrame) -> pd.DataFrame:
    """Return the pairs that differ in outcome: their axes, and outcome, cause, stage and time in both runs."""
    rows = pairs[outcome_change_mask(pairs)]
    return rows[
        ["point_id", *varied_axes(pairs), *(f"{c}{mark}" for c in LABEL_COLUMNS for mark in ("", SECOND_RUN_MARK))]
    ].reset_index(drop=True)
