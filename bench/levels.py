"""Accuracy of rare-failure estimates where the exact answer is known: `python bench/levels.py`.

Sums of normals beyond a bound by subset simulation; these and other shapes by importance sampling. It writes
research/data/levels.json, which research/certainty.md cites.
"""

import time
from collections.abc import Callable

import numpy as np
import pandas as pd
import shared
from scipy.special import ndtri
from scipy.stats import chi2, norm

from sweep.study import importance_sampling, subset_simulation
from sweep.study.adaptive_sampling import RoundSummary
from sweep.study.design_kinds.base import DrawContext
from sweep.study.design_kinds.importance import ImportanceSampling, WeightedEstimate
from sweep.study.design_kinds.subset import SubsetEstimate

SUMS = ((2, 1e-3), (8, 1e-3), (8, 1e-5), (8, 1e-7), (50, 1e-5))  # number of parameters, and probability of failure
LEVELS, RUNS, REPETITIONS = subset_simulation.LevelSettings(1000, 0.1, 1e-9), 5, 40
WIDE, ROUNDS = 2.0, 2
DRAWS = (512, 4096)  # draws of a round of importance sampling


def plane(d: int, p: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return the test for failures whose sum is beyond a bound."""
    return lambda u: u.sum(axis=1) / np.sqrt(d) < norm.ppf(p)


def sides(d: int, p: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return the test for failures whose first parameter is beyond a bound on either side."""
    return lambda u: np.abs(u[:, 0]) > norm.isf(p / 2)


def corner(d: int, p: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return the test for failures whose first two parameters are both beyond a bound."""
    return lambda u: u[:, :2].max(axis=1) < norm.ppf(np.sqrt(p))


def ring(d: int, p: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return the test for failures far from zero in any direction."""
    return lambda u: (u**2).sum(axis=1) > chi2.isf(p, d)


SHAPES = ((plane, 2, 1e-3), (plane, 8, 1e-3), (plane, 8, 1e-4), (plane, 8, 1e-6), (plane, 10, 1e-3),
          (sides, 8, 1e-3), (corner, 8, 1e-3), (ring, 4, 1e-3))  # fmt: skip


def run_levels(d: int, truth: float, seed: int) -> SubsetEstimate:
    """Run subset simulation on the sum of `d` normals, whose margin is the distance to its bound."""
    search = subset_simulation.start_search(d, LEVELS, RUNS, seed)
    draws = next(search)
    try:
        while True:
            margin = norm.isf(truth) - ndtri(draws.quantiles).sum(axis=1) / np.sqrt(d)
            draws = search.send(RoundSummary(margin < 0, margin))
    except StopIteration as end:
        return SubsetEstimate(LEVELS.target, tuple(end.value))


def levels_row(d: int, truth: float) -> list[str]:
    """Return a table row of repetitions of subset simulation."""
    found = [run_levels(d, truth, seed) for seed in range(REPETITIONS)]
    each = np.concatenate([one.run_probabilities for one in found]) / truth
    means = np.array([one.probability for one in found]) / truth
    hold = sum(low <= truth <= high for low, high in (one.interval for one in found))
    rollouts = np.mean([run.rollouts for one in found for run in one.runs])
    told = (each.mean(), each.std(), means.std())
    return [f"{d}", f"{truth:.0e}", *(f"{v:.2f}" for v in told), f"{hold} of {REPETITIONS}", f"{rollouts:,.0f}"]


def run_importance(fails: Callable[[np.ndarray], np.ndarray], d: int, num: int, seed: int) -> WeightedEstimate:
    """Return the estimate of a study by importance sampling."""
    search = importance_sampling.start_search(d, num, WIDE, ROUNDS, seed)
    draws = next(search)
    for _ in range(ROUNDS):
        draws = search.send(RoundSummary(fails(ndtri(draws.quantiles)), np.zeros(num)))
    rows = pd.DataFrame({f"axis.{name}": values for name, values in draws.columns.items()})
    rows["outcome"] = np.where(fails(ndtri(draws.quantiles)), "failure", "success")
    return ImportanceSampling(num=num, rounds=ROUNDS).estimate_failure(rows, DrawContext((), seed))


def importance_row(shape: Callable[..., Callable[[np.ndarray], np.ndarray]], d: int, truth: float) -> list[str]:
    """Return a table row of repetitions for each number of draws."""
    told = []
    for num in DRAWS:
        found = [run_importance(shape(d, truth), d, num, seed) for seed in range(REPETITIONS)]
        each = np.array([one.probability for one in found]) / truth
        hold = sum(one.low <= truth <= one.high for one in found)
        told += [f"{each.mean():.2f}", f"{each.std(ddof=1):.2f}", f"{hold} of {REPETITIONS}",
                 f"{sum(not one.is_reliable for one in found)} of {REPETITIONS}"]  # fmt: skip
    return [shape.__name__, f"{d}", f"{truth:.0e}", *told]


def main() -> None:
    """Compute and write the tables."""
    start, heads = time.perf_counter(), ["parameters", "P(failure)", "mean over truth", "variation of a run",
        f"of {RUNS}", "intervals that hold", "rollouts of a run"]  # fmt: skip
    titles = ["failures", "parameters", "P(failure)"]
    for num in DRAWS:
        titles += [f"{num:,} draws a round: mean over truth", "variation", "intervals that hold", "not trusted"]
    tables = {"sums": [heads, *(levels_row(d, truth) for d, truth in SUMS)]}
    tables["importance"] = [titles, *(importance_row(*one) for one in SHAPES)]
    shared.write_tables("levels", (), start, tables)


if __name__ == "__main__":
    main()
