"""Plans as files: what they say, how their numbers vary, and what is told of mistakes in them."""

import json
import re
import shlex
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml
from recorded import without_forces

from sweep.cli.main import main
from sweep.config.experiment import compose
from sweep.core import project
from sweep.core.errors import InputError
from sweep.fused.eager import evaluate_constant_function
from sweep.models.plan_numbers import PlanTable
from sweep.planning.plan_table import (
    GROUP,
    ORIGINS,
    evaluate_plan,
    find_overrides,
    formula_values,
    load_shipped_plan,
    map_numbers,
    numbers_by_path,
    plan_content,
    plan_values,
)
from sweep.study.study import make_points
from sweep.systems.hexapod import replace_parameter

ROOF = ["scenario=corner_roof"]
AHEAD = "plan.roof.front.on.front.ahead"
OWN = "extends: corner_roof\nroof: {pitch: {base: [-0.2, 0.1, 45]}}\n"


NO_ROOF = "extends: corner\nsizes: {rise: 0}\n"
SLOPED = OWN.partition("\n")[0] + "\nslopes: {at: {robot.thigh: 0.52}, roof.pitch.base.ahead: {robot.thigh: 1}}\n"


@pytest.fixture
def lab(tmp_path, monkeypatch):
    """A project with a plan of its own."""
    (tmp_path / "sweep.yaml").write_text("")
    (tmp_path / "plans").mkdir()
    (tmp_path / "plans" / "mine.yaml").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    return tmp_path / "plans" / "mine.yaml"


def test_a_number_that_varies_moves_its_foothold_and_is_traced():
    exp = compose(ROOF)
    unit = (exp.case.robot.thigh + exp.case.robot.shin) * 1.05 / 0.855
    start, by = exp.system.nominal_parameter_value(AHEAD, exp.settings), 0.03

    @jax.jit
    def foothold(belief):
        _, stages = belief.manoeuvre.route_stages(belief)
        return next(s.swing[5] for s in stages if s.name == "roof.front.on")

    moved = [foothold(exp.system.make_world_and_belief({f"belief.{AHEAD}": value})[1]) for value in (start, start + by)]
    assert foothold._cache_size() == 1
    np.testing.assert_allclose(moved[1] - moved[0], [0, -by * unit, 0], atol=1e-6)


def test_a_plan_of_a_project_changes_what_it_says_and_keeps_the_rest(lab):
    own, mine = (compose([*ROOF, *more]).case for more in ([], ["plan=mine"]))
    was, now = (numbers_by_path(plan_content(case), case.obstacle.charts) for case in (own, mine))
    changed = {path for path in was if was[path] != now[path]}
    assert changed == {f"roof.pitch.base.{name}" for name in ("ahead", "above", "pitch")}
    assert now["roof.pitch.base.pitch"] == 45


def test_numbers_follow_the_sizes_that_are_believed(lab):
    lab.write_text(f"{OWN}slopes:\n  at: {{robot.thigh: 0.52}}\n  roof.pitch.base.above: {{robot.thigh: -0.5}}\n")
    case = compose([*ROOF, "plan=mine"]).case
    longer = replace(case, robot=replace(case.robot, thigh=0.52 * 1.04))

    def above(case):
        return evaluate_plan(case)["roof"]["pitch"]["base"][1]

    assert above(case) == np.float32(0.1)
    np.testing.assert_allclose(above(longer), 0.1 - 0.5 * 0.04, atol=1e-7)
    changed = jax.jit(lambda at: above(replace(longer, plan=longer.plan.replace_number("roof.pitch.base.above", at))))
    np.testing.assert_allclose(changed(0.3), 0.3 - 0.5 * 0.04, atol=1e-7)


def test_feet_on_top_of_a_smaller_ball_stand_on_a_circle_that_is_larger_for_it():
    def circle(radius):
        case = compose(["scenario=ball_over", f"obstacle.radius={radius}"]).case
        feet = case.manoeuvre.descent_manoeuvre.stand_pose(case).feet
        return jnp.max(jnp.hypot(feet[:, 0], feet[:, 1])) / radius

    np.testing.assert_allclose(circle(0.84 * 0.95) / circle(0.84), 1 + 0.05 * 0.6, rtol=1e-4)


def test_a_plan_may_extend_one_that_extends_several(lab):
    lab.write_text("extends: ball_over\nstand: {rise: {seconds: 0.7}}\n")
    case = compose(["scenario=ball_over", "plan=mine"]).case
    mine, own = (
        numbers_by_path(content, case.obstacle.charts)
        for content in (plan_content(case), load_shipped_plan("ball_over"))
    )
    assert {path for path in own if own[path] != mine[path]} == {"stand.rise.seconds"}
    lab.write_text("extends: [ball_climb, mine]\n")
    with pytest.raises(InputError, match="cannot extend itself"):
        compose(["scenario=ball_over", "plan=mine"])


def test_a_whole_plan_is_gone_back_or_there_and_back(lab):
    def names(*more):
        case = compose(["scenario=pole_climb", *more]).case
        return jax.eval_shape(case.manoeuvre.plan, jax.tree.map(jnp.asarray, case)).names

    up = names()
    down = tuple(f"back.{name}" for name in up[::-1])
    for way, expected in (("forth", up), ("back", down), ("there_and_back", up + down)):
        lab.write_text(f"extends: pole\nway: {way}\n")
        assert names("plan=mine") == expected


@pytest.mark.parametrize(
    ("scenario", "text", "told"),
    [
        ("pole_climb", "extends: pole\nway: bak\n", "plan.way = bak is unknown: did you mean back?"),
        (
            "pole_round",
            "extends: pole\nway: back\n",
            "plan.way = back is not allowed: .* pole_round goes forth",
        ),
        (
            "ball_climb",
            "extends: ball_climb\nway: back\n",
            "plan.way = back is not allowed: .* ball_climb goes",
        ),
    ],
)
def test_a_way_that_cannot_be_gone_is_refused(lab, scenario, text, told):
    lab.write_text(text)
    with pytest.raises(InputError, match=told):
        compose([f"scenario={scenario}", "plan=mine"])


def test_rows_have_the_ids_of_their_numbers_whatever_file_they_are_in(lab):
    def ids(*more):
        exp = compose([*ROOF, *more])
        return make_points(exp.study, exp.system, exp.settings)["point_id"].tolist()

    axis = "+study.axes.a={path: plan.roof.pitch.base.pitch, values: [48.8, 45]}"
    assert ids() == ids("plan=corner_roof") == ids(axis)[:1]
    assert len({*ids(), *ids(axis), *ids("plan=mine")}) == 3


@pytest.mark.parametrize("name", sorted(project.shipped_files(GROUP)))
def test_a_shipped_plan_says_where_its_numbers_come_from(name):
    text = project.shipped_files(GROUP)[name].read_text()
    assert len(re.findall(r"^# Numbers: ", text, re.M)) == 1
    searched = yaml.safe_load(text)["searched"]
    assert searched["origin"] in ORIGINS
    if searched["origin"] == "command":
        words = shlex.split(searched["command"])
        assert words[:2] == ["sweep", "tune"]
        assert any(word.startswith("study.seed=") for word in words)


def same(one, other):
    one, other = (evaluate_constant_function(partial(without_forces, case)) for case in (one, other))
    assert one.names == other.names
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-6), one, other)


@pytest.mark.parametrize("scenario", ["pole_climb", "corner_gallop"])
def test_a_formula_is_the_number_that_it_stands_for(scenario):
    case = compose([f"scenario={scenario}", "manoeuvre.cycles=1"]).case
    charts, values, content = case.obstacle.charts, plan_values(case), plan_content(case)
    plain = replace(case, plan=PlanTable(json.dumps(map_numbers(content, charts, lambda path, value: values[path]))))
    assert len(formula_values(case)) > 50
    assert formula_values(plain) == {}
    same(case, plain)


def test_formulas_name_sizes_in_any_order_parameters_and_functions(lab):
    lab.write_text("""extends: corner_roof
roof: {pitch: {base: [share - 1, -half / unit, deg(asin(0.5))], time: 2 * share}}
sizes: {share: "max(half, 0.1) / obstacle.height", half: obstacle.height / 2}
""")
    case = compose([*ROOF, "plan=mine"]).case
    move = jax.jit(lambda case: evaluate_plan(case, "roof")["roof"]["pitch"])
    for height in (2.3, 2.4):
        found = move(replace_parameter(case, "obstacle.height", height))
        np.testing.assert_allclose(found["base"], [-0.5, -height / 2 / 1.05, 30], rtol=1e-6)
        assert found["time"] == 1
    assert move._cache_size() == 1
    found = move(
        replace_parameter(replace_parameter(case, "plan.sizes.half", 1.0), "plan.roof.pitch.time", 3.0)
    )  # in its place
    np.testing.assert_allclose([found["base"][0], found["time"]], [1 / 2.3 - 1, 3], rtol=1e-6)
    lab.write_text(lab.read_text() + "slopes: {at: {robot.thigh: 0.26}, roof.pitch.base.ahead: {robot.thigh: 0.2}}")
    np.testing.assert_allclose(move(compose([*ROOF, "plan=mine"]).case)["base"][0], 0.2 - 0.5, rtol=1e-6)


REPEATED = """start: {stand: {base: {over_ground: [0, 0.5]},
  front: {ground: [0.5, 0.5]}, middle: {ground: [0.5, 0]}, rear: {ground: [0.5, -0.5]}}}
on: {base: over_ground, lift: 1, """
PAIRS = "{base: [%s, 0.5], front: {ground: [0.5, %s]}, rear: {ground: [0.5, %s]}}"


def test_a_part_that_is_repeated_is_its_moves_again_and_again(lab):
    def case(moves):
        lab.write_text(f"{REPEATED}{moves}}}\nsizes: {{step: 0.05}}\n")
        return compose(["scenario=walk_tripod", "manoeuvre=follow", "plan=mine"]).case

    def written(step, more=0.0):
        return ", ".join(f"{k}.all: {PAIRS % (k * step + more, 0.5 + k * step, k * step - 0.5)}" for k in (1, 2))

    again = case(f"repeat: 1 + 1, all: {PAIRS % ('step * (k + 1)', 'step * (k + 1) + 0.5', 'step * (k + 1) - 0.5')}")
    assert evaluate_constant_function(partial(without_forces, again)).names == ("stand", "on.1.all", "on.2.all", "halt")
    same(again, case(written(0.05)))
    same(replace_parameter(again, "plan.sizes.step", 0.04), case(written(0.04)))
    same(
        replace_parameter(again, "plan.on.all.base.ahead", 0.07), case(written(0.05, 0.02))
    )  # the first, and others by as much


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (OWN.replace("base", "bsae"), "plan.roof.pitch.bsae is unknown: did you mean base?"),
        (OWN.replace("45]", "45, 1]"), "plan.roof.pitch.base = .* is not allowed: \\[ahead, above, pitch\\]"),
        (
            "extends: corner_roof\nroof: {over: {base: [far, 0.1]}}",
            "plan.roof.over.base.ahead = far is not allowed: far is unknown",
        ),
        (OWN.replace("base:", "time: 0, base:"), "plan.roof.pitch.time = 0 is not allowed: above 0"),
        (OWN.replace("base:", "seconds: -1, base:"), "plan.roof.pitch.seconds = -1 is not allowed: above 0"),
        (OWN.replace("base: [-0.2, 0.1, 45]", "front: {rof: [0, 0]}"), "chart rof is unknown on corner: did you mean"),
        ("roof: {}", "plan.sizes.rise is missing"),
        (f"{NO_ROOF}roof: {{reverse: roof}}", "plan.roof.reverse = roof is not allowed: another part"),
        (
            f"{NO_ROOF}a: {{b: {{}}}}\nroof: {{reverse: climb, from: a}}",
            "plan.a is not allowed: one move",
        ),
        (f"{NO_ROOF}roof: {{reverse: climb, to: a}}", "plan.roof.to is unknown"),
        (f"{OWN}slopes: {{at: {{robot.tigh: 0.5}}}}", "plan.slopes.at.robot.tigh is unknown: did you mean robot.thigh"),
        (
            f"{OWN}slopes: {{at: {{robot.thigh: 0.5}}, roof.pich.base.ahead: {{robot.thigh: 1}}}}",
            "plan.slopes.roof.pich.base.ahead is unknown: did you mean plan.slopes.roof.pitch.base.ahead",
        ),
        (
            f"{OWN}slopes: {{at: {{robot.thigh: 0.5}}, roof.pitch.base.ahead: {{robot.hip: 1}}}}",
            "plan.slopes.roof.pitch.base.ahead.robot.hip is unknown",
        ),
        (
            f"{SLOPED}roof: {{pitch: {{base: [far, 0.1]}}}}",
            "plan.roof.pitch.base.ahead = far is not allowed: far is unknown",
        ),
        (
            f"{SLOPED}roof: {{pitch: {{base: far}}}}",
            "plan.roof.pitch.base = far is not allowed: plan.slopes has a slope for its number",
        ),
        (
            f"{SLOPED}roof: {{pitch: {{base: [1, 2, 3, 4]}}}}",
            "plan.roof.pitch.base = \\[1.0, 2, 3, 4\\] is not allowed",
        ),
        (f"{OWN}slopes: {{at: {{obstacle.kind: 1}}}}", "plan.slopes.at.obstacle.kind is unknown"),
        (
            OWN.replace("0.1", "hight"),
            "plan.roof.pitch.base.above = hight is not allowed: hight is unknown: did you mean",
        ),
        (
            OWN.replace("0.1", "robot.tigh"),
            "plan.roof.pitch.base.above = robot.tigh is not allowed: robot.tigh is unknown",
        ),
        (OWN.replace("0.1", "k"), "plan.roof.pitch.base.above = k is not allowed: k is unknown"),
        (
            OWN.replace("0.1", "1 +"),
            r"plan.roof.pitch.base.above = 1 \+ is not allowed: a number, or a formula such as",
        ),
        (OWN.replace("0.1", "1 < 2"), "plan.roof.pitch.base.above = 1 < 2 is not allowed: a number, or a formula"),
        (OWN.replace("0.1", "unit ** 2"), "= unit .. 2 is not allowed: 'unit .. 2' is not allowed: names, numbers"),
        (f"{OWN}sizes: {{rise: each}}", "plan.sizes.each = rise / .* is not allowed: rise is told by itself"),
        (f"{OWN}gallop: {{repeat: -1}}", "plan.gallop.repeat = -1 is not allowed: a whole number"),
        (f"{OWN}gallop: {{repeat: unit}}", "plan.gallop.repeat = unit is not allowed: a whole number"),
        (OWN.replace("base: [-0.2, 0.1, 45]", "lift: [1]"), "plan.roof.pitch.lift = \\[1\\] is not allowed: a number"),
        (
            OWN.replace("base: [-0.2, 0.1, 45]", "front: {roof: 1}"),
            "{'roof': 1} is not allowed: coordinates in one chart",
        ),
        ("extends: corner_roof\nroof: {base: 3}", "plan.roof.base = 3 is not allowed: a chart's name"),
        (
            f"{NO_ROOF}roof: {{reverse: a}}\na: {{reverse: roof}}",
            "plan.roof.from = None is not allowed: another part",
        ),
        (
            f"{NO_ROOF}roof: {{reverse: climb, from: a}}\na: {{reverse: climb, from: roof}}",
            "plan.a.from = roof is not allowed: another part",
        ),
    ],
)
def test_mistakes_in_a_file_are_told_in_one_line(lab, text, told):
    lab.write_text(text)
    case = compose([*ROOF, "plan=mine"]).case
    with pytest.raises(InputError, match=told):
        case.manoeuvre.plan(case)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("roof: far", "plan.roof = far is not allowed: keys and values"),
        ("roof: {pitch: {base: [.inf, 1]}}", "plan.roof.pitch.base = inf is not allowed: a finite number"),
        ("roof: {pitch: {base: [[1], 1]}}", r"plan.roof.pitch.base = \[1\] is not allowed: numbers or words"),
        ("roof: {pitch: {time: !!binary aGk=}}", "plan.roof.pitch.time = b'hi' is not allowed: a number"),
        ("roof: &a {pitch: *a}", r"mine.yaml, line 2: the anchor &a contains itself"),
        ("sizes: {a: [1]}", r"plan.sizes.a = \[1\] is not allowed: a number or a formula"),
        ("slopes: far", "plan.slopes = far is not allowed: keys and values"),
        ("slopes: {at: 3}", "plan.slopes.at = 3 is not allowed: sizes and numbers"),
        ("slopes: {at: {robot.thigh: 0}}", "plan.slopes.at.robot.thigh = 0 is not allowed: a number other than 0"),
        (
            "slopes: {roof.time: {robot.thigh: far}}",
            "plan.slopes.roof.time.robot.thigh = 'far' is not allowed: a number",
        ),
    ],
)
def test_a_file_that_is_no_plan_is_refused_as_it_is_read(lab, text, told):
    lab.write_text(f"extends: corner_roof\n{text}\n")
    with pytest.raises(InputError, match=told):
        compose([*ROOF, "plan=mine"])


def test_what_has_no_file_or_no_such_number_is_refused(capsys):
    exp = compose(ROOF)
    with pytest.raises(InputError, match=r"did you mean plan\.roof\.pitch\.base\.ahead"):
        exp.system.parameter("plan.roof.pitch.base.ahed", exp.settings)
    with pytest.raises(InputError, match="depend on the belief only"):
        exp.system.parameter(f"world.{AHEAD}", exp.settings)
    assert main(["run", "scenario=walk_tripod", "plan=pole", "--dry-run"]) == 2
    assert "manoeuvre.kind = walk has no plan file" in capsys.readouterr().err


@pytest.mark.parametrize("values", ["0, 1", "1, -2"])
def test_times_of_an_axis_are_above_0_as_told_ones_are(values, capsys):
    axis = f"+study.axes.t={{path: plan.top.rear.time, values: [{values}]}}"
    assert main(["run", "scenario=pole_top", "study.name=times", axis, "--dry-run"]) == 2
    assert "plan.top.rear.time = " in (said := capsys.readouterr().err)
    assert "is not allowed: greater than 0" in said


def test_described_plans_say_where_their_numbers_come_from(capsys):
    assert main(["describe", "plan.corner_roof"]) == 0
    said = capsys.readouterr().out
    assert "searched for together" in said
    assert f"{AHEAD} " in said


@pytest.mark.parametrize(
    "scenario", ["pole_top", "corner_roof", "ladder_climb", "ball_over", "ball_ledges", "raft_cross"]
)
def test_numbers_are_described_by_the_paths_they_are_varied_by(scenario, capsys):
    case = compose([f"scenario={scenario}"]).case
    assert main(["describe", f"plan.{case.manoeuvre.default_plan_name}"]) == 0
    said = {word.removeprefix("plan.") for word in capsys.readouterr().out.split() if word.startswith("plan.")}
    known = numbers_by_path(plan_content(case), case.obstacle.charts)
    assert said == set(known)
    assert not [path for path in known if path[-1].isdigit() and not path.startswith("sizes.")]


def test_differences_of_plans_are_a_file_that_extends_one():
    own = load_shipped_plan("pole_top")
    other = {**own, "over": {**own["over"], "base": "brink"}, "new": {"move": {"lift": 1}}}
    assert find_overrides(own, other) == {"over": {"base": "brink"}, "new": {"move": {"lift": 1}}}
    assert find_overrides(own, own) == {}


def test_on_and_off_are_names_in_a_plan_that_is_chosen(tmp_path):
    """YAML takes them for truths."""
    (tmp_path / "mine.yaml").write_text("# é\nextends: ball_ledges\non: {front: {seconds: 0.9}}\n")
    for plan, seconds in (("ball_ledges", 0.8), (tmp_path / "mine.yaml", 0.9)):
        case = compose(["scenario=ball_ledges", f"plan={plan}"]).case
        assert numbers_by_path(plan_content(case), case.obstacle.charts)["on.front.seconds"] == seconds
