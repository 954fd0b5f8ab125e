"""A folder that version 0.2 wrote, with 4 of 8 rollouts done: later versions read, check, resume and compare it."""

import shutil
from pathlib import Path

import pytest
from small_study import one_line

import sweep
from sweep.cli.main import main
from sweep.core import provenance

STORED = Path(__file__).parent / "data/release_0_2"
RUN = ["run", "scenario=walk_tripod", "study=any_errors", "study.design.num=8", "engine=native", "engine.width=4"]


@pytest.fixture
def folder(tmp_path):
    return Path(shutil.copytree(STORED, tmp_path / "stored"))


def test_it_is_small():
    assert sum(file.stat().st_size for file in STORED.rglob("*") if file.is_file()) < 100_000


def test_it_is_read_and_sound(folder, capsys):
    for command in (["status", str(folder)], ["verify", str(folder)], ["table", str(folder)]):
        assert main(command) == 0, capsys.readouterr()
    rows = sweep.load(str(folder))
    assert len(rows) == 4
    assert (rows["outcome"] == "success").all()
    assert rows["slip_max_m"].between(0, 0.05).all()


def test_it_is_compared(folder, capsys):
    assert main(["compare", str(STORED), str(folder)]) == 0
    assert main(["relabel", str(folder), "slip_max_m<1e-9"]) == 0
    assert set(sweep.load(str(folder))["outcome"]) == {"failure"}
    assert main(["compare", str(STORED), str(folder)]) != 0
    capsys.readouterr()


def test_rows_of_other_code_are_not_mixed_into_it(folder, monkeypatch, capsys):
    before = {file: file.read_bytes() for file in folder.rglob("*.parquet")}
    monkeypatch.setattr(provenance, "code_version", lambda: "000000000000")
    assert main([*RUN, "study.name=small", f"out={folder}"]) == 2
    one_line(capsys.readouterr().err, "stored")
    assert before == {file: file.read_bytes() for file in before}
