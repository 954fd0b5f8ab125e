"""How right subset simulation is where the answer is known: `python bench/levels.py`, sums of normals beyond a bound.

It writes docs/data/levels.json, which docs/certainty.md cites.
"""

import time

import numpy as np
import shared
from scipy.special import ndtri
from scipy.stats import norm

from sweep.analysis import rare
from sweep.study import subset
from sweep.study.sought import Seen

SUMS = ((2, 1e-3), (8, 1e-3), (8, 1e-5), (8, 1e-7), (50, 1e-5))  # parameters, and how likely the sum is to fail
LEVELS, RUNS, REPETITIONS = subset.Levels(1000, 0.1, 1e-9), 5, 40


def searched(d: int, truth: float, seed: int) -> rare.Repeated:
    """Runs on the sum of `d` normals, whose margin is the distance to its bound."""
    search = subset.search(d, LEVELS, RUNS, seed)
    draws = next(search)
    try:
        while True:
            margin = norm.isf(truth) - ndtri(draws.shares).sum(axis=1) / np.sqrt(d)
            draws = search.send(Seen(margin < 0, margin))
    except StopIteration as end:
        return rare.Repeated(LEVELS.target, tuple(end.value))


def row(d: int, truth: float) -> list[str]:
    """What repetitions come to."""
    found = [searched(d, truth, seed) for seed in range(REPETITIONS)]
    each = np.concatenate([one.each for one in found]) / truth
    means = np.array([one.probability for one in found]) / truth
    hold = sum(low <= truth <= high for low, high in (one.interval for one in found))
    rollouts = np.mean([run.rollouts for one in found for run in one.runs])
    told = (each.mean(), each.std(), means.std())
    return [f"{d}", f"{truth:.0e}", *(f"{v:.2f}" for v in told), f"{hold} of {REPETITIONS}", f"{rollouts:,.0f}"]


def main() -> None:
    """Measure and keep the table."""
    start, heads = time.perf_counter(), ["parameters", "P(failure)", "mean over truth", "variation of a run",
        f"of {RUNS}", "intervals that hold", "rollouts of a run"]  # fmt: skip
    shared.keep("levels", (), start, {"sums": [heads, *(row(d, truth) for d, truth in SUMS)]})


if __name__ == "__main__":
    main()
