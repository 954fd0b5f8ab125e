import signal

import numpy as np
import pandas as pd
import pytest
from small_study import BATCHES, STUDY, content, one_line, start, wait_for

from sweep.cli.main import main
from sweep.runs import runner, store

pytestmark = pytest.mark.usefixtures("fake_engine")


def test_same_command_gives_the_same_files(tmp_path):
    for name in "ab":
        assert main(["run", *STUDY, f"out={tmp_path / name}"]) == 0
    pd.testing.assert_frame_equal(content(tmp_path / "a"), content(tmp_path / "b"))
    assert len(content(tmp_path / "a")) == 56
    assert (tmp_path / "a" / store.POINTS_FILE).read_bytes() == (tmp_path / "b" / store.POINTS_FILE).read_bytes()
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "a" / store.PARTS_FOLDER).iterdir()}
    assert main(["run", *STUDY, f"out={tmp_path / 'a'}"]) == 0  # nothing is missing: nothing is written
    assert before == {p: p.stat().st_mtime_ns for p in (tmp_path / "a" / store.PARTS_FOLDER).iterdir()}


def test_a_killed_run_restarted_gives_what_an_uninterrupted_one_gives(tmp_path, whole):
    killed = tmp_path / "killed"
    process = start(killed, FAKE_SECONDS="1")
    wait_for(killed, 2, process)
    process.send_signal(signal.SIGSTOP)  # it keeps its lock, and on a busy machine does not finish before it is killed
    assert main(["run", *STUDY, f"out={killed}"]) == 2  # locked by the other process
    process.send_signal(signal.SIGKILL)
    process.communicate()
    done = store.finished_batches(killed)
    assert 2 <= len(done) < BATCHES
    assert main(["run", *STUDY, f"out={killed}"]) == 0
    pd.testing.assert_frame_equal(content(killed), whole)


def test_a_limited_run_is_a_beginning_and_a_larger_study_an_extension(tmp_path, capsys):
    out = f"out={tmp_path}"
    assert main(["run", *STUDY, out, "--limit", "5"]) == 0
    first = store.read_points(tmp_path)
    assert len(first) == len(content(tmp_path)) == 5
    assert main(["run", *STUDY, out, "--where", "friction > 1"]) == 0
    assert main(["run", *STUDY, out]) == 0
    assert main(["run", *STUDY, out, "study.axes.step.num=13"]) == 0
    rows = content(tmp_path)
    pd.testing.assert_frame_equal(store.read_points(tmp_path).iloc[:5], first)
    assert len(rows) == 8 * 13
    assert rows["point_id"].is_unique
    assert "104 of 104 planned rollouts" in capsys.readouterr().out


def test_a_folder_keeps_to_one_study_and_one_version_of_the_code(tmp_path, capsys, monkeypatch):
    out = f"out={tmp_path}"
    assert main(["run", *STUDY, out, "--limit", "8"]) == 0
    for other, named in (
        (["contact.stiffness=5e5"], "contact.stiffness is 1000000.0 there and 500000.0 here"),
        (["+study.axes.a={path: robot.shin, values: [0.3]}"], "other axes (robot.shin)"),
        (["study.seed=1"], "study.seed is 0 there and 1 here"),
    ):
        capsys.readouterr()
        assert main(["run", *STUDY, out, *other]) == 2
        one_line(capsys.readouterr().err, named)
    monkeypatch.setattr(runner.provenance, "code_version", lambda: "other")
    assert main(["run", *STUDY, out]) == 2
    assert "another version of the code" in capsys.readouterr().err


def test_other_thresholds_judge_the_stored_rows_anew(tmp_path, capsys):
    assert main(["run", *STUDY, f"out={tmp_path}"]) == 0
    rows = content(tmp_path)
    assert main(["relabel", str(tmp_path), "slip_max_m<0.01", "tilt_max_deg=50"]) == 0
    strict = content(tmp_path)
    assert (strict["outcome"] == "success").equals(rows["slip_max_m"] <= 0.01)
    assert set(strict.loc[strict["outcome"] == "failure", "cause"]) == {"slipped"}
    assert main(["run", *STUDY, f"out={tmp_path}"]) == 0  # the last command's thresholds hold for every row
    pd.testing.assert_frame_equal(content(tmp_path), rows)
    assert main(["relabel", str(tmp_path), "slip_max_m>0.1"]) == 2
    assert main(["relabel", str(tmp_path), "slp_max_m<0.1"]) == 2
    assert "did you mean slip_max_m?" in capsys.readouterr().err


def test_a_stored_point_leads_back_to_its_batch(tmp_path):
    assert main(["run", *STUDY, f"out={tmp_path}"]) == 0
    row = content(tmp_path).iloc[42]
    task, slot, found = runner.load_stored_rollout(tmp_path, row["point_id"])
    assert found["point_id"] == row["point_id"]
    assert np.asarray(task.world.contact.friction)[slot] == row["world.contact.friction"]
    assert np.asarray(task.belief.manoeuvre.half_step_ratio)[slot] == row["manoeuvre.half_step_ratio"]
