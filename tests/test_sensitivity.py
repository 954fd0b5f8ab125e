from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from sweep.analysis import screening, sensitivity
from sweep.analysis.stats import success_rates
from sweep.config.experiment import compose
from sweep.core.errors import InputError
from sweep.report.statistics import statistics_sections
from sweep.study.study import Study, make_points

SHIN = {"path": "robot.shin", "distribution": {"kind": "uniform", "from": 0.3, "to": 0.4}}
THIGH = {"path": "robot.thigh", "distribution": {"kind": "uniform", "from": 0.5, "to": 0.6}}
MASS = {"path": "robot.body_mass", "distribution": {"kind": "uniform", "from": 9.0, "to": 11.0}}


@pytest.fixture(scope="module")
def nominal():
    return compose([])


@pytest.fixture
def study(nominal):
    """An experiment over axes and its points, each judged by a function of the table."""

    def build(axes, succeeds, **keys):
        chosen = Study.parse({**nominal.values["study"], "axes": axes, **keys}, single=False)
        table = make_points(chosen, nominal.system, nominal.settings)
        outcome = np.where(succeeds(table), "success", "failure")
        return replace(nominal, study=chosen), table.assign(outcome=outcome)

    return build


def unit(table, column, low, width):
    return (table[column] - low) / width


def quarter_disc(table):
    """A region of volume pi / 4."""
    return unit(table, "robot.shin", 0.3, 0.1) ** 2 + unit(table, "robot.thigh", 0.5, 0.1) ** 2 < 1


@pytest.mark.parametrize(
    "design",
    [
        {"kind": "monte_carlo", "num": 256},
        {"kind": "latin_hypercube", "num": 256},
        {"kind": "sobol", "num": 64, "scrambles": 8},
    ],
)
def test_the_interval_of_a_volume_covers_it(study, design):
    hits, widths = [], []
    for seed in range(30):
        exp, rows = study({"shin": SHIN, "thigh": THIGH}, quarter_disc, design=design, seed=seed)
        line = sensitivity.success_volume(rows, exp).iloc[0]
        hits.append(line["low"] <= np.pi / 4 <= line["high"])
        widths.append(line["high"] - line["low"])
    assert np.mean(hits) >= 0.83  # 95 % less 3 standard errors of 30 studies
    assert np.mean(widths) < (0.04 if design["kind"] == "sobol" else 0.12)


def test_a_volume_is_told_at_each_condition_and_invalid_rows_are_left_out(study):
    exp, rows = study({"f": {"path": "contact.friction", "values": [0.5, 1.0]}, "shin": SHIN, "thigh": THIGH},
                      quarter_disc, design={"kind": "sobol", "num": 64, "scrambles": 4})  # fmt: skip
    rows.loc[rows.index[:100], "outcome"] = "invalid"
    table = sensitivity.success_volume(rows, exp)
    assert table["contact.friction"].tolist() == [0.5, 1.0]
    assert table["invalid"].tolist() == [100, 0]
    np.testing.assert_allclose(table["share"], np.pi / 4, atol=0.06)


def test_a_grid_brackets_the_volume(study):
    ends = {"num": 21, "from": 0.3, "to": 0.4}
    exp, rows = study({"shin": {"path": "robot.shin", **ends},
                       "thigh": {"path": "robot.thigh", "num": 21, "from": 0.5, "to": 0.6}}, quarter_disc)  # fmt: skip
    found = sensitivity.grid_success_volume(rows, exp)
    assert found.low < np.pi / 4 < found.high
    assert found.share == pytest.approx(np.pi / 4, abs=0.02)
    assert found.high - found.low == pytest.approx(2 * 20 / 400, abs=0.03)  # a circle cuts about 2 n of n^2 cells
    assert found.invalid == 0
    rows.loc[rows.index[3], "outcome"] = "invalid"
    again = sensitivity.grid_success_volume(rows, exp)
    assert again.low < found.low
    assert again.invalid == 1


def test_margins_reach_from_nominal_to_the_boundary(study):
    axes = {
        "shin": {"path": "robot.shin", "values": [0.25, 0.3, 0.35, 0.4]},  # 0.335 nominally
        "friction": {"path": "contact.friction", "side": "world", "from": 0.2, "to": 1.0, "num": 5},
    }
    exp, rows = study(axes, lambda t: (t["world.contact.friction"] > 0.5) & (t["robot.shin"] < 0.38))
    found = sensitivity.success_ranges_around_nominal(rows, exp).set_index(["axis", "side"])
    shin = found.loc["robot.shin"]
    assert shin.loc["above", ["holds_to", "fails_at"]].tolist() == [0.35, 0.4]
    assert shin.loc["below", "holds_to"] == 0.25
    assert np.isnan(shin.loc["below", "fails_at"])
    friction = found.loc[("world.contact.friction", "below")]
    assert friction[["holds_to", "fails_at", "margin"]].tolist() == pytest.approx([0.6, 0.4, 0.4])
    assert ("world.contact.friction", "above") not in found.index


def test_the_logistic_fit_finds_the_curve_and_its_intervals_cover():
    rng = np.random.default_rng(1)
    x = np.repeat([0.0, 0.01, 0.02, 0.04, 0.08], 32)
    truth, at = 1 / (1 + np.exp(-(4 - 150 * x))), (4 - np.log(9)) / 150  # P falls to 0.9 at `at`
    hits, inside, fits = [], [], []
    for _ in range(400):
        success = rng.random(len(x)) < truth
        fit = sensitivity.fit_logistic(x, success)
        fits.append(sensitivity.goodness_of_fit_p_value(fit, x, success))
        low, high = fit.x_at_probability(0.9)[1]
        hits.append(low <= at <= high)
        _, band = fit.probability(0.03)
        inside.append(band.low <= 1 / (1 + np.exp(-(4 - 150 * 0.03))) <= band.high)
    assert 0.92 <= np.mean(hits) <= 0.99
    assert 0.92 <= np.mean(inside) <= 0.99
    assert np.mean(np.array(fits) < 0.05) < 0.1


def test_a_fit_that_the_rates_do_not_follow_is_told():
    x, rng = np.repeat([0.0, 0.2, 0.4, 0.6, 0.65, 0.7], 100), np.random.default_rng(3)
    step = rng.random(len(x)) < np.where(x < 0.62, 0.95, 0.0)
    assert sensitivity.goodness_of_fit_p_value(sensitivity.fit_logistic(x, step), x, step) < 1e-3
    assert np.isnan(
        sensitivity.goodness_of_fit_p_value(sensitivity.fit_logistic(x, step), x + rng.random(len(x)), step)
    )  # all differ


def test_the_logistic_fit_survives_a_clear_cut_and_the_lack_of_any():
    x = np.repeat([1.0, 2.0, 3.0, 4.0], 20)
    assert 2 < sensitivity.fit_logistic(x, x < 2.5).x_at_probability(0.5)[0] < 3
    assert sensitivity.fit_logistic(x, np.ones(80)).x_at_probability(0.9)[1].high == np.inf


def test_the_tolerance_to_an_error_is_told_on_either_side(study):
    rng = np.random.default_rng(2)

    def succeeds(table):
        error = table["axis.error"]
        return rng.random(len(table)) < 1 / (1 + np.exp(-(5 - np.where(error > 0, 200, 50) * np.abs(error))))

    axes = {"error": {"path": "robot.shin", "side": "belief", "relative": 1, "from": -0.08, "to": 0.08, "num": 9},
            "f": {"path": "contact.friction", "values": [0.5, 1.0]}}  # fmt: skip
    exp, rows = study(axes, succeeds, replicates=100)
    found = sensitivity.tolerated_parameter_errors(rows, exp, 0.5).query("axis == 'axis.error'").set_index("side")
    for side, expected in (("above", 5 / 200), ("below", 5 / 50)):
        assert found.loc[side, "low"] < expected < found.loc[side, "high"]
    assert (found["total"] == 5 * 100).all()  # at the nominal friction only
    rows["outcome"] = np.where(np.arange(len(rows)) % 2, "success", "failure")
    assert (sensitivity.tolerated_parameter_errors(rows, exp, 0.9)["error"] == 0).all()


def test_regional_sensitivity_puts_what_matters_first(study):
    exp, rows = study({"shin": SHIN, "thigh": THIGH, "mass": MASS}, lambda t: t["robot.thigh"] < 0.56,
                      design={"num": 400})  # fmt: skip
    found = sensitivity.regional_sensitivity(rows, exp).set_index("axis")
    assert found.index[0] == "robot.thigh"
    assert found.loc["robot.thigh", "distance"] == 1
    assert found.loc["robot.thigh", "median_success"] < found.loc["robot.thigh", "median_failure"]
    assert (found["p"][1:] > 1e-3).all()
    with pytest.raises(InputError, match="successes and failures"):
        sensitivity.regional_sensitivity(rows[rows["outcome"] == "success"], exp)


def test_sobol_indices_are_those_of_a_known_function(study):
    exp, rows = study({"shin": SHIN, "thigh": THIGH, "mass": MASS}, lambda t: t["robot.thigh"] < 0.55,
                      design={"kind": "saltelli", "num": 512})  # fmt: skip
    u = {c: unit(rows, c, *e) for c, e in (("robot.shin", (0.3, 0.1)), ("robot.thigh", (0.5, 0.1)))}
    # f = 4 a + 2 b + 4 (a - 1/2)(b - 1/2) of even a, b: variances 16/12, 4/12 and 16/144, of 16/9 in all
    rows["slip_max_m"] = 4 * u["robot.shin"] + 2 * u["robot.thigh"]
    rows["slip_max_m"] += 4 * (u["robot.shin"] - 0.5) * (u["robot.thigh"] - 0.5)
    rows = rows.sample(frac=1, random_state=0)  # their order does not matter
    found = sensitivity.sobol_indices(rows, exp, "slip_max_m")
    np.testing.assert_allclose(found["first"], [3 / 4, 3 / 16, 0], atol=0.02)
    np.testing.assert_allclose(found["total"], [13 / 16, 1 / 4, 0], atol=0.02)
    assert sensitivity.sobol_indices(rows, exp, "slip_max_m").equals(found)  # its bootstrap too
    assert sensitivity.sobol_indices(rows, exp)["first"].tolist() == pytest.approx([0, 1, 0], abs=0.05)
    rows.loc[rows["replicate"] == 7, "outcome"] = "invalid"
    assert (sensitivity.sobol_indices(rows, exp)["blocks"] == 511).all()


def test_cells_count_invalid_rows_apart():
    rows = pd.DataFrame({"x": [0, 0, 0, 1], "outcome": ["success", "failure", "invalid", "invalid"]})
    found = success_rates(rows, ["x"])
    assert found[["total", "invalid", "success"]].to_numpy().tolist() == [[3, 1, 1], [1, 1, 0]]
    assert found["share"].tolist()[0] == 0.5
    assert np.isnan(found["share"][1])


def test_elementary_effects_screen_axes(study):
    """Of y = thigh + 3 shin in units of their ranges the effects are 1 and 3 everywhere; mass has none."""
    exp, rows = study({"shin": SHIN, "thigh": THIGH, "mass": MASS}, lambda t: t["robot.shin"] > 0.35,
                      design={"kind": "morris", "num": 16})  # fmt: skip
    assert len(rows) == 16 * 4
    y = 3 * unit(rows, "robot.shin", 0.3, 0.1) + unit(rows, "robot.thigh", 0.5, 0.1)
    found = sensitivity.elementary_effects(rows.assign(y_m=y), exp, "y_m")
    assert found["axis"].tolist() == ["robot.shin", "robot.thigh", "robot.body_mass"]
    inner = 0.99  # the design leaves half a percent at either end; effects are for the whole of it
    assert found["mean_size"].to_numpy() / inner == pytest.approx([3 / inner, 1 / inner, 0], rel=0.02)
    assert found["spread"].to_numpy() == pytest.approx([0, 0, 0], abs=1e-9)
    broken = rows.assign(y_m=y, outcome=rows["outcome"].where(rows.index != 5, "invalid"))
    assert (sensitivity.elementary_effects(broken, exp, "y_m")["paths"] == 15).all()
    assert sensitivity.elementary_effects(rows, exp)["mean_size"].iloc[1:].tolist() == [0, 0]


def test_any_draws_tell_which_axes_matter(study):
    """Of y = thigh + 3 shin in units of their ranges the axes explain a tenth and nine tenths of the variance."""
    exp, rows = study({"shin": SHIN, "thigh": THIGH, "mass": MASS}, lambda t: t["robot.shin"] > 0.35,
                      design={"kind": "latin_hypercube", "num": 1000})  # fmt: skip
    rows["y_m"] = 3 * unit(rows, "robot.shin", 0.3, 0.1) + unit(rows, "robot.thigh", 0.5, 0.1)
    found = screening.rbd_fast_indices(rows, exp, "y_m")
    assert found["axis"].tolist() == ["robot.shin", "robot.thigh", "robot.body_mass"]
    assert found["first"].to_numpy() == pytest.approx([0.9, 0.1, 0], abs=0.05)
    moved = screening.pawn_indices(rows, exp, "y_m").set_index("axis")
    assert moved["median"]["robot.shin"] > moved["median"]["robot.thigh"] > moved["by_chance"].iloc[0]
    assert moved["median"]["robot.body_mass"] <= moved["by_chance"].iloc[0]
    titles = [title for title, _ in statistics_sections(rows, exp)]
    assert titles[-2:] == ["PAWN indices of success", "First Sobol indices (RBD-FAST) of success"]
    with pytest.raises(InputError, match="need 100 valid draws"):
        screening.pawn_indices(rows.head(50), exp)


@pytest.mark.parametrize(("draws", "offered"), [(20, False), (100, True)])
def test_indices_need_draws_and_not_rows(study, draws, offered):
    """Twenty draws at five grid points are a hundred rows, and no hundred draws."""
    friction = {"path": "contact.friction", "values": [0.2, 0.4, 0.6, 0.8, 1.0]}
    exp, rows = study({"f": friction, "shin": SHIN}, lambda t: t["robot.shin"] > 0.35, design={"num": draws})
    assert len(rows) == 5 * draws
    titles = [title for title, _ in statistics_sections(rows, exp)]
    assert ("Sensitivity indices of the draws" in titles) == offered


def test_a_number_is_printed_once_and_an_index_with_its_error(study):
    exp, rows = study({"shin": SHIN, "thigh": THIGH}, lambda t: t["robot.shin"] > 0.38, design={"num": 120})
    sections = dict(statistics_sections(rows, exp))
    assert "95 % interval" in sections["Rate of success"]
    assert not [title for title in sections if title.startswith("Share of the draws")]
    assert 0 < (rows["outcome"] == "success").sum() < sensitivity.MIN_RARER_OUTCOMES
    assert sections["First Sobol indices (RBD-FAST) of success"].startswith("not shown, as no error holds")


def test_a_parameter_without_influence_exceeds_the_index_by_chance_in_few_studies(study):
    """Ranks of an idle parameter are a random order of the values, whatever the values are."""
    values, rng, beyond = np.arange(128.0), np.random.default_rng(0), 0
    bound, slices = screening._median_by_chance(values), np.arange(128) * screening.PAWN_SLICES // 128
    for _ in range(4000):
        order = rng.permutation(slices)
        every = np.arange(1, 129) / 128
        within = [np.cumsum(order == k) / (order == k).sum() for k in range(screening.PAWN_SLICES)]
        beyond += np.median([np.abs(one - every).max() for one in within]) > bound
    assert beyond <= 0.06 * 4000
