"""Regions of parameters with a certified upper bound on the failure probability.

Nested regions `score(x) <= c` are learned from one set of rows and tested on fresh rows, which play no part in the
learning. Fresh rows test the regions in a fixed order, from the smallest outwards, each by the exact binomial bound at
the full confidence level, up to the first region that does not pass (fixed-sequence testing). The probability that a
certified region fails more often than promised is at most 1 - confidence. In contrast, the largest region whose
observed failure rate is small enough breaks the promise about half the time, because it was selected for looking good.
"""

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from sweep.core.errors import InputError

SHAPES = ("box", "ellipsoid", "score")
CANDIDATE_COUNT = 100  # candidate regions, at equal steps of the share of draws
PEELED_SHARE = 0.02  # share of the remaining draws that one step of a box removes
MIN_ROWS_IN_BOX = 10  # learning rows
ROWS_PER_PRODUCT = (
    1024  # rows of a matrix product: with more, BLAS starts threads, which wait for each other on busy cores
)
MIN_CURVATURE = 1e-3  # smallest curvature of an ellipsoid, for parameters scaled to unit standard deviation
SIGNIFICANT_DIGITS = 9  # significant digits of a region's numbers, so that its printed condition is exact


@dataclass(frozen=True)
class NestedBoxes:
    """Nested axis-aligned boxes in parameter space: each box cuts one side off the box before; the first holds all
    learning rows."""

    low: np.ndarray  # (boxes, d)
    high: np.ndarray

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Return the score of rows x (n, d): the number of boxes that do not contain each row (n,)."""
        sides = [np.searchsorted(low, v, side="right") for low, v in zip(self.low.T, x.T, strict=True)]
        sides += [np.searchsorted(-high, -v, side="right") for high, v in zip(self.high.T, x.T, strict=True)]
        return len(self.low) - np.min(sides, axis=0).astype(float)

    def region_values(self, names: list[str], threshold: float) -> dict[str, Any]:
        """Return the region `score(x) <= threshold` as plain values, see `CertifiedRegion`."""
        number = len(self.low) - int(threshold) - 1
        return {"names": names, "low": self.low[number].tolist(), "high": self.high[number].tolist()}

    def format_region_condition(self, names: list[str], threshold: float) -> str:
        """Write `score(x) <= threshold` as a condition on columns, in the syntax of `--where`."""
        number = len(self.low) - int(threshold) - 1
        ends = zip(names, self.low[number].tolist(), self.high[number].tolist(), strict=True)
        return " and ".join(f"{low!r} <= {name} <= {high!r}" for name, low, high in ends)


@dataclass(frozen=True)
class QuadraticLogOdds:
    """Log odds of failure as a quadratic function of the parameters: constant + linear z + z' form z, where z = (x -
    centre) / scale."""

    centre: np.ndarray  # (d,)
    scale: np.ndarray
    constant: float
    linear: np.ndarray
    quadratic_form: np.ndarray  # (d, d)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Return the log odds of failure (n,) of rows x (n, d)."""
        z = (x - self.centre) / self.scale
        return self.constant + z @ self.linear + np.einsum("ni,ij,nj->n", z, self.quadratic_form, z)

    def region_values(self, names: list[str], threshold: float) -> dict[str, Any]:
        """Return the region `score(x) <= threshold` as plain values, see `CertifiedRegion`."""
        numbers = {field.name: np.asarray(getattr(self, field.name)).tolist() for field in fields(self)}
        return {"names": names, "threshold": float(threshold), **numbers}

    def format_region_condition(self, names: list[str], threshold: float) -> str:
        """Write `score(x) <= threshold` as a condition on columns, in the syntax of `--where`."""
        z = [f"({name} - {_text(c)}) / {_text(s)}" for name, c, s in zip(names, self.centre, self.scale, strict=True)]
        terms = [f"{_text(w)} * {one}" for w, one in zip(self.linear, z, strict=True)]
        for i in range(len(z)):
            for j in range(i, len(z)):
                weight = self.quadratic_form[i, j] * (1 if i == j else 2)
                terms.append(f"{float(weight)!r} * {z[i]} * {z[j]}")
        return f"{_text(self.constant)} + {' + '.join(terms)} <= {float(threshold)!r}"


RegionScore = NestedBoxes | QuadraticLogOdds  # regions are where the score is small


@dataclass(frozen=True)
class CertifiedRegion:
    """Region of parameter space in which a certificate bounds the failure probability: `score(x) <= threshold`."""

    names: list[str]  # columns (d,) of the parameters
    score: RegionScore
    threshold: float

    @classmethod
    def from_values(cls, values: Any) -> Self:
        """Make a region from the plain values (lists and numbers) that a certificate file stores.

        Args:
            values: Content of the entry `region`, as `region_values` of the score writes it.

        Raises:
            KeyError, TypeError, ValueError: A value is missing, or numbers have the wrong shape or are not finite.
        """
        names = [str(name) for name in values["names"]]
        d = len(names)
        if "low" in values:
            low, high = (_finite_array(values[end], 1, d) for end in ("low", "high"))
            return cls(names, NestedBoxes(low, high), 0.0)
        centre, scale, linear = (_finite_array(values[name], d) for name in ("centre", "scale", "linear"))
        constant, threshold = _finite_array([values["constant"], values["threshold"]], 2).tolist()
        form = _finite_array(values["quadratic_form"], d, d)
        return cls(names, QuadraticLogOdds(centre, scale, constant, linear, form), threshold)

    def contains(self, x: np.ndarray) -> np.ndarray:
        """Return which rows of x (n, d) lie in the region, (n,) of bool."""
        return self.score(x) <= self.threshold


def _finite_array(values: Any, *shape: int) -> np.ndarray:
    array = np.asarray(values, dtype=float).reshape(shape)
    if not np.isfinite(array).all():
        raise ValueError("not finite")
    return array


def _rounded(numbers: np.ndarray) -> np.ndarray:
    return np.vectorize(lambda v: float(_text(v)))(numbers)


def _text(number: float) -> str:
    return f"{number:.{SIGNIFICANT_DIGITS}g}"


def required_failure_free_rows(failures: float, confidence: float) -> int:
    """Return how many rows without any failure certify that the failure probability is at most `failures`.

    Args:
        failures: Failure probability to certify, 0 to 1.
        confidence: Confidence level, 0 to 1.
    """
    return int(np.ceil(np.log1p(-confidence) / np.log1p(-failures)))


def failure_upper_bound(failed: int, rows: int, confidence: float) -> float:
    """Return the exact one-sided upper confidence bound of a failure probability (Clopper-Pearson); 1 without a row."""
    from scipy.special import betaincinv  # slow to import

    return 1.0 if failed >= rows else float(betaincinv(failed + 1, rows - failed, confidence))


def most_failures_that_certify(rows: ArrayLike, failures: float, confidence: float) -> np.ndarray:
    """Return the largest numbers of failures among `rows` that still certify a failure probability of at most
    `failures`; -1 if too few rows.

    Args:
        rows: Numbers of rows.
        failures: Failure probability to certify, 0 to 1.
        confidence: Confidence level, 0 to 1.

    Returns:
        Whole numbers of the shape of `rows`.
    """
    from scipy.stats import binom

    guess = binom.ppf(1 - confidence, rows, failures)  # one too many, unless its law reaches the level exactly
    return np.where(binom.cdf(guess, rows, failures) <= 1 - confidence, guess, guess - 1).astype(int)


def fit_nested_boxes(x: np.ndarray, failed: np.ndarray, least: float) -> NestedBoxes:
    """Learn nested boxes by the patient rule induction method (PRIM, Friedman and Fisher 1999).

    Each step removes the side with the largest failure rate among the draws it removes. Once no failure is left, it
    removes the side that is farthest from the centre.

    Args:
        x: Learning rows (n, d).
        failed: Whether each row failed (n,).
        least: Share of the rows at which the peeling stops.
    """
    low, high = x.min(axis=0), x.max(axis=0)
    spread = np.where(high > low, high - low, 1.0)
    lows, highs, inside = [low], [high], np.ones(len(x), dtype=bool)
    while inside.sum() > max(least * len(x), MIN_ROWS_IN_BOX):
        here, bad = x[inside], failed[inside]
        sides = []
        for axis in range(x.shape[1]):
            for ends, share in ((low, PEELED_SHARE), (high, 1 - PEELED_SHARE)):
                edge = np.quantile(here[:, axis], share)
                gone = here[:, axis] < edge if ends is low else here[:, axis] > edge
                if 0 < gone.sum() < len(here):
                    sides.append((bad[gone].mean(), abs(edge - ends[axis]) / spread[axis], ends is low, axis, edge))
        if not sides:
            break
        _, _, below, axis, edge = max(sides)
        low, high = low.copy(), high.copy()
        (low if below else high)[axis] = edge
        inside &= (x[:, axis] >= low[axis]) & (x[:, axis] <= high[axis])
        lows.append(low)
        highs.append(high)
    return NestedBoxes(np.array(lows), np.array(highs))


def fit_log_odds(x: np.ndarray, failed: np.ndarray, convex: bool) -> QuadraticLogOdds:
    """Fit a logistic model of failure with a quadratic exponent and a ridge penalty.

    Args:
        x: Learning rows (n, d).
        failed: Whether each row failed (n,).
        convex: Restrict the quadratic form to a positive definite one, so that the regions are ellipsoids.
    """
    from scipy.optimize import minimize
    from scipy.special import expit

    d = x.shape[1]
    spread = x.std(axis=0)
    centre, scale = _rounded(x.mean(axis=0)), _rounded(np.where(spread, spread, 1.0))
    every, signs = (x - centre) / scale, np.where(failed, 1.0, -1.0)
    parts = [
        (every[k : k + ROWS_PER_PRODUCT], signs[k : k + ROWS_PER_PRODUCT]) for k in range(0, len(x), ROWS_PER_PRODUCT)
    ]

    def loss(weights: np.ndarray) -> tuple[float, np.ndarray]:
        root = weights[1 + d :].reshape(d, d)
        held = np.r_[0.0, weights[1:]]  # the constant is free
        total, gradient = 0.5 * (held**2).sum(), held
        for known, sign in parts:
            turned = known @ root.T
            form = (
                (turned**2).sum(axis=1) + MIN_CURVATURE * (known**2).sum(axis=1)
                if convex
                else (turned * known).sum(axis=1)
            )
            value = sign * (weights[0] + known @ weights[1 : 1 + d] + form)
            slope = -sign * expit(-value)
            inner = 2 * (slope[:, None] * turned).T @ known if convex else (slope[:, None] * known).T @ known
            total += np.logaddexp(0, -value).sum()
            gradient = gradient + np.r_[slope.sum(), known.T @ slope, inner.ravel()]
        return float(total), gradient

    start = np.r_[np.zeros(1 + d), 0.1 * np.eye(d).ravel()]
    weights = minimize(loss, start, jac=True, method="L-BFGS-B").x
    root = weights[1 + d :].reshape(d, d)
    form = root.T @ root + MIN_CURVATURE * np.eye(d) if convex else root
    return QuadraticLogOdds(
        centre, scale, float(_text(weights[0])), _rounded(weights[1 : 1 + d]), _rounded((form + form.T) / 2)
    )


def learn_region_score(shape: str, x: np.ndarray, failed: np.ndarray, least: float) -> RegionScore:
    """Learn a score function of the parameters: regions where it is small are nested and contain few failures.

    Args:
        shape: One of `SHAPES`: "box", "ellipsoid" or "score" (any quadric).
        x: Learning rows (n, d).
        failed: Whether each row failed (n,).
        least: Share of the rows in the smallest box: that of the fresh rows which suffice to certify without a failure.

    Returns:
        A function of rows (n, d) to scores (n,); the smaller the score, the safer the row.
    """
    return (
        fit_nested_boxes(x, failed, least) if shape == "box" else fit_log_odds(x, failed, convex=shape == "ellipsoid")
    )


def candidate_thresholds(
    scores: np.ndarray, failed: np.ndarray, fresh: int, failures: float, confidence: float
) -> np.ndarray:
    """Return ascending thresholds of the score, each of which bounds a region, beginning with the region most likely to
    be certified.

    A larger region may contain more failures, but does contain more of them, too: the first threshold maximises the
    power of the test that follows.

    Args:
        scores: Scores of the learning rows (n,).
        failed: Whether each learning row failed (n,).
        fresh: Number of fresh rows that will test the regions.
        failures: Failure probability to certify, 0 to 1.
        confidence: Confidence level, 0 to 1.
    """
    from scipy.stats import binom

    every = np.unique(np.quantile(scores, np.arange(1, CANDIDATE_COUNT + 1) / CANDIDATE_COUNT, method="higher"))
    inside = scores <= every[:, None]
    rows, bad = inside.sum(axis=1), (inside & failed).sum(axis=1)
    falling = np.round(fresh * rows / len(scores)).astype(int)
    allowed = most_failures_that_certify(falling, failures, confidence)
    power = binom.cdf(allowed, falling, (bad + 0.5) / (rows + 1.0))
    return every[int(np.argmax(power)) :]


@dataclass(frozen=True)
class Certificate:
    """Result of `certify_largest_region`: the certified region, if any, and the counts of fresh rows that certify
    it."""

    failures: float  # certified upper bound of the failure probability
    confidence: float
    score: RegionScore
    threshold: float  # NaN without a region
    rows: int  # fresh rows in the region
    failed: int  # fresh rows in the region that failed, invalid ones included
    fresh_draws: int  # all fresh rows
    next_region_rows: int  # fresh rows in the first region that was not certified; 0 if all were
    next_region_failed: int

    @property
    def is_certified(self) -> bool:
        """Whether any region is certified."""
        return bool(np.isfinite(self.threshold))

    @property
    def region_draw_share(self) -> float:
        """Share of all fresh draws that fall into the region."""
        return self.rows / self.fresh_draws

    @cached_property
    def failure_probability_bound(self) -> float:
        """Upper confidence bound of the region's failure probability, from its own fresh rows."""
        return failure_upper_bound(self.failed, self.rows, self.confidence)

    def contains(self, x: np.ndarray) -> np.ndarray:
        """Return which rows of x (n, d) lie in the certified region, (n,) of bool."""
        return self.score(x) <= self.threshold


def certify_largest_region(
    score: RegionScore,
    learning: tuple[np.ndarray, np.ndarray],
    fresh: tuple[np.ndarray, np.ndarray],
    failures: float,
    confidence: float,
) -> Certificate:
    """Find the largest region whose failure probability is certified, by fresh rows, to be at most `failures`.

    The promise holds for future draws from the same distribution that fall into the region.

    Args:
        score: Score of `learn_region_score`, whose sublevel sets are the candidate regions.
        learning: Rows (n, d) that the score was learned from, and whether each failed (n,); invalid rows count as
            failed.
        fresh: Independent rows (m, d) of the same distribution, and whether each failed (m,).
        failures: Failure probability to certify, 0 to 1.
        confidence: Confidence level, 0 to 1.

    Returns:
        The certificate; its threshold is NaN if no region passes.

    Raises:
        InputError: There are too few fresh rows to certify any region.
    """
    need, (x, failed) = required_failure_free_rows(failures, confidence), fresh
    if len(x) < need:
        raise InputError(
            f"{len(x)} fresh rows cannot certify {failures:g} at {confidence:.1%}: at least {need}, if none fails"
        )
    own, best = score(x), (np.nan, 0, 0)
    for threshold in candidate_thresholds(score(learning[0]), learning[1], len(x), failures, confidence):
        inside = own <= threshold
        rows, bad = int(inside.sum()), int(failed[inside].sum())
        if failure_upper_bound(bad, rows, confidence) > failures:
            return Certificate(failures, confidence, score, *best, len(x), rows, bad)
        best = (float(threshold), rows, bad)
    return Certificate(failures, confidence, score, *best, len(x), 0, 0)
