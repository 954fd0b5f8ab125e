"""Studies of research/studies are files that run by path; folders made when they had names go on."""

import shutil
from pathlib import Path

import pytest
from small_study import one_line
from test_docs import AnyEngine

from sweep.cli.choices import shipped_group_choices
from sweep.cli.main import main
from sweep.config.experiment import compose
from sweep.runs import store

FOLDER = Path(__file__).parents[1] / "research" / "studies"
STUDIES = sorted(FOLDER.glob("*.yaml"))


@pytest.mark.parametrize("file", STUDIES, ids=lambda file: file.stem)
def test_every_study_of_the_evidence_runs_by_path_from_anywhere(file, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    exp = compose([f"study={file}"])
    assert exp.study.axes
    assert exp.study.name in (file.stem, exp.scenario + file.stem[file.stem.index("_") :])
    assert file.stem not in shipped_group_choices("study")


@pytest.mark.parametrize("fake_engine", [AnyEngine], indirect=True)
def test_a_folder_made_by_name_is_opened_resumed_and_reproduced(fake_engine, monkeypatch, tmp_path, capsys):
    assert main(["init", str(tmp_path / "lab")]) == 0
    monkeypatch.chdir(tmp_path / "lab")
    for name in ("corner_draws", "corner_unknown"):  # as when both had names
        text = (FOLDER / f"{name}.yaml").read_text().replace("extends: corner_draws.yaml", "extends: corner_draws")
        Path("studies", f"{name}.yaml").write_text(text)
    few = ["study.design.num=8", "study.expect=[]", "study.invalid_max=1"]
    assert main(["run", "study=corner_unknown", *few, "--limit", "5"]) == 0
    for name in ("corner_draws", "corner_unknown"):
        Path("studies", f"{name}.yaml").unlink()
    capsys.readouterr()
    folder = Path("results/corner_unknown")
    for command in ("status", "table", "stats"):
        assert main([command, str(folder)]) == 0
    assert main(["run", "study=corner_unknown", *few]) == 2
    one_line(capsys.readouterr().err, "study = corner_unknown is unknown", "study=research/studies/NAME.yaml")
    assert main(["run", f"study={FOLDER / 'corner_unknown.yaml'}", *few]) == 0
    assert len(store.read_rows(folder)) == 8
    assert main(["verify", str(folder)]) == 0
    assert main(["export", str(folder), "--crate", "crate"]) == 0
    assert main(["reproduce", "crate", "--rows", "2"]) == 0
    assert "2 rollouts simulated again" in capsys.readouterr().out


def test_a_file_is_extended_from_beside_it(monkeypatch, tmp_path):
    (tmp_path / "here").mkdir()
    shutil.copy(FOLDER / "beam_known.yaml", tmp_path / "here" / "base.yaml")
    (tmp_path / "here" / "more.yaml").write_text("extends: base.yaml\nstudy: {seed: 7}\n")
    (tmp_path / "base.yaml").write_text("scenario: walk_tripod\n")
    monkeypatch.chdir(tmp_path)
    exp = compose(["study=here/more.yaml"])
    assert (exp.scenario, exp.study.seed) == ("beam_cross", 7)
