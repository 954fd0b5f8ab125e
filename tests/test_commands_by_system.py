"""Each cell of the table at the end of `docs/own_model.md`: what works on the robot, and on an own model."""

import re
from pathlib import Path

import pytest

from sweep.cli.main import main

PAGE = (Path(__file__).parents[1] / "docs/own_model.md").read_text(encoding="utf-8")
CELLS = {
    (command, system): says == "yes"
    for command, *both in re.findall(r"^\| `([^`]+)` \| (yes|no) \| (yes|no) \|$", PAGE, re.MULTILINE)
    for system, says in zip(("robot", "own"), both, strict=True)
}
ROBOT = ["study=walk_map", "study.axes.friction.num=4", "study.axes.step.num=3", "study.expect=[]"]
OWN = ["study=grip", "model.duration=0.2"]
DRAWN = {"robot": ("walk_tripod", "contact.friction"), "own": ("own", "model.body.trunk.mass")}
DRAWS = "scenario: {}\nstudy: {{design: {{num: 40}}, axes: {{x: {{path: {}, side: world, relative: 0.02}}}}}}\n"
LIMIT = {"robot": "slip_max_m<0.02", "own": "goal=travelled_m > 0"}
EXPORTED = {"robot": ["scenario=walk_tripod"], "own": ["scenario=own"]}


@pytest.fixture(params=["robot", "own"])
def system(request, fake_engine, tmp_path, monkeypatch):
    """A project with a small study of either, which the robot's fake engine takes no time for."""
    monkeypatch.chdir(tmp_path)
    assert main(["init", *(["--model"] if request.param == "own" else []), "lab"]) == 0
    monkeypatch.chdir(tmp_path / "lab")
    study = ROBOT if request.param == "robot" else [*OWN, "outcome.goal='travelled_m > -9'"]
    for folder in ("a", "b"):
        assert main(["run", *study, f"out={folder}"]) == 0
    Path("studies/draws.yaml").write_text(DRAWS.format(*DRAWN[request.param]))
    more = study[1:] if request.param == "own" else []
    assert main(["run", "study=draws", *more, "out=draws"]) == 0
    return request.param


def lines(system):
    """The command of each row."""
    study = ROBOT if system == "robot" else OWN
    return {
        "run": ["run", *study, "out=c"],
        "run engine=mjx": ["run", *study, "engine=mjx", "--dry-run"],
        "run --limit": ["run", *study, "out=d", "--limit", "2"],
        "run --check": ["run", *study, "--check"],
        "status": ["status", "a"],
        "verify": ["verify", "a"],
        "table": ["table", "a"],
        "stats": ["stats", "a"],
        "compare": ["compare", "a", "b"],
        "certify": ["certify", "draws", "--failures", "0.9"],
        "relabel": ["relabel", "b", LIMIT[system]],
        "audit": ["audit", "a", "--ways", "again"],
        "report": ["report", "a"],
        "report A B": ["report", "a", "b"],
        "report --replays": ["report", "a", "--replays", "1"],
        "export --paper": ["export", "a", "--paper", "paper"],
        "replay": ["replay", "a", "1"],
        "replay --png": ["replay", "a", "1", "--png", "pictures"],
        "replay --mcap": ["replay", "a", "1", "--mcap", "r.mcap"],
        "replay --states": ["replay", "a", "1", "--states", "states.parquet"],
        "view": ["view", "a", "1", "-o", "v.html"],
        "export-model": ["export-model", *EXPORTED[system], "out=exported"],
    }


def test_each_cell_is_as_the_page_says(system, capsys):
    wrong = {}
    assert {command for command, _ in CELLS} == {*lines(system)}
    for command, line in lines(system).items():
        capsys.readouterr()
        code = main(line)
        said = capsys.readouterr().err
        if "pictures need OpenGL" in said:  # which this machine has none of
            continue
        if (code in (0, 4)) != CELLS[command, system]:
            wrong[command] = code, said
    assert not wrong
