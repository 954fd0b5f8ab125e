"""What is recorded over time beside the rows: histories that a study keeps, last states of rows that are invalid."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from small_study import STUDY, content, one_line

import sweep
from sweep.cli.main import main
from sweep.config.experiment import compose
from sweep.contract.engine import TimeSeriesRequest
from sweep.report import time_series_plots
from sweep.runs import manifest, results, store, time_series
from sweep.runs.batches import assign_batches, make_batch, make_engine, make_nominal_batch
from sweep.runs.runner import select_points_to_simulate

KEEP = ["study.keep=[tilt_deg,base_z_m]", "study.keep_rate=2", "study.keep_rows=20"]
BROKEN = ["study.axes.friction.values=[7,0.3]", "study.axes.step.num=17", "study.invalid_max=1"]


@pytest.fixture
def folder(fake_engine, tmp_path):
    """20 of 56 rows, in three of seven batches, have histories."""
    assert main(["run", *STUDY, *KEEP, f"out={tmp_path / 'out'}"]) == 0
    return tmp_path / "out"


def test_the_first_rows_of_a_study_are_kept_over_time(folder, whole):
    kept, rows = time_series.read_histories(folder), content(folder)
    assert kept.columns.to_list() == ["point_id", "time_s", "tilt_deg", "base_z_m"]
    assert kept["point_id"].unique().tolist() == rows["point_id"].iloc[:20].tolist()
    assert (kept.groupby("point_id").size() == 20).all()  # 10 s, twice a second
    np.testing.assert_allclose(kept["tilt_deg"], kept["time_s"], rtol=1e-6)
    pd.testing.assert_frame_equal(rows.drop(columns="run_id"), whole.drop(columns="run_id"))
    loaded = sweep.load(folder, 'outcome == "failure"').sweep.histories()
    assert set(loaded["outcome"]) == {"failure"}


def test_a_report_lays_histories_over_each_other(folder):
    found = results.read_results(folder)
    (figure,) = time_series_plots.time_series_figure(found)
    table = figure.data
    first = table[(table["column"] == "tilt_deg") & (table["time_s"] == 0.5)]
    assert first["rollouts"].sum() == 20
    assert (first["median"] == 0.5).all()
    assert "20 of 56 rollouts" in figure.caption
    assert len(figure.draw().axes) == 2
    assert main(["report", str(folder)]) == 0
    assert "Over time" in (folder / "report.html").read_text()


def test_a_forecast_says_how_much_is_kept(fake_engine, tmp_path, capsys):
    assert main(["run", *STUDY, *KEEP, "--dry-run", f"out={tmp_path / 'out'}"]) == 0
    assert "time series of 20 rollouts (tilt_deg, base_z_m): about 0.0 MiB" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (["study.keep=[tilt]"], "tilt is unknown: did you mean tilt_deg?"),
        (["study.keep=[tilt_deg]", "study.keep_rate=7"], "a whole fraction of the control rate, 250 a second"),
        (["study.keep=[tilt_deg]", "study.keep_rate=0"], "keep_rate = 0 is not allowed"),
        (["study.keep=[tilt_deg]", "study.keep_rows=0"], "keep_rows = 0 is not allowed: at least 1"),
        (["study.keep=[tilt_deg]", "study.keep_rate=250", "study.keep_rows=1000000", "study.axes.step.num=20000"],
         "at most 500000000 numbers"),
    ],
)  # fmt: skip
def test_histories_that_cannot_be_kept_are_refused(fake_engine, tmp_path, capsys, asked, said):
    assert main(["run", *STUDY, *asked, "--dry-run", f"out={tmp_path / 'out'}"]) == 2
    one_line(capsys.readouterr().err, said)


def test_the_first_invalid_rows_keep_their_last_states(fake_engine, tmp_path):
    assert main(["run", *STUDY, *BROKEN, f"out={tmp_path}"]) == 0
    rows = content(tmp_path)
    broken = rows[rows["outcome"] == "invalid"]
    assert len(broken) == 17
    entries = store.list_recordings(tmp_path, store.LAST_STATES_FOLDER)
    assert [e.file.split("/")[1].split("-")[0] for e in entries] == broken["point_id"].iloc[:10].tolist()
    states = store.read_part(tmp_path, entries[0])
    assert states["time_s"].iloc[0] == pytest.approx(9.004)
    assert states["time_s"].iloc[-1] == pytest.approx(10)
    assert {"qpos_24", "qvel_23", "foot6_force_z_n"} < set(states)
    assert main(["verify", str(tmp_path)]) == 0


def test_a_run_without_invalid_rows_simulates_nothing_twice(folder):
    assert not store.list_recordings(folder, store.LAST_STATES_FOLDER)
    assert not (folder / store.LAST_STATES_FOLDER).exists()


def test_what_lies_beside_the_parts_counts_as_they_do(folder, capsys):
    entry, other = store.list_recordings(folder, store.HISTORIES_FOLDER)[:2]
    (folder / entry.file).write_bytes(b"nothing")
    (folder / store.HISTORIES_FOLDER / "stranger.parquet").write_bytes(b"")
    assert main(["verify", str(folder)]) == 4
    shown = capsys.readouterr()
    assert entry.file in shown.out + shown.err
    assert "stranger.parquet is not in manifest.txt: ignored" in shown.out + shown.err
    assert main(["run", *STUDY, *KEEP, f"out={folder}"]) == 0
    assert entry.file in capsys.readouterr().err
    assert main(["verify", str(folder)]) == 0
    assert entry not in manifest.read_manifest(folder)
    (folder / manifest.MANIFEST_FILE).unlink()
    assert main(["run", *STUDY, *KEEP, f"out={folder}"]) == 0
    assert other in manifest.read_manifest(folder)


def test_relabelling_and_putting_parts_together_keep_histories(folder):
    before = store.list_recordings(folder, store.HISTORIES_FOLDER)
    assert main(["relabel", str(folder), "slip_max_m<0.02"]) == 0
    assert store.list_recordings(folder, store.HISTORIES_FOLDER) == before


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mjx", "native"])
def test_rollouts_that_are_watched_are_those_of_the_run(name):
    exp = compose(["study=walk_map", "study.axes.friction.num=4", "study.axes.step.num=2", "engine.width=8",
                   "manoeuvre.steps=1", f"engine={name}"])  # fmt: skip
    rows = assign_batches(exp, pd.DataFrame(), select_points_to_simulate(exp))
    engine, task = make_engine(exp, make_nominal_batch(exp, rows, 8)), make_batch(exp, rows)
    inputs = task.world, task.belief, task.streams
    watch, trace = TimeSeriesRequest(("base_z_m", "tilt_deg", "foot1_force_z_n"), 5, 10), engine.trace(*inputs, 6)
    figures, samples = engine.run_with_time_series(*inputs, np.array([1, 6, 7]), watch)
    assert samples.shape[1:] == (3, 3)
    frames = len(trace.time) // 5
    np.testing.assert_array_equal(samples[:frames, 1, 0], trace.qpos[4::5, 2][:frames])
    np.testing.assert_array_equal(samples[:frames, 1, 2], trace.foot_force[4::5, 0, 2][:frames])
    for column, values in engine.run(*inputs).items():
        np.testing.assert_array_equal(figures[column], values, err_msg=column)


def test_the_page_on_debugging_finds_what_was_lost_first(fake_engine, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["run", *STUDY, *BROKEN]) == 0
    page = (Path(__file__).parents[1] / "docs/debugging.md").read_text()
    (sample,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    capsys.readouterr()
    exec(sample, {})
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 10
    assert all("9.004" in line for line in lines)
