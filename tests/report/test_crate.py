"""A study as a crate that others can read, and rows of it simulated again."""

import hashlib
import json
import shutil
import subprocess
import zipfile
from importlib.resources import files
from pathlib import Path

import pandas as pd
import pytest
from conftest import simulated
from fake_engine import FakeEngine
from small_study import one_line

from sweep.backends import run_id
from sweep.cli.main import main
from sweep.runs import store

VALIDATOR = shutil.which("rocrate-validator") or ""  # a program of its own: it wants another `rich` than this project
KEEP = """
import sys
from requests.adapters import HTTPAdapter
from requests_cache import CachedSession
from urllib3 import HTTPResponse

class Kept(HTTPAdapter):
    def send(self, request, **_):
        told = {"Content-Type": "application/ld+json"}
        return self.build_response(request, HTTPResponse(open(sys.argv[2], "rb"), told, 200, preload_content=False))

with CachedSession(sys.argv[1], backend="sqlite") as session:
    session.mount("https://", Kept())
    session.get("https://w3id.org/ro/crate/1.1/context")
"""  # has the validator's cache hold a file as that context, so that no network is asked


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    out = tmp_path_factory.mktemp("crate") / "study"
    assert simulated(out, "study.axes.friction.num=4", "study.axes.step.num=3") == 0
    return out


def test_a_crate_has_the_study_and_says_how_it_was_made(study, tmp_path, capsys):
    pytest.importorskip("rocrate")
    assert main(["export", str(study), "--crate", str(tmp_path / "crate"), "--author", "A. Person"]) == 0
    told = json.loads((tmp_path / "crate/ro-crate-metadata.json").read_text())
    entities = {one["@id"]: one for one in told["@graph"]}
    run = entities["#run"]
    files = {one["@id"] for one in [*run["object"], *run["result"]]}
    assert files == {str(file.relative_to(tmp_path / "crate")) for file in (tmp_path / "crate").rglob("*.*")} - {
        "ro-crate-metadata.json"
    }
    program = entities[run["instrument"]["@id"]]
    assert program["softwareVersion"] == store.read_study(study)["commit"]
    assert {entities[one["@id"]]["name"] for one in program["softwareRequirements"]} >= {"mujoco", "jax"}
    assert entities["./"]["license"]["@id"].endswith("CC-BY-4.0")
    pd.testing.assert_frame_equal(store.read_rows(tmp_path / "crate/study"), store.read_rows(study))
    for words, error in ((["--crate", str(tmp_path / "crate")], "is not an empty folder"),
                         ([], "needs either --paper FOLDER or --crate FOLDER"),
                         (["--crate", "else", "--license", "mine"], "--license = mine is not allowed"),
                         (["--crate", "else", "--where", "friction > 1"], "contains the whole study")):  # fmt: skip
        assert main(["export", str(study), *words]) == 2
        assert error in capsys.readouterr().err


def test_a_study_that_a_run_adds_to_is_no_crate(study, tmp_path, capsys):
    pytest.importorskip("rocrate")
    with store.lock_folder(study):
        assert main(["export", str(study), "--crate", str(tmp_path / "crate")]) == 2
    assert "in use by another sweep process" in capsys.readouterr().err
    assert not (tmp_path / "crate").exists()


def test_a_log_that_is_damaged_tells_what_days_it_has(study, tmp_path):
    pytest.importorskip("rocrate")
    folder, crate = tmp_path / "study", tmp_path / "crate"
    shutil.copytree(study, folder)
    (folder / store.LOG_FILE).write_bytes(b"| a |\n2026-01-02T03:04:05+0000 batch 0\n\xff\x00 batch 1\n")
    assert main(["export", str(folder), "--crate", str(crate)]) == 0
    (run,) = (
        one for one in json.loads((crate / "ro-crate-metadata.json").read_text())["@graph"] if one["@id"] == "#run"
    )
    assert run["startTime"] == run["endTime"] == "2026-01-02T03:04:05+00:00"


@pytest.mark.skipif(not VALIDATOR, reason="needs pipx install roc-validator")
def test_a_crate_has_all_that_its_profile_requires(study, tmp_path):
    pytest.importorskip("rocrate")
    crate, cache = tmp_path / "crate", tmp_path / "cache"
    assert main(["export", str(study), "--crate", str(crate), "--author", "A. Person"]) == 0
    # crates refer to the context of RO-Crate 1.1; the library's, of 1.3, has the same terms for all that ours say
    context = files("rocrate") / "data" / "ro-crate.jsonld"
    subprocess.run([Path(VALIDATOR).resolve().with_name("python"), "-c", KEEP, cache, str(context)], check=True)

    def missing():
        words = ["-y", "validate", "--offline", "--cache-path", cache, "-p", "process-run-crate", "-f", "json", crate]
        told = json.loads(subprocess.run([VALIDATOR, *words], capture_output=True, text=True).stdout)
        assert told["passed"] == (not told["issues"])
        assert not told["skipped_checks"]
        return [one["message"] for one in told["issues"]]

    assert missing() == []
    metadata = crate / "ro-crate-metadata.json"
    told = json.loads(metadata.read_text())
    del next(one for one in told["@graph"] if one["@id"] == "#run")["instrument"]
    metadata.write_text(json.dumps(told))
    assert "instrument" in " ".join(missing())


def test_rows_of_a_crate_are_simulated_again(study, fake_engine, tmp_path, capsys, monkeypatch):
    pytest.importorskip("rocrate")
    monkeypatch.chdir(tmp_path)
    assert main(["export", str(study), "--crate", "crate", "--zip"]) == 0
    assert capsys.readouterr().out == "crate.zip\n"
    assert main(["reproduce", "crate.zip", "--rows", "5"]) == 0
    assert "5 rollouts simulated again: 5 equal to the last bit, 0 within 0.001" in capsys.readouterr().out
    run = FakeEngine.run

    def rounded(self, world, belief, streams):  # a machine that rounds otherwise
        figures = run(self, world, belief, streams)
        return figures | {"slip_max_m": figures["slip_max_m"] * (1 + 1e-9)}

    def elsewhere(self, world, belief, streams):  # and sees one of them fall
        figures = rounded(self, world, belief, streams)
        return figures | {"tilt_max_deg": figures["tilt_max_deg"] + 50 * (figures["slip_max_m"] > 0.01)}

    monkeypatch.setattr(FakeEngine, "run", lambda *args: run(*args) | {"energy_j": run(*args)["energy_j"] + 5})
    for command in (["reproduce", "crate.zip", "--rows", "3"], ["verify", str(study), "--simulate", "3"]):
        assert main(command) == 4
        told = capsys.readouterr().out
        assert "3 not; 0 have another outcome" in told
        assert "energy_j" in told
    monkeypatch.setattr(FakeEngine, "run", run)
    assert main(["verify", str(study), "--simulate", "3"]) == 0
    assert "3 equal to the last bit" in capsys.readouterr().out
    assert main(["verify", str(study), "--simulate", "0"]) == 2
    monkeypatch.setattr(FakeEngine, "run", rounded)
    for command in (["reproduce", "crate.zip", "--rows", "3"], ["verify", str(study), "--simulate", "3"]):
        assert main(command) == 4  # rows of one `run_id` are equal to the last bit
        told = capsys.readouterr().out
        assert "0 equal to the last bit, 0 within 0.001 in every metric, 3 not" in told
        assert told.count("slip_max_m 0.") == 3
    monkeypatch.setattr(run_id, "describe_device", lambda settings: "another processor")
    for command in (["reproduce", "crate.zip", "--rows", "3"], ["verify", str(study), "--simulate", "3"]):
        assert main(command) == 0
        told = capsys.readouterr().out
        assert "0 equal to the last bit, 3 within 0.001 in every metric, 0 not" in told
        assert "3 were simulated before with other code" in told
    monkeypatch.setattr(FakeEngine, "run", elsewhere)
    assert main(["reproduce", "crate.zip", "--rows", "12"]) == 4
    told = capsys.readouterr().out
    assert "12 rollouts simulated again: 0 equal to the last bit" in told
    assert "success there, failure fell here" in told
    with zipfile.ZipFile("crate.zip") as packed:
        packed.extractall("crate")
    part = next((tmp_path / "crate/study/parts").iterdir())
    part.write_bytes(part.read_bytes()[:-9])
    for crate, error in (("crate", "is damaged"), (str(study), "is not a crate of a study"), ("none", "none is not")):
        assert main(["reproduce", crate]) == 2
        assert error in capsys.readouterr().err


@pytest.fixture(scope="module")
def crate_zip(study, tmp_path_factory):
    pytest.importorskip("rocrate")
    out = tmp_path_factory.mktemp("zip") / "crate"
    assert main(["export", str(study), "--crate", str(out), "--zip"]) == 0
    return out.with_suffix(".zip")


@pytest.mark.parametrize("how", ["modules", "module file", "network"])
def test_code_of_a_crate_runs_only_where_it_is_trusted(crate_zip, fake_engine, tmp_path, monkeypatch, capsys, how):
    monkeypatch.chdir(tmp_path)
    with zipfile.ZipFile(crate_zip) as packed:
        packed.extractall("crate")
    project = tmp_path / "crate/project"
    project.mkdir()
    code = f"open({str(tmp_path / 'ran')!r}, 'w').close()\n"
    name = "walk.onnx" if how == "network" else "stranger_of_a_crate.py"
    (project / name).write_text(code)
    (project / "sweep.yaml").write_text(f"modules: [{'stranger_of_a_crate' if how == 'modules' else ''}]\n")
    assert main(["reproduce", "crate", "--rows", "1"]) == 2
    told = capsys.readouterr()
    assert f"project/{name}, SHA-256 {hashlib.sha256(code.encode()).hexdigest()}" in told.out
    assert ("module stranger_of_a_crate, by sweep.yaml" in told.out) == (how == "modules")
    assert "--trust" in told.err
    assert not (tmp_path / "ran").exists()
    assert main(["reproduce", "crate", "--rows", "1", "--trust"]) == 0
    assert (tmp_path / "ran").exists() == (how == "modules")


def flagged(content, flag):
    """An archive whose entries say that they are encrypted."""
    for mark, at in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        parts = content.split(mark)
        content = mark.join(
            [parts[0], *(one[: at - 4] + bytes([one[at - 4] | flag]) + one[at - 3 :] for one in parts[1:])]
        )
    return content


@pytest.mark.parametrize("damage", ["encrypted", "method", "checksum", "cut", "text"])
def test_an_archive_that_cannot_be_unpacked_is_one_line(crate_zip, tmp_path, capsys, damage):
    file = tmp_path / "crate.zip"
    content = crate_zip.read_bytes()
    if damage == "encrypted":
        content = flagged(content, 1)
    elif damage == "method":
        with zipfile.ZipFile(file, "w", zipfile.ZIP_LZMA) as packed:
            packed.writestr("ro-crate-metadata.json", "{}")
        content = file.read_bytes()
    elif damage == "checksum":
        start = content.index(b"PK\x03\x04") + 300
        content = content[:start] + bytes([content[start] ^ 255]) + content[start + 1 :]
    content = {"cut": content[:-100], "text": b"no archive"}.get(damage, content)
    file.write_bytes(content)
    assert main(["reproduce", str(file)]) == 2
    one_line(capsys.readouterr().err, "crate.zip")


def test_an_archive_that_unpacks_to_a_thousand_times_its_size_is_not_unpacked(tmp_path, capsys, monkeypatch):
    file = tmp_path / "bomb.zip"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as packed, packed.open("study/points.parquet", "w") as entry:
        for _ in range(200):
            entry.write(bytes(2**20))
    monkeypatch.setattr(zipfile.ZipFile, "extractall", lambda *_: pytest.fail("it was unpacked"))
    assert main(["reproduce", str(file)]) == 2
    one_line(capsys.readouterr().err, "bomb.zip is not allowed", "unpack to 209,715,200")
