"""YAML that is read otherwise than it looks, or that grows without bound, is refused in one line."""

import time
from pathlib import Path

import pytest
from small_study import one_line

from sweep.cli.main import main
from sweep.config.experiment import compose
from sweep.core.errors import InputError
from sweep.core.yaml_check import check_yaml


@pytest.fixture(autouse=True)
def project(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("sweep.yaml").write_text("modules: []\n")
    for folder in ("studies", "scenarios", "robots", "plans"):
        Path(folder).mkdir()


@pytest.mark.parametrize("number", ["010", "1:30", "-0_7", "09", "1:30.5", "190:20:30"])
@pytest.mark.parametrize(
    ("file", "text", "argument", "key"),
    [
        ("robots/mine.yaml", "body_mass: {}", "robot=mine", "body_mass"),
        ("scenarios/mine.yaml", "extends: walk_tripod\nrobot: {{body_mass: {}}}", "scenario=mine", "robot.body_mass"),
        ("studies/mine.yaml", "study: {{axes: {{m: {{path: robot.body_mass, values: [8, {}]}}}}}}", "study=mine",
         "study.axes.m.values"),
        ("plans/mine.yaml", "extends: pole\nclimb: {{a: {}}}", "plan=mine", "climb.a"),
        ("sweep.yaml", "modules: [{}]", "study=walk_map", "modules"),
    ],
)  # fmt: skip
def test_octal_and_sexagesimal_numbers_are_refused_by_name(capsys, number, file, text, argument, key):
    Path(file).write_text(text.format(number))
    assert main(["run", argument, "--dry-run"]) == 2
    one_line(capsys.readouterr().err, file, f"{key} = {number} is not allowed")


@pytest.mark.parametrize(
    "override",
    ["robot.body_mass=010", "robot.body_mass=09", "robot.body_mass=-007", "engine.width=010", "noise.delay=01",
                 "+study.axes={m: {path: robot.body_mass, values: [010]}}", "robot.body_mass=1:30"]
)  # fmt: skip
def test_a_number_on_the_command_line_is_decimal(override):
    with pytest.raises(InputError, match="is not allowed"):
        compose(["scenario=walk_tripod", override])


def test_words_and_decimal_numbers_are_read_as_before():
    check_yaml("{a: 10, b: 0.5, c: 0, d: '010', e: \"1:30\", f: 0x10, g: 1e3, h: -0.07, i: v1:30, j: 2026-01-02}", "it")
    assert compose(["scenario=walk_tripod", "robot.body_mass=10", "out='010'"]).out == "010"


def test_a_file_that_hydra_reads_is_checked_too(tmp_path, capsys):
    (tmp_path / "mine/study").mkdir(parents=True)
    (tmp_path / "mine/study/own.yaml").write_text("# @package _global_\nrobot: {body_mass: 010}\n")
    assert main(["run", "--config-dir", "mine", "+study=own", "--dry-run"]) == 2
    one_line(capsys.readouterr().err, "own.yaml, line 2: robot.body_mass = 010 is not allowed")


@pytest.mark.parametrize(
    "files",
    [
        {"studies/t.yaml": "defaults: [/study: t, _self_]\nscenario: stand_push"},
        {"studies/t.yaml": "defaults: [u, _self_]", "studies/u.yaml": "defaults: [t, _self_]"},
        {"studies/t.yaml": "defaults: [optional /study@_global_: [u]]", "studies/u.yaml": "extends: t"},
        {"studies/t.yaml": "defaults: [/scenario: s]", "scenarios/s.yaml": "defaults: [/study: t]"},
    ],
)
def test_files_that_start_from_each_other_are_named(capsys, files):
    for file, text in files.items():
        Path(file).write_text(f"{text}\n")
    assert main(["run", "study=t", "--dry-run"]) == 2
    one_line(capsys.readouterr().err, "t.yaml", "a file cannot extend itself")


@pytest.mark.parametrize("kind", ["cycle", "laughs", "deep"])
def test_aliases_and_levels_have_a_limit(capsys, kind):
    lines = ["a0: &a0 [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 7)]
    text = {"cycle": "a: &a [*a]", "laughs": "\n".join(lines), "deep": f"a: {'[' * 5000}{']' * 5000}"}[kind]
    Path("studies/mine.yaml").write_text(text)
    start = time.monotonic()
    assert main(["run", "study=mine", "--dry-run"]) == 2
    assert time.monotonic() - start < 5
    one_line(capsys.readouterr().err, "mine.yaml, line ")
