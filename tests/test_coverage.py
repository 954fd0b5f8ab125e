"""Coverage of every printed interval and p-value, by simulated studies of systems whose truth is known.

The systems and the intervals are those of bench/interval_coverage.py, whose table is on research/certainty.md.
"""

import ast
import itertools
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from interval_coverage import (
    AXES,
    CASES,
    EVEN,
    LEVELS,
    NOISE,
    covers,
    judged,
    linear,
    normals,
    points,
    rate_with_noise,
    simulate,
    study,
)
from scipy.stats import beta, binom, norm

from sweep.analysis import compare, failing, sampling_units, screening, sensitivity, sequential
from sweep.analysis.sample import is_random_sample, pooled_success_rate
from sweep.core.errors import InputError
from sweep.report.statistics import sensitivity_methods
from sweep.runs import refine
from sweep.study import design_kinds

SEEDS = range(100)
FEW = 20  # studies of a case; all of them are slow
COVERS, REJECTS = 0.93, 0.07
CONSISTENT = 0.01  # probability of so few intervals that hold, if 93 % do
GRID = {name: {"path": f"controller.{name}", "from": 0, "to": 1, "num": 21} for name in ("x1", "x2")}
IDS = [f"{case.kind}, {case.interval}, {case.setting}" for case in CASES]


@pytest.mark.parametrize("case", CASES[::2], ids=IDS[::2])
def test_an_interval_holds_as_often_as_it_says(case):
    held, printed = simulate(case, FEW)
    assert held >= binom.ppf(CONSISTENT, printed, COVERS)


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=IDS)
def test_an_interval_holds_in_many_studies(case):
    held, printed = simulate(case, case.number)
    assert held >= binom.ppf(CONSISTENT, printed, COVERS)


def test_errors_that_do_not_hold_are_not_printed():
    silent = {(case.kind, case.interval) for case in CASES if not simulate(case, 3)[1]}
    assert silent == {
        (kind, "RBD-FAST index") for kind, cls in design_kinds.DESIGN_BY_KIND.items() if cls.is_low_discrepancy
    }


def exact_width(number: int, truth: float) -> float:
    """Mean width of Clopper and Pearson's interval of so many draws that each succeed or fail as a whole."""
    k = np.arange(number + 1)
    with warnings.catch_warnings(action="ignore"):
        low, high = beta.ppf(0.025, k, number - k + 1), beta.ppf(0.975, k + 1, number - k)
    return float(binom.pmf(k, number, truth) @ (np.nan_to_num(high, nan=1.0) - np.nan_to_num(low)))


def simulate_draws(kind: str, cut: float, replicates: int, **design: Any) -> dict[str, float]:
    """Mean width of the rate's interval, and how often x2, which does nothing, has p < 0.05."""
    widths, tests = [], []
    for seed in SEEDS:
        exp = study(AXES, seed, design={"kind": kind, **design}, replicates=replicates)
        rows = points(exp)
        noise = NOISE * normals(rows, seed) if replicates > 1 else 0.0
        rows = judged(rows, rows["controller.x1"] + noise < cut)
        rate = pooled_success_rate(rows, exp)
        widths.append(rate.high - rate.low)
        if rows["outcome"].nunique() > 1:
            tests.append(sensitivity.regional_sensitivity(rows, exp).set_index("axis").loc["controller.x2", "p"])
    return {"width": np.mean(widths), "rejects": np.mean(np.array(tests) < 0.05)}


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
def test_draws_are_counted_by_their_unit(kind, cut, replicates, design):
    found = simulate_draws(kind, cut, replicates, **design)
    assert found["rejects"] <= REJECTS
    if replicates > 1:
        assert found["width"] <= 1.3 * exact_width(design["num"], rate_with_noise(cut))


def test_a_tolerance_is_no_wider_than_needed():
    """200 draws have their own limits, which are logistic: an exact interval of the rates is 0.0074 wide."""
    axes, widths = {"error": {"path": "controller.x3", "values": LEVELS}, "x1": AXES["x1"]}, []
    for seed in range(20):
        exp = study(axes, seed, design={"num": 200})
        exp.system.nominal_parameter_value = lambda path, settings: 0.0
        limit = np.random.default_rng(seed).logistic(0.045, 0.007, 200)
        rows = points(exp)
        rows = judged(rows, rows["controller.x3"] < limit[rows["replicate"]])
        line = sensitivity.tolerated_parameter_errors(rows, exp).iloc[0]
        assert line["low"] <= line["error"] <= line["high"]
        widths.append(line["high"] - line["low"])
    assert np.median(widths) <= 0.0075


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
            tests[name].append(
                sensitivity.goodness_of_fit_p_value(sensitivity.fit_logistic(x, success), x, success, unit)
            )
    assert np.mean(np.array(tests["right"]) < 0.05) <= REJECTS
    assert np.mean(np.array(tests["wrong"]) < 0.05) >= 0.8


def test_morris_has_no_p_and_its_trajectories_are_units():
    axes = {f"x{k}": {"path": f"controller.x{k}", "distribution": EVEN} for k in range(1, 9)}
    exp = study(axes, design={"kind": "morris", "num": 50})
    rows = points(exp)
    found = sensitivity.regional_sensitivity(judged(rows, linear(rows) < 1.4), exp)
    assert found["p"].isna().all()
    units = sampling_units.unit_numbers(rows, exp)
    assert units is not None
    assert np.bincount(units).tolist() == [9] * 50
    assert sampling_units.describe_sample_size(rows, exp) == "50 independent trajectories"


def test_an_index_of_draws_that_agree_names_what_is_lacking():
    exp = study(AXES, design={"num": 100})
    rows = points(exp)
    with pytest.raises(InputError, match="all 100 valid draws agree"):
        screening.pawn_indices(judged(rows, [True] * 100), exp)


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
        unit = compare.pair_sampling_unit_ids(pairs, exp)
        found = compare.count_flips(pairs, unit)
        tests.append(found.p_value)
        hits.append(covers(found.low, found.high, 2 * rate_with_noise(0.8) * (1 - rate_with_noise(0.8))))
        decided.append(sequential.sequential_test(pairs, unit=unit).is_decided)
    assert np.mean(np.array(tests) < 0.05) <= REJECTS
    assert np.mean(decided) <= REJECTS
    assert np.mean(hits) >= COVERS


def test_a_grid_is_no_sample():
    exp = study(GRID)
    rows = points(exp).assign(point_id=lambda t: np.arange(len(t)).astype(str))
    rows = judged(rows, linear(rows) < np.sqrt(2))
    assert np.isnan(pooled_success_rate(rows, exp).low)
    pairs = compare.pair_rows(rows, judged(rows, linear(rows) + 0.05 / np.sqrt(8) < np.sqrt(2)))
    assert compare.pair_sampling_unit_ids(pairs, exp) is None
    found = compare.count_flips(pairs)
    assert found.lost > 0
    assert np.isnan([found.p_value, found.low, found.high]).all()
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
    """Of x2, which does nothing, beside x1, which decides, at four conditions of 160 draws: seldom a share."""
    axes = {"level": {"path": "controller.x3", "values": [0.3, 0.4, 0.5, 0.6]}} | AXES
    told = []
    for seed in range(30):
        exp = study(axes, seed, design={"num": 160})
        rows = points(exp)
        found = failing.shapley_failure_shares(
            judged(rows, rows["controller.x1"] + 0.1 * normals(rows, seed) < 0.7), exp
        )
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


def test_every_printed_interval_is_simulated():
    """A public function of the analysis that gives a 95 % interval or error, or a method that a design prints."""
    of_rates = {"success_rates", "one_at_a_time_rates", "success_rate"}  # which `success_rates_by_condition` prints
    named = {case.prints.__name__ for case in CASES} | of_rates
    for path in Path(sampling_units.__file__).parent.glob("*.py"):
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.FunctionDef) and "95 %" in (ast.get_docstring(node) or ""):
                assert node.name in named | {"_interval"} or node.name.startswith("_"), f"{path.name}: {node.name}"
    simulated = {(case.kind, case.prints) for case in CASES}
    for kind in design_kinds.DESIGN_BY_KIND:
        if not design_kinds.is_adaptive_kind(kind):
            for function in sensitivity_methods(study(AXES, design={"kind": kind, "num": 128}), 10_000).values():
                assert (kind, function) in simulated


def test_every_design_has_a_simulation():
    assert {case.kind for case in CASES} - {"grid"} == set(design_kinds.DESIGN_BY_KIND)
    for kind in filter(design_kinds.is_adaptive_kind, design_kinds.DESIGN_BY_KIND):
        exp = study({"x1": {"path": "controller.x1", "distribution": EVEN}}, design={"kind": kind, "num": 100})
        rows = judged(pd.DataFrame({"controller.x1": [0.1, 0.9], "replicate": [0, 1]}), [True, False])
        assert sampling_units.unit_numbers(rows, exp) is None
        assert not is_random_sample(rows, exp)
        assert sensitivity.regional_sensitivity(rows, exp)["p"].isna().all()


def test_replicates_of_one_condition_are_independent_and_those_of_a_grid_share_their_noise():
    for values, independent in (([0.5], True), ([0.5, 0.6], False)):
        exp = study({"x1": {"path": "controller.x1", "values": values}}, replicates=40)
        assert sampling_units.has_independent_rows(points(exp), exp) == independent
