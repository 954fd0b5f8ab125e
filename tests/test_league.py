"""Rankings of policies whose success rates are known, and the command on rows of a small study."""

import re

import numpy as np
import pandas as pd
import pytest
from small_study import one_line

from sweep.analysis import league
from sweep.analysis.compare import sign_flip_p_value
from sweep.analysis.sequential import sequential_test
from sweep.cli.main import main
from sweep.runs import store

RATES = np.array([0.5, 0.52, 0.7, 0.9])
NAMES = ("a", "b", "c", "d")


def outcomes(rates, points, seed):
    """Outcomes of policies at the same points: whether a common number, and one of each policy, are small enough."""
    rng = np.random.default_rng(seed)
    return np.where(rng.random((points, 1)) < 0.5, rng.random((points, 1)), rng.random((points, len(rates)))) < rates


def rows_of(rates, points, seed, unit=None):
    own = np.arange(points) if unit is None else unit
    return league.PairedPolicyOutcomes(NAMES[: len(rates)], outcomes(rates, points, seed), own, pd.DataFrame(), ())


def test_verdicts_and_intervals_hold_together():
    """Of 60 leagues with two equal policies at most 5 % have a wrong verdict, a wrong rate or a wrong difference."""
    rates = np.array([0.5, 0.5, 0.7, 0.9])
    truth = np.array([x - y for k, x in enumerate(rates) for y in rates[k + 1 :]])
    wrong, better = np.zeros(3), np.zeros((4, 4), bool)
    for seed in range(60):
        one = rows_of(rates, 150, seed)
        pairs, table = league.pairwise_test_table(one), league.policy_success_rates(one)
        better = league.decided_win_matrix(pairs, NAMES)
        wrong += [
            (better & (rates[:, None] <= rates)).any(),
            ((table["low"] > rates) | (table["high"] < rates)).any(),
            ((pairs["low"] > truth) | (pairs["high"] < truth)).any(),
        ]
    assert (wrong / 60 <= 0.05 + 0.05).all(), wrong
    assert better[3, 0]


def test_a_pair_alone_is_the_test_of_compare():
    one = rows_of(np.array([0.5, 0.7]), 60, 3)
    change = one.success[:, 0].astype(int) - one.success[:, 1]
    assert league.pairwise_test_table(one)["p_holm"].iloc[0] == pytest.approx(sign_flip_p_value(change))


def test_copies_of_a_draw_decide_nothing_more():
    """Ten equal rows of each draw are one observation: rates, p-values and intervals stay as wide."""
    draws = rows_of(RATES, 40, 1)
    unit = np.repeat(np.arange(40), 10)
    copies = league.PairedPolicyOutcomes(NAMES, np.repeat(draws.success, 10, axis=0), unit, pd.DataFrame(), ())
    for column in ("difference", "low", "high", "p_holm"):
        np.testing.assert_allclose(
            league.pairwise_test_table(copies)[column], league.pairwise_test_table(draws)[column], atol=1e-9
        )
    wide, narrow = (league.policy_success_rates(one)[["low", "high"]].to_numpy() for one in (copies, draws))
    assert (np.diff(wide) > 0.95 * np.diff(narrow)).all()


def test_places_follow_from_verdicts():
    table = league.policy_success_rates(rows_of(RATES, 800, 0))
    better = np.array([[0, 0, 0, 0], [0, 0, 0, 0], [1, 1, 0, 0], [1, 1, 1, 0]], bool)
    assert dict(zip(*league.standings(table, better)[["policy", "places"]].to_numpy().T, strict=True)) == {
        "d": "1", "c": "2", "a": "3 to 4", "b": "3 to 4"
    }  # fmt: skip


def test_conditions_have_their_own_best_policies():
    """A wins on ice and B on sand; together they are equal."""
    ice = np.repeat([[True, False], [False, True]], 60, axis=0)
    ground = pd.DataFrame({"ground": ["ice"] * 60 + ["sand"] * 60})
    rows = league.PairedPolicyOutcomes(("a", "b"), ice, np.arange(120), ground, ())
    assert list(league.policy_success_rates_by_condition(rows, ["ground"])["best"]) == ["a", "b"]
    assert league.pairwise_test_table(rows)["verdict"].iloc[0] == league.NOT_DECIDED


def test_a_race_of_two_is_the_sequential_test():
    won = outcomes(np.array([0.5, 0.8]), 200, 0)
    names = np.where(won, "success", "failure")
    pairs = pd.DataFrame({"replicate": range(200), "outcome": names[:, 0], "outcome (B)": names[:, 1]})
    found, race = sequential_test(pairs), league.PolicyRace(2)
    race.add_unit_success_rates(won[: found.pairs - 1].astype(float))
    assert not race.better.any()
    race.add_unit_success_rates(won[found.pairs - 1 : found.pairs].astype(float))
    assert race.better.tolist() == [[False, False], [True, False]]


def test_a_race_decides_what_follows_and_is_rarely_wrong():
    race = league.PolicyRace(3)
    race.add_unit_success_rates(np.tile([[1.0, 1.0, 0.0], [1.0, 0.0, np.nan], [1.0, 0.0, np.nan]], (9, 1)))
    assert race.better.tolist() == [[False, True, True], [False, False, True], [False, False, False]]
    race = league.PolicyRace(3)  # A beats B, B beats C, A and C never meet
    race.add_unit_success_rates(np.tile([[np.nan, 1.0, 0.0], [1.0, 0.0, np.nan]], (20, 1)))
    assert race.better[0, 2]
    wrong = 0
    for seed in range(60):  # stopped policies have no more outcomes
        race, won = league.PolicyRace(4), outcomes(np.array([0.6, 0.6, 0.6, 0.9]), 600, seed).astype(float)
        for start in range(0, 600, 60):
            is_open = race.undecided_policies()
            race.add_unit_success_rates(np.where(is_open, won[start : start + 60], np.nan))
        wrong += race.better[:3, :3].any()
        assert race.better[3].sum() + race.better[:, 3].sum() > 0
    assert wrong / 60 <= 0.05 + 0.05


DRAWS = """scenario: walk_tripod
study:
  name: draws
  design: {num: 40}
  axes:
    friction: {path: contact.friction, side: world, distribution: {kind: uniform, from: 0.05, to: 0.5}}
"""


@pytest.fixture
def three(fake_engine, tmp_path, monkeypatch):
    """Folders of three policies: the fake engine walks on friction above 5 half_step_ratio."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "draws.yaml").write_text(DRAWS)
    for name, step in (("far", 0.08), ("middle", 0.075), ("near", 0.02)):
        assert main(["run", "study=draws.yaml", f"manoeuvre.half_step_ratio={step}", f"out={name}"]) == 0
    return ["far", "middle", "near"]


def test_folders_are_ranked(three, capsys, tmp_path):
    assert main(["report", "near"]) == 0
    capsys.readouterr()
    words = ["--by", "friction", "-o", "pairs.csv", "--picture", "league.png", "--page", "league.html"]
    assert main(["league", *three, *words]) == 0
    printed = capsys.readouterr().out
    assert "3 policies on the same 40 points (40 draws)" in printed
    rates = [(store.read_rows(tmp_path / name)["outcome"] == "success").mean() for name in three]
    pairs = pd.read_csv("pairs.csv")
    np.testing.assert_allclose(pairs["difference"], [rates[0] - rates[1], rates[0] - rates[2], rates[1] - rates[2]])
    assert list(pairs["verdict"]) == ["not decided", "near", "near"]
    assert (tmp_path / "league.png").stat().st_size > 5000
    page = (tmp_path / "league.html").read_text()
    assert "near is the best policy; 2 of 3 pairs are decided." in page
    assert re.findall(r'<tr><td data-value="(\w+)">(<a href="near/report.html">)?', page) == [
        ("near", '<a href="near/report.html">'), ("middle", ""), ("far", "")
    ]  # fmt: skip
    assert [float(one) for one in re.findall(r'<td data-value="([\d.]+)">[\d.]+ %</td>', page)] == rates[::-1]


def test_a_race_simulates_only_policies_that_are_not_decided(three, capsys, tmp_path):
    capsys.readouterr()
    assert main(["league", *three, "--anytime", "--most", "400"]) == 0
    printed = capsys.readouterr().out
    sizes = [len(store.read_rows(tmp_path / name)) for name in three]
    assert sizes[2] < sizes[0] == sizes[1] <= 400, printed
    assert "3 of 3 pairs are decided" in printed


def test_an_axis_of_policies_is_ranked(fake_engine, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "draws.yaml").write_text(
        DRAWS + "    step: {path: manoeuvre.half_step_ratio, side: belief, values: [0.02, 0.06, 0.08]}\n"
    )
    assert main(["run", "study=draws.yaml", "out=all"]) == 0
    capsys.readouterr()
    assert main(["league", "all", "--axis", "step"]) == 0
    assert "3 policies on the same 40 points (40 draws)" in capsys.readouterr().out


def test_what_cannot_be_ranked_is_refused(three, capsys):
    for words, message in (
        (["far"], "give the folder of each policy"),
        ([*three, "--axis", "friction"], "--axis ranks the values of an axis of one folder"),
        (["far", "--axis", "step"], "step"),
        ([*three, "--most", "9"], "--most is for --anytime"),
        ([*three, "--anytime", "--by", "friction"], "--by is not allowed with --anytime"),
        ([*three, "--level", "1"], "--level = 1 is not allowed"),
    ):
        capsys.readouterr()
        assert main(["league", *words]) == 2
        one_line(capsys.readouterr().err, message)
