"""Confidence intervals of a probability from counts; arrays in, arrays out."""

from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sweep.core.constants import CONFIDENCE_LEVEL

MIN_UNITS_FOR_VARIANCE = 5  # with fewer that have the rarer outcome, the variance between them is no estimate


class Interval(NamedTuple):
    """Confidence interval of a probability: lower and upper end, of the shape of the counts; 0 to 1 without a trial."""

    low: np.ndarray
    high: np.ndarray


def wilson(success: ArrayLike, trials: ArrayLike, level: float = CONFIDENCE_LEVEL) -> Interval:
    """Compute Wilson's score interval, which covers its level on average over probabilities; for the cells of a map.

    Args:
        success: Numbers of successes.
        trials: Numbers of independent trials, of the same shape.
        level: Confidence level.
    """
    k, n = np.asarray(success, float), np.maximum(np.asarray(trials, float), 1e-300)
    z2 = NormalDist().inv_cdf(0.5 + level / 2) ** 2  # SciPy's takes long to load, also after a single rollout
    centre = (k + z2 / 2) / (n + z2)
    half = np.sqrt(z2 * (k * (1 - k / n) + z2 / 4)) / (n + z2)
    return Interval(np.where(k > 0, centre - half, 0.0), np.where(k < n, centre + half, 1.0))


def clopper_pearson(success: ArrayLike, trials: ArrayLike, level: float = CONFIDENCE_LEVEL) -> Interval:
    """Compute the exact interval of Clopper and Pearson, which covers at least its level at every probability.

    Args:
        success: Numbers of successes.
        trials: Numbers of independent trials, of the same shape.
        level: Confidence level.
    """
    from scipy.special import betaincinv

    k, n = np.asarray(success, float), np.asarray(trials, float)
    tail = (1 - level) / 2
    low = np.where(k > 0, betaincinv(np.where(k > 0, k, 1), n - k + 1, tail), 0.0)
    return Interval(low, np.where(k < n, betaincinv(k + 1, np.where(k < n, n - k, 1), 1 - tail), 1.0))


def korn_graubard(
    success: ArrayLike,
    trials: ArrayLike,
    squared_deviations: ArrayLike,
    units: ArrayLike,
    rare_units: ArrayLike,
    level: float = CONFIDENCE_LEVEL,
) -> Interval:
    """Compute the interval of a success rate whose trials come in clusters, such as the replicates of a draw.

    It is Clopper and Pearson's interval at the effective number of independent trials (Korn and Graubard 1998): the
    variance is that between clusters, with a quantile of Student's t. If fewer than `MIN_UNITS_FOR_VARIANCE` clusters
    have the rarer outcome, their variance is unreliable, and a cluster counts as one trial at most.

    Args:
        success: Number of successes k.
        trials: Number of trials n, of the same shape.
        squared_deviations: Sum over clusters of (k_u - p n_u)^2, where p = k / n.
        units: Number of clusters with a trial.
        rare_units: Number of clusters with the rarer outcome: the smaller of those with a success and those with a
            failure.
        level: Confidence level.

    Returns:
        Lower and upper end; 0 to 1 where there are fewer than two clusters.
    """
    from scipy.stats import t

    counts = (np.asarray(v, float) for v in (success, trials, squared_deviations, units, rare_units))
    k, n, squared_deviations, m, rare = np.broadcast_arrays(*counts)
    p, size = np.where(n > 0, k / np.maximum(n, 1), 0.0), n.copy()
    spread = (m > 1) & (squared_deviations > 0)
    variance = m[spread] / (m[spread] - 1) * squared_deviations[spread] / n[spread] ** 2
    quantiles = t.ppf(0.5 + level / 2, n[spread] - 1) / t.ppf(0.5 + level / 2, m[spread] - 1)
    size[spread] = np.minimum(p[spread] * (1 - p[spread]) / variance * quantiles**2, n[spread])
    size = np.where(m > 1, np.where(rare < MIN_UNITS_FOR_VARIANCE, np.minimum(size, m), size), 0.0)
    return clopper_pearson(p * size, size, level)


def korn_graubard_by_group(
    group: np.ndarray, success: np.ndarray, trials: np.ndarray, number: int, level: float = CONFIDENCE_LEVEL
) -> Interval:
    """Compute the cluster interval (Korn and Graubard) of the success rate of each group of clusters.

    Args:
        group: Index of the group of each cluster (u,).
        success: Number of successes of each cluster (u,).
        trials: Number of trials of each cluster (u,), at least 1.
        number: Number g of groups.
        level: Confidence level.

    Returns:
        Lower and upper ends (g,), see `korn_graubard`.
    """

    def total(values: np.ndarray) -> np.ndarray:
        return np.bincount(group, values, number)

    won, tried = total(success), total(trials)
    share = won / np.maximum(tried, 1)
    rare = np.minimum(total(success > 0), total(success < trials))
    squared_deviations = total((success - share[group] * trials) ** 2)
    return korn_graubard(won, tried, squared_deviations, np.bincount(group, minlength=number), rare, level)


def student_interval(values: ArrayLike, level: float = CONFIDENCE_LEVEL) -> tuple[float, float]:
    """Compute the Student t interval of the mean of independent values (n,); NaN if all of them are equal."""
    from scipy.stats import t

    x = np.asarray(values, float)
    if len(x) < 2 or not np.ptp(x) > 0:
        return np.nan, np.nan
    half = t.ppf(0.5 + level / 2, len(x) - 1) * x.std(ddof=1) / np.sqrt(len(x))
    return float(x.mean() - half), float(x.mean() + half)


def confidence_sequence(success: ArrayLike, trials: ArrayLike, level: float = CONFIDENCE_LEVEL) -> Interval:
    """Compute a confidence sequence of a probability: its coverage holds under any stopping rule.

    Robbins' mixture of likelihood ratios B(k + 1/2, n - k + 1/2) / B(1/2, 1/2) / (p^k (1 - p)^(n - k)) is a martingale
    of mean 1 at the true p; Ville's inequality keeps it below 1 / (1 - level) with probability `level`.

    Args:
        success: Sums of outcomes between 0 and 1. An outcome may be a share, such as that of a draw's replicates: the
            likelihood ratio is convex in it, so that its mean stays at most 1.
        trials: Numbers of independent trials, of the same shape.
        level: Confidence level.
    """
    from scipy.special import betaln, xlog1py, xlogy

    k, n = np.broadcast_arrays(np.asarray(success, float), np.asarray(trials, float))
    most = betaln(k + 0.5, n - k + 0.5) - betaln(0.5, 0.5) + np.log(1 - level)  # of the log likelihood

    def end(outer: np.ndarray) -> np.ndarray:
        """Where the likelihood, largest at k / n, has fallen to exp(most), on the way to `outer`."""
        inner = np.where(n > 0, k / np.maximum(n, 1), 0.5)
        for _ in range(50):
            middle = (inner + outer) / 2
            inside = xlogy(k, middle) + xlog1py(n - k, -middle) > most
            inner, outer = np.where(inside, middle, inner), np.where(inside, outer, middle)
        return outer

    low, high = np.where(k > 0, end(np.zeros_like(n)), 0.0), np.where(k < n, end(np.ones_like(n)), 1.0)
    return Interval(low, high)
