"""What goes wrong on the machine costs time, never rows: one clear line, the designed exit code, the same content."""

import random
import resource
import signal
import subprocess
import time
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from small_study import BATCHES, STUDY, content, one_line, start, wait_for

from sweep.backends import devices
from sweep.cli.main import main
from sweep.runs import store

pytestmark = pytest.mark.usefixtures("fake_engine")


@pytest.mark.slow
def test_twenty_kills_at_random_moments_leave_the_same_rows(tmp_path, whole):
    """From the start of the process on: laying out, writing the plan, between and within parts."""
    moments, kills = random.Random(5), 0
    folder = tmp_path / "killed"
    while kills < 20:
        process = start(folder, FAKE_SECONDS="0.02")
        try:
            process.communicate(timeout=moments.uniform(1.5, 6.0))
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            process.communicate()
            kills += 1
        if (folder / store.STUDY_FILE).exists() and store.finished_batches(folder):
            assert set(content(folder)["point_id"]) <= set(whole["point_id"])
            # so that there is work until the last kill
            (folder / moments.choice(store.list_current_parts(folder)).file).unlink(missing_ok=True)
    assert main(["run", *STUDY, f"out={folder}"]) == 0
    pd.testing.assert_frame_equal(content(folder), whole)
    assert not list(folder.rglob("*.tmp"))


def test_an_interrupted_run_says_so_and_goes_on(tmp_path, whole):
    process = start(tmp_path / "out", FAKE_SECONDS="1")
    wait_for(tmp_path / "out", 2, process)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 130, error
    one_line(error, "interrupted", "finished rollouts are kept, repeat the command")
    assert main(["run", *STUDY, f"out={tmp_path / 'out'}"]) == 0
    pd.testing.assert_frame_equal(content(tmp_path / "out"), whole)


def test_a_full_disk_is_one_line_and_loses_nothing(tmp_path, whole):
    """A limit to the size of files stands for a disk that fills up: the plan fits, a part does not."""
    process = start(tmp_path / "out")
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (12_000, 12_000))
    _, error = process.communicate(timeout=60)
    assert process.returncode == 5
    one_line(error, "part-000000-", "cannot be written", "finished rollouts are kept, repeat the command")
    assert not list((tmp_path / "out" / store.PARTS_FOLDER).iterdir())
    assert main(["run", *STUDY, f"out={tmp_path / 'out'}"]) == 0
    pd.testing.assert_frame_equal(content(tmp_path / "out"), whole)


def test_a_full_disk_leaves_no_part_of_what_is_exported(tmp_path, fake_engine, capsys):
    study, soft_hard = str(tmp_path / "out"), resource.getrlimit(resource.RLIMIT_FSIZE)
    assert main(["run", *STUDY, f"out={study}"]) == 0
    place = str(tmp_path / "there")
    for command in (
        ["replay", study, "0", "--mcap"],
        ["export", study, "--crate"],
        ["export", study, "--zip", "--crate"],
    ):
        resource.setrlimit(resource.RLIMIT_FSIZE, (2_000, soft_hard[1]))
        capsys.readouterr()
        try:
            assert main([*command, place]) == 5
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, soft_hard)
        one_line(capsys.readouterr().err, place)
        assert [path.name for path in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("place", ["/proc/sweep", "file/below"])
def test_a_folder_that_cannot_be_written_is_refused(tmp_path, monkeypatch, capsys, place):
    """Places where not even root may write, whom permissions do not stop."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    assert main(["run", *STUDY, f"out={place}"]) == 2
    one_line(capsys.readouterr().err, f"out = {place} cannot be written")


@pytest.mark.parametrize("place", ["/", "mine"])
@pytest.mark.parametrize("flags", [[], ["--dry-run"]])
def test_a_folder_of_other_files_is_refused_and_left_as_it_is(tmp_path, monkeypatch, capsys, place, flags):
    """Such as the folder of a study's own file, which would be written over."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "study.yaml").write_text("scenario: walk_tripod\n")
    assert main(["run", *STUDY, f"out={place}", *flags]) == 2
    one_line(capsys.readouterr().err, f"out = {place} holds ", " and no results: give a new folder, or an empty one")
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["study.yaml"]
    assert not Path("/parts").exists()


def test_damaged_parts_are_named_and_simulated_again(tmp_path, capsys, whole):
    assert main(["run", *STUDY, f"out={tmp_path}"]) == 0
    parts = [tmp_path / entry.file for entry in store.list_current_parts(tmp_path)]
    data, third = parts[3].read_bytes(), len(parts[3].read_bytes()) // 3
    parts[0].write_bytes(parts[0].read_bytes()[:-100])
    parts[2].write_bytes(b"")
    parts[3].write_bytes(data[:third] + bytes(b ^ 0xFF for b in data[third : third + 40]) + data[third + 40 :])
    sound = {p: p.stat().st_mtime_ns for p in (parts[1], *parts[4:])}
    capsys.readouterr()
    assert main(["table", str(tmp_path)]) == 2
    one_line(capsys.readouterr().err, f"{parts[0].name} is damaged", "`sweep run`")
    assert main(["verify", str(tmp_path)]) == 4
    out = capsys.readouterr().out
    assert [path.name in out for path in parts] == [k in (0, 2, 3) for k in range(BATCHES)]
    assert main(["run", *STUDY, f"out={tmp_path}"]) == 0
    error = capsys.readouterr().err
    assert [f"{path.name} is damaged" in error for path in parts] == [k in (0, 2, 3) for k in range(BATCHES)]
    assert "24 rollouts in" in error
    pd.testing.assert_frame_equal(content(tmp_path), whole)
    assert sound == {p: p.stat().st_mtime_ns for p in sound}
    assert main(["verify", str(tmp_path)]) == 0


def test_too_little_memory_halves_the_width_and_goes_on(tmp_path, whole, monkeypatch):
    monkeypatch.setenv("FAKE_ROOM", "3")
    out = tmp_path / "out"
    assert main(["run", *STUDY, f"out={out}"]) == 0
    rows = content(out)
    assert set(rows["width"]) == {2}
    place = ["batch", "slot", "width", "run_id"]
    pd.testing.assert_frame_equal(
        rows.drop(columns=place).sort_values("point_id", ignore_index=True),
        whole.drop(columns=place).sort_values("point_id", ignore_index=True),
    )
    planned = store.read_points(out)
    pd.testing.assert_frame_equal(planned, rows[planned.columns])
    assert "half the width" in (out / store.LOG_FILE).read_text()
    monkeypatch.setenv("FAKE_ROOM", "0")
    assert main(["run", *STUDY, f"out={tmp_path / 'none'}"]) == 5


@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "", "x"])
def test_a_point_that_is_not_a_number_is_refused(tmp_path, monkeypatch, capsys, value):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "p.csv").write_text(f"contact.friction,robot.shin\n1.0,0.3\n{value},0.3\n")
    assert main(["run", "--points", "p.csv", "out=here"]) == 2
    one_line(capsys.readouterr().err, "contact.friction = ", "is not allowed")
    assert not (tmp_path / "here").exists()


def test_figures_that_are_not_finite_make_a_row_invalid_and_leave_its_neighbours(tmp_path):
    seven = [*STUDY, "study.axes.friction.values=[1.0,7.0,2.0]", "study.invalid_max=0.5"]
    assert main(["run", *seven, f"out={tmp_path}"]) == 0
    rows = content(tmp_path)
    poisoned = rows["world.contact.friction"] == 7
    assert set(rows.loc[poisoned, "outcome"]) == {"invalid"}
    assert set(rows.loc[poisoned, "cause"]) == {"not_finite"}
    assert not np.isin("invalid", rows.loc[~poisoned, "outcome"])


ABSURD = {"robot.shin": "1e-9", "robot.body_mass": "1e15", "drive.stiffness": "1e300", "robot.thigh": "1e9"}


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["mjx", "native"])
def test_absurd_sizes_are_invalid_rows_and_their_neighbours_untouched(tmp_path, monkeypatch, engine):
    """On the real engines: the first row and the last are the same bits whatever lies between them."""
    monkeypatch.undo()
    nominal = {"robot.shin": "0.335", "robot.body_mass": "10", "drive.stiffness": "4.5e4", "robot.thigh": "0.52"}
    sound = [nominal, *(nominal | {"robot.body_mass": mass} for mass in ("9", "8", "11", "12")),
             nominal | {"robot.body_mass": "10.5"}]  # fmt: skip
    absurd = [sound[0], *(nominal | {key: value} for key, value in ABSURD.items()), sound[-1]]
    for name, points in (("sound", sound), ("absurd", absurd)):
        pd.DataFrame(points).to_csv(tmp_path / f"{name}.csv", index=False)
        options = ["engine.width=6", "manoeuvre.steps=1", "study.invalid_max=1", f"out={tmp_path / name}"]
        assert main(["run", f"engine={engine}", "--points", str(tmp_path / f"{name}.csv"), *options]) == 0
    sound, absurd = content(tmp_path / "sound"), content(tmp_path / "absurd")
    pd.testing.assert_frame_equal(absurd.iloc[[0, 5]], sound.iloc[[0, 5]])
    assert set(absurd["outcome"][[0, 5]]) == {"success"}
    assert "success" not in set(absurd["outcome"][1:5]), absurd["outcome"]
    assert (absurd["outcome"][1:5] == "invalid").sum() >= 2


@pytest.mark.slow
def test_kills_of_the_real_engine_leave_the_same_rows(tmp_path, monkeypatch):
    monkeypatch.undo()
    study = [*STUDY[:2], "study.axes.step.num=3", *STUDY[3:], "manoeuvre.steps=1"]
    assert main(["run", *study, f"out={tmp_path / 'whole'}"]) == 0
    out, moments = tmp_path / "killed", random.Random(2)
    for parts in (0, 1, 2):
        process = start(out, *study[2:], fake=False)
        wait_for(out, parts, process)
        time.sleep(moments.uniform(0, 0.5))
        process.kill()
        process.communicate()
    assert len(store.finished_batches(out)) >= 2
    assert main(["run", *study, f"out={out}"]) == 0
    pd.testing.assert_frame_equal(content(out), content(tmp_path / "whole"))


def test_a_device_without_room_is_told_from_other_errors():
    with pytest.raises(MemoryError), devices.convert_memory_errors():
        jnp.zeros(10**14).block_until_ready()
    with pytest.raises(RuntimeError), devices.convert_memory_errors():
        raise RuntimeError("another error")
