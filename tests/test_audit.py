import numpy as np
import pandas as pd
import pytest
from fake_engine import FakeEngine
from small_study import one_line

from sweep.analysis import compare
from sweep.cli import certification
from sweep.cli.main import main
from sweep.core.errors import InputError
from sweep.report import engine_agreement, figures, page
from sweep.runs import audit, results, store
from sweep.systems.hexapod import AUDIT_VARIANTS

STUDY = ["run", "study=walk_map", "study.axes.friction.num=21", "study.axes.step.num=18", "study.expect=[]"]


class CoarseEngine(FakeEngine):
    """The boundary moves with the time step, and a little with the precision; the other engine agrees.

    Above a friction of 1.1 success takes a body that passes through another.
    """

    def __init__(self, settings, world, belief, limits):
        super().__init__(settings, world, belief, limits)
        self.solid = settings.solid
        self.shift = {0.002: 0.0, 0.001: 0.03}[settings.time_step] + (0.005 if settings.precision == "float64" else 0)

    def run(self, world, belief, streams):
        figures = super().run(world, belief, streams)
        friction = np.broadcast_to(world.contact.friction, (self.width,)) + self.shift
        ratio = np.broadcast_to(belief.manoeuvre.half_step_ratio, (self.width,))
        fails = (friction < 5 * ratio) | (self.solid & (friction > 1.1))
        return figures | {"tilt_max_deg": np.where(fails, 40.0, 1.0)}


coarse = pytest.mark.parametrize("fake_engine", [CoarseEngine], indirect=True)


@coarse
def test_flips_tell_how_far_the_boundary_moves(fake_engine, tmp_path, capsys):
    assert main([*STUDY, f"out={tmp_path}"]) == 0
    rows = store.read_rows(tmp_path)
    near = audit.boundary_mask(results.read_results(tmp_path))
    # every chosen point lies within a cell of the line friction = 5 ratio, and both sides of it are chosen
    away = np.abs(rows["world.contact.friction"] - 5 * rows["manoeuvre.half_step_ratio"])
    assert away[near].max() <= (1.2 - 0.05) / 20 + 5 * 0.01 + 1e-9
    assert 0 < (rows.loc[near, "outcome"] == "success").mean() < 1
    assert 30 < near.sum() < 60
    assert main(["audit", str(tmp_path), "--points", "1000"]) == 0
    every = audit.outcome_flip_table(results.read_results(tmp_path))
    assert (every["rollouts"] == every["of"]).all()
    friction, needed = rows["world.contact.friction"], 5 * rows["manoeuvre.half_step_ratio"]
    wins = (rows["outcome"] == "success") & ~near
    elsewhere = every[every["drawn"] == "successes elsewhere"].set_index("simulated")
    assert (elsewhere["rollouts"] == wins.sum()).all()
    assert list(elsewhere["flips"]) == [0, 0, 0, 0, (wins & (friction > 1.1)).sum()]
    assert elsewhere["flips"].max() > 5
    table = every[every["drawn"] == "next to the boundary"].set_index("simulated")
    assert (table["rollouts"] == near.sum()).all()
    moved = {AUDIT_VARIANTS[way].description: shift for way, shift in
             (("again", 0), ("half_step", 0.03), ("float64", 0.005), ("other_engine", 0))}  # fmt: skip
    for name, shift in moved.items():
        assert table.loc[name, "flips"] == ((friction < needed) & (friction + shift >= needed) & near).sum(), name
    assert table["flips"].max() > 5
    assert "half the time step" in capsys.readouterr().out
    html = page.render_page(results.read_results(tmp_path))
    assert f"<td>successes elsewhere</td><td>{wins.sum()}</td><td>{wins.sum()}</td>" in html
    assert 'id="audit"' in html
    at = table.loc["half the time step"]
    assert f"{at['flips']:.0f} of {near.sum()} half the time step (at most {100 * at['high']:.1f} %)" in html
    (shown,) = figures.audit_figure(results.read_results(tmp_path))
    shown.data.loc[:4, f"outcome{compare.SECOND_RUN_MARK}"] = "invalid"  # of rollouts that did not flip
    for ax, (_, part) in zip(shown.draw().axes, every.groupby("simulated", sort=False), strict=False):
        marks = {line.get_marker(): len(line.get_xdata()) for line in ax.lines}
        assert marks["x"] == part["flips"].sum()
        assert marks["+"] == 5 * (ax is ax.figure.axes[0])


@coarse
def test_an_audit_is_a_draw_and_is_not_simulated_twice(fake_engine, tmp_path):
    assert main([*STUDY, f"out={tmp_path}"]) == 0
    few = ["audit", str(tmp_path), "--points", "7", "--ways", "half_step"]
    assert main(few) == 0
    assert [p.name for p in (tmp_path / "audit").iterdir() if p.is_dir()] == ["half_step"]
    parts = {p: p.stat().st_mtime_ns for p in (tmp_path / "audit/half_step/parts").iterdir()}
    assert len(store.read_rows(tmp_path / "audit/half_step")) == 14
    assert main(few) == 0
    assert parts == {p: p.stat().st_mtime_ns for p in (tmp_path / "audit/half_step/parts").iterdir()}


def test_a_folder_that_cannot_be_written_is_no_way_that_is_left_out(fake_engine, tmp_path, capsys):
    assert main([*STUDY, f"out={tmp_path}"]) == 0
    (tmp_path / "audit").mkdir()
    (tmp_path / "audit/again").touch()
    capsys.readouterr()
    assert main(["audit", str(tmp_path), "--points", "2"]) == 2
    assert capsys.readouterr().err == f"sweep: out = {tmp_path}/audit/again cannot be written: Not a directory\n"


def test_what_has_neither_a_boundary_nor_successes_is_refused(fake_engine, tmp_path, capsys):
    assert main([*STUDY, f"out={tmp_path}", "study.where='friction < 0.15'"]) == 0
    for arguments, message in (
        ([], "no neighbouring points have different outcomes, and none succeeds"),
        (["--ways", "quarter_step"], "--ways quarter_step is unknown"),
        (["--points", "0"], "at least 1"),
    ):
        capsys.readouterr()
        assert main(["audit", str(tmp_path), *arguments]) == 2
        one_line(capsys.readouterr().err, message)


class EngineOfItsOwn(FakeEngine):
    """On `native` the boundary lies at a friction that is 0.07 higher."""

    def __init__(self, settings, world, belief, limits):
        super().__init__(settings, world, belief, limits)
        self.shift = -0.07 if settings.name == "native" else 0.0

    def run(self, world, belief, streams):
        figures = super().run(world, belief, streams)
        friction = np.broadcast_to(world.contact.friction, (self.width,)) + self.shift
        ratio = np.broadcast_to(belief.manoeuvre.half_step_ratio, (self.width,))
        return figures | {"tilt_max_deg": np.where(friction < 5 * ratio, 40.0, 1.0), "slip_max_m": 0 * friction}


class RefusingEngine(FakeEngine):
    """`native` refuses every model, as an engine that is not installed does when it is made."""

    def __init__(self, settings, world, belief, limits):
        if settings.name == "native":
            raise InputError("engine.name = native is not allowed: it needs its extra")
        super().__init__(settings, world, belief, limits)


DRAWN = """scenario: walk_tripod
study:
  replays: 0
  design: {kind: monte_carlo, num: 160}
  axes:
    friction: {path: contact.friction, side: world, distribution: {kind: uniform, from: 0.05, to: 1.2}}
    step: {path: manoeuvre.half_step_ratio, distribution: {kind: uniform, from: 0.02, to: 0.19}}
"""


@pytest.mark.parametrize("fake_engine", [EngineOfItsOwn], indirect=True)
def test_rows_on_which_engines_differ_are_those_between_their_boundaries(fake_engine, tmp_path, capsys):
    (study := tmp_path / "drawn.yaml").write_text(DRAWN)
    tmp_path = tmp_path / "rows"
    assert main(["run", f"study={study}", f"out={tmp_path}"]) == 0
    before = store.read_rows(tmp_path)
    assert main(["table", str(tmp_path), "--where", 'engines_agree == "yes"']) == 2
    few = ["audit", str(tmp_path), "--engines", "all", "--most", "40"]
    assert main(few) == 0
    parts = {p: p.stat().st_mtime_ns for p in (tmp_path / "audit/engine_native/parts").iterdir()}
    assert main(few) == 0
    assert parts == {p: p.stat().st_mtime_ns for p in (tmp_path / "audit/engine_native/parts").iterdir()}
    rows = store.read_rows(tmp_path)
    pd.testing.assert_frame_equal(rows.drop(columns="engines_agree"), before)
    assert (rows["engines_agree"] != "").sum() == 40
    assert main(["audit", str(tmp_path), "--engines", "mjx,native"]) == 0
    assert len(store.read_rows(tmp_path / "audit/engine_native")) == 160
    rows = store.read_rows(tmp_path)
    away = 5 * rows["manoeuvre.half_step_ratio"] - rows["world.contact.friction"]
    between = (away <= 0) & (away > -0.07)
    assert 3 < between.sum() < 30
    assert (rows["engines_agree"] == np.where(between, "no", "yes")).all()
    out = capsys.readouterr().out
    assert f"all engines agree on {160 - between.sum()} of 160 rows" in out
    (shown,) = engine_agreement.engine_figure(results.read_results(tmp_path))
    (ax, _) = shown.draw().axes
    assert len(ax.lines[1].get_xdata()) == between.sum()
    assert " (" in shown.caption  # independent draws have an interval
    assert main(["table", str(tmp_path), "--where", 'engines_agree == "no"', "--format", "csv"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 1 + between.sum()
    agreed = ["certify", str(tmp_path), "--failures", "0.2", "--engines-agree"]
    counted = certification.select_agreed_rows(rows)["outcome"]
    assert ((counted == "success") == ((rows["outcome"] == "success") & ~between)).all()
    assert main(agreed) in (0, 4)
    assert "succeeds on all audited engines" in capsys.readouterr().out
    for arguments, message in (
        ([*agreed, "--rollouts", "160"], "--rollouts is not allowed with --engines-agree"),
        ([*few[:2], "--engines", "mjx"], "the rows are by mjx; name another engine"),
        ([*few[:2], "--engines", "bullet"], "--engines bullet is unknown"),
        ([*few[:4], "--ways", "again"], "--ways is not allowed with --engines"),
        ([*few[:4], "--most", "0"], "at least 1"),
        ([*few[:2], "--most", "5"], "--most is not allowed without --engines"),
    ):
        assert main(arguments) == 2
        one_line(capsys.readouterr().err, message)
    assert main(["relabel", str(tmp_path), "tilt_max_deg<50"]) == 0  # verdicts hold for the thresholds of before
    assert "engines_agree" not in store.read_rows(tmp_path)
    assert main(["verify", str(tmp_path)]) == 0


@pytest.mark.parametrize("fake_engine", [RefusingEngine], indirect=True)
def test_an_engine_that_refuses_the_model_is_left_out_of_all_and_ends_an_audit_that_names_it(
    fake_engine, tmp_path, capsys
):
    few = ["study.axes.friction.num=5", "study.axes.step.num=4", "study.expect=[]"]
    assert main(["run", "study=walk_map", *few, f"out={tmp_path}"]) == 0
    for engines, lines in (
        ("native", ["sweep: engine.name = native is not allowed: it needs its extra"]),
        ("all", ["sweep: audit: native is left out: engine.name = native is not allowed: it needs its extra",
                 "sweep: no engine but mjx can simulate these rows"]),
    ):  # fmt: skip
        capsys.readouterr()
        assert main(["audit", str(tmp_path), "--engines", engines, "--most", "4"]) == 2
        assert capsys.readouterr().err.splitlines() == lines
    assert main(["audit", str(tmp_path), "--points", "2"]) == 0  # of its ways other_engine is left out
    assert "audit: other_engine is left out: engine.name = native is not allowed" in capsys.readouterr().err
    assert main(["verify", str(tmp_path)]) == 0


@pytest.mark.slow
def test_the_boundary_of_a_walk_is_the_robots(tmp_path):
    """Where legs cross is a matter of geometry: neither the time step nor the engine moves it."""
    axes = ["study.axes.friction.num=3", "study.axes.step.from=0.16", "study.axes.step.num=5", "study.expect=[]"]
    assert main(["run", "study=walk_map", *axes, f"out={tmp_path}"]) == 0
    assert main(["audit", str(tmp_path), "--points", "6"]) == 0
    table = audit.outcome_flip_table(results.read_results(tmp_path))
    assert len(table) == 10
    assert (table["invalid"] == 0).all()
    assert (table["flips"] <= 1).all()
