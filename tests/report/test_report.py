import io
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from sweep.analysis import expectations
from sweep.analysis.expectations import unmet_expectations
from sweep.analysis.stats import success_rate
from sweep.config.experiment import compose
from sweep.core.parameters import InputError
from sweep.core.plot_style import PAGE_WIDTH_IN, add_legend_below, plot_style, save_figure
from sweep.metrics.outcome import FAILURE_MEANINGS
from sweep.report import maps, tables
from sweep.report.cells import MapCells
from sweep.report.outcome_style import marker_path
from sweep.study.study import RateExpectation

EXP = compose(["study=walk_map"])
STORED = {"config": EXP.values}


@pytest.fixture
def rows():
    """A grid of 4 by 3 with every kind of outcome, on two engines."""
    grid = pd.MultiIndex.from_product(
        [["mjx", "native"], np.linspace(0.2, 0.8, 4), [0.05, 0.1, 0.2]],
        names=["engine.name", "world.contact.friction", "manoeuvre.half_step_ratio"],
    ).to_frame(index=False)
    slides = grid["world.contact.friction"] < 4 * grid["manoeuvre.half_step_ratio"]
    outcome = np.where(slides, "failure", "success").astype(object)
    outcome[[3, 15]] = "invalid"
    cause = np.select([outcome == "invalid", slides], ["solver", "slipped"], "")
    time = np.where(slides, 1.5, np.nan)
    return grid.assign(replicate=0, slip_max_m=0.001, outcome=outcome, cause=cause, stage="walk", t_cause_s=time,
                       limit=np.where(slides, "slip_max_m", ""), margin=np.where(slides, -0.5, 0.5),
                       margin_of="slip_max_m")  # fmt: skip


def test_rate_counts_invalid_rows_apart():
    found = success_rate(pd.Series(["success"] * 8 + ["failure"] * 2 + ["invalid"] * 3))
    assert (found.valid_count, found.share) == (10, 0.8)
    assert (found.low, found.high) == pytest.approx((0.4902, 0.9433), abs=1e-4)  # Wilson, 8 of 10
    assert "no valid rollout among 1" in str(success_rate(pd.Series(["invalid"])))


def test_expectations_look_at_valid_rows(rows):
    assert not unmet_expectations(
        (RateExpectation(where="friction > 0.7 and half_step_ratio < 0.2", at_least=1.0),), rows, EXP
    )
    assert (
        len(unmet_expectations((RateExpectation(at_least=0.9), RateExpectation(where="friction > 9")), rows, EXP)) == 2
    )


def test_expectations_of_a_search_weigh_its_rows_once(monkeypatch):
    """Half of the rows failed, but they were drawn where failures are, and count for a hundredth."""
    calls = []

    def weigh(rows, exp):
        calls.append(len(rows))
        return np.where(rows["outcome"] == "failure", 0.01, 1.0), np.zeros(len(rows))

    monkeypatch.setattr(expectations.rare, "draw_and_failure_weights", weigh)
    rows = pd.DataFrame({"outcome": ["success", "failure"] * 50, "x_m": np.arange(100.0)})
    exp = SimpleNamespace(study=SimpleNamespace(is_adaptive=True))
    asked = tuple(RateExpectation(at_least=least) for least in (0.5, 0.95, 0.995))
    lines = expectations.judge_expectations(asked, rows, exp)  # pyright: ignore[reportArgumentType]
    assert [bool(line) for line in lines] == [False, False, True]
    assert "got 0.9901 of 100" in lines[2]
    assert calls == [100]


def test_tables_hold_the_rows_in_four_forms(rows):
    pd.testing.assert_frame_equal(
        pd.read_parquet(io.BytesIO(tables.render_table(rows, "parquet"))), rows, check_dtype=False
    )
    back = pd.read_csv(io.BytesIO(tables.render_table(rows, "csv"))).fillna(
        dict.fromkeys(("cause", "stage", "limit"), "")
    )
    pd.testing.assert_frame_equal(back, rows, check_dtype=False)
    page = tables.render_table(rows, "markdown", exp=EXP).decode()
    assert page.startswith("| engine   | friction (world)   | step [a_r]")
    longer = rows.assign(**{"belief.robot.shin": 1.2})
    assert "| shin (belief) [m]" in tables.render_table(longer, "markdown", exp=EXP).decode()
    assert (
        ",belief.robot.shin\n" in tables.render_table(longer, "csv", exp=EXP).decode()
    )  # the column's name, for programs
    assert sum(line.startswith("|") for line in page.splitlines()) == len(rows) + 2
    assert "- 2 solver: the contact solver left more than" in page
    latex = tables.render_table(rows, "latex", ["name", "friction", "cause", "slip_max_m"]).decode()
    assert r"\toprule" in latex
    assert r"\begin{tabular}{lrlr}" in latex
    assert r"slip max [m]" in latex
    with pytest.raises(InputError, match="did you mean slip_max_m"):
        tables.render_table(rows, "csv", ["slip_max"])


def test_map_of_single_rollouts_shows_causes_and_hatches_invalid_cells(rows, tmp_path):
    figure = maps.success_map(rows, STORED)
    left = figure.axes[0]
    assert len(figure.axes) == 2
    assert left.get_xlabel() == "friction (world)"
    assert "step" in left.get_ylabel()
    assert "7 of 11 succeed" in left.get_title()
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["success", "slipped", "invalid"]
    (glyphs,) = [one for one in left.collections if one.get_offsets().shape == (4, 2)]  # one in each cell that slips
    shapes = [one.vertices / np.abs(one.vertices).max() for one in (glyphs.get_paths()[0], marker_path("slipped"))]
    assert np.allclose(*shapes)
    hatched = [patch.get_extents() for patch in left.patches if patch.get_hatch() == "////"]
    assert [left.transData.inverted().transform(box.p0) for box in hatched] == [pytest.approx([0.3, 0.025])]
    assert "friction (world)" in save_figure(figure, tmp_path / "map.svg").read_text()


def test_a_legend_shows_what_the_map_shows(rows):
    """Each failure's colour, glyph and ink, to the pixel; and no glyph where cells have no room for one."""
    causes = [list(FAILURE_MEANINGS)[k % len(FAILURE_MEANINGS)] for k in range(len(rows) // 2)]
    rows = rows.assign(outcome="failure", cause=[*causes, *causes])
    figure = maps.success_map(rows, STORED)
    figure.set_dpi(400)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[::-1, :, :3].astype(int)
    legend = figure.legends[0]
    for text, mark in zip(legend.get_texts(), legend.legend_handles, strict=True):
        cause = text.get_text().replace(" ", "_")
        if cause == "success":
            continue
        shown = around(pixels, mark.get_transform().transform(mark.get_xydata().mean(axis=0)))
        assert len(np.unique(shown.reshape(-1, 3), axis=0)) > 1, cause  # a glyph on a colour
        row = rows[rows["cause"] == cause].iloc[0]
        place = row[["world.contact.friction", "manoeuvre.half_step_ratio"]]
        ax = figure.axes[["mjx", "native"].index(row["engine.name"])]
        middle = ax.transData.transform([place.iloc[0], {0.05: 0.05, 0.1: 0.1125, 0.2: 0.2}[place.iloc[1]]])
        assert np.abs(shown - around(pixels, middle)).mean() < 12, cause
    many = maps.legend_cell("fell", "#D55E00")
    assert len(many) == 1
    assert not maps.has_room_for_glyphs(MapCells(np.arange(maps.MAX_GLYPH_CELLS + 1), np.arange(2)))


def around(pixels, middle):
    """What is drawn within a glyph's size of a place, from below upwards."""
    x, y = np.round(middle).astype(int)
    return pixels[y - 12 : y + 13, x - 12 : x + 13]


def test_a_legend_is_never_cut(rows):
    causes = [list(FAILURE_MEANINGS)[k % len(FAILURE_MEANINGS)] for k in range(len(rows))]
    with plot_style():
        figure = maps.success_map(rows.assign(outcome="failure", cause=causes), STORED)
        figure.draw_without_rendering()
    legend, whole = figure.legends[0].get_window_extent(), figure.bbox
    assert len(figure.legends[0].get_texts()) == len(set(causes)) > 20  # none succeeds
    assert whole.x0 <= legend.x0 < legend.x1 <= whole.x1
    assert whole.y0 <= legend.y0 < legend.y1 <= whole.y1
    assert figure.get_size_inches()[0] == pytest.approx(PAGE_WIDTH_IN)


def test_a_long_entry_of_a_legend_leaves_the_map_its_room(rows):
    figure = Figure(figsize=(PAGE_WIDTH_IN, 3.6), layout="constrained")
    axes = figure.subplots()
    with plot_style():
        add_legend_below(
            figure, [Patch(label=one) for one in ("short", "words", "again", "others", "more", "a limit " * 8)]
        )
        figure.draw_without_rendering()
    assert len({text.get_window_extent().y0 for text in figure.legends[0].get_texts()}) <= 2
    assert axes.get_window_extent().height > 0.8 * 3.6 * figure.dpi


def test_map_of_repeated_rollouts_shows_rates_and_how_many(rows):
    figure = maps.success_map(pd.concat([rows, rows.assign(replicate=1)]), STORED)
    assert "n = 2 a cell" in figure.axes[-1].get_ylabel()
    with pytest.raises(InputError, match="two varied parameters"):
        maps.success_map(rows[(rows["world.contact.friction"] < 0.3) & (rows["engine.name"] == "mjx")], STORED)


def test_cells_stay_visible_where_values_are_uneven(rows):
    uneven = rows.assign(**{"world.contact.friction": rows["world.contact.friction"].replace({0.2: 0.001, 0.4: 0.002})})
    left = maps.success_map(uneven, STORED).axes[0]
    assert [label.get_text() for label in left.get_xticklabels()] == ["0.001", "0.002", "0.6", "0.8"]
    assert left.get_xlim() == (-0.5, 3.5)


def test_theory_is_a_curve_over_the_map_and_what_it_limits_is_beside():
    """On a pole (2.1.8) is k = sqrt(4 eps^2 + 1) P / 4 N, with N = U / d_c: 46.8 N m / U for the base robot."""
    stored = {"config": compose(["study=pole_torque_map"]).values}
    names = ["drive.torque_limit", "world.contact.friction"]
    grid = pd.MultiIndex.from_product([[60.0, 120.0, 180.0], [0.3, 0.6]], names=names).to_frame(index=False)
    rows = grid.assign(outcome="success", cause="", stage="", friction_demand_mean=[0.3, 0.4] * 3)
    left, right = maps.success_map(rows, stored).axes[:2]
    for ax in (left, right):
        torque, friction = ax.lines[0].get_data()
        assert list(torque) == [60.0, 120.0, 180.0]
        assert friction * torque == pytest.approx(46.8, rel=0.01)
    assert list(np.ravel(right.collections[0].get_array())) == pytest.approx([0.3, 0.3, 0.3, 0.4, 0.4, 0.4])


@pytest.mark.parametrize(("key", "value", "complaint"), [
    ("formula", "corner_leats_friction", "did you mean corner_least_friction"),
    ("output", "q", r"theory.0.output = q is unknown \(allowed: k, k_tau, k_zeta"),
    ("of", "contact.fiction", "did you mean friction"),
    ("inputs.eps", "drive.torque / 2", r"study.theory.inputs.eps = 'drive.torque / 2' is not allowed: .*torque_limit"),
    ("inputs.eps", "exec(2)", "exec.2.' is not allowed: names, numbers"),
    ("inputs.eps", "-1", "eps = -1 is not allowed: greater than 0"),
])  # fmt: skip
def test_theory_that_means_nothing_is_refused_at_once(key, value, complaint):
    given = {"formula": "corner_least_friction", "output": "k", "of": "contact.friction", "inputs": {"psi": 0.0}}
    group, _, name = key.rpartition(".")
    (given[group] if group else given)[name] = value
    text = ", ".join(f"{k}: {v}" for k, v in given.items() if k != "inputs")
    inputs = ", ".join(f"{k}: '{v}'" if isinstance(v, str) else f"{k}: {v}" for k, v in given["inputs"].items())
    with pytest.raises(InputError, match=complaint):
        compose(["study=walk_map", f"study.theory=[{{{text}, inputs: {{{inputs}}}}}]"])


def test_a_map_is_over_parameters_that_do_not_follow_from_one_another(rows):
    """A ratio and the length that it gives are one parameter."""
    ratio = rows.assign(**{"axis.step": rows["manoeuvre.half_step_ratio"] * 2}).iloc[:, ::-1]
    assert maps.choose_map_axes(ratio, ()) == ("axis.step", "world.contact.friction")
