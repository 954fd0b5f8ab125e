"""Sizes of pushes up to which a robot succeeds, by direction, from a fit that falls with the size.

The fit assumes that a larger push is survived less often. Whether that holds is tested: an island is a size at which
more rollouts succeed than at a smaller size of the same direction, beyond chance.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from sweep.analysis import sensitivity
from sweep.analysis.compare import holm_adjust
from sweep.analysis.sampling_units import confidence_interval_unit_ids, unit_numbers
from sweep.analysis.stats import bin_values, sum_by_independent_unit
from sweep.config.experiment import Experiment
from sweep.contract.system import split_side_prefix
from sweep.core.constants import CONFIDENCE_LEVEL
from sweep.core.distinct_values import count_distinct, has_several_values, rank_distinct_values
from sweep.study.study import parameter_columns

SUCCESS_LEVEL = 0.5  # success rate that the threshold of a direction has
MAX_DIRECTION_BINS, MAX_OTHER_BINS = 24, 4  # of drawn directions, and of any other drawn condition
SIZE_BINS, ROWS_PER_BIN = (4, 40), 20  # fewest and most bins of drawn sizes, and the rollouts that a bin should have
ISLAND_COLUMNS = ("fails_at", "rate_there", "survives_at", "rate_above", "p_holm")


@dataclass(frozen=True)
class PushRows:
    """Rollouts with a push: where and how large it was, and whether they succeeded."""

    conditions: pd.DataFrame  # (n, c), such as direction, time and body; each combination has a threshold of its own
    size: np.ndarray  # (n,), N s or N; middles of bins where sizes were drawn
    bin_width: float  # 0 where sizes were listed
    success: np.ndarray  # (n,), bool
    unit: np.ndarray | None  # (n,) independent draw of each row; None for single rollouts, of which each is a fact


@dataclass(frozen=True)
class SizeCounts:
    """Independent rollouts of one condition, by size."""

    size: np.ndarray  # (k,), rising
    trials: np.ndarray  # (k,)
    success: np.ndarray  # (k,)
    outcomes: np.ndarray | None  # (u, k) 0, 1 or NaN by unit, where units have rollouts of several sizes

    @property
    def rate(self) -> np.ndarray:
        """Success rates (k,)."""
        return self.success / self.trials


def threshold_table(rows: PushRows, level: float = SUCCESS_LEVEL, confidence: float = CONFIDENCE_LEVEL) -> pd.DataFrame:
    """Compute the largest push that is survived under each condition, and the most significant island beyond it.

    Args:
        rows: Rollouts (n) with pushes.
        level: Success rate at the threshold.
        confidence: Confidence of each interval, and of all islands of the table together.

    Returns:
        A row for each condition: its columns, `rollouts`, `threshold`, `low` and `high`, and `ISLAND_COLUMNS` with
        NaN where no island is decided. The threshold is 0 if even the smallest push is not survived, and infinite if
        the largest is. `low` to `high` is the interval of the threshold, see `threshold_interval`. For single rollouts
        it reaches from the last size below every failure to the first above every success, and each success above a
        failure is an island, without a p-value.
    """
    groups = list(_group_rows(rows))
    pairs = [find_island_pairs(counts, rows.unit is not None) for _, counts in groups]
    every = np.concatenate([one["p"].to_numpy() for one in pairs]) if pairs else np.zeros(0)
    adjusted = np.split(holm_adjust(every) if rows.unit is not None else every, np.cumsum([*map(len, pairs)])[:-1])
    lines = []
    for (condition, counts), found, p_holm in zip(groups, pairs, adjusted, strict=True):
        half = rows.bin_width / 2
        if rows.unit is None:
            low, high = _bracket(counts)
        else:
            low, high = threshold_interval(counts, level, confidence)
        line = {**condition, "rollouts": int(counts.trials.sum()), "threshold": fit_threshold(counts, level)}
        line |= {"low": max(low - half, 0.0), "high": high + half} | dict.fromkeys(ISLAND_COLUMNS, np.nan)
        is_island = p_holm <= 1 - confidence
        if is_island.any():
            k = int(np.argmin(np.where(is_island, p_holm, np.inf)))
            small, large = (int(found[name].iloc[k]) for name in ("small", "large"))
            told = counts.size[small], counts.rate[small], counts.size[large], counts.rate[large]
            line |= dict(zip(ISLAND_COLUMNS, (*told, np.nan if rows.unit is None else p_holm[k]), strict=True))
        lines.append(line)
    return pd.DataFrame(lines, columns=[*rows.conditions, "rollouts", "threshold", "low", "high", *ISLAND_COLUMNS])


def fit_threshold(counts: SizeCounts, level: float = SUCCESS_LEVEL) -> float:
    """Return the size at which a success rate that falls with the size, fitted by least squares, crosses a level.

    Args:
        counts: Rollouts by size.
        level: Success rate at the threshold.

    Returns:
        The size, interpolated between two sizes; 0 if the fit is below the level at all sizes, infinity if above.
    """
    from scipy.optimize import isotonic_regression

    fit = isotonic_regression(counts.rate, weights=counts.trials, increasing=False).x
    above, below = np.flatnonzero(fit > level), np.flatnonzero(fit < level)
    if not len(below):
        return np.inf
    if not len(above):
        return 0.0 if below[0] == 0 else float(counts.size[: below[0]].mean())
    last, first = int(above[-1]), int(below[0])
    if first > last + 1:  # sizes at the level itself lie between
        return float((counts.size[last + 1] + counts.size[first - 1]) / 2)
    share = (fit[last] - level) / (fit[last] - fit[first])
    return float(counts.size[last] + share * (counts.size[first] - counts.size[last]))


def threshold_interval(
    counts: SizeCounts, level: float = SUCCESS_LEVEL, confidence: float = CONFIDENCE_LEVEL
) -> tuple[float, float]:
    """Compute a confidence interval of the size at which a falling success rate crosses a level.

    Binomial tests reject, from the largest size down, that the rate is still at least `level`, and from the smallest
    size up that it is below. Each pools the rollouts of 1, 2, 4, ... neighbouring sizes, with Bonferroni's correction;
    only single sizes where rollouts of different sizes share their random numbers. The interval covers the threshold
    at least with the given confidence, if the rate falls with the size.

    Args:
        counts: Rollouts by size.
        level: Success rate at the threshold.
        confidence: Confidence level of the interval.

    Returns:
        Lower end, 0 if unknown, and upper end, infinity if unknown.
    """
    from scipy.special import bdtr, bdtrc

    number = len(counts.size)
    widths = [1] if counts.outcomes is not None else [2**k for k in range(number.bit_length()) if 2**k <= number]
    tail = (1 - confidence) / 2 / len(widths)
    trials, success = (np.concatenate([[0], np.cumsum(x)]) for x in (counts.trials, counts.success))
    too_few, too_many = np.zeros(number, bool), np.zeros(number, bool)
    for width in widths:
        n, x = trials[width:] - trials[:-width], success[width:] - success[:-width]
        too_few[width - 1 :] |= bdtr(x, n, level) <= tail  # of sizes up to this one
        too_many[: number - width + 1] |= np.where(x > 0, bdtrc(np.maximum(x - 1, 0), n, level), 1.0) <= tail
    from_above, from_below = np.cumprod(too_few[::-1]).sum(), np.cumprod(too_many).sum()
    high = counts.size[number - from_above] if from_above else np.inf
    low = counts.size[from_below - 1] if from_below else 0.0
    return float(low), float(high)


def find_island_pairs(counts: SizeCounts, is_sample: bool) -> pd.DataFrame:
    """Test for each pair of sizes whether more rollouts succeed at the larger one.

    Args:
        counts: Rollouts by size.
        is_sample: Whether rollouts are a random sample. If not, each is a fact.

    Returns:
        Places of the sizes, `small` and `large`, and the one-sided p-value `p`: Fisher's exact test of independent
        rollouts, or a sign test of units with rollouts at both sizes. For facts, p is 0 where a larger push is
        survived and a smaller one is not, else 1.
    """
    from scipy.special import bdtr

    small, large = np.triu_indices(len(counts.size), 1)
    if not is_sample:
        p = np.where((counts.rate[small] < 1) & (counts.rate[large] > counts.rate[small]), 0.0, 1.0)
    elif counts.outcomes is not None:
        change = counts.outcomes[:, large] - counts.outcomes[:, small]
        gained, lost = (change > 0).sum(axis=0), (change < 0).sum(axis=0)
        p = np.where(gained + lost > 0, bdtr(lost, np.maximum(gained + lost, 1), 0.5), 1.0)
    else:
        p = np.ones(len(small))
        rises = counts.rate[large] > counts.rate[small]  # no other pair can be significant
        a, b = small[rises], large[rises]
        n, success = counts.trials, counts.success
        p[rises] = fisher_p(success[b], n[b], success[a], n[a])
    return pd.DataFrame({"small": small, "large": large, "p": p})


def fisher_p(success: np.ndarray, trials: np.ndarray, other: np.ndarray, other_trials: np.ndarray) -> np.ndarray:
    """Compute the one-sided p-values of Fisher's exact test that success rates are larger than others.

    Args:
        success: Numbers of successes (m,).
        trials: Numbers of trials (m,).
        other: Numbers of successes to compare with (m,).
        other_trials: Their numbers of trials (m,).

    Returns:
        Probabilities (m,) of at least so many successes, if the rates are equal.
    """
    from scipy.stats import hypergeom  # slow to import

    return hypergeom.sf(success - 1, trials + other_trials, success + other, trials)


def _bracket(counts: SizeCounts) -> tuple[float, float]:
    """Largest size below every failure, 0 if none, and smallest size above every success, infinity if none."""
    failed, survived = np.flatnonzero(counts.rate < 1), np.flatnonzero(counts.rate > 0)
    first = failed[0] if len(failed) else len(counts.size)
    last = survived[-1] if len(survived) else -1
    low = counts.size[first - 1] if first else 0.0
    return float(low), float(counts.size[last + 1]) if last + 1 < len(counts.size) else np.inf


def _group_rows(rows: PushRows) -> Iterator[tuple[dict[str, object], SizeCounts]]:
    """Yield each condition with its counts by size; of a unit's rollouts at one size the first counts."""
    names = [*map(str, rows.conditions)]
    for values, places in rows.conditions.groupby(names, sort=True, observed=True).indices.items():
        condition: dict[str, object] = dict(zip(names, values if isinstance(values, tuple) else (values,), strict=True))
        yield (
            condition,
            count_by_size(rows.size[places], rows.success[places], None if rows.unit is None else rows.unit[places]),
        )


def count_by_size(size: Sequence[float] | np.ndarray, success: np.ndarray, unit: np.ndarray | None) -> SizeCounts:
    """Count rollouts and successes at each size of a push.

    Args:
        size: Size of each rollout's push (n,).
        success: Whether it succeeded (n,).
        unit: Independent draw of each rollout (n,); of several with one size, the first counts. None: each is its own.

    Returns:
        Counts by size.
    """
    sizes, at = np.unique(np.asarray(size, float), return_inverse=True)
    outcomes = None
    success = np.asarray(success, bool)
    if unit is not None:
        codes = rank_distinct_values(unit)
        _, first = np.unique(codes * len(sizes) + at, return_index=True)
        codes, at, success = codes[first], at[first], success[first]
        if codes.max(initial=-1) + 1 < len(codes):
            outcomes = np.full((codes.max() + 1, len(sizes)), np.nan)
            outcomes[codes, at] = success
    won, trials = sum_by_independent_unit(success.astype(float), at)
    return SizeCounts(sizes, trials, won.astype(int), outcomes)


def select_push_rows(rows: pd.DataFrame, exp: Experiment) -> "tuple[PushRows, str] | None":
    """Select the rollouts of a study that varies size and direction of a push.

    Drawn sizes, directions and times are put into bins. Values of other listed axes are conditions of their own;
    thresholds hold on average over other drawn axes. Invalid rollouts are left out.

    Args:
        rows: Rows of the study.
        exp: Its experiment.

    Returns:
        The rollouts, whose first condition is the direction, and the column of the size. None if no push varies in
        size and direction, or if the design does not combine them.
    """
    study = exp.study
    if study.is_sequential or study.points or study.design.is_one_at_a_time:
        return None
    rows = rows[rows["outcome"] != "invalid"]
    by_path = {split_side_prefix(c)[1]: c for c in parameter_columns(rows) if has_several_values(rows[c])}
    for push in exp.system.push_columns.values():
        size = next((by_path[path] for path in push.sizes if path in by_path), None)
        if size and push.direction in by_path:
            break
    else:
        return None
    listed = [axis.column for axis in sensitivity.listed_value_axes(rows, exp)]
    own = [by_path[path] for path in (push.direction, push.start, push.body) if path in by_path]
    names = [*own, *(c for c in listed if c not in (*own, size))]
    most = {c: MAX_DIRECTION_BINS if c == own[0] else MAX_OTHER_BINS for c in names}
    conditions = pd.DataFrame({c: rows[c] if c in listed else bin_values(rows[c], most[c]) for c in names})
    per_condition = len(rows) / conditions.groupby(names, observed=True).ngroups
    bins = int(np.clip(per_condition / ROWS_PER_BIN, *SIZE_BINS))
    is_binned = size not in listed and count_distinct(rows[size], bins) > bins
    sizes = bin_values(rows[size], bins) if is_binned else rows[size]
    width = float(rows[size].max() - rows[size].min()) / bins if is_binned else 0.0
    unit = None if unit_numbers(rows, exp) is None else confidence_interval_unit_ids(rows, exp)
    success = (rows["outcome"] == "success").to_numpy()
    return PushRows(conditions, sizes.to_numpy(float), width, success, unit), size
