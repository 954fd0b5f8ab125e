"""The table at the end of `docs/own_model_reference.md`: which subcommands work for one of the two systems only."""

import re
from pathlib import Path

import pytest
from slow_cases import mark_slow_cases

from sweep.cli import commands
from sweep.cli.main import main

PAGE = (Path(__file__).parents[1] / "docs/own_model_reference.md").read_text(encoding="utf-8")
SYSTEMS = {"the built-in robot": "robot", "your own models": "own"}
ONLY = dict(re.findall(rf"^- `([^`]+)` works for ({'|'.join(SYSTEMS)}) only\.$", PAGE, re.MULTILINE))  # by subcommand
ROBOT = ["study=walk_map", "study.axes.friction.num=4", "study.axes.step.num=3", "study.expect=[]"]
OWN = ["study=grip", "model.duration=0.2"]
DRAWN = {"robot": ("walk_tripod", "contact.friction"), "own": ("own", "model.body.trunk.mass")}
SLOW = "run cluster=dask_local", "run engine=mjx", "tune"  # workers that take long to start, programs to compile
ALONE = {"init", "list", "describe", "completion", "bench", "formula", "power"}  # that need no study
DRAWS = "scenario: {}\nstudy: {{design: {{num: 40}}, axes: {{x: {{path: {}, side: world, relative: 0.02}}}}}}\n"
LIMIT = {"robot": "slip_max_m<0.02", "own": "goal=travelled_m > 0"}
TRIALS = {"robot": "friction,outcome\n0.05,failure\n", "own": "grip,outcome\n0.1,failure\n"}
NOISE = {"robot": ["noise.position_noise=0.001"], "own": ["noise.white=0.001"]}
TUNED = {
    "robot": ["scenario=pole_top", "study=pole_sizes", "study.design.num=2"],
    "own": ["scenario=own"],
}
CHECKED = {"robot": "walk_tripod", "own": "own"}
EXPORTED = {"robot": ["scenario=walk_tripod"], "own": ["scenario=own"]}


@pytest.fixture(params=mark_slow_cases(["robot", "own"], ["own"]))
def system(request, fake_engine, tmp_path, monkeypatch):
    """A project with a small study of either, which the robot's fake engine takes no time for."""
    monkeypatch.chdir(tmp_path)
    assert main(["init", *(["--model"] if request.param == "own" else []), "lab"]) == 0
    monkeypatch.chdir(tmp_path / "lab")
    study = ROBOT if request.param == "robot" else [*OWN, "outcome.goal='travelled_m > -9'"]
    for folder in ("a", "b"):
        assert main(["run", *study, f"out={folder}"]) == 0
    Path("studies/draws.yaml").write_text(DRAWS.format(*DRAWN[request.param]))
    Path("real.csv").write_text(TRIALS[request.param])
    more = study[1:] if request.param == "own" else []
    for folder in ("draws", "others"):
        assert main(["run", "study=draws", *more, f"out={folder}"]) == 0
    return request.param


def lines(system):
    """The command lines that are tried, by subcommand and what it is asked for."""
    study = ROBOT if system == "robot" else OWN
    return {
        "run": ["run", *study, "out=c"],
        "run engine=mjx": ["run", *study, "engine=mjx", "out=i", "--limit", "2"],
        "run cluster=dask_local": ["run", *study, "out=e", "cluster=dask_local", "cluster.workers=1"],
        "run study.resolution": ["run", *study, "out=f", "study.resolution=0.3"],
        "run study.budget": ["run", *study, "out=g", *NOISE[system], "study.replicates=2", "study.budget=80"],
        "run study.expect": ["run", *study, "out=h", "study.expect=[{at_least: 0}]"],
        "run --limit": ["run", *study, "out=d", "--limit", "2"],
        "run --check": ["run", *study, "--check"],
        "status": ["status", "a"],
        "verify": ["verify", "a"],
        "table": ["table", "a"],
        "stats": ["stats", "a"],
        "compare": ["compare", "a", "b"],
        "compare --anytime": ["compare", "draws", "others", "--by", "replicate", "--anytime"],
        "league": ["league", "draws", "others", "--by", "replicate"],
        "certify": ["certify", "draws", "--failures", "0.9"],
        "relabel": ["relabel", "b", LIMIT[system]],
        "trials": ["trials", "real.csv", "a"],
        "audit": ["audit", "a", "--ways", "again"],
        "report": ["report", "a"],
        "report A B": ["report", "a", "b"],
        "report --replays": ["report", "a", "--replays", "1"],
        "export --paper": ["export", "a", "--paper", "paper"],
        "export --crate": ["export", "a", "--crate", "crate"],
        "reproduce": ["reproduce", "crate", "--rows", "2", "--trust"],
        "replay": ["replay", "a", "1"],
        "replay --png": ["replay", "a", "1", "--png", "pictures"],
        "replay --video": ["replay", "a", "1", "--video", "film.mp4"],
        "replay --mcap": ["replay", "a", "1", "--mcap", "r.mcap"],
        "replay --states": ["replay", "a", "1", "--states", "states.parquet"],
        "view": ["view", "a", "1", "-o", "v.html"],
        "log": ["log", "a", "--tensorboard", "runs"],
        "policy check": ["policy", "check", CHECKED[system]],
        "tune": ["tune", *TUNED[system], "--check"],
        "export-model": ["export-model", *EXPORTED[system], "out=exported"],
    }


def works(command, system):
    """Whether the page says that a command works for a system."""
    only = ONLY.get(command.partition(" ")[0])
    return only is None or SYSTEMS[only] == system


def wrong(system, capsys, commands):
    """Which of the commands end otherwise than the page says, with their exit code and what they say."""
    found = {}
    for command in commands:
        capsys.readouterr()
        code = main(lines(system)[command])
        said = capsys.readouterr().err
        if "pictures need OpenGL" in said:  # which this machine has none of
            continue
        if (code == 0) != works(command, system):
            found[command] = code, said
    return found


def test_every_command_works_where_the_page_says(system, capsys):
    assert set(ONLY) == {"tune", "export-model", "policy"}
    assert not wrong(system, capsys, [command for command in lines(system) if command not in SLOW])


@pytest.mark.slow
def test_commands_that_take_long_work_where_the_page_says(system, capsys):
    assert not wrong(system, capsys, SLOW)


def test_every_command_is_tried():
    assert {*commands.shipped_command_names()} - ALONE == {command.partition(" ")[0] for command in lines("robot")}
