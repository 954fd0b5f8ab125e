import os
import subprocess
import sys
import time

import pytest

from sweep.core import files, progress


def test_a_wait_in_a_pipe_is_told_and_remembered(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(progress, "FIRST_LINE_AFTER_S", 0.05)
    assert progress.format_last_duration("walk for mjx") == ""
    progress.store_step_duration("walk for mjx", 17.2)
    with progress.show_elapsed_time(f"compiling walk for mjx{progress.format_last_duration('walk for mjx')}"):
        time.sleep(0.3)
    out, err = capsys.readouterr()
    assert not out
    assert err == "sweep: compiling walk for mjx (17 s last time), 0 s\n"
    with progress.show_elapsed_time("short"):
        pass
    assert not capsys.readouterr().err


def test_which_program_is_compiled_is_told_with_what_it_took_last_time(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(progress, "MIN_STORED_DURATION_S", 0.0)
    with progress.measure_part_duration("plan"), progress.measure_part_duration("closed loop"):
        assert progress.format_running_parts("ladder for mjx") == ": plan for 0 s and closed loop for 0 s"
        time.sleep(0.1)
    progress.store_step_duration("ladder for mjx", 50.0)
    with progress.measure_part_duration("plan"):
        assert progress.format_running_parts("ladder for mjx") == ": plan for 0 s (0 s last time)"
        assert progress.format_running_parts("walk for mjx") == ": plan for 0 s"
    assert progress.format_running_parts("ladder for mjx") == ""
    progress.store_step_duration("ladder for mjx", 5.0)  # with programs that were kept
    assert progress.format_last_duration("ladder for mjx") == " (5 s last time)"
    assert progress.format_last_duration("ladder for mjx: closed loop")


@pytest.mark.parametrize("folder", [True, False])
def test_waits_are_kept_where_programs_are_or_not_at_all(monkeypatch, tmp_path, folder):
    kept = tmp_path / ".cache" / "insect-sweep"
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", "")
    monkeypatch.setenv("HOME", str(tmp_path))
    if not folder:  # as for a user without a home
        monkeypatch.setattr(progress, "cache_folder", lambda: None)
    before = os.umask(0o002)
    try:
        progress.store_step_duration("walk for mjx", 17.2)
    finally:
        os.umask(before)
    assert progress.format_last_duration("walk for mjx") == (" (17 s last time)" if folder else "")
    assert list(tmp_path.rglob("*.json")) == ([kept / "waits.json"] if folder else [])
    if folder:
        assert files.ensure_private_folder(kept)


def test_the_compilers_own_alarm_is_silent_unless_asked_for():
    code = "import os, sweep, jax; print(os.environ['TF_CPP_MIN_LOG_LEVEL'])"
    for given, told in (({}, "3"), ({"TF_CPP_MIN_LOG_LEVEL": "0"}, "0")):
        done = subprocess.run([sys.executable, "-c", code], env=given, capture_output=True, text=True, check=True)
        assert done.stdout.strip() == told


def test_compile_time_is_estimated_by_the_last_time_on_this_machine(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert "not measured on this machine before" in progress.format_compile_estimate("walk for mjx")
    progress.store_step_duration("walk for mjx", 17.2)
    assert progress.format_compile_estimate("walk for mjx").startswith("about 17 s to compile")
    assert "not measured" in progress.format_compile_estimate("ladder for mjx")


@pytest.mark.parametrize("content", ["", "{", "[1, 2]", '{"walk for mjx": "soon"}', '{"walk for mjx": null}', "\xff"])
def test_a_damaged_file_of_compile_times_is_named_and_written_anew(monkeypatch, tmp_path, content):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    file = tmp_path / "insect-sweep" / "waits.json"
    file.parent.mkdir(mode=0o700)
    file.write_text(content, encoding="latin-1")
    assert f"compile time unknown: {file} is damaged" in progress.format_compile_estimate("walk for mjx")
    assert progress.format_last_duration("walk for mjx") == ""
    progress.store_step_duration("walk for mjx", 17.2)
    assert progress.format_compile_estimate("walk for mjx").startswith("about 17 s")
