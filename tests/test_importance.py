"""Importance sampling: unbiased where the answer is known, the same rows for a seed, and its doubts are told."""

import re
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from distant import AXES, FAR, CliffEngine
from scipy.special import ndtri
from scipy.stats import norm

from sweep.analysis import rare
from sweep.cli.main import main
from sweep.report.page import opening
from sweep.runs import results, store
from sweep.study import importance_sampling
from sweep.study.adaptive_sampling import RoundSummary
from sweep.study.design_kinds.base import DrawContext
from sweep.study.design_kinds.importance import ImportanceSampling, WeightedEstimate

far = pytest.mark.parametrize("fake_engine", [CliffEngine], indirect=True)
STUDY = [
    "run", "scenario=walk_tripod", "study.name=rare", "study.design.kind=importance", "study.design.num=512", AXES,
]  # fmt: skip


@far
def test_a_failure_of_three_in_a_hundred_thousand_is_found_and_measured(fake_engine, tmp_path, capsys):
    assert main([*STUDY, f"out={tmp_path}"]) == 0
    out = capsys.readouterr().out
    found = results.read_results(tmp_path)
    told = rare.estimate_failure_probability(found.rows, found.exp)
    assert isinstance(told, WeightedEstimate)
    truth = norm.cdf(-FAR)
    assert told.low < truth < told.high
    assert told.high / told.low < 2
    assert told.is_reliable
    assert told.equivalent_plain_draws > 1e6
    assert str(told) in out
    shown = opening.describe_estimate(found)  # what the page opens with
    assert shown
    modes, mode_of_row = shown[0]["modes"], shown[1].codes
    assert sum(mode["share"] for mode in modes) == pytest.approx(1.0)
    assert np.bincount(mode_of_row[mode_of_row >= 0]).tolist() == [mode["rows"] for mode in modes]
    assert set(found.rows["outcome"][mode_of_row >= 0]) == {"failure"}
    assert main(["stats", str(tmp_path)]) == 0
    stats = capsys.readouterr().out
    assert "fell" in stats
    assert re.search(r"fell +\| 100\.0 % +\| \d+ +\| .*friction -(2|3)\.\d", stats)
    assert "Clopper" not in stats  # the rows are no sample
    assert main(["export", str(tmp_path), "--paper", str(tmp_path / "paper")]) == 0
    text, numbers = ((tmp_path / "paper" / file).read_text() for file in ("main.tex", "numbers.tex"))
    assert r"P(failure) is \rareFailing{}, with a 95\,\% interval from \rareFailingLow{} to \rareFailingHigh{}." in text
    digits, power = re.findall(r"\\rareFailing}{\$(.+)\\cdot10\^{(-5)}\$}", numbers)[0]
    assert float(f"{digits}e{power}") == pytest.approx(told.probability, rel=0.02)


@pytest.mark.slow
@far
def test_a_run_in_parts_draws_the_same(fake_engine, tmp_path):
    assert main([*STUDY, f"out={tmp_path / 'a'}"]) == 0
    assert main([*STUDY, "--limit", "200", f"out={tmp_path / 'b'}"]) == 0
    assert main([*STUDY, f"out={tmp_path / 'b'}"]) == 0
    a, b = (store.read_rows(tmp_path / name).sort_values("replicate") for name in "ab")
    assert len(a) == 3 * 512
    assert a["point_id"].tolist() == b["point_id"].tolist()
    assert a["stream"].nunique() == len(a)  # each with noise of its own
    assert main([*STUDY, f"out={tmp_path / 'b'}", "outcome.tilt_max_deg=50"]) == 2  # drawn by other failures


def repeated(d, bounds, num=400, rounds=2, times=200):
    """Estimates of how often a sum, or one of two, is far off, and how often their intervals hold the truth."""
    fails = [lambda u: u.sum(axis=1) / np.sqrt(d) < -bounds[0], lambda u: u[:, 0] > bounds[1]]

    def failed(draws):
        return np.any([f(ndtri(draws.quantiles)) for f in fails], axis=0)

    found = []
    for seed in range(times):
        search = importance_sampling.start_search(d, num, 2.5, rounds, seed)
        draws = next(search)
        for _ in range(rounds):
            draws = search.send(RoundSummary(failed(draws), np.zeros(num)))
        found.append(draws.columns["weight"] @ failed(draws) / num)
        assert draws.columns["weight"].max() <= 1 / importance_sampling.PLAIN_SHARE + 1e-9
    return np.array(found)


@pytest.mark.parametrize(("d", "bounds"), [(2, (3.0, np.inf)), (2, (3.5, 3.5)), (8, (3.0, np.inf))])
def test_its_mean_is_the_truth(d, bounds):
    found = repeated(d, bounds)
    truth = norm.sf(bounds[0]) + norm.sf(bounds[1])
    if np.isfinite(bounds[1]):  # both at once, the sum having the correlation -1/sqrt(2) with the first
        both = np.random.default_rng(0).standard_normal((4_000_000, d))
        truth -= np.mean((both.sum(axis=1) / np.sqrt(d) < -bounds[0]) & (both[:, 0] > bounds[1]))
    assert abs(found.mean() - truth) < 4 * found.std() / np.sqrt(len(found))
    assert found.std() / truth < 0.35


def test_without_a_failure_there_is_a_bound_and_one_heavy_row_is_told():
    rows = pd.DataFrame({"axis.round": 1.0, "axis.weight": np.ones(300), "outcome": "success", "cause": ""})

    design, ctx = ImportanceSampling(num=300, rounds=1), DrawContext((), 0)
    none = design.estimate_failure(rows, ctx)
    assert none.high == pytest.approx(0.01 / importance_sampling.PLAIN_SHARE, rel=0.02)
    assert str(none).endswith("try a larger study.design.wide, more draws, or wider distributions")
    rows.loc[:9, "outcome"] = "failure"
    rows.loc[0, "axis.weight"] = 3.0
    assert "NOT reliable: one row carries 25%" in str(design.estimate_failure(rows, ctx))
    every = design.estimate_failure(rows.assign(outcome="failure", **{"axis.weight": 1.3}), ctx)
    assert (every.low, every.probability, every.high) == (1.0, 1.0, 1.0)  # whatever weights sum to


@pytest.mark.parametrize(
    ("argument", "told"),
    [
        ("study.design.wide=7", "study.design.wide = 7 is not allowed: from 1 to 5"),
        ("study.design.rounds=0", "study.design.rounds = 0 is not allowed: at least 1"),
        ("study.design.num=1", "study.design.num = 1 is not allowed: at least 2"),
        ("study.design.runs=8", "study.design.runs = 8 is not allowed with study.design.kind = importance"),
        ("study.design.lead=tilt_max_deg", "study.design.lead = tilt_max_deg is not allowed with study.design.kind"),
        ("study.points=rows.csv", "study.points is not allowed with study.design.kind = importance"),
        ("study.axes.step={path: manoeuvre.half_step_ratio, values: [0.1, 0.2]}", "not allowed with listed axes: step"),
    ],
)
def test_what_it_cannot_do_is_refused(fake_engine, tmp_path, capsys, argument, told):
    assert main([*STUDY, f"out={tmp_path}", argument.replace("study.axes.step", "+study.axes.step")]) == 2
    assert told in capsys.readouterr().err


def test_modes_are_apart_however_they_are_caused():
    rng, n = np.random.default_rng(0), 40_000
    u = 2.0 * rng.standard_normal((n, 3))
    weight = np.prod(norm.pdf(u) / norm.pdf(u, scale=2.0), axis=1)
    low, high = u[:, 0] < -2.8, u[:, 1] + u[:, 2] > 4.2  # of probabilities 2.6e-3 and 1.5e-3
    rows = pd.DataFrame(u, columns=list("abc")).assign(**{"axis.round": 1, "axis.weight": weight, "cause": ""})
    rows.loc[low, "cause"] = "slipped"
    rows.loc[high & ~low, "cause"] = np.where(rng.random((high & ~low).sum()) < 0.25, "slipped", "fell")
    rows["outcome"] = np.where(low | high, "failure", "success")
    study = SimpleNamespace(adaptive_design=ImportanceSampling(rounds=1), draw_context=DrawContext((), 0))
    study.axes = [SimpleNamespace(name=name, column=name) for name in "abc"]
    found = rare.failure_modes(rows, SimpleNamespace(study=study))  # pyright: ignore[reportArgumentType]
    assert found["share"].tolist() == pytest.approx([0.635, 0.365], abs=0.05)
    assert found["cause"][0].startswith("slipped")  # and what falls beside it
    assert re.fullmatch(r"fell 7\d%, slipped 2\d%", found["cause"][1])
    where = found["where, in standard deviations"]
    assert re.match(r"a -3\.\d", where[0])
    assert re.match(r"[bc] \+2\.\d, [bc] \+2\.\d, a", where[1])
