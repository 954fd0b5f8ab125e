"""Coverage of every printed interval and p-value, by simulated studies of an analytic system whose truth is known.

`toy`: parameters x1 to x8, 0.5 nominally, and a normal number z of each replicate's own noise. A study's design makes
the points, the formula below takes the place of rollouts, and the product's own functions judge the rows.
"""

import itertools
import warnings
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.stats import beta, binom, norm

from sweep.analysis import compare, failing, sampling_units, sensitivity, sequential
from sweep.analysis.sample import is_sample, pooled_rate
from sweep.runs import refine
from sweep.study import designs
from sweep.study.config import compose_values
from sweep.study.study import Study

SEEDS = range(100)  # of fixed seeds; 400 each when a method is chosen
COVERS, REJECTS = 0.93, 0.07
LEVELS = [0.0, 0.01, 0.02, 0.03, 0.04, 0.05]
EVEN = {"kind": "uniform", "from": 0, "to": 1}
AXES = {name: {"path": f"controller.{name}", "distribution": EVEN} for name in ("x1", "x2")}
GRID = {name: {"path": f"controller.{name}", "from": 0, "to": 1, "num": 21} for name in ("x1", "x2")}
PLAIN = compose_values([])["study"]
NOISE = 0.02  # standard deviation of what is added to x1


def study(axes: dict[str, Any], seed: int = 0, **keys: Any) -> Any:
    """An experiment of these axes, with what the analysis asks of it."""
    design = {**PLAIN["design"], **keys.pop("design", {})}
    parsed = Study.parse({**PLAIN, "name": "toy", "axes": axes, "seed": seed, **keys, "design": design}, single=False)
    system = SimpleNamespace(nominal=lambda path, settings: 0.5, random=lambda rows, settings: np.ones(len(rows), bool))
    return SimpleNamespace(study=parsed, system=system, settings=None)


def points(exp: Any, round_: Any = None) -> pd.DataFrame:
    """The rows of a study before they are judged, a line for each replicate."""
    own = exp.study
    table = designs.make_design_table(own.axes, own.design, own.seed, lambda path: 0.5, round_=round_)
    draw = table.pop("draw").to_numpy()
    rows = table.loc[table.index.repeat(own.replicates)].reset_index(drop=True)
    again = np.tile(np.arange(own.replicates), len(draw))
    return rows.assign(replicate=np.repeat(draw, own.replicates) * own.replicates + again)


def judged(rows: pd.DataFrame, succeeds: Any) -> pd.DataFrame:
    return rows.assign(outcome=np.where(succeeds, "success", "failure"), cause=np.where(succeeds, "", "late"))


def normals(rows: pd.DataFrame, seed: int) -> np.ndarray:
    """z of each row: that of its replicate, the same at every grid point."""
    return np.random.default_rng([seed, 7]).standard_normal(rows["replicate"].max() + 1)[rows["replicate"]]


def linear(rows: pd.DataFrame) -> np.ndarray:
    """The sum of x1 to x8 over the square root of 8."""
    given = [rows[f"controller.x{k}"].to_numpy() for k in range(1, 9) if f"controller.x{k}" in rows]
    return (sum(given) + 0.5 * (8 - len(given))) / np.sqrt(8)


def covers(low: float, high: float, truth: float) -> bool:
    assert high > low, "an interval has a width"
    return low <= truth <= high


def rate_with_noise(cut: float) -> float:
    """P(x1 + NOISE z < cut) for even x1."""
    grid = (np.arange(100_000) + 0.5) / 100_000
    return float(norm.cdf((cut - grid) / NOISE).mean())


def exact_width(number: int, truth: float) -> float:
    """Mean width of Clopper and Pearson's interval of so many draws that each succeed or fail as a whole."""
    k = np.arange(number + 1)
    with warnings.catch_warnings(action="ignore"):
        low, high = beta.ppf(0.025, k, number - k + 1), beta.ppf(0.975, k + 1, number - k)
    return float(binom.pmf(k, number, truth) @ (np.nan_to_num(high, nan=1.0) - np.nan_to_num(low)))


def of_draws(kind: str, cut: float, replicates: int, **design: Any) -> dict[str, float]:
    """Coverage of the rates of a study of draws, its mean width, and how often x2, which does nothing, has p < 0.05."""
    truth = rate_with_noise(cut) if replicates > 1 else cut
    hits, widths, tests = [], [], []
    for seed in SEEDS:
        exp = study(AXES, seed, design={"kind": kind, **design}, replicates=replicates)
        rows = points(exp)
        noise = NOISE * normals(rows, seed) if replicates > 1 else 0.0
        rows = judged(rows, rows["controller.x1"] + noise < cut)
        for one in (pooled_rate(rows, exp), sensitivity.success_volume(rows, exp).iloc[0]):
            if not np.isnan(one.low):
                hits.append(covers(one.low, one.high, truth))
                widths.append(one.high - one.low)
        if rows["outcome"].nunique() > 1:
            tests.append(sensitivity.regional_sensitivity(rows, exp).set_index("axis").loc["controller.x2", "p"])
    return {"covers": np.mean(hits), "width": np.mean(widths), "rejects": np.mean(np.array(tests) < 0.05)}


@pytest.mark.parametrize(
    ("kind", "cut", "replicates", "design"),
    [
        *(pytest.param(kind, 0.8, 1, {"num": 64}, id=kind) for kind in ("monte_carlo", "latin_hypercube", "saltelli")),
        *(pytest.param("monte_carlo", cut, 10, {"num": 64}, id=f"monte_carlo x 10, {cut}") for cut in (0.8, 0.985)),
        pytest.param("latin_hypercube", 0.8, 10, {"num": 64}, id="latin_hypercube x 10"),
        pytest.param("sobol", 0.985, 1, {"num": 64}, id="sobol"),
        pytest.param("sobol", 0.985, 1, {"num": 16, "scrambles": 4}, id="sobol 4 x 16"),
        pytest.param("sobol", 0.985, 1, {"num": 64, "scrambles": 4}, id="sobol 4 x 64"),
    ],
)
def test_rates_of_draws(kind, cut, replicates, design):
    found = of_draws(kind, cut, replicates, **design)
    assert found["covers"] >= COVERS
    assert found["rejects"] <= REJECTS
    if replicates > 1:
        assert found["width"] <= 1.3 * exact_width(design["num"], rate_with_noise(cut))


@pytest.mark.parametrize("cut", [1.42, 1.4225])
def test_the_tolerance_of_errors_that_share_their_draws(cut):
    """Of x1 and x2, each 0.5 (1 + error u), u even in -1 to 1: P(success) is that of the sum of both u."""
    error = {"relative": "error", "distribution": {"kind": "uniform", "from": -1, "to": 1}}
    axes = {"error": {"values": LEVELS}} | {name: {"path": f"controller.{name}", **error} for name in ("x1", "x2")}
    truth = (cut - np.sqrt(2)) * 2 * np.sqrt(8) / (2 - np.sqrt(0.8))
    hits = []
    for seed in SEEDS:
        exp = study(axes, seed, design={"num": 64})
        rows = points(exp)
        line = sensitivity.tolerance(judged(rows, linear(rows) < cut), exp).iloc[0]
        hits.append(covers(line["low"], line["high"], truth))
    assert np.mean(hits) >= COVERS


def test_the_fit_is_rejected_as_often_as_it_should_be():
    """Errors that share 64 draws, whose own limits are logistic: the fit is right, and p < 0.05 about as seldom."""
    x, unit = np.repeat(LEVELS, 64), np.tile(np.arange(64), len(LEVELS))
    tests = {"right": [], "wrong": []}
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        for name, limit in (("right", rng.logistic(0.03, 0.008, 64)), ("wrong", rng.uniform(0.028, 0.032, 64))):
            success = x < np.tile(limit, len(LEVELS))
            if name == "wrong":
                success &= np.tile(rng.random(64) < 0.8, len(LEVELS))
            tests[name].append(sensitivity.goodness_of_fit_p(sensitivity.fit_logistic(x, success), x, success, unit))
    assert np.mean(np.array(tests["right"]) < 0.05) <= REJECTS
    assert np.mean(np.array(tests["wrong"]) < 0.05) >= 0.8


def test_a_budget_has_the_confidence_sequence_of_its_stopping_rule():
    """Noisy replicates of one condition near P = 0.5, half as many more until the level is decided or 800 are run."""
    axes = {"x1": {"path": "controller.x1", "values": [0.5, 0.6]}}
    hits = []
    for seed, truth in itertools.product(range(50), (0.5, 0.56)):
        exp = study(axes, seed, budget=1000, replicates=20)
        success, size = np.random.default_rng([seed, 3]).random(800) < truth, 20
        while True:
            rows = pd.DataFrame({"controller.x1": 0.5, "replicate": np.arange(size)})
            line = sampling_units.condition_rates(judged(rows, success[:size]), exp, ["controller.x1"]).iloc[0]
            if size == 800 or not line["low"] <= 0.5 <= line["high"]:
                break
            size = min(size + size // 2, 800)
        hits.append(covers(line["low"], line["high"], truth))
    assert np.mean(hits) >= COVERS


def test_morris_has_no_p_and_its_trajectories_are_units():
    axes = {f"x{k}": {"path": f"controller.x{k}", "distribution": EVEN} for k in range(1, 9)}
    exp = study(axes, design={"kind": "morris", "num": 50})
    rows = points(exp)
    found = sensitivity.regional_sensitivity(judged(rows, linear(rows) < 1.4), exp)
    assert found["p"].isna().all()
    units = sampling_units.unit_numbers(rows, exp)
    assert units is not None
    assert np.bincount(units).tolist() == [9] * 50


@pytest.mark.parametrize(
    ("replicates", "levels"),
    [pytest.param(5, [0.5], id="replicates"), pytest.param(1, [0.3, 0.4, 0.5, 0.6], id="levels")],
)
def test_pairs_of_a_draw_are_no_independent_pairs(replicates, levels):
    """B is A with another cut, which is as good: seldom p < 0.05, seldom a decision, and the flips are covered."""
    axes = {"level": {"path": "controller.x3", "values": levels}} | AXES
    tests, decided, hits = [], [], []
    for seed in SEEDS:
        exp = study(axes, seed, design={"num": 64}, replicates=replicates)
        rows = points(exp)
        noise = NOISE * normals(rows, seed)
        one, other = (rows[f"controller.{name}"] + noise < 0.8 for name in ("x1", "x2"))
        named = judged(rows.assign(point_id=np.arange(len(rows)).astype(str)), one)
        pairs = compare.pair_rows(named, judged(named, other))
        unit = compare.independent_unit_of_pairs(pairs, exp)
        found = compare.count_flips(pairs, unit)
        tests.append(found.p)
        hits.append(covers(found.low, found.high, 2 * rate_with_noise(0.8) * (1 - rate_with_noise(0.8))))
        decided.append(sequential.sequential_test(pairs, unit=unit).decided)
    assert np.mean(np.array(tests) < 0.05) <= REJECTS
    assert np.mean(decided) <= REJECTS
    assert np.mean(hits) >= COVERS


def test_a_grid_is_no_sample():
    exp = study(GRID)
    rows = points(exp).assign(point_id=lambda t: np.arange(len(t)).astype(str))
    rows = judged(rows, linear(rows) < np.sqrt(2))
    assert np.isnan(pooled_rate(rows, exp).low)
    pairs = compare.pair_rows(rows, judged(rows, linear(rows) + 0.05 / np.sqrt(8) < np.sqrt(2)))
    assert compare.independent_unit_of_pairs(pairs, exp) is None
    found = compare.count_flips(pairs)
    assert found.lost > 0
    assert np.isnan([found.p, found.low, found.high]).all()
    assert "interval" not in str(found)


def test_a_refined_map_says_what_its_cells_do():
    """Rows of a disc's boundary are even along both axes, x3 does nothing: the cells say so, and no p is given."""
    axes = {name: {"path": f"controller.{name}", "from": 0, "to": 1, "num": 5} for name in ("x1", "x2", "x3")}
    exp = study(axes, resolution=0.125)
    grid = refine.make_lattice(exp.study)
    rows = pd.DataFrame(itertools.product(*grid.values), columns=[f"controller.{name}" for name in axes])
    disc = (rows["controller.x1"] - 0.5) ** 2 + (rows["controller.x2"] - 0.5) ** 2
    rows = judged(rows.assign(replicate=0), disc < 0.16)
    near = rows[(abs(disc - 0.16) < 0.08) | rows.index.isin(rows.iloc[::7].index)]
    found = refine.total_effects(exp, rows).set_index("axis")["total"]
    assert found["controller.x3"] == 0
    assert found["controller.x1"] == pytest.approx(found["controller.x2"])
    assert found["controller.x1"] > 0.4
    assert not sampling_units.has_independent_rows(near, exp)


def test_a_share_of_failing_that_is_chance_is_not_told():
    """Of x2, which does nothing, beside x1, which decides, at four conditions of 40 draws: seldom a share."""
    axes = {"level": {"path": "controller.x3", "values": [0.3, 0.4, 0.5, 0.6]}} | AXES
    told = []
    for seed in range(30):
        exp = study(axes, seed, design={"num": 40})
        rows = points(exp)
        found = failing.failure_shares(judged(rows, rows["controller.x1"] + 0.1 * normals(rows, seed) < 0.7), exp)
        told.append(found.set_index("axis")["share"].notna())
    told = pd.DataFrame(told)
    assert told["controller.x1"].mean() > 0.95
    assert told[["controller.x2", "controller.x3"]].mean().max() <= REJECTS


def test_a_correlated_latin_hypercube_keeps_its_strata():
    for seed in range(20):
        exp = study(AXES, seed, design={"kind": "latin_hypercube", "num": 100, "correlation": [["x1", "x2", 0.7]]})
        rows = points(exp)
        for name in rows[[f"controller.{one}" for one in AXES]]:
            assert sorted((100 * rows[name]).astype(int)) == list(range(100))
        normal = norm.ppf(rows[["controller.x1", "controller.x2"]])
        assert np.corrcoef(normal.T)[0, 1] == pytest.approx(0.7, abs=0.15)


# which test above simulates each design, so that a new one without a unit and a simulation fails
SIMULATED = {
    "monte_carlo": test_rates_of_draws,
    "latin_hypercube": test_rates_of_draws,
    "sobol": test_rates_of_draws,
    "saltelli": test_rates_of_draws,
    "morris": test_morris_has_no_p_and_its_trajectories_are_units,
    "importance": None,  # tests/test_importance.py: the interval of the weighted probability
    "subset": None,  # tests/test_subset.py: that of independent runs
}


def test_every_design_has_a_unit_and_a_simulation():
    assert set(sampling_units.UNITS) == set(SIMULATED) == set(designs.DESIGNS)
    for kind in ("importance", "subset"):
        exp = study({"x1": {"path": "controller.x1", "distribution": EVEN}}, design={"kind": kind, "num": 100})
        rows = judged(pd.DataFrame({"controller.x1": [0.1, 0.9], "replicate": [0, 1]}), [True, False])
        assert sampling_units.unit_numbers(rows, exp) is None
        assert not is_sample(rows, exp)
        assert sensitivity.regional_sensitivity(rows, exp)["p"].isna().all()
