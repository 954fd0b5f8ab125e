"""What a comparison that stops by itself saves and costs, on simulated pairs: `python bench/anytime.py`.

It writes research/data/anytime.json, which research/certainty.md cites.

The two arms succeed with stated probabilities and a stated correlation, as common draws bring about. Beside the
e-process of `sweep compare --anytime`: McNemar's exact test looked at after every ten pairs (which is wrong), the
size of a test that is looked at once, and two sequential tests that have to be told the most pairs beforehand and take
the arms as independent. Lai's stops where the generalised likelihood ratio exceeds log(1 / (c n)), n pairs on;
Barnard's where the difference of the shares does, in its standard deviations, a constant. Both numbers are set by
simulation, so that of two arms that are equal at most 5 % are found to differ, whatever share succeeds.
"""

import time

import numpy as np
import shared
from scipy.special import rel_entr
from scipy.stats import binom

from sweep.analysis.sequential import fixed_size, log_evidence

Table = list[list[str]]  # columns, then rows

ALPHA, REPETITIONS, MOST = 0.05, 2000, 4000
SETTINGS = ((0.9, 0.8, 0.5), (0.9, 0.85, 0.5), (0.99, 0.95, 0.2), (0.7, 0.5, 0.3), (0.95, 0.9, 0.0))
TOLD, FIRST = 1000, 10  # pairs at most, and before Barnard's test is looked at
NUISANCE = (0.5, 0.7, 0.85, 0.95, 0.98)  # shares that equal arms succeed in
EQUAL = ((0.85, 0.85, 0.5), (0.5, 0.5, 0.2), (0.97, 0.97, 0.0))


def flips(a: float, b: float, correlation: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Discordant pairs (repetitions, pairs) of either direction after each pair."""
    both = a * b + correlation * np.sqrt(a * (1 - a) * b * (1 - b))
    kind = np.digitize(rng.random((REPETITIONS, MOST)), np.cumsum([both, a - both, b - both]))
    return np.cumsum(kind == 1, axis=1), np.cumsum(kind == 2, axis=1)


def arms(lost: np.ndarray, gained: np.ndarray, both: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What Lai's and Barnard's tests see after each pair, of arms that both succeed so often: larger is more unlike."""
    n = np.arange(1, lost.shape[1] + 1)
    a, b = (both + lost) / n, (both + gained) / n
    pooled = (a + b) / 2

    def divergence(p: np.ndarray) -> np.ndarray:
        return rel_entr(p, pooled) + rel_entr(1 - p, 1 - pooled)

    ratio = n * (divergence(a) + divergence(b))
    spread = np.sqrt(np.maximum(2 * pooled * (1 - pooled), 1e-12) / n)
    return ratio + np.log(n), np.where(n >= FIRST, np.abs(a - b) / spread, 0.0)


def outcomes(a: float, b: float, correlation: float, rng: np.random.Generator, most: int) -> tuple[np.ndarray, ...]:
    """Pairs (repetitions, pairs) of which A alone, B alone and both have succeeded."""
    both = a * b + correlation * np.sqrt(a * (1 - a) * b * (1 - b))
    kind = np.digitize(rng.random((REPETITIONS, most)), np.cumsum([a - both, b - both, both]))
    return tuple(np.cumsum(kind == k, axis=1) for k in range(3))


def bounds(rng: np.random.Generator) -> np.ndarray:
    """Of both statistics, which arms that are equal and independent exceed within `TOLD` pairs 1 time in 20 at most."""
    most = [[s.max(axis=1) for s in arms(*outcomes(p, p, 0.0, rng, TOLD))] for p in NUISANCE]
    return np.quantile(np.array(most), 1 - ALPHA, axis=2).max(axis=0)


def sequential(rng: np.random.Generator) -> Table:
    """Pairs until it is decided, of at most `TOLD`, by three tests, and how often it is."""
    limits = bounds(rng)
    table = [["A", "B", "correlation", "*E*", "Lai's", "Barnard's"]]
    for a, b, correlation in (*SETTINGS, *EQUAL):
        counts = outcomes(a, b, correlation, rng, TOLD)
        over = [log_evidence(*counts[:2]) >= -np.log(ALPHA)]
        over += [s >= limit for s, limit in zip(arms(*counts), limits, strict=True)]
        cells = []
        for hit in over:
            decided = hit.any(axis=1)
            pairs = np.where(decided, hit.argmax(axis=1) + 1, TOLD)
            cells.append(f"{pairs.mean():.0f}, {100 * decided.mean():.3g} %")
        table.append([f"{a:.2f}", f"{b:.2f}", f"{correlation:g}", *cells])
    return table


def equal(rng: np.random.Generator) -> Table:
    """How often a difference is found of arms that are equal, however often one looks."""
    table = [
        ["both succeed", "correlation", "*E* finds a difference", "McNemar's test, looked at every ten pairs, does"]
    ]
    for a, b, correlation in EQUAL:
        lost, gained = flips(a, b, correlation, rng)
        wrong = (log_evidence(lost, gained) >= -np.log(ALPHA)).any(axis=1).mean()
        b_, c_ = lost[:, 9::10], gained[:, 9::10]
        p = 2 * binom.cdf(np.minimum(b_, c_), b_ + c_, 0.5)
        often = (p <= ALPHA).any(axis=1).mean()
        table.append([f"{a:.2f}", f"{correlation:g}", f"{100 * wrong:.1f} %", f"{100 * often:.0f} %"])
    return table


def different(rng: np.random.Generator) -> Table:
    """Pairs until the evidence finds the difference."""
    table = [["A", "B", "correlation", "looked at once", "mean", "median", "95 of 100 within"]]
    for a, b, correlation in SETTINGS:
        lost, gained = flips(a, b, correlation, rng)
        over = log_evidence(lost, gained) >= -np.log(ALPHA)
        pairs = np.where(over.any(axis=1), over.argmax(axis=1) + 1, MOST)
        once = fixed_size(a - (both := a * b + correlation * np.sqrt(a * (1 - a) * b * (1 - b))), b - both)
        found = (once, pairs.mean(), np.median(pairs), np.percentile(pairs, 95))
        table.append([f"{a:.2f}", f"{b:.2f}", f"{correlation:g}", *(f"{v:.0f}" for v in found)])
    return table


def main() -> None:
    """Measure the three tables."""
    rng, start = np.random.default_rng(0), time.perf_counter()
    tables = {"equal": equal(rng), "different": different(rng), "sequential": sequential(rng)}
    shared.keep("anytime", (), start, tables)


if __name__ == "__main__":
    main()
