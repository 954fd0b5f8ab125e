"""Cost and savings of comparisons that stop by themselves, on simulated pairs: `python bench/anytime.py`.

It writes research/data/anytime.json, which research/certainty.md cites.

The two arms succeed with given probabilities and a given correlation, as common random numbers cause. The e-process of
`sweep compare --anytime` is compared with McNemar's exact test evaluated after every ten pairs (which is wrong), with a
test evaluated once, and with two sequential tests that need the largest number of pairs in advance and treat the arms
as independent. Lai's test stops when the generalised likelihood ratio after n pairs exceeds log(1 / (c n)). Barnard's
test stops when the difference of the shares, in standard deviations, exceeds a constant. Both constants are calibrated
by simulation, so that equal arms are found to differ in at most 5 % of cases, whatever share succeeds.
"""

import time

import numpy as np
import shared
from scipy.special import rel_entr
from scipy.stats import binom

from sweep.analysis.sequential import log_e_value, pairs_for_fixed_sample_test

ALPHA, REPETITIONS, MOST = 0.05, 2000, 4000
SETTINGS = ((0.9, 0.8, 0.5), (0.9, 0.85, 0.5), (0.99, 0.95, 0.2), (0.7, 0.5, 0.3), (0.95, 0.9, 0.0))
MAX_PAIRS, FIRST = 1000, 10  # pairs at most, and before Barnard's test is first evaluated
NUISANCE = (0.5, 0.7, 0.85, 0.95, 0.98)  # success probabilities of equal arms
EQUAL = ((0.85, 0.85, 0.5), (0.5, 0.5, 0.2), (0.97, 0.97, 0.0))


def flips(a: float, b: float, correlation: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return the discordant pairs of either direction after each pair, (repetitions, pairs)."""
    both = a * b + correlation * np.sqrt(a * (1 - a) * b * (1 - b))
    kind = np.digitize(rng.random((REPETITIONS, MOST)), np.cumsum([both, a - both, b - both]))
    return np.cumsum(kind == 1, axis=1), np.cumsum(kind == 2, axis=1)


def sequential_statistics(lost: np.ndarray, gained: np.ndarray, both: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the statistics of Lai's and Barnard's tests after each pair, of arms that both succeed `both` times."""
    n = np.arange(1, lost.shape[1] + 1)
    a, b = (both + lost) / n, (both + gained) / n
    pooled = (a + b) / 2

    def divergence(p: np.ndarray) -> np.ndarray:
        return rel_entr(p, pooled) + rel_entr(1 - p, 1 - pooled)

    ratio = n * (divergence(a) + divergence(b))
    spread = np.sqrt(np.maximum(2 * pooled * (1 - pooled), 1e-12) / n)
    return ratio + np.log(n), np.where(n >= FIRST, np.abs(a - b) / spread, 0.0)


def outcomes(a: float, b: float, correlation: float, rng: np.random.Generator, most: int) -> tuple[np.ndarray, ...]:
    """Return the numbers of pairs in which A alone, B alone and both have succeeded, (repetitions, pairs)."""
    both = a * b + correlation * np.sqrt(a * (1 - a) * b * (1 - b))
    kind = np.digitize(rng.random((REPETITIONS, most)), np.cumsum([a - both, b - both, both]))
    return tuple(np.cumsum(kind == k, axis=1) for k in range(3))


def bounds(rng: np.random.Generator) -> np.ndarray:
    """Return the bounds of both statistics that equal arms exceed within `MAX_PAIRS` pairs in at most 1 of 20 cases."""
    most = [[s.max(axis=1) for s in sequential_statistics(*outcomes(p, p, 0.0, rng, MAX_PAIRS))] for p in NUISANCE]
    return np.quantile(np.array(most), 1 - ALPHA, axis=2).max(axis=0)


def decision_table(rng: np.random.Generator) -> shared.Table:
    """Return the pairs until a decision by three tests, and how often there is one within `MAX_PAIRS`."""
    limits = bounds(rng)
    table = [["A", "B", "correlation", "*E*", "Lai's", "Barnard's"]]
    for a, b, correlation in (*SETTINGS, *EQUAL):
        counts = outcomes(a, b, correlation, rng, MAX_PAIRS)
        over = [log_e_value(*counts[:2]) >= -np.log(ALPHA)]
        over += [s >= limit for s, limit in zip(sequential_statistics(*counts), limits, strict=True)]
        cells = []
        for hit in over:
            decided = hit.any(axis=1)
            pairs = np.where(decided, hit.argmax(axis=1) + 1, MAX_PAIRS)
            cells.append(f"{pairs.mean():.0f}, {100 * decided.mean():.3g} %")
        table.append([f"{a:.2f}", f"{b:.2f}", f"{correlation:g}", *cells])
    return table


def false_difference_table(rng: np.random.Generator) -> shared.Table:
    """Return how often a difference is found between equal arms, by how often the test is evaluated."""
    table = [
        ["both succeed", "correlation", "*E* finds a difference", "McNemar's test, looked at every ten pairs, does"]
    ]
    for a, b, correlation in EQUAL:
        lost, gained = flips(a, b, correlation, rng)
        wrong = (log_e_value(lost, gained) >= -np.log(ALPHA)).any(axis=1).mean()
        b_, c_ = lost[:, 9::10], gained[:, 9::10]
        p = 2 * binom.cdf(np.minimum(b_, c_), b_ + c_, 0.5)
        often = (p <= ALPHA).any(axis=1).mean()
        table.append([f"{a:.2f}", f"{correlation:g}", f"{100 * wrong:.1f} %", f"{100 * often:.0f} %"])
    return table


def difference_table(rng: np.random.Generator) -> shared.Table:
    """Return the pairs until the evidence shows a difference."""
    table = [["A", "B", "correlation", "looked at once", "mean", "median", "95 of 100 within"]]
    for a, b, correlation in SETTINGS:
        lost, gained = flips(a, b, correlation, rng)
        over = log_e_value(lost, gained) >= -np.log(ALPHA)
        pairs = np.where(over.any(axis=1), over.argmax(axis=1) + 1, MOST)
        once = pairs_for_fixed_sample_test(
            a - (both := a * b + correlation * np.sqrt(a * (1 - a) * b * (1 - b))), b - both
        )
        found = (once, pairs.mean(), np.median(pairs), np.percentile(pairs, 95))
        table.append([f"{a:.2f}", f"{b:.2f}", f"{correlation:g}", *(f"{v:.0f}" for v in found)])
    return table


def main() -> None:
    """Compute and write the three tables."""
    rng, start = np.random.default_rng(0), time.perf_counter()
    tables = {
        "equal": false_difference_table(rng),
        "different": difference_table(rng),
        "sequential": decision_table(rng),
    }
    shared.write_tables("anytime", (), start, tables)


if __name__ == "__main__":
    main()
