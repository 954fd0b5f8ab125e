"""`sweep power` beside simulated studies, and beside sums over all outcomes of small ones."""

import itertools
import json

import interval_coverage
import numpy as np
import pytest
from scipy.stats import binom, chi2_contingency
from small_study import one_line

from sweep.analysis import power, sampling_units
from sweep.analysis.compare import sign_flip_p_value
from sweep.analysis.intervals import wilson
from sweep.cli.main import main
from sweep.core.errors import InputError


def test_a_rate_is_as_narrow_as_asked_in_nine_of_ten_studies():
    size = power.rollouts_for_half_width(0.9, 0.02)

    def share(trials):
        low, high = wilson(np.random.default_rng(1).binomial(trials, 0.9, 20_000), trials)
        return np.mean((high - low) / 2 <= 0.02)

    assert 0.9 - 0.01 < share(size) < 0.95
    assert share(round(0.97 * size)) < 0.87


@pytest.mark.parametrize(("pairs", "lost", "gained"), [(9, 0.6, 0.1), (12, 0.3, 0.3), (7, 0.5, 0.0)])
def test_the_power_of_paired_tests_is_a_sum_over_all_outcomes(pairs, lost, gained):
    total = 0.0
    for b, c in itertools.product(range(pairs + 1), repeat=2):
        if 0 < b + c <= pairs and sign_flip_p_value(np.repeat([1, -1], [b, c])) <= 0.05:
            total += binom.pmf(b + c, pairs, lost + gained) * binom.pmf(b, b + c, lost / (lost + gained))
    assert power.mcnemar_power(pairs, lost, gained) == pytest.approx(total, abs=1e-9)
    differences = np.repeat([1, -1, 0], [round(100 * lost), round(100 * gained), round(100 * (1 - lost - gained))])
    assert power.simulated_sign_flip_power(differences, pairs) == pytest.approx(total, abs=0.05)


def test_the_power_of_unpaired_tests_is_a_sum_over_all_outcomes():
    total = 0.0
    for j, k in itertools.product(range(13), repeat=2):
        if 0 < j + k < 24 and chi2_contingency([[j, 12 - j], [k, 12 - k]], correction=False)[1] < 0.05:
            total += binom.pmf(j, 12, 0.9) * binom.pmf(k, 12, 0.4)
    assert power.unpaired_test_power(12, 0.9, 0.4) == pytest.approx(total, abs=1e-9)
    above, below = power.MAX_EXACT + 1, power.MAX_EXACT
    assert power.unpaired_test_power(above, 0.9, 0.895) == pytest.approx(
        power.unpaired_test_power(below, 0.9, 0.895), abs=2e-3
    )


def test_common_draws_flip_fewer_pairs():
    assert power.discordant_pair_shares(0.9, 0.8, 0.0) == pytest.approx((0.18, 0.08))
    assert power.discordant_pair_shares(0.9, 0.8, 0.5) == pytest.approx((0.12, 0.02))
    with pytest.raises(InputError, match=r"to 0\.667"):
        power.discordant_pair_shares(0.9, 0.8, 0.9)


def test_a_region_is_certified_as_often_as_said():
    """A region of all draws without failures needs 299 draws (0.99 ** 299 < 0.05)."""
    assert power.certification_power(298, 1 - 1e-15, 0.0, 0.01, 0.95) == 0
    assert power.certification_power(299, 1 - 1e-15, 0.0, 0.01, 0.95) == pytest.approx(1)
    rng = np.random.default_rng(0)
    inside = rng.binomial(1000, 0.6, 4000)
    bounds = binom.cdf(rng.binomial(inside, 0.001), inside, 0.01) <= 0.05
    assert power.certification_power(1000, 0.6, 0.001, 0.01, 0.95) == pytest.approx(bounds.mean(), abs=0.02)


@pytest.mark.parametrize(
    ("design", "replicates"),
    [({"kind": "monte_carlo", "num": 64}, 10), ({"kind": "sobol", "num": 32, "scrambles": 8}, 1)],
)
def test_a_pilot_knows_the_unit_of_its_design(design, replicates):
    """The mean half-width of fresh studies is that which one of them predicts, not that of as many independent rows."""

    def rows_of(seed):
        exp = interval_coverage.study(interval_coverage.AXES, seed, design=design, replicates=replicates)
        rows = interval_coverage.points(exp)
        noise = interval_coverage.NOISE * interval_coverage.normals(rows, seed) if replicates > 1 else 0
        return exp, interval_coverage.judged(rows, rows["controller.x1"] + rows["controller.x2"] ** 2 + noise < 0.7)

    widths, number = [], 0
    for seed in range(40):
        exp, rows = rows_of(seed)
        one = sampling_units.success_rates_by_condition(rows, exp, []).iloc[0]
        widths.append((one["high"] - one["low"]) / 2)
    predicted = []
    for seed in range(100, 110):
        exp, rows = rows_of(seed)
        is_even = sampling_units.independent_unit(exp.study).is_even
        success = (rows["outcome"] == "success").to_numpy()
        unit = sampling_units.unit_numbers(rows, exp)
        assert unit is not None
        pilot, number = power.count_unit_successes(success, unit, is_even), len(rows)
        predicted.append(power.simulated_half_widths(pilot, len(pilot.won)).mean())
    assert np.mean(predicted) == pytest.approx(np.mean(widths), rel=0.15)
    of_rows = power.expected_half_width(number, 0.55)
    assert abs(np.mean(widths) / of_rows - 1) > 0.5


def test_a_dry_run_says_how_wide_intervals_will_be():
    def text(**keys):
        return power.describe_expected_half_width(interval_coverage.study(interval_coverage.AXES, **keys).study)

    plain = text(design={"kind": "monte_carlo", "num": 100})
    assert plain.startswith("expected 95 % interval, 100 draws: ±9.6 % at a rate of 50 %")
    assert power.expected_half_width(100, 0.5) == pytest.approx(0.096, abs=5e-4)
    assert "±9.6 % to ±4.4 %" in text(design={"kind": "monte_carlo", "num": 100}, replicates=5)
    assert "spreads its draws evenly" in text(design={"kind": "sobol", "num": 16, "scrambles": 4})
    assert text(design={"kind": "importance", "num": 512, "rounds": 2}) == ""


def test_the_command_answers_and_refuses(tmp_path, capsys, fake_engine):
    assert main(["power", "difference", "0.9", "0.8", "-o", str(tmp_path / "a.json")]) == 0
    assert "`sweep compare --anytime`" in capsys.readouterr().out
    answer = json.loads((tmp_path / "a.json").read_text())
    assert answer["rollouts"] == 2 * answer["size"]
    assert power.mcnemar_power(answer["size"], 0.18, 0.08) >= 0.9
    grid = str(tmp_path / "grid")
    few = ["study.axes.friction.num=4", "study.axes.step.num=3", "study.expect=[]"]
    assert main(["run", "study=walk_map", *few, f"out={grid}"]) == 0
    for words, message in (
        (["rate"], "P = none is not allowed: 1 expected, or --pilot"),
        (["rate", "1.5"], "P = 1.5 is not allowed: between 0 and 1"),
        (["rate", "0.5", "--share", "0.2"], "--share is for `sweep power region`"),
        (["difference", "0.9", "0.9"], "equal rates need infinitely many rollouts"),
        (["region", "0.1"], "P = 0.1 is not allowed: below --failures = 0.01"),
        (["rate", "--pilot", grid], "its points are no random draws"),
    ):
        capsys.readouterr()
        assert main(["power", *words]) == 2
        one_line(capsys.readouterr().err, message)
