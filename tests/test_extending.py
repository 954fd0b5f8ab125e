"""Pages of docs/howto that write files, followed to the letter in a copy of the package.

What a page adds and the repository keeps is taken out of the copy first.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
from slow_cases import mark_slow_cases

from sweep.config.experiment import compose
from sweep.controllers.plan import stage_end_stances
from sweep.core.errors import InputError
from sweep.models.obstacles.surface import empty_free_body_state

ROOT = Path(__file__).parents[1]
OBSTACLE, MANOEUVRE, PLATFORM, CHART = "write_an_obstacle", "write_a_manoeuvre", "write_a_plan", "write_a_chart"
SIMULATED = MANOEUVRE, PLATFORM, CHART  # with the real engine
SLOW = {*SIMULATED, "write_a_plan_variant", "write_a_metric", "write_a_study_design", "write_a_subcommand"}
BLOCK = re.compile(r"(?:^`(?P<path>[^`]+)`\n\n)?^```(?P<kind>\w+)\n(?P<text>.*?)^```", re.M | re.S)
SAID = {  # by the commands of a page
    "write_a_robot": ["long_legs            The base robot, thighs and shins a fifth longer", "| walk_tripod "],
    "write_a_formula": ["v = 0.", "0.15"],
    "write_a_figure": ["report.html"],
    "write_a_metric": ["base_speed_max_mps", "m/s", "| base speed max"],
    "write_a_plan_variant": [
        "pole_top_high        As pole_top",
        "plan.top.rear.base.above                      0.75",
        "0.7, 0.75",
        "0.05 + gap / 4",
    ],
    "write_a_study_design": ["of 16 succeed", "4 independent scrambles"],
    "write_a_subcommand": [" walk"],
    PLATFORM: ["platform             The base robot steps up", "| reach ", "| platform "],
    CHART: [
        "stairs_climb         The base robot climbs",
        "from edge to edge",
        "| stairs_climb                | success",
        "plan.up.a.base.above",
    ],
    OBSTACLE: ["kerb                 A step up in level ground", "of the ground beyond the edge"],
    MANOEUVRE: ["| walk_kerb "],
}
PAGES = {name: (ROOT / "docs/howto" / f"{name}.md").read_text() for name in SAID}


@pytest.fixture
def checkout(tmp_path):
    """A copy with the configuration where an installed package has it."""
    ignored = shutil.ignore_patterns("__pycache__", "conf")  # also where a checkout links to it
    shutil.copytree(ROOT / "sweep", tmp_path / "sweep", ignore=ignored)
    shutil.copytree(ROOT / "conf", tmp_path / "sweep/conf", ignore=ignored)
    (tmp_path / "conf").symlink_to(tmp_path / "sweep/conf")
    return tmp_path


def blocks(page):
    """Path, kind and text of each fenced block; one without a path of its own goes with the file named last."""
    path = None
    for found in BLOCK.finditer(page):
        path = found["path"] or path
        yield path, found["kind"], found["text"]


def sides(diff):
    """What a diff takes out and puts in, context included."""
    lines = diff.splitlines(keepends=True)
    return tuple("".join(line[1:] for line in lines if line[0] in f" {sign}") for sign in "-+")


def replaced(file, old, new):
    text = file.read_text()
    assert text.count(old) == 1, f"{file.name} has {text.count(old)} times\n{old}"
    file.write_text(text.replace(old, new))


def take_out(root, page):
    """Undo what the page adds where the repository keeps it, which has to be word for word."""
    for path, kind, text in blocks(page):
        file = root / str(path)
        if kind == "diff" and sides(text)[1] in file.read_text():
            replaced(file, *reversed(sides(text)))
        elif kind in ("python", "yaml") and file.exists():
            assert file.read_text() == text
            file.unlink()


def run(command, root, program):
    """As in a shell, `program` standing for `sweep`."""
    name, *words = shlex.split(command)
    assert name == "sweep"
    there = {"cwd": root, "env": {**os.environ, "PYTHONPATH": str(root)}}
    done = subprocess.run([sys.executable, *program, *words], capture_output=True, text=True, check=False, **there)
    assert done.returncode == 0, done.stderr
    return done.stdout


def run_test(path, root):
    """A test of a page passes in the copy, with the modules and data that tests of the repository share."""
    (root / "tests").mkdir(exist_ok=True)
    (root / "tests/data").symlink_to(ROOT / "tests/data")
    there = {"cwd": root, "env": {**os.environ, "PYTHONPATH": f"{root}{os.pathsep}{ROOT / 'tests'}"}}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", path]
    done = subprocess.run(command, capture_output=True, text=True, check=False, **there)
    assert done.returncode == 0, done.stdout


def test_pages_show_what_the_repository_keeps(checkout):
    take_out(checkout, PAGES[OBSTACLE])
    take_out(checkout, PAGES[MANOEUVRE])
    assert not (checkout / "sweep/models/obstacles/kerb.py").exists()
    assert not (checkout / "conf/scenario/walk_kerb.yaml").exists()


def test_every_page_that_writes_files_is_followed():
    pages = (ROOT / "docs/howto").glob("write_*.md")
    assert {page.stem for page in pages if any(path for path, *_ in blocks(page.read_text()))} == set(SAID)


@pytest.mark.parametrize("title", mark_slow_cases(PAGES, SLOW))
def test_a_page_followed_to_the_letter_adds_what_it_says(title, checkout):
    take_out(checkout, PAGES[title])
    program = ["-m", "sweep.cli"] if title in SIMULATED else [ROOT / "tests/fake_engine.py"]
    said = ""
    for path, kind, text in blocks(PAGES[title]):
        if kind == "sh":
            said += "".join(run(command, checkout, program) for command in text.splitlines())
        elif kind == "diff":
            replaced(checkout / path, *sides(text))
        else:
            (checkout / path).parent.mkdir(exist_ok=True, parents=True)
            (checkout / path).write_text(text)
    for path in {path for path, *_ in blocks(PAGES[title]) if path and Path(path).name.startswith("test_")}:
        run_test(path, checkout)
    assert all(part in said for part in SAID[title]), said
    if title == "write_a_figure":
        assert "Median and largest slip" in (checkout / "results/slips/report.html").read_text()


def test_a_manoeuvre_of_a_file_goes_there_and_back_within_reach(tmp_path, monkeypatch):
    """What the simulated page shows, but for physics: the file of the page in a project of its own."""
    (tmp_path / "sweep.yaml").write_text("")
    (tmp_path / "scenarios").mkdir()
    (text,) = (text for _, kind, text in blocks(PAGES[PLATFORM]) if kind == "yaml")
    (tmp_path / "scenarios/platform.yaml").write_text(text)
    monkeypatch.chdir(tmp_path)
    case = compose(["scenario=platform"]).case
    with jax.enable_x64(True):
        plan = case.manoeuvre.plan(case)
        stances = jax.tree.map(np.asarray, stage_end_stances(plan, empty_free_body_state()))
    up, down = ([name for name in plan.names if name.startswith(part)] for part in ("up.", "down."))
    assert [name.removeprefix("down.") for name in down] == [name.removeprefix("up.") for name in up[::-1]]
    top = plan.names.index("up.stand")
    np.testing.assert_allclose(stances.feet[top, :, 2], 0.2 - case.manoeuvre.deepening, atol=1e-6)
    for there, back in zip(plan.start, (x[-1] for x in stances), strict=True):
        np.testing.assert_allclose(back, there, atol=1e-6)
    (tmp_path / "scenarios/platform.yaml").write_text(text.replace("{top: [0.75, -0.42]}", "{top: [0.75, 0.42]}"))
    farther = compose(["scenario=platform"]).case
    with pytest.raises(InputError, match=r"foot [56] is .* m out of reach at the end of stage up\.front"):
        farther.manoeuvre.plan(farther)
