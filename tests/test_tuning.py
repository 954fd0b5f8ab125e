"""`sweep tune`: a search for a plan's numbers, which goes on where it was interrupted."""

import math
import re
import shlex
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
import yaml

from sweep.cli.main import main
from sweep.cli.plan_limits import describe_separating_sizes
from sweep.cli.plan_rollouts import score_ends
from sweep.cli.plan_search import nominal_drawn_parameters, tuned_plan_content
from sweep.config.experiment import compose
from sweep.core.errors import InputError
from sweep.engines.limiting_parts import describe_limiting_part
from sweep.planning import plan_table
from sweep.planning.plan_table import evaluate_plan, numbers_by_path
from sweep.planning.score import (
    DIFFERENCE_SHARE,
    MAX_DEFICIT,
    MarginAim,
    PlanScore,
    broadcast_over_draws,
    group_independent_numbers,
    mask_non_minima,
)
from sweep.planning.score import replace_plan_value as moved
from sweep.runs import tuning
from sweep.runs.tuning import (
    fit_plan_slopes_over_sizes,
    parse_free_plan_numbers,
    search_by_cma,
    search_by_gradients,
    search_by_rollouts,
)
from sweep.runs.unsearched_values import describe_values_outside_tuned_range
from sweep.study.study import make_points

STUDIES = Path(__file__).parents[1] / "research" / "studies"
AT, STEPS = np.array([1.0, -2.0, 0.5]), np.array([0.1, 0.1, 0.02])
HOW = {"seed": 3, "population": 6, "generations": 12, "free": ["a"]}


class Scores:
    """Of a bowl around numbers that are to be found."""

    def __init__(self):
        self.asked = 0

    def __call__(self, many):
        self.asked += 1
        return np.sum(((many - AT - 3 * STEPS) / STEPS) ** 2, axis=1)


def found(log, how=HOW):
    scores = Scores()
    best, least = search_by_cma(scores, AT, STEPS, how, log, lambda done, least: None)
    return best, least, scores.asked


def test_an_interrupted_search_goes_on_to_the_same_numbers(tmp_path):
    whole, log = found(tmp_path / "whole"), tmp_path / "log"
    assert whole[1] < 9  # of the first
    lines = (tmp_path / "whole").read_text().splitlines()
    log.write_text("\n".join(lines[:5]) + '\n[0.1, "br')  # four generations, and a part of another
    best, least, asked = found(log)
    assert asked == whole[2] - 4
    np.testing.assert_array_equal(best, whole[0])
    assert least == whole[1]
    assert found(log)[2] == 0
    assert found(log, {**HOW, "generations": 13})[2] == 1
    with pytest.raises(InputError, match="log belongs to another search"):
        found(log, {**HOW, "seed": 4})
    log.write_text("\n".join(lines[:1]) + "\n")  # which came to nothing
    assert found(log, {**HOW, "seed": 4})[2] == whole[2]
    for content in (b"{}\n[0.1, \n", b"\xbe\n"):
        log.write_bytes(content)
        with pytest.raises(InputError, match="log is damaged: remove it"):
            found(log)


class Wants:
    """Of draws that want numbers `at`, moved in proportion to their sizes."""

    at, slopes = np.array([1.0, -2.0]), np.array([[0.5, 0.0], [0.0, -1.0]])
    off, steps = np.random.default_rng(1).uniform(-0.04, 0.04, (12, 2)), np.array([0.02, 0.02])

    def __init__(self, ends=np.inf):
        self.asked, self.ends = 0, ends

    def ask(self):
        if self.asked >= self.ends:
            raise KeyboardInterrupt
        self.asked += 1

    def descent(self, numbers):
        self.ask()
        lacks = (numbers - self.at - self.off @ self.slopes.T) / 0.01
        return np.sum(lacks**2, axis=1), 2 * lacks / 0.01

    def lacking(self, moved):
        beside = (moved - self.off @ self.slopes.T) / 0.01
        return np.hstack([beside, -beside])

    def sloping(self, moved):
        self.ask()
        slope = np.vstack([np.eye(2), -np.eye(2)]) / 0.01
        return self.lacking(moved)[:, None], np.broadcast_to(slope, (len(moved), 1, 4, 2))

    def by_rollouts(self, how, log):
        def scores(off, moved):
            self.ask()
            return -np.abs(moved - off @ self.slopes.T).sum(axis=-1) / 0.01

        draw = lambda number: (self.off, self.off)  # noqa: E731
        found = search_by_rollouts(draw, scores, self.steps, how, log, lambda done, mean: None)
        return (found - self.slopes) * np.abs(self.off).max(axis=0)

    def by_gradients(self, how, log):
        return (
            search_by_gradients(self.descent, self.at - 0.05, self.steps, how, log, lambda done, least: None) - self.at
        )

    def by_programs(self, how, log):
        found = fit_plan_slopes_over_sizes(
            self.lacking, self.sloping, self.steps, self.off, how, log, lambda done, least: None
        )
        return found - self.slopes


@pytest.mark.parametrize(
    ("by", "ends", "off"),
    [(Wants.by_gradients, 100, 0.015), (Wants.by_programs, 2, 1e-6), (Wants.by_rollouts, 20, 2e-3)],
)
def test_what_draws_want_is_found_and_an_interrupted_search_goes_on(by, ends, off, tmp_path):
    how, whole, rest = {"seed": 1, "generations": 300}, Wants(), Wants()
    beside = by(whole, how, tmp_path / "whole")
    assert np.abs(beside).max() < off
    with pytest.raises(KeyboardInterrupt):
        by(Wants(ends), how, tmp_path / "log")
    np.testing.assert_array_equal(by(rest, how, tmp_path / "log"), beside)
    assert rest.asked == whole.asked - ends
    with pytest.raises(InputError, match="log belongs to another search"):
        by(rest, {**how, "seed": 2}, tmp_path / "log")


def test_a_rollout_scores_by_the_stages_before_the_one_that_fails_and_by_its_margin():
    labels = {
        "outcome": np.array(["success", "success", "failure", "failure", "invalid"], object),
        "stage": np.array(["", "", "up", "over", "stand"], object),
        "margin": np.array([0.1, 0.9, -0.5, -7.0, np.nan], object),
    }
    np.testing.assert_allclose(score_ends(labels, ("stand", "up", "on", "over")), [1.1, 1.2, -0.25, -0.25, -1.0])


def test_a_search_by_rollouts_refuses_what_margins_need(tmp_path, capsys):
    words = ["tune", "scenario=pole_top", f"study={STUDIES / 'pole_loads.yaml'}", f"out={tmp_path / 'x.yaml'}"]
    assert main([*words, "--by-rollouts", "--forces"]) == 2
    assert "--forces is not allowed with --by-rollouts" in capsys.readouterr().err


def test_numbers_are_free_by_pattern_times_only_by_a_step():
    at = {"top.rear.time": 3.0, "top.rear.base.ahead": 0.1, "top.rear.base.pitch": 5.0, "over.lift": 1.0}
    assert parse_free_plan_numbers(at, ["top.*"]) == {"top.rear.base.ahead": 0.02, "top.rear.base.pitch": 2.0}
    assert parse_free_plan_numbers(at, ["*.time=0.5", "*.pitch", "*.pitch=1"]) == {
        "top.rear.time": 0.5,
        "top.rear.base.pitch": 1,
    }
    for wrong in ("roof.*", "*=wide", "*=-1", "*.time"):
        with pytest.raises(InputError, match=r"--free = "):
            parse_free_plan_numbers(at, [wrong])


@pytest.mark.slow
def test_a_plan_that_touches_is_tuned_until_it_does_not(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "low.yaml").write_text("extends: pole_top\nover:\n  front: {base: [-0.019, 0.34, 22]}\n")
    asked = ["tune", "scenario=pole_top", "plan=low.yaml", "--stages", "over.front", "--moments", "5"]
    search = [*asked, "--free", "over.front.base.a*", "--population", "4", "--generations", "3", "--need", "base=0.01"]
    assert main([*search, "out=plans/mine.yaml"]) == 0
    told = capsys.readouterr().out
    before, after = (float(word) for word in told.split()[1:4:2])
    assert after < before
    text = (tmp_path / "plans" / "mine.yaml").read_text()
    assert text.startswith(f"# 2 numbers searched for by CMA-ES: score {before:.4g} before, {after:.4g} after\n")
    command = yaml.safe_load(text)["searched"]["command"]
    assert main([*shlex.split(command)[1:], "--check"]) == 0  # as it stands
    capsys.readouterr()
    was, now = (compose(["scenario=pole_top", f"plan={file}"]).case for file in ("low.yaml", "plans/mine.yaml"))
    was, now = (numbers_by_path(evaluate_plan(case), case.obstacle.charts) for case in (was, now))
    assert {path for path in was if was[path] != now[path]} == {"over.front.base.ahead", "over.front.base.above"}
    assert len((tmp_path / "plans" / "mine.yaml.log").read_text().splitlines()) == 1 + 3
    (tmp_path / "low.yaml").write_text("extends: pole_top\nover:\n  front: {base: [-0.018, 0.34, 22]}\n")
    assert main([*search, "out=plans/mine.yaml"]) == 2
    assert "mine.yaml.log belongs to another search" in capsys.readouterr().err
    assert main([*asked, "--free", "top.centre.lift", "--generations", "1", "out=plans/other.yaml"]) == 4
    assert "no better plan was found; plans/other.yaml is unchanged" in capsys.readouterr().err


def test_a_formula_is_free_with_a_step_and_raised_to_what_is_found():
    case, path = compose(["scenario=pole_climb"]).case, "climb.up.rear.rear.above"
    formulas = plan_table.formula_values(case)
    assert set(parse_free_plan_numbers(plan_table.plan_values(case), ["climb.up.rear.*"], formulas)) == {
        f"climb.up.rear.{name}" for name in ("rear.ahead", "lift", "plane.out", "plane.ahead", "plane.up")
    }
    assert parse_free_plan_numbers(plan_table.plan_values(case), [f"{path}=0.1"], formulas) == {path: 0.1}
    found = {path: formulas[path] + 0.01, "climb.up.middle.base.above": formulas["climb.up.middle.base.above"] + 1e-5}
    content = tuned_plan_content(case, found)
    assert content["climb"]["up.rear"]["rear"]["side"] == [0, "upright - reach + 0.01"]
    assert content["climb"]["up.middle"] == plan_table.plan_content(case)["climb"]["up.middle"]
    longer = replace(case, robot=replace(case.robot, body_length=1.06))  # which it goes on to follow
    raised = numbers_by_path(evaluate_plan(moved(longer, path, found[path], formulas)), case.obstacle.charts)
    np.testing.assert_allclose(raised[path], plan_table.plan_values(longer)[path] + 0.01, atol=1e-12)


@pytest.mark.slow
def test_gradients_move_numbers_of_the_manoeuvre_too_and_the_file_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    asked = ["tune", "scenario=pole_climb", "robot.thigh=0.598", "robot.shin=0.38525", "--stages", "stand"]
    free = ["--free", "manoeuvre.spread_ratio", "--moments", "3", "--generations", "20"]
    assert main([*asked, *free, "--gradients", "out=mine.yaml"]) == 0  # legs cross before the first step
    told = capsys.readouterr().out
    before, after = (float(word) for word in told.split()[1:4:2])
    assert after < 0.1 < before
    (found,) = re.findall(
        r"^# to be run with manoeuvre.spread_ratio=(\S+)$", (tmp_path / "mine.yaml").read_text(), re.M
    )
    assert 0.175 < float(found) < 0.3
    assert main([*asked, *free, "--follow", "out=mine.yaml"]) == 2


@pytest.mark.slow
def test_gradients_of_what_forces_lack_are_those_of_small_changes():
    exp, stages = compose(["scenario=pole_top"]), ["over.front"]
    draws = broadcast_over_draws(*tuning.draw_beliefs(exp, 1))
    score = PlanScore(exp.case, ["over.front.base.above"], [MarginAim("hold", "*", 0.5)], stages, [("*", 2)], True, 1)
    above = numbers_by_path(evaluate_plan(exp.case), exp.case.obstacle.charts)["over.front.base.above"]
    (less, _), (_, slope), (more, _) = (
        score.squared_deficit_gradients(np.array([above + by]), draws) for by in (-0.002, 0.0, 0.002)
    )
    np.testing.assert_allclose(slope[:, 0], (more - less) / 0.004, rtol=0.05)


def test_a_margin_that_is_no_number_lacks_the_most():
    score = PlanScore(compose(["scenario=pole_top"]).case, [], [], ["over.front"], [("*", 3)], False, 1)
    rates = [np.array([[[x], [0.0]]]) for x in (-1.0, -7.0, np.nan)]  # rad/s, of two draws
    kept, short, unknown = (score.worst_draw_score({"rate": rate})[0] for rate in rates)
    assert kept == 0 < short < unknown == MAX_DEFICIT**2


@pytest.mark.slow
def test_stages_are_judged_at_moments_of_their_own():
    exp, stages = compose(["scenario=pole_top"]), ["over.front", "top.rear"]
    draws = broadcast_over_draws(*tuning.draw_beliefs(exp, 1))

    def rates(*moments):
        return PlanScore(exp.case, [], [], stages, moments, False, 1).margins(np.zeros(0), draws)["rate"][0]

    some, all_of_them = rates(("*", 2), ("*.front", 9)), rates(("*", 9))
    np.testing.assert_allclose(some[0], all_of_them[0], rtol=1e-4)
    assert some[1] > all_of_them[1] + 0.05  # rad/s: joints stand still at the ends of a stage
    plan = exp.case.manoeuvre.plan(exp.case)
    counts = [math.ceil(float(plan.duration[plan.names.index(name)]) / 0.05) + 1 for name in stages]
    np.testing.assert_allclose(rates(), rates(*zip(stages, counts, strict=True)), rtol=1e-4)


def test_worst_moments_are_those_worse_than_beside_them():
    found = mask_non_minima(
        jnp.array([[3.0, 1.0, 2.0, 2.0, 0.0, 0.0], [1.0, 2.0, 3.0, 2.0, 1.0, 2.0], [1.0, 1.0, 1.0, 1.0, 1.0, 1.0]])
    )
    least = np.full((3, 6), np.inf)
    least[[0, 0, 1, 1, 2], [1, 5, 0, 4, 5]] = [1.0, 0.0, 1.0, 1.0, 1.0]
    np.testing.assert_array_equal(found, least)


def test_only_what_touches_nothing_in_common_is_of_one_group():
    touched = np.array([[1, 1, 0, 0], [0, 1, 1, 0], [0, 0, 1, 1], [0, 0, 0, 1]], bool)
    assert group_independent_numbers(touched).tolist() == [0, 1, 0, 1]
    assert group_independent_numbers(np.ones((3, 2), bool)).tolist() == [0, 1, 2]


@pytest.mark.slow
def test_slopes_of_numbers_that_move_together_are_those_of_each():
    exp, free = compose(["scenario=pole_top"]), ["over.front.base.ahead", "top.rear.base.ahead", "top.rear.base.above"]
    draws, told = (
        broadcast_over_draws(*tuning.draw_beliefs(exp, 1)),
        numbers_by_path(evaluate_plan(exp.case), exp.case.obstacle.charts),
    )
    first, steps = np.array([[told[path] for path in free]]), np.array([0.01, 0.02, 0.03])
    score = PlanScore(exp.case, free, [], ["over.front", "top.rear"], [("*", 3)], False, 1)
    lack, slopes = score.deficit_finite_differences(first, draws, steps)
    known = np.isfinite(lack[0, 0])
    moved = [
        score.margin_deficits(score.margins(first + DIFFERENCE_SHARE * step, draws))[0, known]
        for step in np.diag(steps)
    ]
    apart = np.stack([x - lack[0, 0, known] for x in moved], axis=1)
    np.testing.assert_allclose(slopes[0, 0, known] * DIFFERENCE_SHARE * steps, apart, atol=2e-3)
    assert (np.abs(apart) > 0.01).any(axis=0).all()


@pytest.mark.slow
def test_a_plan_is_tuned_to_follow_sizes_and_simulated(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "draws.yaml").write_text(
        "scenario: pole_top\nstudy:\n  design: {kind: monte_carlo, num: 4}\n  axes:\n"
        "    radius: {path: obstacle.radius, relative: 0.1}\n    mass: {path: robot.shin_mass, relative: 0.1}\n"
    )
    asked = ["tune", "scenario=pole_top", "study=draws.yaml", "--stages", "over.front", "--moments", "3"]
    assert main([*asked, "--free", "over.front.*", "--need", "outer=0.006", "--generations", "20", "--follow",
                 "--simulate", "out=plans/mine.yaml"]) == 0  # fmt: skip
    told = capsys.readouterr().out
    text = (tmp_path / "plans" / "mine.yaml").read_text()
    assert " before, 0 after" in told
    assert "over.front.base.ahead: {obstacle.radius: -" in text
    ranges = yaml.safe_load(text)["searched"]["ranges"]
    low, high = ranges["obstacle.radius"]
    assert 0.378 < low < high < 0.462  # four draws within 10 % of 0.42 m
    assert ranges.keys() == {"obstacle.radius", "robot.shin_mass"}
    assert ": {robot.shin_mass" not in text  # on which no margin depends
    assert ", robot.shin_mass" not in text
    for seed in (0, 1):
        line = next(line for line in told.splitlines() if line.startswith(f"simulated draws of seed {seed}"))
        assert f"# {line}" in text
        assert (tmp_path / "plans" / "mine.draws" / f"after-{seed}" / "study.yaml").exists()
    assert main([*asked, "--follow", "out=x.yaml", "study.axes.radius.relative=0"]) == 2
    assert "no margin depends on obstacle.radius, robot.shin_mass" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("args", "told"),
    [
        (["scenario=walk_tripod", "out=x.yaml"], "manoeuvre.kind = walk has no plan file"),
        (["scenario=pole_top"], "out =  is not allowed: the file of the plan"),
        (
            ["scenario=pole_top", "out=x.yaml", "--moments", "over.*=1"],
            "--moments = over.*=1 is not allowed: N or STAGES=N",
        ),
        (["scenario=pole_top", "out=x.yaml", "--population", "2"], "--population = 2 is not allowed: at least 4"),
        (
            ["scenario=pole_top", "out=x.yaml", "--follow"],
            "--follow is not allowed: study pole_top draws no number of robot",
        ),
        (["scenario=pole_top", "out=x.yaml", "--stages", "*", "--stages", "roof"], "--stages = roof names no stage of"),
        (["scenario=pole_top", "out=x.yaml", "--moments", "roof=3"], "--moments = roof names no stage of stand"),
        (["scenario=pole_top", "out=x.yaml", "--need", "base@roof=1"], "--need = roof names no stage of stand"),
        (
            ["scenario=pole_top", "out=x.yaml", "--need", "bass=1"],
            "--need: margin bass is unknown: did you mean base? (allowed: base, body, edge, fold, legs, links",
        ),
        (["scenario=pole_top", "out=x.yaml", "--need", "hold=1"], "--need: margin hold is unknown"),
        (["scenario=pole_top", "out=x.yaml", "--need", "base=nan"], "--need = base=nan is not allowed: MARGIN"),
        (
            ["scenario=pole_top", "out=x.yaml", "--forces", "--need", "base"],
            "--need = base is not allowed: MARGIN",
        ),
    ],
)
def test_what_cannot_be_tuned_is_refused_in_one_line(args, told, capsys):
    assert main(["tune", *args]) == 2
    assert told in capsys.readouterr().err


ON_A_BALL = """
# @package _global_
defaults: [override /obstacle: ball, override /manoeuvre: follow]
scenario: {name: beside}
plan:
  start:
    on: {base: {tangent: [31.7, 0.87, -0.63]}, rear: {ground: [0.5, -1.67]}, middle: {ground: [0.5, -1.16]},
         front: {ball: [0.4825, 23.33]}}
  go: {rear: {rear: {ground: [0.55, -1.1]}, lift: 0.2}}
"""


@pytest.mark.slow
def test_a_foot_that_lands_has_not_swung_into_the_ground(tmp_path, monkeypatch):
    (tmp_path / "sweep.yaml").write_text("")
    (tmp_path / "scenarios").mkdir()
    (tmp_path / "scenarios" / "beside.yaml").write_text(ON_A_BALL)
    monkeypatch.chdir(tmp_path)
    case = compose(["scenario=beside"]).case
    played = PlanScore(case, (), (), ("go.*",), [("*", 1)], False, 1).margins(
        np.zeros(0), broadcast_over_draws(case, 1)
    )
    assert played["swing"].min() > 0.003


def test_numbers_do_not_follow_a_size_that_is_nought():
    exp = compose(["scenario=ball_to_ball", f"study={STUDIES / 'ball_to_ball_known.yaml'}"])
    assert exp.case.obstacle.offset == 0
    assert "obstacle.gap" in (sizes := nominal_drawn_parameters(exp))
    assert "obstacle.offset" not in sizes


@pytest.mark.parametrize(
    ("cause", "leg", "angles", "part"),
    [
        ("folded", 5, [0, 2.2, -3.1], "front right leg"),
        ("leg_crossing", 4, [0.9, 2.2, -1.2], "rear left and middle left leg"),
        ("base_hit", 4, [0.9, 2.2, -1.2], "middle left leg"),
        ("link_collision", 3, [0, 2.2, -1.2], "shin of the middle right leg"),  # 1.2 m beside the pole's axis
        ("slipped", 3, [0, 2.2, -1.2], "middle left foot"),
        ("fell", 3, [0, 2.2, -1.2], ""),
    ],
)
def test_the_part_that_limits_a_plan_is_measured_from_states(cause, leg, angles, part):
    qpos = np.array([[0, 1.2, 2, 1, 0, 0, 0, *[0, 2.2, -1.2] * 6]])
    qpos[0, 7 + 3 * (leg - 1) : 10 + 3 * (leg - 1)] = angles
    feet = np.zeros((1, 6, 3))
    trace = SimpleNamespace(
        world=compose(["scenario=pole_top"]).case, qpos=qpos, stage=np.zeros(1, int), stages=("up", "down"),
        foot_position=feet, foot_target=feet + np.array([0, 0, 0, 0.1, 0.02, 0])[:, None],
    )  # fmt: skip
    assert describe_limiting_part(trace, cause, "up") == part
    assert not describe_limiting_part(trace, cause, "down")  # which it never came to


def test_sizes_that_separate_failures_are_named():
    masses, radii = np.linspace(8, 12, 20), np.linspace(0.378, 0.504, 20)
    rows = pd.DataFrame({"robot.body_mass": np.roll(masses, 9), "obstacle.radius": radii})
    lines = describe_separating_sizes(rows[radii > 0.45], rows[radii < 0.45])
    assert lines == ["obstacle.radius is 0.4509 to 0.504 in these, 0.378 to 0.4443 in successes"]
    assert not describe_separating_sizes(rows[radii > 0.495], rows)


def test_a_study_is_told_which_sizes_its_plan_was_not_searched_for(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.yaml").write_text(
        "extends: pole_top\nsearched:\n  ranges: {obstacle.radius: [0.4, 0.44], robot.thigh: [0.5, 0.54]}\n"
    )
    study = "scenario: pole_top\nstudy: {name: wide, axes: {radius: {path: obstacle.radius, values: [0.41, %s]}}}\n"

    def describe(largest):
        (tmp_path / "wide.yaml").write_text(study % largest)
        exp = compose(["study=wide.yaml", "plan=mine.yaml"])
        return describe_values_outside_tuned_range(exp, make_points(exp.study, exp.system, exp.settings))

    command = "sweep tune scenario=pole_top study=wide --follow --simulate out=plans/pole_top.yaml"
    assert describe(0.46) == [
        "obstacle.radius is 0.41 to 0.46; the numbers of the plan were searched for 0.4 to 0.44: "
        f"`{command}` searches for these"
    ]
    assert describe(0.43) == []


@pytest.mark.parametrize(
    ("ranges", "told"),
    [
        ("{obstacle.radius: 0.4}", "obstacle.radius = 0.4 is not allowed: the least and the largest value"),
        ("{obstacle.radius: [0.44, 0.4]}", "obstacle.radius = [0.44, 0.4] is not allowed: the least value comes first"),
        ("{obstacle.radius: [0.4, wide]}", "obstacle.radius = [0.4, 'wide'] is not allowed: the least and"),
    ],
)
def test_malformed_ranges_of_a_search_are_refused(ranges, told, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.yaml").write_text(f"extends: pole_top\nsearched: {{ranges: {ranges}}}\n")
    assert main(["run", "scenario=pole_top", "plan=mine.yaml"]) == 2
    assert f"plan.searched.ranges.{told}" in capsys.readouterr().err
    (tmp_path / "mine.yaml").write_text("extends: pole_top\nsearched: {origin: found}\n")
    assert main(["run", "scenario=pole_top", "plan=mine.yaml"]) == 2
    assert "plan.searched.origin is unknown" in capsys.readouterr().err
