"""Errors of single terms of a learned policy's observation: noise, bias, delay and drop-out, each on its own."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from robots import save_perceptron, write_project
from small_study import one_line

from sweep.cli.main import main
from sweep.config.experiment import compose
from sweep.runs import batches, store
from sweep.runs.runner import select_points_to_simulate

POLICY = "observation: [{term: sensor, sensor: clock, name: time}, base_height]\naction: {scale: 1.0}\n"


def simulate(*axis):
    """Times (rollouts, ticks) that the policy has seen, as its first action is: what is late, wrong or held."""
    exp = compose(["study=one", "engine.precision=float64", *axis])
    rows = select_points_to_simulate(exp)
    exp = batches.allocate_delay_buffers(exp, rows)
    rows = batches.assign_batches(exp, pd.DataFrame(), rows).assign(width=len(rows))
    task = batches.make_batch(exp, rows)
    made = exp.system.make_engine(task.settings, task.world, task.belief, None)
    return np.stack([one.joint_target[:, 1] for one in made.traces(task.world, task.belief, task.streams, 1)])


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A policy whose action is tanh of 0.1 times the time that it measures, and 0 times the height."""
    monkeypatch.chdir(tmp_path)
    write_project(tmp_path, POLICY)
    robot = Path("robot.xml").read_text()
    Path("robot.xml").write_text(robot.replace("<sensor>", '<sensor><clock name="clock"/>'))
    save_perceptron("walk.onnx", (2, 12), weight=np.tile([0.1, 0.0], (12, 1)))
    return tmp_path


def measured(commands):
    """The time that a command comes from: the first hip's stand is at 0.795."""
    return np.arctanh(commands - 0.795) / 0.1


def test_each_error_acts_on_its_term_alone(here):
    time = 0.02 * np.arange(50)
    late = measured(simulate("study.axes.load={path: noise.time.delay, values: [0, 3]}"))
    np.testing.assert_allclose(late[0], time, atol=1e-9)
    np.testing.assert_allclose(late[1], np.maximum(time - 0.06, 0), atol=1e-9)
    other = measured(simulate("study.axes.load={path: noise.base_height.white, values: [0, 3]}"))
    np.testing.assert_allclose(other, np.tile(time, (2, 1)), atol=1e-9)
    white = measured(simulate("study.axes.load={path: noise.time.white, values: [0.1]}", "study.replicates=8")) - time
    assert 0.08 < white.std() < 0.12
    bias = measured(simulate("study.axes.load={path: noise.time.bias, values: [0.1]}", "study.replicates=8")) - time
    assert np.ptp(bias, axis=1).max() < 1e-9
    assert 0.03 < bias[:, 0].std() < 0.3
    held = measured(simulate("study.axes.load={path: noise.time.dropout, values: [0.5]}", "study.replicates=8"))
    stays = np.isclose(np.diff(held, axis=1), 0, atol=1e-9)
    assert 0.4 < stays.mean() < 0.6
    np.testing.assert_allclose(held[:, 1:][~stays], np.tile(time[1:], (8, 1))[~stays], atol=1e-9)


def test_rows_with_errors_of_terms_do_not_depend_on_the_width(here):
    noisy = [
        "study=one",
        "model.duration=0.2",
        "study.replicates=12",
        "+noise.time.white=0.1",
        "+noise.time.dropout=0.3",
    ]
    for width in (5, 12):
        assert main(["run", *noisy, f"engine.width={width}", f"out=w{width}"]) == 0
    a, b = (store.read_rows(Path(f"w{width}")).set_index("point_id")["energy_j"] for width in (5, 12))
    pd.testing.assert_series_equal(a.sort_index(), b.sort_index(), check_exact=True)
    assert a.nunique() == 12


def test_an_unknown_term_is_one_line(here, capsys):
    assert main(["run", "study=one", "+noise.tim.white=0.1"]) == 2
    one_line(capsys.readouterr().err, "noise.tim.white is unknown: did you mean noise.time.white?")
