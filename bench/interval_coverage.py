"""Coverage of every printed interval on systems whose truth is known: `python bench/interval_coverage.py [NUMBER]`.

Each case simulates 400 studies (2000 of paths, whose coverage is close to 93 %), or NUMBER, with fixed seeds. A
study's design makes the points, a formula of its parameters x1 to x8 (0.5 nominally) takes the place of rollouts, and
the product's own functions judge the rows. It writes research/data/interval_coverage.json; tests/test_coverage.py runs
the same cases with fewer studies.
"""

import itertools
import sys
import time
from collections.abc import Callable, Iterable
from types import SimpleNamespace
from typing import Any, NamedTuple

import levels
import numpy as np
import pandas as pd
import shared
from scipy.stats import norm

from sweep.analysis import compare, failing, rare, sampling_units, screening, sensitivity
from sweep.analysis.sample import pooled_success_rate
from sweep.config.experiment import compose_values
from sweep.core.errors import InputError
from sweep.study import design_kinds, designs
from sweep.study.design_kinds.morris import Morris
from sweep.study.study import Study

NUMBER = 400  # studies of a case
MANY = 2000  # of a case close to 93 %: a coverage of 95 % is then known to 0.5 %, with 400 studies to 1.1 %
LEVELS = [0.0, 0.01, 0.02, 0.03, 0.04, 0.05]
EVEN = {"kind": "uniform", "from": 0, "to": 1}
AXES = {name: {"path": f"controller.{name}", "distribution": EVEN} for name in ("x1", "x2")}
THREE = {name: {"path": f"controller.{name}", "distribution": EVEN} for name in ("x1", "x2", "x3")}
PLAIN = compose_values([])["study"]
NOISE = 0.02  # standard deviation of what is added to x1
WEIGHTS = np.array([0.0, 1.0, 9.0])  # of Sobol's g function; the larger, the less its parameter matters
HALF = np.array([2 / 3, 1 / 12, 0.0]), np.array([11 / 12, 1 / 3, 0.0])  # first and total indices of x1 + x2 / 2 < 0.75


def study(axes: dict[str, Any], seed: int = 0, **keys: Any) -> Any:
    """Return an experiment of these axes, with what the analysis asks of it."""
    design = {**PLAIN["design"], **keys.pop("design", {})}
    parsed = Study.parse({**PLAIN, "name": "toy", "axes": axes, "seed": seed, **keys, "design": design}, single=False)
    system = SimpleNamespace(
        nominal_parameter_value=lambda path, settings: 0.5,
        find_stochastic_rows=lambda rows, settings: np.ones(len(rows), bool),
    )
    return SimpleNamespace(study=parsed, system=system, settings=None)


def points(exp: Any) -> pd.DataFrame:
    """Return the rows of a study before they are judged, one for each replicate."""
    own = exp.study
    table = designs.make_design_table(own.axes, own.design, own.seed, lambda path: 0.5)
    draw = table.pop("draw").to_numpy()
    rows = table.loc[table.index.repeat(own.replicates)].reset_index(drop=True)
    again = np.tile(np.arange(own.replicates), len(draw))
    return rows.assign(replicate=np.repeat(draw, own.replicates) * own.replicates + again)


def judged(rows: pd.DataFrame, succeeds: Any) -> pd.DataFrame:
    """Return the rows with outcome and cause."""
    return rows.assign(outcome=np.where(succeeds, "success", "failure"), cause=np.where(succeeds, "", "late"))


def normals(rows: pd.DataFrame, seed: int) -> np.ndarray:
    """Return the noise of each row: that of its replicate, the same at every grid point."""
    return np.random.default_rng([seed, 7]).standard_normal(rows["replicate"].max() + 1)[rows["replicate"]]


def linear(rows: pd.DataFrame) -> np.ndarray:
    """Return the sum of x1 to x8 over the square root of 8."""
    given = [rows[f"controller.x{k}"].to_numpy() for k in range(1, 9) if f"controller.x{k}" in rows]
    return (sum(given) + 0.5 * (8 - len(given))) / np.sqrt(8)


def inputs(rows: pd.DataFrame) -> np.ndarray:
    """Return x1 to x3 of the rows (n, 3)."""
    return rows[[f"controller.{name}" for name in THREE]].to_numpy()


def half(x: np.ndarray) -> np.ndarray:
    """Return which of the points x (n, 3) succeed: half of them."""
    return x[:, 0] + 0.5 * x[:, 1] < 0.75


def sobol_g(x: np.ndarray) -> np.ndarray:
    """Return Sobol's g function of points x (n, 3)."""
    return np.prod((np.abs(4 * x - 2) + WEIGHTS) / (1 + WEIGHTS), axis=1)


def sobol_g_indices() -> tuple[np.ndarray, np.ndarray]:
    """Return the first and the total Sobol indices of `sobol_g`."""
    part = 1 / 3 / (1 + WEIGHTS) ** 2
    variance = np.prod(1 + part) - 1
    return part / variance, part * np.prod(1 + part) / (1 + part) / variance


def mean_effects(function: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Return the mean sizes (3,) of the elementary effects of a function on the grid of a Morris design."""
    grid = Morris.trajectory_grid
    low, high = grid.low, grid.high
    values = low + (high - low) * np.arange(4) / 3
    means = []
    for k in range(3):
        base = np.array(list(itertools.product(*(values[:2] if j == k else values for j in range(3)))))
        moved = base + (high - low) * grid.step * (np.arange(3) == k)
        means.append(np.abs(function(moved).astype(float) - function(base)).mean() / grid.step)
    return np.array(means)


def rate_with_noise(cut: float) -> float:
    """Return P(x1 + NOISE z < cut) for even x1."""
    grid = (np.arange(100_000) + 0.5) / 100_000
    return float(norm.cdf((cut - grid) / NOISE).mean())


def covers(low: Any, high: Any, truth: Any) -> np.ndarray:
    """Return 1 where an interval holds the truth and has a width, 0 where not, NaN where none is printed."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    hit = (low - 1e-12 <= truth) & (truth <= high + 1e-12) & (high > low)
    return np.where(np.isnan(low) | np.isnan(high), np.nan, hit.astype(float))


def rate_hits(seed: int, kind: str, cut: float, replicates: int, **design: Any) -> np.ndarray:
    """Simulate the rate of success of all draws, and the share of the draws that succeeds."""
    exp = study(AXES, seed, design={"kind": kind, **design}, replicates=replicates)
    rows = points(exp)
    noise = NOISE * normals(rows, seed) if replicates > 1 else 0.0
    rows = judged(rows, rows["controller.x1"] + noise < cut)
    truth = rate_with_noise(cut) if replicates > 1 else cut
    both = pooled_success_rate(rows, exp), sensitivity.success_volume(rows, exp).iloc[0]
    return covers([one.low for one in both], [one.high for one in both], truth)


def tolerance_line(seed: int, cut: float, num: int = 64) -> tuple[pd.Series, float]:
    """Simulate the tolerance to an error that scales x1 and x2; return its line of the table, and the truth.

    x1 and x2 are each 0.5 (1 + error u), u even in -1 to 1, so that P(success) is that of the sum of both u.
    """
    error = {"relative": "error", "distribution": {"kind": "uniform", "from": -1, "to": 1}}
    axes = {"error": {"values": LEVELS}} | {name: {"path": f"controller.{name}", **error} for name in ("x1", "x2")}
    exp = study(axes, seed, design={"num": num})
    rows = points(exp)
    line = sensitivity.tolerated_parameter_errors(judged(rows, linear(rows) < cut), exp).iloc[0]
    return line, (cut - np.sqrt(2)) * 2 * np.sqrt(8) / (2 - np.sqrt(0.8))


def tolerance_hits(seed: int, cut: float) -> np.ndarray:
    """Simulate the tolerance at which 90 % succeed."""
    line, truth = tolerance_line(seed, cut)
    return covers([line["low"]], [line["high"]], truth)


def budget_hits(seed: int, truth: float) -> np.ndarray:
    """Simulate noisy replicates of one condition: half as many more until P = 0.5 is decided or 800 are run."""
    axes = {"x1": {"path": "controller.x1", "values": [0.5, 0.6]}}
    exp = study(axes, seed, budget=1000, replicates=20)
    success, size = np.random.default_rng([seed, 3]).random(800) < truth, 20
    while True:
        rows = pd.DataFrame({"controller.x1": 0.5, "replicate": np.arange(size)})
        line = sampling_units.success_rates_by_condition(judged(rows, success[:size]), exp, ["controller.x1"]).iloc[0]
        if size == 800 or not line["low"] <= 0.5 <= line["high"]:
            return covers([line["low"]], [line["high"]], truth)
        size = min(size + size // 2, 800)


def flip_hits(seed: int, replicates: int, values: list[float]) -> np.ndarray:
    """Simulate the share of flips between two runs of the same draws that are as good."""
    exp = study({"level": {"path": "controller.x3", "values": values}} | AXES, seed, design={"num": 64},
                replicates=replicates)  # fmt: skip
    rows = points(exp)
    noise = NOISE * normals(rows, seed)
    one, other = (rows[f"controller.{name}"] + noise < 0.8 for name in ("x1", "x2"))
    named = judged(rows.assign(point_id=np.arange(len(rows)).astype(str)), one)
    pairs = compare.pair_rows(named, judged(named, other))
    found = compare.count_flips(pairs, compare.pair_sampling_unit_ids(pairs, exp))
    return covers([found.low], [found.high], 2 * rate_with_noise(0.8) * (1 - rate_with_noise(0.8)))


def index_hits(
    seed: int,
    method: Callable[..., pd.DataFrame],
    kind: str,
    num: int,
    metric: bool,
    columns: tuple[tuple[str, str], ...],
    truths: tuple[np.ndarray, ...],
) -> np.ndarray:
    """Simulate sensitivity indices of success, or of a metric, with their errors."""
    exp = study(THREE, seed, design={"kind": kind, "num": num})
    rows = points(exp)
    rows = judged(rows.assign(g_m=sobol_g(inputs(rows))), half(inputs(rows)))
    table = method(rows, exp, "g_m" if metric else None).set_index("axis").loc[[f"controller.{name}" for name in THREE]]
    pairs = zip(columns, truths, strict=True)
    return np.concatenate([covers(table[a] - table[e], table[a] + table[e], truth) for (a, e), truth in pairs])


def pawn_hits(seed: int, kind: str, num: int, metric: bool) -> np.ndarray:
    """Simulate whether the PAWN index of an axis without influence stays below the one by chance."""
    exp = study(THREE, seed, design={"kind": kind, "num": num})
    rows = points(exp)
    x = inputs(rows)
    rows = judged(rows.assign(g_m=x[:, 0] * x[:, 1]), half(x))
    table = screening.pawn_indices(rows, exp, "g_m" if metric else None)
    line = table[table["axis"] == "controller.x3"]
    return (line["median"] <= line["by_chance"]).to_numpy(dtype=float)


def share_hits(seed: int) -> np.ndarray:
    """Simulate the shares in failing of two axes that count alike, so that each has one half."""
    exp = study(AXES, seed, design={"num": 256})
    rows = points(exp)
    x = rows[[f"controller.{name}" for name in AXES]].to_numpy()
    try:
        table = failing.shapley_failure_shares(judged(rows, x.sum(axis=1) < 1.4), exp)
    except InputError:
        return np.full(2, np.nan)
    return covers(table["low"], table["high"], 0.5)


def importance_hits(seed: int, d: int, truth: float, num: int) -> np.ndarray:
    """Simulate a failure probability by importance sampling: of a sum of normals beyond a bound."""
    low, high = levels.run_importance(levels.plane(d, truth), d, num, seed).interval
    return covers([low], [high], truth)


def subset_hits(seed: int, d: int, truth: float) -> np.ndarray:
    """Simulate a failure probability by subset simulation: of a sum of normals beyond a bound."""
    low, high = levels.run_levels(d, truth, seed).interval
    return covers([low], [high], truth)


class Case(NamedTuple):
    """A design and one of its printed intervals."""

    kind: str  # of the design
    prints: Callable[..., Any]  # the function whose interval it is
    interval: str
    setting: str
    hits: Callable[..., np.ndarray]
    arguments: dict[str, Any]
    number: int = NUMBER  # of studies


def _cases() -> Iterable[Case]:
    for kind in design_kinds.list_kinds(lambda kind: kind.gives_rate and not kind.is_low_discrepancy):
        prints = (
            pooled_success_rate
            if design_kinds.DESIGN_BY_KIND[kind].follows_distributions
            else sensitivity.success_volume
        )
        yield Case(kind, prints, "rate", "64 draws", rate_hits, {"kind": kind, "cut": 0.8, "replicates": 1, "num": 64})
    for kind, cut in (("monte_carlo", 0.8), ("monte_carlo", 0.985), ("latin_hypercube", 0.8)):
        settings = {"kind": kind, "cut": cut, "replicates": 10, "num": 64}
        yield Case(kind, pooled_success_rate, "rate", f"64 draws x 10 replicates, P = {cut:g}", rate_hits, settings)
    for kind in design_kinds.list_kinds(lambda kind: kind.is_low_discrepancy):
        for num, scrambles in ((64, 1), (16, 4), (64, 4)):
            if scrambles == 1 or "scrambles" in design_kinds.kind_specific_settings(design_kinds.DESIGN_BY_KIND[kind]):
                settings = {"kind": kind, "cut": 0.985, "replicates": 1, "num": num, "scrambles": scrambles}
                yield Case(
                    kind, pooled_success_rate, "rate", f"{scrambles} x {num} draws, P = 0.985", rate_hits, settings
                )
    for cut in (1.42, 1.4225):
        yield Case(
            "monte_carlo",
            sensitivity.tolerated_parameter_errors,
            "tolerance",
            f"6 values x 64 draws, cut {cut:g}",
            tolerance_hits,
            {"cut": cut},
        )
    for truth in (0.5, 0.56):
        yield Case(
            "grid",
            sampling_units.success_rates_by_condition,
            "rate with a budget",
            f"P = {truth:g}",
            budget_hits,
            {"truth": truth},
        )
    for replicates, values in ((5, [0.5]), (1, [0.3, 0.4, 0.5, 0.6])):
        settings = {"replicates": replicates, "values": values}
        yield Case(
            "monte_carlo",
            compare.count_flips,
            "share of flips",
            f"64 draws x {replicates * len(values)}",
            flip_hits,
            settings,
        )
    yield Case("monte_carlo", failing.shapley_failure_shares, "shares in failing", "256 draws", share_hits, {})
    first, total = ("first", "first_error"), ("total", "total_error")
    for metric, what, truths in ((False, "success", HALF), (True, "a metric", sobol_g_indices())):
        settings = {"method": sensitivity.sobol_indices, "kind": "saltelli", "num": 128, "metric": metric}
        more = {"columns": (first, total), "truths": truths}
        yield Case(
            "saltelli", sensitivity.sobol_indices, "Sobol indices", f"128 blocks, {what}", index_hits, settings | more
        )
        for kind in design_kinds.list_kinds(lambda kind: kind.follows_distributions):
            settings = {"method": screening.rbd_fast_indices, "kind": kind, "num": 128, "metric": metric}
            more = {"columns": (("first", "error"),), "truths": truths[:1]}
            yield Case(
                kind, screening.rbd_fast_indices, "RBD-FAST index", f"128 draws, {what}", index_hits, settings | more
            )
            settings = {"kind": kind, "num": 128, "metric": metric}
            yield Case(kind, screening.pawn_indices, "PAWN index by chance", f"128 draws, {what}", pawn_hits, settings)
        truth = mean_effects(sobol_g if metric else half)
        for num in (20, 50) if metric else (10, 20, 50):
            settings = {"method": sensitivity.elementary_effects, "kind": "morris", "num": num, "metric": metric}
            more = {"columns": (("mean_size", "error"),), "truths": (truth,)}
            yield Case(
                "morris",
                sensitivity.elementary_effects,
                "mean elementary effect",
                f"{num} paths, {what}",
                index_hits,
                settings | more,
                MANY,
            )
    for d, truth, num in ((2, 1e-3, 512), (8, 1e-3, 512), (8, 1e-3, 4096)):
        settings = {"d": d, "truth": truth, "num": num}
        yield Case(
            "importance",
            rare.estimate_failure_probability,
            "P(failure)",
            f"{d} axes, {truth:g}, {num} draws",
            importance_hits,
            settings,
        )
    for d, truth in ((2, 1e-3), (8, 1e-3)):
        settings = {"d": d, "truth": truth}
        yield Case(
            "subset",
            rare.estimate_failure_probability,
            "P(failure)",
            f"{d} axes, {truth:g}, 5 runs of 1000",
            subset_hits,
            settings,
        )


CASES = tuple(_cases())


def simulate(case: Case, number: int) -> tuple[int, int]:
    """Simulate studies of a case with the seeds 0, 1, ...

    Returns:
        Intervals that hold, and intervals printed, of the axis with the lowest coverage.
    """
    hits = np.array([case.hits(seed, **case.arguments) for seed in range(number)])
    printed = (~np.isnan(hits)).sum(axis=0)
    held = np.nansum(hits, axis=0).astype(int)
    worst = int(np.argmin(np.where(printed > 0, held / np.maximum(printed, 1), np.inf)))
    return int(held[worst]), int(printed[worst])


def main() -> None:
    """Compute and write the table."""
    start = time.perf_counter()
    table = [["design", "interval", "study", "printed", "hold"]]
    for case in CASES:
        number = int(sys.argv[1]) if len(sys.argv) > 1 else case.number
        held, printed = simulate(case, number)
        share = f"{held / printed:.1%}".replace("%", " %") if printed else "not printed"
        table.append([case.kind, case.interval, case.setting, f"{printed} of {number}", share])
        print(*table[-1], sep=" | ", flush=True)
    shared.write_tables("interval_coverage", (), start, {"coverage": table})


if __name__ == "__main__":
    main()
