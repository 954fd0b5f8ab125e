"""Rankings of ten policies with known success rates: `python bench/league.py`.

It writes research/data/league.json and research/figures/league.png, which research/decisions.md cites. The policies
succeed at 0.50, 0.55, ..., 0.95. Their outcomes at a point are independent, or correlated by a common number. The race
of `sweep league --anytime` stops a policy once its pairs are decided. Two ways with equal allocation are compared with
it: the same tests for all policies until all pairs are decided, and leagues of a size that is fixed in advance.
"""

import time
from itertools import pairwise

import numpy as np
import pandas as pd
import shared
from scipy.special import ndtri
from scipy.stats import multivariate_normal

from sweep.analysis import league
from sweep.analysis.power import find_smallest_sample_size, mcnemar_power
from sweep.core.plot_style import save_figure
from sweep.report import league as report

RATES = np.round(np.arange(0.5, 0.96, 0.05), 2)
STEP, MOST, RACES = 20, 20_000, 40  # units between looks, units at most, simulated races
LEAGUES, POINTS = 120, 150  # simulated leagues, and their points
CORRELATIONS = (0.0, 0.5)  # of the normal numbers behind the outcomes
FIGURE = shared.FIGURES / "league.png"


def outcomes(rates: np.ndarray, points: int, correlation: float, rng: np.random.Generator) -> np.ndarray:
    """Return whether policies (k) succeed at points (points, k): normal numbers with a common part are small enough."""
    common, own = rng.standard_normal((points, 1)), rng.standard_normal((points, len(rates)))
    return np.sqrt(correlation) * common + np.sqrt(1 - correlation) * own < ndtri(rates)


def run_race(correlation: float, rng: np.random.Generator, only_best: bool, stops: bool) -> tuple[int, bool]:
    """Run a race; return its rollouts and whether a verdict is wrong.

    Args:
        correlation: Correlation of the normal numbers.
        rng: Random numbers.
        only_best: Whether only the best policy is wanted.
        stops: Whether a policy whose pairs are decided takes no more rollouts.
    """
    race, rollouts, units = league.PolicyRace(len(RATES)), 0, 0
    while units < MOST and (is_open := race.undecided_policies(only_best)).any():
        chosen = is_open if stops else np.ones(len(RATES), bool)
        won = outcomes(RATES, STEP, correlation, rng).astype(float)
        race.add_unit_success_rates(np.where(chosen, won, np.nan))
        rollouts, units = rollouts + STEP * int(chosen.sum()), units + STEP
    return rollouts, bool((race.better & (RATES[:, None] <= RATES)).any())


def fixed_rollouts(correlation: float) -> int:
    """Return the rollouts of a league of fixed size that decides each neighbouring pair nine times in ten.

    Each pair is tested at the level that Holm's correction asks of the largest p-value but those of neighbours.
    """
    sizes = []
    for a, b in pairwise(RATES):
        both = multivariate_normal.cdf([ndtri(a), ndtri(b)], cov=[[1, correlation], [correlation, 1]])  # pyright: ignore[reportArgumentType]
        lost, gained = a - both, b - both
        level = 1 - 0.05 / (len(RATES) - 1)
        sizes.append(
            find_smallest_sample_size(lambda n, p=(lost, gained), v=level: mcnemar_power(n, *p, v) >= 0.9, checked=0)
        )
    return max(sizes) * len(RATES)


def race_table(rng: np.random.Generator) -> shared.Table:
    """Return the mean rollouts of races with and without stopping, and how often a verdict is wrong."""
    table = [["wanted", "correlation", "race", "equal allocation, same tests", "saved", "fixed size", "wrong verdict"]]
    for wanted, only_best in (("all pairs", False), ("the best policy", True)):
        for correlation in CORRELATIONS:
            stopped = [run_race(correlation, rng, only_best, True) for _ in range(RACES)]
            equal = [run_race(correlation, rng, only_best, False) for _ in range(RACES)]
            mean, plain = (np.mean([one[0] for one in each]) for each in (stopped, equal))
            wrong = (f"{100 * np.mean([one[1] for one in each]):.0f} %" for each in (stopped, equal))
            fixed = "" if only_best else f"{fixed_rollouts(correlation):,}"
            table.append(
                [wanted, f"{correlation:g}", f"{mean:,.0f}", f"{plain:,.0f}", f"{100 * (1 - mean / plain):.0f} %",
                 fixed, ", ".join(wrong)]
            )  # fmt: skip
    return table


def error_table(rng: np.random.Generator) -> shared.Table:
    """Return how often any of all statements of a league is wrong."""
    table = [["success rates", "correlation", "a verdict", "an interval of a rate", "an interval of a difference"]]
    for name, rates in (
        ("ten times 0.5", np.full(10, 0.5)),
        ("ten times 0.95", np.full(10, 0.95)),
        ("0.50 to 0.95", RATES),
    ):
        first, second = np.triu_indices(len(rates), 1)
        truth = rates[first] - rates[second]
        for correlation in CORRELATIONS:
            wrong = np.zeros(3)
            for _ in range(LEAGUES):
                names = tuple(str(k) for k in range(len(rates)))
                won = outcomes(rates, POINTS, correlation, rng)
                one = league.PairedPolicyOutcomes(names, won, np.arange(POINTS), pd.DataFrame(), ())
                pairs, shares = league.pairwise_test_table(one), league.policy_success_rates(one)
                better = league.decided_win_matrix(pairs, names)
                wrong += [
                    (better & (rates[:, None] <= rates)).any(),
                    ((shares["low"] > rates) | (shares["high"] < rates)).any(),
                    ((pairs["low"] > truth + 1e-9) | (pairs["high"] < truth - 1e-9)).any(),
                ]
            table.append([name, f"{correlation:g}", *(f"{100 * v / LEAGUES:.1f} %" for v in wrong)])
    return table


def main() -> None:
    """Compute and write the tables and the picture."""
    rng, start = np.random.default_rng(0), time.perf_counter()
    tables = {"races": race_table(rng), "errors": error_table(rng)}
    names = tuple(f"rate {rate:.2f}" for rate in RATES)
    won = outcomes(RATES, 400, 0.5, rng)
    one = league.PairedPolicyOutcomes(names, won, np.arange(400), pd.DataFrame(), (0,) * len(names))
    save_figure(report.draw_league(*report.standings_and_pair_table(one, 0.95)), FIGURE)
    shared.write_tables("league", (), start, tables)


if __name__ == "__main__":
    main()
