"""What a command writes is whole, quoted and escaped, whatever the names in it and wherever it is run."""

import errno
import io
import os
import shutil
import subprocess
import sys

import pandas as pd
import pytest
from slow_cases import mark_slow_cases
from small_study import FAKE, STUDY, one_line

from sweep.cli.main import main
from sweep.report import tables
from sweep.runs import store

pytestmark = pytest.mark.usefixtures("fake_engine")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    from fake_engine import FakeEngine

    import sweep.engines
    from sweep.runs import batches

    path = tmp_path_factory.mktemp("out")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sweep.engines, "make_engine", FakeEngine)
        batches.clear_engine_cache()
        assert main(["run", *STUDY, f"out={path}"]) == 0
    return path


def test_headers_with_commas_and_quotes_are_quoted():
    rows = pd.DataFrame({"axis.a,b": [1.5], 'axis.say "c"': [2.5], "axis.d\ne": ["x"]})
    pd.testing.assert_frame_equal(pd.read_csv(io.BytesIO(tables.csv_bytes(rows))), rows)


def test_a_line_break_in_a_condition_is_no_line_of_latex(folder, tmp_path):
    where = "friction >\n 0.1 and\n\\tilt_max_deg > -1".replace("\\", "")
    assert main(["export", str(folder), "--paper", str(tmp_path), "--where", f"({where})"]) == 0
    lines = (tmp_path / "numbers.tex").read_text().splitlines()
    assert all(line.startswith(("%", "\\newcommand")) for line in lines)


def test_a_table_fits_the_terminal_and_data_for_programs_stay_whole(folder, monkeypatch, capsys):
    monkeypatch.setenv("PAGER", "cat")
    told = {}
    for terminal in (False, True):
        monkeypatch.setattr(sys.stdout, "isatty", lambda is_one=terminal: is_one)
        monkeypatch.setenv("COLUMNS", "80")
        for form in ("markdown", "latex", "csv"):
            assert main(["table", str(folder), "--format", form]) == 0
            told[form, terminal] = capsys.readouterr().out
    assert max(map(len, told["markdown", False].splitlines())) > 80
    assert max(map(len, told["markdown", True].splitlines())) <= 80
    assert told["latex", True] == told["latex", False]
    assert told["csv", True] == told["csv", False]


@pytest.mark.parametrize("command", ["table", "report", "export", "replay"])
def test_a_full_disk_leaves_the_old_output(folder, tmp_path, monkeypatch, capsys, command):
    options = {"table": ["--format", "csv", "-o", str(tmp_path / "t.csv")], "report": ["-o", str(tmp_path)],
               "export": ["--paper", str(tmp_path)],
               "replay": ["3", "--states", str(tmp_path / "s.parquet")]}  # fmt: skip
    assert main([command, str(folder), *options[command]]) == 0
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}

    def full(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    capsys.readouterr()
    assert main([command, str(folder), *options[command]]) == 5
    one_line(capsys.readouterr().err, "No space left")
    assert before == {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}


@pytest.mark.slow
def test_an_open_file_is_added_to_where_it_is(folder, tmp_path):
    """A log that the shell has opened, and a link to it, keep what is there; other files are put in place whole."""
    log, link, other = tmp_path / "log", tmp_path / "link", tmp_path / "other"
    log.write_text("before\n")
    link.symlink_to("/dev/stdout")
    for name in ("/dev/stdout", str(link), "/dev/fd/1", "-"):
        words = [sys.executable, str(FAKE), "table", str(folder), "--format", "csv", "-o", name]
        with log.open("ab") as opened:
            subprocess.run(words, check=True, stdout=opened)
    assert main(["table", str(folder), "--format", "csv", "-o", str(other)]) == 0
    assert log.read_text() == "before\n" + 4 * other.read_text()
    assert link.is_symlink()


def test_a_user_without_a_home_or_our_letters_is_served(folder, tmp_path):
    plain = {key: value for key, value in os.environ.items() if key != "HOME" and not key.startswith(("LC_", "LANG"))}
    plain |= {"LC_ALL": "POSIX", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONPATH": str(FAKE.parent)}
    for command in (["run", *STUDY, f"out={tmp_path}"], ["table", str(folder)], ["stats", str(folder)]):
        done = subprocess.run([sys.executable, str(FAKE), *command], env=plain, capture_output=True)
        assert done.returncode == 0, done.stderr
    assert len(store.read_rows(tmp_path)) == 56


STREAMS = [(">&- 2>&-", 0), ("> /dev/full", 5), ("2> /dev/full", 0), ("2>&1 | true", 0), ("> /dev/full 2>&1", 5)]


@pytest.mark.parametrize(("streams", "code"), mark_slow_cases(STREAMS, STREAMS[2:]))
def test_rows_are_kept_whatever_becomes_of_the_streams(tmp_path, streams, code):
    """Closed, full, or without a reader; a failing output is told, where it can be."""
    words = " ".join(f"'{word}'" for word in (sys.executable, str(FAKE), "run", *STUDY, f"out={tmp_path / 'o'}"))
    buffered = {key: value for key, value in os.environ.items() if key != "PYTHONUNBUFFERED"}
    done = subprocess.run(["bash", "-c", f"set -o pipefail; {words} {streams}"], env=buffered, capture_output=True)
    assert done.returncode == code
    assert len(store.read_rows(tmp_path / "o")) == 56
    told = done.stderr.decode().splitlines()[1:]
    assert told == (["sweep: standard output: No space left on device"] if streams == "> /dev/full" else [])


def test_names_that_are_no_letters_are_refused_and_listed(folder, tmp_path, capsys):
    latin = os.fsencode(tmp_path) + b"/caf\xe9"
    shutil.copytree(os.fsencode(folder), latin)
    for words in (["run", *STUDY, f"out='{os.fsdecode(latin)}'"], ["table", os.fsdecode(latin)]):
        assert main(words) == 2
        one_line(capsys.readouterr().err, r"caf\xe9", "not allowed: letters in UTF-8")
    assert main(["list", str(tmp_path)]) == 0
    assert r"caf\xe9 | walk_map | 56 of 56" in " ".join(capsys.readouterr().out.split())
    assert main(["table", str(tmp_path / "new\nline")]) == 2
    one_line(capsys.readouterr().err, r"new\nline is not a folder of results")


def test_a_working_folder_that_is_gone_is_named(tmp_path, monkeypatch, capsys):
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert main(["list"]) == 2
    one_line(capsys.readouterr().err, "the working folder: No such file or directory")
