"""Regions of parameters in which the probability of failing is bounded: learned on some rows, tested on others.

Regions are nested, each `score(x) <= c` of a score that is learned from rows which play no part in the test. Fresh rows
then test them in a fixed order, from the region most likely to pass outwards, each by the exact binomial bound at the
whole confidence, up to the first that does not pass (fixed sequence testing): a region that fails more often than is
promised is certified with probability 1 - confidence at most. The largest region whose observed rate is small enough is
wrong about half the time, as it is chosen because it looked good.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sweep.core.errors import InputError

SHAPES = ("box", "ellipsoid", "score")
STEPS = 100  # regions, at equal shares of the draws
PEEL = 0.02  # share of the draws left that is taken off one side of a box at a time
FEWEST_IN_BOX = 10  # learning rows
PART = 1024  # rows of a product: of more, BLAS takes threads, which on busy cores wait for each other
ROUND = 1e-3  # least curvature of an ellipsoid, in the parameters' own spreads
DIGITS = 9  # of the numbers of a region, so that its condition has all of them


@dataclass(frozen=True)
class Boxes:
    """Nested boxes: the whole of what was drawn, and one side after the other taken off. The last has the fewest."""

    low: np.ndarray  # (boxes, d)
    high: np.ndarray

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Rows (n, d) to the number of boxes that each is not in (n,)."""
        sides = [np.searchsorted(low, v, side="right") for low, v in zip(self.low.T, x.T, strict=True)]
        sides += [np.searchsorted(-high, -v, side="right") for high, v in zip(self.high.T, x.T, strict=True)]
        return len(self.low) - np.min(sides, axis=0).astype(float)

    def condition(self, names: list[str], threshold: float) -> str:
        """`score(x) <= threshold` as a condition on columns, such as `--where` takes: ends of every parameter."""
        number = len(self.low) - int(threshold) - 1
        ends = zip(names, self.low[number].tolist(), self.high[number].tolist(), strict=True)
        return " and ".join(f"{low!r} <= {name} <= {high!r}" for name, low, high in ends)


@dataclass(frozen=True)
class Odds:
    """Log odds of failing: constant + linear z + z' form z, with z = (x - centre) / scale."""

    centre: np.ndarray  # (d,)
    scale: np.ndarray
    constant: float
    linear: np.ndarray
    form: np.ndarray  # (d, d)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Rows (n, d) to log odds (n,)."""
        z = (x - self.centre) / self.scale
        return self.constant + z @ self.linear + np.einsum("ni,ij,nj->n", z, self.form, z)

    def condition(self, names: list[str], threshold: float) -> str:
        """The same: the polynomial written out."""
        z = [f"({name} - {_text(c)}) / {_text(s)}" for name, c, s in zip(names, self.centre, self.scale, strict=True)]
        terms = [f"{_text(w)} * {one}" for w, one in zip(self.linear, z, strict=True)]
        for i in range(len(z)):
            for j in range(i, len(z)):
                weight = self.form[i, j] * (1 if i == j else 2)
                terms.append(f"{float(weight)!r} * {z[i]} * {z[j]}")
        return f"{_text(self.constant)} + {' + '.join(terms)} <= {float(threshold)!r}"


Outside = Boxes | Odds  # a score, how far outside rows are: regions are where it is small


def _rounded(numbers: np.ndarray) -> np.ndarray:
    return np.vectorize(lambda v: float(_text(v)))(numbers)


def _text(number: float) -> str:
    return f"{number:.{DIGITS}g}"


def fewest(failures: float, confidence: float) -> int:
    """Rows without a failure that certify a probability of `failures`."""
    return int(np.ceil(np.log1p(-confidence) / np.log1p(-failures)))


def bound(failed: int, rows: int, confidence: float) -> float:
    """Exact upper bound of a probability of failing; 1 without a row (Clopper, Pearson; one-sided)."""
    from scipy.special import betaincinv  # slow to import

    return 1.0 if failed >= rows else float(betaincinv(failed + 1, rows - failed, confidence))


def most_failed(rows: int, failures: float, confidence: float) -> int:
    """The most failures among `rows` with which `failures` is certified; -1 where there are too few rows."""
    from scipy.stats import binom

    guess = int(binom.ppf(1 - confidence, rows, failures))
    return next(k for k in range(guess, -2, -1) if k < 0 or bound(k, rows, confidence) <= failures)


def box(x: np.ndarray, failed: np.ndarray, least: float) -> Boxes:
    """Take off the side with most failures to the draws it costs, until a share `least` of the draws is left.

    Patient rule induction (Friedman, Fisher 1999) on the rows x (n, d). Where no failure is left the side goes that is
    farthest from the middle.
    """
    low, high = x.min(axis=0), x.max(axis=0)
    spread = np.where(high > low, high - low, 1.0)
    lows, highs, inside = [low], [high], np.ones(len(x), dtype=bool)
    while inside.sum() > max(least * len(x), FEWEST_IN_BOX):
        here, bad = x[inside], failed[inside]
        sides = []
        for axis in range(x.shape[1]):
            for ends, share in ((low, PEEL), (high, 1 - PEEL)):
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
    return Boxes(np.array(lows), np.array(highs))


def odds(x: np.ndarray, failed: np.ndarray, convex: bool) -> Odds:
    """Fit a logistic law whose exponent is of the second degree in x (n, d), lightly held to zero.

    `convex` makes its form root' root + `ROUND`: regions are ellipsoids, whose middle is where the rows say.
    """
    from scipy.optimize import minimize
    from scipy.special import expit

    d = x.shape[1]
    spread = x.std(axis=0)
    centre, scale = _rounded(x.mean(axis=0)), _rounded(np.where(spread, spread, 1.0))
    every, signs = (x - centre) / scale, np.where(failed, 1.0, -1.0)
    parts = [(every[k : k + PART], signs[k : k + PART]) for k in range(0, len(x), PART)]

    def loss(weights: np.ndarray) -> tuple[float, np.ndarray]:
        root = weights[1 + d :].reshape(d, d)
        held = np.r_[0.0, weights[1:]]  # the constant is free
        total, gradient = 0.5 * (held**2).sum(), held
        for known, sign in parts:
            turned = known @ root.T
            form = (turned**2).sum(axis=1) + ROUND * (known**2).sum(axis=1) if convex else (turned * known).sum(axis=1)
            value = sign * (weights[0] + known @ weights[1 : 1 + d] + form)
            slope = -sign * expit(-value)
            inner = 2 * (slope[:, None] * turned).T @ known if convex else (slope[:, None] * known).T @ known
            total += np.logaddexp(0, -value).sum()
            gradient = gradient + np.r_[slope.sum(), known.T @ slope, inner.ravel()]
        return float(total), gradient

    start = np.r_[np.zeros(1 + d), 0.1 * np.eye(d).ravel()]
    weights = minimize(loss, start, jac=True, method="L-BFGS-B").x
    root = weights[1 + d :].reshape(d, d)
    form = root.T @ root + ROUND * np.eye(d) if convex else root
    return Odds(centre, scale, float(_text(weights[0])), _rounded(weights[1 : 1 + d]), _rounded((form + form.T) / 2))


def learn(shape: str, x: np.ndarray, failed: np.ndarray, least: float) -> Outside:
    """The score of nested regions of a `shape` from rows x (n, d); `least` is the share of the draws in the smallest.

    That is the share of fresh rows that certify where none fails.
    """
    return box(x, failed, least) if shape == "box" else odds(x, failed, convex=shape == "ellipsoid")


def thresholds(scores: np.ndarray, failed: np.ndarray, fresh: int, failures: float, confidence: float) -> np.ndarray:
    """Of nested regions, ascending, from the one most likely to be certified by so many `fresh` rows.

    `scores` (n,) are those of the learning rows, `failed` which of them failed: the more rows a region has the more
    failures it may have, but the more it has of them, too.
    """
    from scipy.stats import binom

    every = np.unique(np.quantile(scores, np.arange(1, STEPS + 1) / STEPS, method="higher"))
    inside = scores <= every[:, None]
    rows, bad = inside.sum(axis=1), (inside & failed).sum(axis=1)
    falling = np.round(fresh * rows / len(scores)).astype(int)
    allowed = [most_failed(int(n), failures, confidence) for n in falling]
    power = binom.cdf(allowed, falling, (bad + 0.5) / (rows + 1.0))
    return every[int(np.argmax(power)) :]


@dataclass(frozen=True)
class Certificate:
    """The largest region found, or none, and what fresh rows say of it."""

    failures: float  # probability that is promised not to be exceeded
    confidence: float
    score: Outside
    threshold: float  # NaN without a region
    rows: int  # fresh rows in the region
    failed: int  # of them, invalid ones among them
    drawn: int  # fresh rows in all
    next_rows: int  # of the first region that was not certified; 0 where all were
    next_failed: int

    @property
    def found(self) -> bool:
        """Whether any region is certified."""
        return bool(np.isfinite(self.threshold))

    @property
    def share(self) -> float:
        """Of the draws that fall into the region."""
        return self.rows / self.drawn

    @cached_property
    def at_most(self) -> float:
        """What the region's own fresh rows bound its probability of failing by."""
        return bound(self.failed, self.rows, self.confidence)

    def inside(self, x: np.ndarray) -> np.ndarray:
        """Which rows x (n, d) are in the region."""
        return self.score(x) <= self.threshold


def certify(
    score: Outside,
    learning: tuple[np.ndarray, np.ndarray],
    fresh: tuple[np.ndarray, np.ndarray],
    failures: float,
    confidence: float,
) -> Certificate:
    """The largest region of a `score` whose probability of failing is certified to be at most `failures`.

    `learning`, which the score was learned from, and `fresh` are rows (n, d) with whether they failed (n,), invalid
    ones as failed; both are independent draws from one distribution, and the promise is for draws from it that fall
    into the region. Raises `InputError` where there are too few fresh rows for any region.
    """
    need, (x, failed) = fewest(failures, confidence), fresh
    if len(x) < need:
        raise InputError(
            f"{len(x)} fresh rows cannot certify {failures:g} at {confidence:.1%}: at least {need}, if none fails"
        )
    own, best = score(x), (np.nan, 0, 0)
    for threshold in thresholds(score(learning[0]), learning[1], len(x), failures, confidence):
        inside = own <= threshold
        rows, bad = int(inside.sum()), int(failed[inside].sum())
        if bound(bad, rows, confidence) > failures:
            return Certificate(failures, confidence, score, *best, len(x), rows, bad)
        best = (float(threshold), rows, bad)
    return Certificate(failures, confidence, score, *best, len(x), 0, 0)
