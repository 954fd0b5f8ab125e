"""A folder of results from a stranger: no command reads, writes or removes a file outside of it."""

import dataclasses
import json
import os
import shutil
from dataclasses import replace

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from slow_cases import mark_slow_cases
from small_study import STUDY, content, one_line

from sweep.api import load
from sweep.cli.main import main
from sweep.core import files
from sweep.core.errors import InputError
from sweep.core.files import path_inside_folder
from sweep.runs import manifest, store

pytestmark = pytest.mark.usefixtures("fake_engine")
SECRET = b"not for strangers"


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """A finished study of 56 rollouts."""
    from fake_engine import FakeEngine

    import sweep.engines
    from sweep.runs import batches

    out = tmp_path_factory.mktemp("sound") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sweep.engines, "make_engine", FakeEngine)
        batches.clear_engine_cache()
        assert main(["run", *STUDY, f"out={out}"]) == 0
        batches.clear_engine_cache()
    return out


@pytest.fixture
def folder(sound, tmp_path):
    return shutil.copytree(sound, tmp_path / "out")


@pytest.fixture
def secret(tmp_path):
    """A file of the user's own, outside of the folder."""
    file = tmp_path / "secret"
    file.write_bytes(SECRET)
    return file


def commands(folder):
    """Every command that reads or writes a folder of results."""
    one = str(folder)
    crate = folder.parent / "made"
    return (["status", one], ["verify", one], ["table", one], ["stats", one], ["report", one], ["list", one],
            ["compare", one, one], ["relabel", one, "slip_max_m<0.011"], ["export", one, "--crate", str(crate)],
            ["export", one, "--paper", str(crate)], ["audit", one], ["certify", one],
            ["run", *STUDY, f"out={folder}"])  # fmt: skip


@pytest.mark.parametrize("name", ["{secret}", "../secret", "parts/../../secret", "parts/", "other/secret", "secret"])
@pytest.mark.parametrize("place", ["part", "beside"])
def test_a_manifest_names_files_of_the_folder_only(folder, secret, capsys, name, place):
    name = name.format(secret=secret)
    entry = dataclasses.replace(store.list_current_parts(folder)[0], file=name, length=len(SECRET), labels="others")
    manifest_line = manifest.format_line(entry if place == "part" else dataclasses.replace(entry, batches=()))
    with (folder / manifest.MANIFEST_FILE).open("a") as file:
        file.write(f"{manifest_line}\n")
    for command in commands(folder):
        capsys.readouterr()
        code = main(command)
        told = capsys.readouterr()
        assert secret.read_bytes() == SECRET, command
        if command[0] == "list":  # names what is wrong with each of many folders
            assert "manifest.txt" in told.out
            continue
        assert code == 2, command
        one_line(told.err, "manifest.txt, line", repr(name))


def test_a_manifest_line_with_values_of_other_types_is_one_line(folder, capsys):
    good = dataclasses.asdict(store.list_current_parts(folder)[0])
    for change in ({"file": 3}, {"batches": ["0"]}, {"length": None}, {"more": 1}):
        text = manifest.json.dumps({**good, **change})
        (folder / manifest.MANIFEST_FILE).write_text(f"{manifest.files.digest(text.encode())[:16]} {text}\n")
        assert main(["table", str(folder)]) == 2
        one_line(capsys.readouterr().err, "manifest.txt, line 1 is no entry")


LINKS = [store.STUDY_FILE, store.POINTS_FILE, manifest.MANIFEST_FILE, store.LOG_FILE, store.LOCK_FILE, "report.html",
         "parts", "part"]  # fmt: skip


@pytest.mark.parametrize("name", mark_slow_cases(LINKS, [store.LOG_FILE, store.LOCK_FILE, "report.html"]))
def test_a_link_that_leads_out_of_the_folder_is_not_followed(folder, secret, capsys, name):
    path = folder / (store.list_current_parts(folder)[0].file if name == "part" else name)
    if name == "parts":
        shutil.move(path, secret.with_name("elsewhere"))
        path.symlink_to(secret.with_name("elsewhere"))
        kept = {file: file.read_bytes() for file in secret.with_name("elsewhere").iterdir()}
    else:
        if path.exists():
            secret.write_bytes(path.read_bytes())
            path.unlink()
        path.symlink_to(secret)
        kept = {secret: secret.read_bytes()}
    for command in commands(folder):
        capsys.readouterr()
        code = main(command)
        assert {file: file.read_bytes() for file in kept} == kept, command
        reads = {store.LOG_FILE: ("report",), store.LOCK_FILE: ("relabel", "run"),
                 "report.html": ("report",)}.get(name)  # fmt: skip
        if command[0] in (reads or ("table", "run", "relabel")) and "--paper" not in command:
            assert code == 2, command
            assert "is not allowed: it leads out of the folder" in capsys.readouterr().err
    if name == "parts":
        assert set(secret.with_name("elsewhere").iterdir()) == set(kept)


def test_a_pipe_in_a_folder_is_refused_and_not_waited_for(folder, capsys):
    for name in (store.POINTS_FILE, store.list_current_parts(folder)[0].file):
        content = (folder / name).read_bytes()
        (folder / name).unlink()
        os.mkfifo(folder / name)
        assert main(["table", str(folder)]) == 2
        one_line(capsys.readouterr().err, "neither a file nor a folder")
        (folder / name).unlink()
        (folder / name).write_bytes(content)


def test_a_path_in_a_folder_may_be_new_and_is_no_link(tmp_path):
    (tmp_path / "here").mkdir()
    (tmp_path / "link").symlink_to("here")
    (tmp_path / "ring").symlink_to("ring")
    assert path_inside_folder(tmp_path, "here/new") == tmp_path / "here/new"
    for name in ("", "/etc/passwd", "here/../../x", "..", "link/new", "link", "ring", "n" * 300):
        with pytest.raises(InputError):
            path_inside_folder(tmp_path, name)


def test_nothing_is_written_through_a_hard_link_or_a_prepared_temporary_name(folder, secret, monkeypatch):
    elsewhere = {}
    for name in (store.LOG_FILE, manifest.MANIFEST_FILE, store.LOCK_FILE):
        other = folder.parent / f"elsewhere-{name}"
        other.write_bytes((folder / name).read_bytes() or SECRET)
        (folder / name).unlink()
        os.link(other, folder / name)
        elsewhere[other] = other.read_bytes()
    monkeypatch.setattr(files.socket, "gethostname", lambda: "host")
    (folder / f"{files.UNFINISHED_PREFIX}host-{os.getpid()}-{store.STUDY_FILE}").symlink_to(secret)
    for command in (["relabel", str(folder), "slip_max_m<0.011"], ["run", *STUDY, f"out={folder}"]):
        assert main(command) == 0
    store.append_to_log(folder, "one line more")
    assert {file: file.read_bytes() for file in elsewhere} == elsewhere
    assert secret.read_bytes() == SECRET
    assert (folder / store.LOG_FILE).read_text().endswith(" one line more\n")


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("rollouts", [], "rollouts"),
        ("stages", {0: "walk"}, "stages"),
        ("versions", "1", "versions"),
        ("config.study.level", "half", "study.level"),
        ("config.study.design.num", "many", "study.design.num"),
        ("config.study.design", 3, "study.design"),
        ("config.scenario.name", "\x1b[2J", "character"),
        ("commit", "a\x1b]0;title\x07", "character"),
        ("commit", "\u202egpj.exe", "character"),
        ("config.study.axes", {"=1+1": {"path": "contact.friction", "values": [1.0]}}, "'=1+1' is not allowed"),
    ],
)
def test_a_study_file_with_values_of_other_types_is_one_line(folder, capsys, path, value, words):
    content = store.read_study(folder)
    *parents, last = path.split(".")
    part = content
    for name in parents:
        part = part[name]
    part[last] = value
    store.write_study(folder, {key: one for key, one in content.items() if key != "format"})
    for command in ("stats", "report", "table"):
        assert main([command, str(folder)]) == 2
        one_line(error := capsys.readouterr().err, words)
        assert error[:-1].isprintable()
    assert main(["list", str(folder)]) == 0


@pytest.mark.parametrize("name", ["parts/a\nb.parquet", "parts/\x1b[2J", f"parts/{'n' * 5000}", "parts/./x", "parts/ü"])
def test_a_manifest_names_files_by_plain_words(folder, capsys, name):
    entry = dataclasses.replace(store.list_current_parts(folder)[0], file=name)
    (folder / manifest.MANIFEST_FILE).write_text(f"{manifest.format_line(entry)}\n")
    assert main(["table", str(folder)]) == 2
    error = capsys.readouterr().err
    one_line(error, "manifest.txt, line 1 names")
    assert error[:-1].isprintable()
    assert len(error) < 1000


def test_a_replay_puts_no_markup_into_a_page(folder, capsys):
    row = store.read_rows(folder).iloc[0]
    (folder / "replays").mkdir()
    file = folder / "replays" / f"{row['run_id']}-{row['point_id']}.json"
    good = {"states": "AAAA", "frames": 1, "step": 0.1, "scales": [], "force_scale": 1.0, "stages": [], "bodies": {},
            "equal": 0, "of": 0, "why": ""}  # fmt: skip
    for change in (
        {"states": "</script><img src=x onerror=alert(1)>"},
        {"frames": 10**12},
        {"bodies": 3},
        {"why": None},
    ):
        file.write_text(json.dumps({**good, **change}))
        assert main(["report", str(folder)]) == 2
        one_line(capsys.readouterr().err, "is no replay")
    file.write_text("[" * 100_000)
    assert main(["report", str(folder)]) == 2
    one_line(capsys.readouterr().err, "is no replay")


def forged(folder, change):
    """The folder with the rows of its first part changed, and a manifest that vouches for them."""
    entries = manifest.read_manifest(folder)
    part = store.list_current_parts(folder)[0]
    rows = change(store.read_part(folder, part))
    manifest.rewrite_manifest(folder, [one for one in entries if one != part])
    (folder / part.file).unlink()
    made = store.write_part(folder, rows, part.study, part.labels)
    manifest.append_entries(folder, dataclasses.replace(made, batches=part.batches))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda rows: rows.iloc[1:], "1 row is missing"),
        (lambda rows: pd.concat([rows] * 10), "72 rows are repeated"),
        (lambda rows: pd.concat([rows, rows.tail(2).assign(slot=[90, 91])]), "2 rows are not planned"),
        (lambda rows: rows.assign(**{rows.columns[0]: 0.123}), "differs in"),
        (lambda rows: rows.drop(columns="stream"), "stream"),
        (lambda rows: rows.assign(**{"@SUM(1)": 0.0}), "a column called '@SUM"),
    ],
)
def test_rows_that_are_not_those_of_the_plan_are_named_and_made_again(folder, whole, capsys, change, words):
    forged(folder, change)
    with pytest.raises(InputError, match=words):
        load(folder)
    assert main(["stats", str(folder)]) == 2
    one_line(capsys.readouterr().err, words)
    assert main(["verify", str(folder)]) == 4
    assert words in capsys.readouterr().out
    assert main(["run", *STUDY, f"out={folder}"]) == 0
    assert "8 rollouts in" in capsys.readouterr().err
    pd.testing.assert_frame_equal(content(folder), whole)


def test_words_that_a_spreadsheet_computes_are_refused(folder, capsys):
    forged(folder, lambda rows: rows.assign(stage="=cmd|'/C calc'!A0"))
    assert main(["table", str(folder), "--format", "csv"]) == 2
    one_line(capsys.readouterr().err, 'column stage holds "=cmd')


def test_verify_counts_planned_rollouts_that_are_not_there(folder, capsys):
    part = store.list_current_parts(folder)[2]
    manifest.rewrite_manifest(folder, [one for one in manifest.read_manifest(folder) if one != part])
    (folder / part.file).unlink()
    assert main(["verify", str(folder)]) == 0
    assert "48 of 56 planned rollouts are there" in capsys.readouterr().out


MODEL = '<mujoco><worldbody><body><joint/><geom size="1"/></body></worldbody></mujoco>'


def give_own_model(folder, model, controller):
    """Have a folder's configuration name a model and a controller."""
    content = {key: one for key, one in store.read_study(folder).items() if key != "format"}
    kept = {key: one for key, one in content["config"].items() if key in ("scenario", "study", "cluster", "out")}
    own = {"mjcf": str(model), "controller": controller, "duration": 0.2}
    content["config"] = {
        **kept,
        "engine": {"name": "native"},
        "model": own,
        "controller": {},
        "noise": {},
        "outcome": {"goal": "duration_s > 0"},
    }
    store.write_study(folder, content)


@pytest.mark.parametrize("place", ["parts", "beside", "crate", "link"])
def test_code_in_a_folder_of_results_is_not_imported(folder, tmp_path, monkeypatch, capsys, place):
    monkeypatch.chdir(tmp_path)
    where = {"parts": "out.parts.evil", "beside": "out.evil", "crate": "crate.project.evil", "link": "linked"}[place]
    file = tmp_path / ("out/evil.py" if place == "link" else f"{where.replace('.', '/')}.py")
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(f"open({str(tmp_path / 'ran')!r}, 'w').close()\npolicy = print\n")
    if place == "crate":
        (tmp_path / "crate/ro-crate-metadata.json").write_text("{}")
    if place == "link":
        (tmp_path / "linked.py").symlink_to(file)
    (tmp_path / "model.xml").write_text(MODEL)
    give_own_model(folder, tmp_path / "model.xml", f"{where}:policy")
    for command in commands(folder):
        if command[0] in ("verify", "list", "run"):  # read no configuration of the folder, or are given another
            continue
        capsys.readouterr()
        assert main(command) == 2, command
        one_line(capsys.readouterr().err, f"model.controller = {where}:policy is not allowed: it lies in {tmp_path}")
    assert not (tmp_path / "ran").exists()


def test_a_model_in_a_folder_of_results_and_modules_of_python_are_refused(folder, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for model in (folder / "model.xml", tmp_path / "model.xml"):
        model.write_text(MODEL)
    give_own_model(folder, folder / "model.xml", "own:policy")
    assert main(["stats", str(folder)]) == 2
    one_line(capsys.readouterr().err, "model.mjcf = ", f"it lies in {folder}")
    for name in ("antigravity", "os", "sys", "idlelib.idle", "xml.etree.ElementTree"):
        give_own_model(folder, tmp_path / "model.xml", f"{name}:open")
        assert main(["stats", str(folder)]) == 2
        one_line(capsys.readouterr().err, f"{name} is a module of Python itself")


def test_a_folder_of_results_is_no_project(folder, tmp_path, monkeypatch):
    (folder / "evil_of_results.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w').close()\n")
    (folder / "sweep.yaml").write_text("modules: [evil_of_results]\n")
    for place in (folder, folder / "parts"):
        monkeypatch.chdir(place)
        assert main(["status", str(folder)]) == 0
        assert main(["list", "study"]) == 0
    assert not (tmp_path / "ran").exists()


def test_names_of_files_are_printed_without_commands_to_a_terminal(folder, capsys):
    (folder / "parts" / "a\nb\x1b]0;title\x07\u202e").write_bytes(b"")
    shown = r"a\nb\x1b]0;title\x07\u202e"
    assert main(["verify", str(folder)]) == 0
    assert f"{shown} is not in manifest.txt" in capsys.readouterr().out
    assert main(["run", *STUDY, f"out={folder}"]) == 0
    assert f"{shown} does not belong to this study" in capsys.readouterr().err
    assert f"{shown} does not belong" in (folder / store.LOG_FILE).read_text()


@pytest.mark.parametrize("name", [store.STUDY_FILE, manifest.MANIFEST_FILE, store.LOG_FILE, "replay"])
def test_a_file_with_a_hole_of_gigabytes_is_not_read(folder, capsys, name):
    row = store.read_rows(folder).iloc[0]
    path = folder / (f"replays/{row['run_id']}-{row['point_id']}.json" if name == "replay" else name)
    path.parent.mkdir(exist_ok=True)
    with path.open("ab") as file:
        file.truncate(2**40)  # which takes no room
    assert main(["report", str(folder)]) == 2
    one_line(capsys.readouterr().err, path.name)


def list_as(folder, entry, path):
    """List a file of a folder in the place of an entry of its manifest, as it is now."""
    listed = [one for one in manifest.read_manifest(folder) if one != entry]
    manifest.rewrite_manifest(
        folder, [*listed, replace(entry, length=path.stat().st_size, sha256=files.digest_file(path))]
    )


@pytest.mark.parametrize("kind", ["points", "part", "unlisted part"])
def test_a_file_that_is_larger_than_the_plan_warrants_is_not_even_hashed(folder, monkeypatch, capsys, kind):
    """A listed file of 1 TB, all of it a hole that takes no room."""
    entries = manifest.read_manifest(folder)
    entry = next(one for one in entries if bool(one.batches) == ("part" in kind))
    with (folder / entry.file).open("ab") as file:
        file.truncate(2**40)
    left = [one for one in entries if one != entry]
    manifest.rewrite_manifest(folder, left if kind == "unlisted part" else [*left, replace(entry, length=2**40)])

    def digest_file(path):
        assert path.stat().st_size < 2**40
        return files.digest(path.read_bytes())

    monkeypatch.setattr(files, "digest_file", digest_file)
    assert main(["verify", str(folder)]) == (0 if kind == "unlisted part" else 4)
    assert kind != "part" or "more than the" in capsys.readouterr().out
    assert main(["status", str(folder)]) == (0 if kind == "unlisted part" else 2)
    assert main(["run", *STUDY, f"out={folder}"]) == 0
    assert len(store.read_rows(folder)) == 56


@pytest.mark.parametrize("kind", ["points", "part"])
def test_a_table_with_more_rows_than_the_plan_is_refused_before_it_is_read(folder, monkeypatch, capsys, kind):
    entry = next(one for one in manifest.read_manifest(folder) if bool(one.batches) == (kind == "part"))
    path = folder / entry.file
    table = pq.read_table(path)
    pq.write_table(pa.concat_tables([table] * 2000), path)
    list_as(folder, entry, path)
    with monkeypatch.context() as patch:
        patch.setattr(pq, "ParquetFile", None)  # nothing may be decoded
        if kind == "part":
            patch.setattr(store, "read_points", lambda *args: pd.read_parquet(folder / manifest.POINTS_FILE))
        assert main(["status", str(folder)]) == 2
    told = capsys.readouterr()
    one_line(told.err, f"{path} is not allowed: it has {len(table) * 2000:,} rows; the study's plan allows")
    assert not told.out
