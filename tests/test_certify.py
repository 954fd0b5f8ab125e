import json
from typing import ClassVar

import numpy as np
import pandas as pd
import pytest
from fake_engine import FakeEngine
from scipy.stats import binom
from small_study import one_line

from sweep.analysis import certify
from sweep.analysis.certify import CertifiedRegion
from sweep.cli.certification import format_certificate
from sweep.cli.main import main
from sweep.core.errors import InputError
from sweep.core.expressions import condition_mask
from sweep.report.page import opening
from sweep.runs import results

DRAWS = """scenario: walk_tripod
study:
  name: draws
  design: {num: 1024}
  axes:
    friction: {path: contact.friction, side: world, distribution: {kind: uniform, from: 0.3, to: 1.2}}
    step: {path: manoeuvre.half_step_ratio, distribution: {kind: uniform, from: 0.03, to: 0.12}}
"""


def drawn(number, rng):
    """Rows that fail with a probability that grows along a direction of six parameters: 6 % in all."""
    x = rng.uniform(-1, 1, (number, 6))
    odds = 8 * (x @ np.arange(1, 7) ** -0.5 - 1.45)
    return x, rng.random(number) < 1 / (1 + np.exp(-odds))


def certified(shape, learning, fresh, failures, confidence):
    least = certify.required_failure_free_rows(failures, confidence) / len(fresh[0])
    return certify.certify_largest_region(
        certify.learn_region_score(shape, *learning, least), learning, fresh, failures, confidence
    )


def test_the_bound_is_the_exact_one():
    assert certify.required_failure_free_rows(1e-2, 0.95) == 299
    assert certify.required_failure_free_rows(1e-5, 0.95) == 299_572
    for failed, rows in ((0, 299), (3, 800)):
        assert binom.cdf(failed, rows, certify.failure_upper_bound(failed, rows, 0.95)) == pytest.approx(0.05)
    assert certify.most_failures_that_certify(298, 1e-2, 0.95) == -1
    assert certify.most_failures_that_certify(473, 1e-2, 0.95) == 1  # 1 of 473 is bounded by 0.9997 %
    assert certify.most_failures_that_certify(472, 1e-2, 0.95) == 0


def test_a_region_chosen_in_a_fixed_order_is_rarely_wrong_and_the_one_that_looks_best_often_is():
    rng = np.random.default_rng(0)
    truth, fails = drawn(100_000, rng)
    wrong, naive, share = [], [], []
    for _ in range(60):
        learning, fresh = drawn(800, rng), drawn(1500, rng)
        found = certified("score", learning, fresh, 1e-2, 0.9)
        scores, own = found.score(truth), found.score(fresh[0])
        wrong.append(found.is_certified and fails[scores <= found.threshold].mean() > 1e-2)
        share.append((scores <= found.threshold).mean() if found.is_certified else 0.0)
        order = np.argsort(own)
        good = np.flatnonzero(np.cumsum(fresh[1][order]) / np.arange(1, len(order) + 1) <= 1e-2)
        naive.append(fails[scores <= own[order][good[-1]]].mean() > 1e-2)
    assert np.mean(share) > 0.5  # it is no promise of nothing
    # 10 % are allowed: of 60 at most 12 with a probability of 99 %
    assert np.sum(wrong) <= 12
    assert np.mean(naive) > 0.25  # the largest region with a small observed rate


@pytest.mark.parametrize("shape", certify.SHAPES)
def test_a_region_is_a_condition_that_chooses_the_same_rows(shape):
    rng = np.random.default_rng(1)
    learning, fresh = drawn(3000, rng), drawn(6000, rng)
    found = certified(shape, learning, fresh, 0.03, 0.95)
    assert found.is_certified
    names = [f"robot.p{k}" for k in range(6)]
    rows = pd.DataFrame(fresh[0], columns=names)
    assert (
        condition_mask(rows, found.score.format_region_condition(names, found.threshold)) == found.contains(fresh[0])
    ).all()
    assert found.failure_probability_bound <= 0.03 < fresh[1].mean()


def test_nothing_is_certified_where_it_cannot_be():
    rng = np.random.default_rng(2)
    x = rng.random((2000, 2))
    everywhere = rng.random(2000) < 0.2
    half = (x[:1000], everywhere[:1000]), (x[1000:], everywhere[1000:])
    assert not certified("box", *half, 1e-2, 0.95).is_certified
    with pytest.raises(InputError, match=r"100 fresh rows cannot certify 0\.01 at 95\.0%: at least 299"):
        certified("box", half[0], (x[:100], everywhere[:100]), 1e-2, 0.95)


class WideEngine(FakeEngine):
    """Its best width is that of all draws."""

    made: ClassVar = []

    def __init__(self, settings, world, belief, limits):
        super().__init__(settings, world, belief, limits)
        self.width = settings.width or 2000
        self.made.append(settings.width)


@pytest.mark.parametrize("fake_engine", [WideEngine], indirect=True)
def test_a_study_is_certified_by_fresh_draws_and_checked_where_it_looks_worst(
    fake_engine, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "draws.yaml").write_text(DRAWS)
    assert main(["run", "study=draws.yaml", "out=d"]) == 0
    capsys.readouterr()
    command = [
        "certify",
        "d",
        "--shape",
        "ellipsoid",
        "--rollouts",
        "1500",
        "--confidence",
        "0.975",
        "-o",
        "region.json",
    ]
    WideEngine.made.clear()
    assert main(command) == 0
    assert WideEngine.made == [0, 1500]  # whose best width is asked for, and one for fresh draws and checks
    first = capsys.readouterr().out
    assert "with a confidence of 97.5 % at most 1 % of the study's draws" in first
    assert "where the region looks worst" in first
    region = json.loads((tmp_path / "region.json").read_text())
    assert region["certified"]
    assert [one["rollouts"] for one in region["checked"]] == [64, 64]
    assert region["next_rows"] > region["rows"] > 900
    assert main(["table", "d", "--where", region["where"], "--format", "csv", "-o", "inside.csv"]) == 0
    inside = pd.read_csv("inside.csv")
    # it fails where friction < 5 x step, by the fake engine's law
    assert 0.6 < len(inside) / 1024 < 0.95
    assert (inside["outcome"] != "success").mean() < 0.02
    capsys.readouterr()
    assert main(command) == 0  # nothing is simulated again
    assert capsys.readouterr().out == first
    shown = opening.describe_region(found := results.read_results(tmp_path / "d"))
    assert shown
    assert ((shown[1].codes == 0) == condition_mask(found.rows, region["where"])).all()
    assert shown[0]["start"] == ["world.contact.friction", "manoeuvre.half_step_ratio"]  # that the fake engine reads
    ends = np.concatenate([np.reshape(line, (-1, 2)) for line in shown[0]["outlines"][0]["lines"]])
    kept = CertifiedRegion.from_values(region["region"])
    score = kept.score(pd.DataFrame(ends, columns=shown[0]["start"])[kept.names].to_numpy())
    assert score == pytest.approx(np.full(len(ends), kept.threshold), abs=0.05)
    assert main(["relabel", "d", "tilt_max_deg<50"]) == 0  # what was certified is another study's now
    assert opening.describe_region(results.read_results(tmp_path / "d")) is None


def test_draws_of_which_none_fails_leave_regions_in_no_order(fake_engine, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "draws.yaml").write_text(DRAWS.replace("from: 0.3", "from: 0.9"))
    assert main(["run", "study=draws.yaml", "out=d", "engine.width=256"]) == 0
    assert main(["certify", "d"]) == 0
    out = capsys.readouterr().out
    assert "there is no larger region" in out
    assert "no region can be formed: none of the rows to fit it to failed; draw from wider distributions" in out


def test_nothing_is_simulated_where_all_rows_to_learn_from_fail(fake_engine, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "draws.yaml").write_text(DRAWS.replace("from: 0.3, to: 1.2", "from: 0.05, to: 0.1"))
    assert main(["run", "study=draws.yaml", "out=d", "engine.width=256"]) == 0
    assert main(["certify", "d", "--rollouts", "1500"]) == 2
    assert "no region can be formed: none of the rows to fit it to succeeds" in capsys.readouterr().err
    assert not (tmp_path / "d" / "certify").exists()


def test_a_small_promise_keeps_its_digits():
    x = np.linspace(0, 1, 80_000)[:, None]
    fails = x[:, 0] > 0.9
    found = certified("box", (x[::2], fails[::2]), (x[1::2], fails[1::2]), 1e-4, 0.95)
    assert "with a confidence of 95 % at most 0.01 % of the study's draws" in format_certificate(
        found, "box", ["friction"]
    )


@pytest.mark.parametrize(
    ("more", "line"),
    [
        (["--failures", "0"], "--failures = 0 is not allowed: between 0 and 1"),
        (["--rollouts", "200"], "--rollouts = 200 is not allowed: 0.01 at 95 % takes at least 299"),
    ],
)
def test_numbers_that_mean_nothing_are_refused(more, line, tmp_path, capsys):
    assert main(["certify", str(tmp_path), *more]) == 2
    assert line in capsys.readouterr().err


def test_a_map_is_no_sample_to_certify(fake_engine, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert (
        main(
            ["run", "study=walk_map", "study.axes.friction.num=6", "study.axes.step.num=5", "study.expect=[]", "out=m"]
        )
        == 0
    )
    capsys.readouterr()
    assert main(["certify", "m"]) == 2
    one_line(capsys.readouterr().err, "walk_map has 30 rollouts (the points were chosen: no random sample)")


def test_certify_counts_draws_as_stats_does(fake_engine, tmp_path, capsys):
    axis = "+study.axes.f={path: contact.friction, side: world, distribution: {kind: uniform, from: 0.2, to: 1.2}}"
    study = ["scenario=walk_tripod", "scenario.expect=[]", "study.design.num=8", axis]
    for more, told in (
        (["study.replicates=3"], "24 rollouts (8 independent draws)"),
        (["study.design.kind=latin_hypercube"], "8 rollouts (8 draws, spread more evenly than independent ones)"),
    ):
        out = str(tmp_path / told[:2].strip())
        assert main(["run", *study, *more, f"out={out}"]) == 0
        capsys.readouterr()
        assert main(["certify", out]) == 2
        one_line(capsys.readouterr().err, told)
        assert main(["stats", out]) == 0
        assert told.partition("(")[2].removesuffix(")") in capsys.readouterr().out
