import itertools
import re

import pytest
from small_study import one_line

from sweep.cli.choices import shipped_group_choices
from sweep.cli.main import main
from sweep.config.experiment import build_experiment, compose, compose_values
from sweep.core.groups import GROUPS
from sweep.core.parameters import InputError
from sweep.manoeuvres import MANOEUVRES
from sweep.models.obstacles import OBSTACLES

TOGETHER = ("obstacle", "manoeuvre")  # which have to fit
CHOICES = [
    f"{group}={name}" for group in GROUPS if group not in (*TOGETHER, "plan") for name in shipped_group_choices(group)
]
for name in ("engine=warp", "engine=kernel"):  # of own models alone
    CHOICES.remove(name)


@pytest.mark.parametrize("choice", CHOICES)
def test_every_config_file_composes(choice):
    exp = compose([choice])
    group, _, name = choice.partition("=")
    if group not in ("study", "scenario"):
        assert exp.study.name == "walk_tripod"
    elif exp.study.name != name:  # a study of many scenarios has a folder for each
        assert exp.study.name == exp.scenario + name[name.index("_") :]


@pytest.mark.parametrize(("group", "classes"), [("obstacle", OBSTACLES), ("manoeuvre", MANOEUVRES)])
def test_a_class_is_a_choice_without_a_file(group, classes):
    assert set(classes) <= set(shipped_group_choices(group))
    assert all(shipped_group_choices(group).values())


@pytest.mark.slow
def test_a_manoeuvre_on_an_obstacle_that_it_is_not_for_is_refused_in_one_line():
    nominal, fits, refusals = compose_values([]), set(), {}
    values = {
        group: {name: compose_values([f"{group}={name}"])[group] for name in shipped_group_choices(group)}
        for group in TOGETHER
    }
    del values["manoeuvre"]["follow"]  # on any obstacle, with a plan that is made for it
    for manoeuvre, obstacle in itertools.product(values["manoeuvre"], values["obstacle"]):
        pair = {"manoeuvre": values["manoeuvre"][manoeuvre], "obstacle": values["obstacle"][obstacle]}
        try:
            build_experiment({**nominal, **pair})
            fits.add((manoeuvre, obstacle))
        except InputError as error:
            kinds = f"obstacle.kind = {pair['obstacle']['kind']} .* manoeuvre.kind = {pair['manoeuvre']['kind']} needs"
            refusals[f"{kinds} [a-z_ ]+"] = str(error)
    assert all(re.fullmatch(pattern, text) for pattern, text in refusals.items())
    walks = ("tripod", "gallop", "walk", "stand", "waypoints")
    ground = set(itertools.product(walks, ("flat", "slope", "plane")))
    others = {(name, part) for name in values["manoeuvre"] for part in name.split("_") if part in values["obstacle"]}
    others -= {("ball_ledges", "ball"), ("ball_to_ball", "ball")}
    others |= {("ball_to_ball", "two_balls")}
    others |= {(name, "pole_ledge") for name, on in others if on == "pole"}
    assert fits == ground | others


def test_a_study_chooses_its_scenario_and_the_command_line_has_the_last_word():
    exp = compose(["study=push_map"])
    assert (exp.scenario, exp.case.manoeuvre.kind, exp.case.execution.push_time) == ("stand_push", "stand", 1.0)
    assert not exp.study.single
    exp = compose(["study=push_map", "scenario=walk_gallop", "robot=three_link", "robot.coxa=0.2"])
    assert "gallop" in exp.case.manoeuvre.gait
    assert (exp.case.robot.legs, exp.case.robot.coxa) == ("three_link", 0.2)


def test_prototype_has_the_ratios_of_the_monograph():
    robot = compose(["robot=prototype"]).case.robot
    sizes = [robot.mount_radius, robot.coxa, robot.thigh, robot.shin]
    assert [s / robot.body_length for s in sizes] == pytest.approx([0.5, 0.129927, 0.272263, 0.465693])


BAD = [
    ("robot.coxx=1", ["robot.coxx = 1", "did you mean coxa?"]),
    ("+robot.coxx=1", ["robot.coxx", "did you mean coxa?"]),
    ("robot.coxa=-1", ["robot.coxa = -1", "at least 0 m"]),
    ("robot.coxa=long", ["robot.coxa = 'long'", "a number"]),
    ("robot.thigh=520", ["robot.thigh = 520 is not allowed: is it 0.52 m?", "at most 20 times the nominal 0.52 m"]),
    ("robot.shin=33.5", ["robot.shin = 33.5 is not allowed: is it 0.335 m?"]),
    ("contact.friction=.nan", ["contact.friction = .nan is not allowed: a finite number"]),
    ("+study.axes.f={path: contact.friction, values: [1, -.Inf]}", ["study.axes.f = -.Inf", "a finite number"]),
    ("contact.friction=-1", ["contact.friction = -1", "at least 0"]),
    ("noise.delay=0.02", ["noise.delay = 0.02", "a whole number of control ticks"]),
    ("scenario=wlak_tripod", ["scenario = wlak_tripod", "did you mean walk_tripod?"]),
    ("robot.mounts=star", ["robot.mounts = 'star'", "rectangle, circle"]),
    ("frictoin=1", ["frictoin = 1", "contact"]),
    ("obstacle=ball", ["obstacle.kind = ball", "manoeuvre.kind = walk needs plane"]),
    ("plan.top.rear.time=1", ["plan.top is unknown", "choose a plan first, plan=NAME"]),
    ("robot.thigh", ["robot.thigh", "group.name=value"]),
    ("study.name=a<b", ["study.name=a<b cannot be read", "quotes"]),
    ("out=results/ö", ["out=results/ö cannot be read", """'out="results/ö"'"""]),
    ("study.replicates=0", ["study.replicates = 0", "at least 1"]),
    ("+study.axes.f={path: contact.friction, num: 3}", ["study.axes.f.from is missing", "from, to and num"]),
    ("+study.axes.f={path: contact.friction}", ["study.axes.f", "values, or from, to and num"]),
    ("+study.axes.f={path: contact.friction, form: 0}", ["study.axes.f.form", "did you mean from?"]),
    ("++contcat.friction=0.2", ["contcat is unknown", "did you mean contact?"]),
    ("+foo.bar=1", ["foo is unknown"]),
    ("+study.foo=1", ["study.foo", "unknown"]),
    ("+study.axes.f={path: '', values: [1]}", ["study.axes.f.path = ''", "a parameter"]),
    ("study.name=..", ["study.name = '..'", "a folder name"]),
    ('study.name="a\nb"', ["study.name", "a folder name"]),
    ('study.name="a\ud800"', ["study.name", "a folder name"]),
    ("study=null", ["study=null", "the name of a choice"]),
    ("~robot", ["robot"]),
    ("cluster=-1", ["cluster=-1", "the name of a choice"]),
    ("engine.iterations=1e400", ["engine.iterations = inf", "at most 20"]),
    (f"engine.width={'9' * 400}", ["engine.width", "400 digits"]),
    ("+study.axes.f={path: contact.friction, from: 0, to: 1, num: 1000000000}", ["study.axes.f.num", "20000000"]),
    ("contact.friction='${oc.env:SECRET}'", ["contact.friction = ${oc.env:SECRET}", "another key"]),
    ("study.name=${oc.env:SECRET}", ["study.name = ${oc.env:SECRET}", "another key"]),
    ("contact.friction='${friction}'", ["contact.friction = '${friction}'", "may only name another key"]),
    ("~contact.friction", ["~contact.friction is not allowed"]),
    ("contact=[base,soft]", ["contact = soft is unknown (allowed: base)"]),
    ("study.axes=[1]", ["study.axes = [1]", "keys and values"]),
    ("study.keep={a: 1}", ["study.keep = {a: 1}", "a list"]),
    ("study.keep=[[1]]", ["study.keep: [1] is unknown"]),
    ("study.seed=1.5", ["study.seed = 1.5", "a whole number"]),
    ("out=[a]", ["out = ['a']", "a word"]),
    ("+study.axes.f={path: contact.friction, values: [[1]]}", ["study.axes.f.values = [[1]]", "a number or a name"]),
    (
        "+study.axes.f={path: contact.friction, values: [1], with: [g]}",
        ["study.axes.f.with = ['g']", "name of an axis"],
    ),
    ("+study.axes.f={path: contact.friction, values: [1, true]}", ["values = [1, True]", "all numbers, or all names"]),
    ("+study.axes.f={path: contact.friction, values: [1, null]}", ["values = [1, None]", "each a number or a name"]),
    ("study.keep_rate=0", ["study.keep_rate = 0", "above 0, and finite"]),
    ("+study.axes.f={path: contact.friction, distribution: normal}", ["distribution = 'normal'", "{kind: uniform"]),
    ("study.design.correlation=3", ["study.design.correlation = 3", "a list"]),
    ("scenario.expect=[{where: 3}]", ["scenario.expect.0.where = 3", "a condition"]),
    ("scenario.expect=[{at_least: 2}]", ["scenario.expect.0.at_least = 2", "0 to 1"]),
    ("scenario.expect=[{at_least: 0.9, at_most: 0.8}]", ["scenario.expect.0.at_least = 0.9", "at most", "0.8"]),
]


@pytest.mark.parametrize(("override", "named"), BAD)
def test_bad_configuration_is_one_line_naming_key_value_and_what_is_allowed(override, named):
    with pytest.raises(InputError) as error:
        compose([override])
    assert "\n" not in str(error.value)
    assert all(part in str(error.value) for part in named), str(error.value)


CODE = {
    "hydra": "hydra: {callbacks: {x: {_target_: pandas.read_pickle, filepath_or_buffer: evil.pickle}}}",
    "environment": "hydra: {job: {env_set: {XLA_FLAGS: x}}}",
    "target": "study: {name: mine, axes: {a: {_target_: os.system}}}",
    "choice": "defaults: [{override /hydra/launcher: joblib}]",
    "package": "defaults: [{/contact@hydra.callbacks: base}]",
}


@pytest.mark.usefixtures("fake_engine")
@pytest.mark.parametrize("kind", CODE)
def test_a_file_of_a_user_runs_nothing(tmp_path, monkeypatch, capsys, kind):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "conf" / "study").mkdir(parents=True)
    (tmp_path / "conf" / "study" / "mine.yaml").write_text(f"# @package _global_\n{CODE[kind]}\n")
    (tmp_path / "evil.pickle").write_bytes(b"cos\nmkdir\n(S'ran'\ntR.")
    assert main(["run", "--config-dir", "conf", "study=mine", "--dry-run"]) == 2
    assert not (tmp_path / "ran").exists()
    one_line(capsys.readouterr().err, "which runs code")


@pytest.mark.usefixtures("fake_engine")
def test_a_study_in_a_folder_of_a_user_is_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "conf" / "study").mkdir(parents=True)
    text = "# @package _global_\nstudy: {name: mine, axes: {f: {path: contact.friction, values: [1, 2]}}}\n"
    (tmp_path / "conf" / "study" / "mine.yaml").write_text(text)
    assert main(["run", "--config-dir", "conf", "study=mine", "--dry-run", "engine.width=2"]) == 0
    assert "mine: 2 of 2 rollouts" in capsys.readouterr().out
