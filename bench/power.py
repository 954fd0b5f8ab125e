"""Sizes of studies that `sweep power` computes, beside simulated studies: `python bench/power.py`.

It writes research/data/power.json and research/figures/power.png, which research/decisions.md cites. Studies of
independent rollouts are drawn from the binomial law. Those of dependent rows come from the analytic system of
bench/interval_coverage.py, judged by the functions that `sweep stats` calls.
"""

import time
from collections.abc import Callable

import interval_coverage
import numpy as np
import shared
from scipy.stats import binom

from sweep.analysis import power, sampling_units
from sweep.analysis.intervals import clopper_pearson, wilson
from sweep.core.plot_style import COLUMN_WIDTH_IN, add_legend_below, new_figure, save_figure

STUDIES = 4000  # simulated studies of independent rollouts
FRESH, PILOTS = 200, 20  # simulated studies of dependent rows, and pilots that predict them
FIGURE = shared.FIGURES / "power.png"
PAIRED = ((0.9, 0.8, 0.5), (0.9, 0.85, 0.5), (0.99, 0.95, 0.2), (0.7, 0.5, 0.0))
DESIGNS = (
    ("64 draws, 10 replicates", {"kind": "monte_carlo", "num": 64}, 10),
    ("64 draws", {"kind": "monte_carlo", "num": 64}, 1),
    ("8 scrambles of 32 points", {"kind": "sobol", "num": 32, "scrambles": 8}, 1),
)


def size_table(rng: np.random.Generator) -> shared.Table:
    """Return sizes by question, and the share of simulated studies that meet the goal."""
    table = [["question", "rollouts", "wanted", "met", "met with 10 % fewer"]]

    def add(question: str, size: int, factor: int, met: Callable[[int], float]) -> None:
        shares = [f"{100 * met(n):.1f} %" for n in (size, round(0.9 * size))]
        table.append([question, f"{factor * size:,}", "90.0 %", *shares])

    for rate, goal in ((0.5, 0.03), (0.9, 0.02), (0.99, 0.01)):

        def is_narrow(n: int, rate: float = rate, goal: float = goal) -> float:
            low, high = wilson(rng.binomial(n, rate, STUDIES), n)
            return float(np.mean((high - low) / 2 <= goal))

        add(f"rate {rate:g} within ±{goal:g}", power.rollouts_for_half_width(rate, goal), 1, is_narrow)
    rare = power.rollouts_for_half_width(1e-4, 5e-5, interval=clopper_pearson)

    def is_rare_narrow(n: int) -> float:
        low, high = clopper_pearson(rng.binomial(n, 1e-4, STUDIES), np.full(STUDIES, n))
        return float(np.mean((high - low) / 2 <= 5e-5))

    add("failure probability 1e-4 within ±50 %", rare, 1, is_rare_narrow)
    for a, b, correlation in PAIRED:
        lost, gained = power.discordant_pair_shares(a, b, correlation)

        def is_decided(n: int, lost: float = lost, gained: float = gained) -> float:
            counts = rng.multinomial(n, [lost, gained, 1 - lost - gained], STUDIES)
            flips = counts[:, :2].sum(axis=1)
            return float(np.mean(2 * binom.cdf(counts[:, :2].min(axis=1), flips, 0.5) <= 0.05))

        shares = lost, gained
        size = power.find_smallest_sample_size(lambda n, shares=shares: power.mcnemar_power(n, *shares) >= 0.9)
        add(f"{a:g} or {b:g}, paired, correlation {correlation:g}", size, 2, is_decided)
    unpaired = power.find_smallest_sample_size(lambda n: power.unpaired_test_power(n, 0.9, 0.8) >= 0.9, 2)

    def is_told_apart(n: int) -> float:
        a, b = rng.binomial(n, 0.9, STUDIES), rng.binomial(n, 0.8, STUDIES)
        pooled = (a + b) / (2 * n)
        return float(np.mean(np.abs(a - b) / n > 1.959964 * np.sqrt(2 * pooled * (1 - pooled) / n)))

    add("0.9 or 0.8, different draws", unpaired, 2, is_told_apart)
    region = power.find_smallest_sample_size(lambda n: power.certification_power(n, 0.6, 0.001, 0.01, 0.95) >= 0.9)

    def is_certified(n: int) -> float:
        inside = rng.binomial(n, 0.6, STUDIES)
        return float(np.mean(binom.cdf(rng.binomial(inside, 0.001), inside, 0.01) <= 0.05))

    add("region with 0.1 % failures, certify 1 %", region, 1, is_certified)
    return table


def unit_table() -> shared.Table:
    """Return the mean half-width of simulated studies, as one of them predicts it and as rows predict it."""
    table = [["design", "half-width", "predicted by a pilot", "of as many independent rows"]]
    for name, design, replicates in DESIGNS:
        studies = []
        for seed in range(FRESH + PILOTS):
            exp = interval_coverage.study(interval_coverage.AXES, seed, design=design, replicates=replicates)
            rows = interval_coverage.points(exp)
            noise = interval_coverage.NOISE * interval_coverage.normals(rows, seed) if replicates > 1 else 0.0
            sums = rows["controller.x1"] + rows["controller.x2"] ** 2 + noise
            studies.append((exp, interval_coverage.judged(rows, sums < 0.7)))
        ends = [sampling_units.success_rates_by_condition(rows, exp, []).iloc[0] for exp, rows in studies[:FRESH]]
        predicted = []
        for exp, rows in studies[FRESH:]:
            unit, kind = sampling_units.unit_numbers(rows, exp), sampling_units.independent_unit(exp.study)
            assert unit is not None
            pilot = power.count_unit_successes((rows["outcome"] == "success").to_numpy(), unit, kind.is_even)
            predicted.append(power.simulated_half_widths(pilot, len(pilot.won)).mean())
        rate = float(np.mean([one["share"] for one in ends]))
        widths = np.mean([(one["high"] - one["low"]) / 2 for one in ends]), np.mean(predicted)
        plain = power.expected_half_width(len(studies[0][1]), rate)
        table.append([name, *(f"±{100 * v:.2f} %" for v in (*widths, plain))])
    return table


def draw_power(rng: np.random.Generator) -> None:
    """Draw the power of the paired test by the number of pairs, exact and simulated."""
    figure = new_figure(0.7 * COLUMN_WIDTH_IN, COLUMN_WIDTH_IN)
    ax = figure.add_subplot()
    for (a, b, correlation), colour in zip(PAIRED, ("#00649E", "#D55E00", "#009E73", "#8E1B5E"), strict=True):
        lost, gained = power.discordant_pair_shares(a, b, correlation)
        sizes = np.unique(np.geomspace(10, 600, 40).astype(int))
        label = f"{a:g}, {b:g}, correlation {correlation:g}"
        ax.plot(sizes, [100 * power.mcnemar_power(int(n), lost, gained) for n in sizes], color=colour, label=label)
        for n in sizes[5::9]:
            counts = rng.multinomial(n, [lost, gained, 1 - lost - gained], STUDIES)
            p = 2 * binom.cdf(counts[:, :2].min(axis=1), counts[:, :2].sum(axis=1), 0.5)
            ax.plot(n, 100 * np.mean(p <= 0.05), "o", markersize=3, color=colour)
    ax.set(xlabel="pairs", ylabel="power, %", ylim=(0, 101), xlim=(0, 600))
    add_legend_below(figure, ax.get_legend_handles_labels()[0])
    save_figure(figure, FIGURE)


def main() -> None:
    """Compute and write the tables and the picture."""
    rng, start = np.random.default_rng(0), time.perf_counter()
    tables = {"sizes": size_table(rng), "units": unit_table()}
    draw_power(rng)
    shared.write_tables("power", (), start, tables)


if __name__ == "__main__":
    main()
