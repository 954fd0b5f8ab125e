"""Workers come and go; the rows are those of a run in one process."""

import json
import os
import random
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pandas as pd
import psutil
import pytest
from small_study import BATCHES, STUDY, content, one_line, start, wait_for, without_progress

from sweep.cli.main import main
from sweep.core.errors import InputError
from sweep.runs import repair, store, time_series
from sweep.study import clusters

pytestmark = pytest.mark.usefixtures("fake_engine")
WORKERS = ("cluster=dask_local", "cluster.workers=2")


@pytest.mark.slow
def test_a_killed_worker_costs_time_only(tmp_path, whole):
    process = start(tmp_path, *WORKERS, FAKE_SECONDS="0.4")
    wait_for(tmp_path, 2, process)
    workers = [p for p in psutil.Process(process.pid).children(recursive=True) if "spawn_main" in "".join(p.cmdline())]
    assert len(workers) == 2
    random.Random(1).choice(workers).kill()
    assert len(store.finished_batches(tmp_path)) < BATCHES
    out, error = process.communicate(timeout=240)
    assert process.returncode == 0, error
    assert "56 of 56 planned rollouts" in out
    assert without_progress(error).count("\n") == 1
    pd.testing.assert_frame_equal(content(tmp_path), whole)


@pytest.mark.slow
def test_a_batch_that_kills_every_worker_is_named_and_the_others_are_done(tmp_path):
    process = start(tmp_path, *WORKERS, FAKE_DEATH="1.2")
    _, error = process.communicate(timeout=400)
    assert process.returncode == 5
    one_line(error, "1 batches repeatedly lost their worker", "finished rollouts are kept, repeat the command")
    assert store.finished_batches(tmp_path) == set(range(BATCHES - 1))


@pytest.mark.slow
def test_workers_keep_histories_and_the_last_states_of_few_invalid_rows(tmp_path):
    broken = ["study.axes.friction.values=[7,0.3]", "study.axes.step.num=17", "study.invalid_max=1"]
    process = start(tmp_path, *WORKERS, *broken, "study.keep=[tilt_deg]", "study.keep_rows=20")
    _, error = process.communicate(timeout=400)
    assert process.returncode == 0, error
    assert time_series.read_histories(tmp_path)["point_id"].nunique() == 20
    assert len(list((tmp_path / store.LAST_STATES_FOLDER).iterdir())) == 10
    assert not repair.verify_folder(tmp_path)[0]


@pytest.mark.slow
def test_workers_with_too_little_memory_get_narrower_batches(tmp_path, whole):
    process = start(tmp_path, *WORKERS, FAKE_ROOM="4")
    _, error = process.communicate(timeout=240)
    assert process.returncode == 0, error
    rows = content(tmp_path)
    assert set(rows["width"]) == {4}
    assert set(rows["point_id"]) == set(whole["point_id"])
    assert len(rows) == len(whole)


@pytest.mark.slow
def test_an_interrupted_cluster_leaves_no_process_and_goes_on(tmp_path, whole):
    process = start(tmp_path, *WORKERS, FAKE_SECONDS="0.4")
    wait_for(tmp_path, 2, process)
    children = psutil.Process(process.pid).children(recursive=True)
    os.killpg(process.pid, signal.SIGINT)  # as from a terminal: the workers get it too
    _, error = process.communicate(timeout=240)
    assert process.returncode == 130
    one_line(error, "interrupted")
    assert not psutil.wait_procs(children, timeout=30)[1]
    assert main(["run", *STUDY, f"out={tmp_path}"]) == 0  # where it is finished may change
    pd.testing.assert_frame_equal(content(tmp_path), whole)


@pytest.mark.slow
def test_workers_at_an_address_must_have_this_code(tmp_path, whole, monkeypatch, capsys):
    import distributed

    monkeypatch.setenv("PYTHONPATH", os.path.dirname(__file__))
    with distributed.LocalCluster(n_workers=1, dashboard_address=None, preload=["fake_engine"]) as cluster:
        run = ["run", *STUDY, "cluster=dask_address", f"cluster.address={cluster.scheduler_address}"]
        assert main([*run, f"out={tmp_path / 'a'}"]) == 0
        pd.testing.assert_frame_equal(content(tmp_path / "a"), whole)
        monkeypatch.setattr("sweep.core.provenance.code_version", lambda: "other")
        capsys.readouterr()
        assert main([*run, f"out={tmp_path / 'b'}"]) == 2
        one_line(capsys.readouterr().err, "another version of the code", "not other")


@pytest.mark.slow
def test_a_worker_that_hangs_is_named_and_its_batch_goes_to_another(tmp_path, whole, monkeypatch, capsys):
    import dask.config

    monkeypatch.setenv("FAKE_STOP", str(tmp_path / "stopped"))
    monkeypatch.setattr(clusters, "MIN_TIME_LIMIT_S", 4.0)
    monkeypatch.setattr(clusters, "FIRST_BATCH_LIMIT_S", 20.0)  # which another machine's load must not reach
    monkeypatch.setattr(clusters, "RESTART_TIMEOUT_S", 10.0)
    with dask.config.set({"distributed.worker.preload": ["fake_engine"]}):
        assert main(["run", *STUDY, *WORKERS, f"out={tmp_path / 'out'}"]) == 0
    assert (tmp_path / "stopped").exists()
    error = capsys.readouterr().err
    assert "batch 6 has occupied worker tls://" in error
    assert "it is given to another" in error
    pd.testing.assert_frame_equal(content(tmp_path / "out"), whole)


def test_a_scheduler_that_the_command_starts_listens_to_nobody_else():
    import distributed

    with clusters.DaskLocalCluster(workers=1).connect(clusters.WorkerStatus(print)) as dispatch:
        address = dispatch.args[0].scheduler.address  # pyright: ignore
        for security in (None, distributed.Security.temporary()):
            with pytest.raises((OSError, ValueError)):
                distributed.Client(
                    address.replace("tls:", "tls:" if security else "tcp:"), security=security, timeout=2
                )
        assert list(dispatch(abs, [-3])) == [3]


def test_jobs_of_slurm_are_given_keys_that_only_this_user_can_read(tmp_path, monkeypatch):
    seen = []

    def check(script):
        files = [Path(line) for line in re.findall(r"--tls-\w+(?:-\w+)? (\S+)", script)]
        seen.extend((script, *(file.stat().st_mode & 0o077 for file in files), len(files)))
        raise InputError("enough")

    monkeypatch.setattr(clusters, "_check_job", check)
    with (
        pytest.raises(InputError),
        clusters.SlurmCluster(logs=str(tmp_path / "logs")).connect(clusters.WorkerStatus(print)),
    ):
        pass
    assert "tls://" in seen[0]
    assert seen[1:] == [0, 0, 0, 3]


def test_a_cluster_without_workers_and_a_lost_scheduler_are_told(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(clusters, "JOIN_TIMEOUT_S", 1.0)
    monkeypatch.setattr(clusters, "RESTART_TIMEOUT_S", 2.0)
    file, log = tmp_path / "scheduler.json", tmp_path / "out" / store.LOG_FILE

    def wait_for_text(path: Path, text: str) -> None:
        deadline = time.monotonic() + 60
        while not (path.exists() and text in path.read_text()) and time.monotonic() < deadline:
            time.sleep(0.1)

    command = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"]
    command += ["--no-dashboard", "--scheduler-file", str(file)]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as scheduler:
        wait_for_text(file, "}")
        address = json.loads(file.read_text())["address"]
        killer = threading.Thread(target=lambda: (wait_for_text(log, "no worker"), scheduler.kill()))
        killer.start()
        run = ["run", *STUDY, "cluster=dask_address", f"cluster.address={address}", f"out={log.parent}"]
        assert main(run) == 5
        killer.join()
    told = without_progress(capsys.readouterr().err).splitlines()
    assert told[0].startswith(f"sweep: no worker has joined the scheduler {address} for 1 s: its log has no warning")
    assert told[1:] == [f"sweep: the scheduler {address} is lost; finished rollouts are kept, repeat the command"]


def test_a_refused_worker_is_named_with_the_reason():
    """The first two texts are those of Dask's scheduler, whose log `distributed.comm.tcp` writes."""
    failed = "Listener on 'tls://10.0.0.1:8786': TLS handshake failed with remote 'tls://10.0.0.7:4242': "
    reason = "[SSL: CERTIFICATE_VERIFY_FAILED] certificate verify failed (_ssl.c:1000)"
    line = clusters.explain_scheduler_warning(f"{failed}{reason}\n")
    assert line.startswith("it refused the worker at 10.0.0.7:4242, which has other TLS keys or none")
    assert reason in line
    other = clusters.explain_scheduler_warning("Worker tried to connect with a duplicate name: \n 3")
    assert other == "its last warning is: Worker tried to connect with a duplicate name: 3"


def test_what_a_cluster_needs_is_said_before_anything_runs(tmp_path, monkeypatch, capsys):
    cases = (
        (["cluster=dask_address"], "cluster.address is missing"),
        (["cluster=dask_address", "cluster.address=tcp://127.0.0.1:9"], "does not answer"),
        (["engine.width=0", "cluster=slurm"], "needs engine.width"),
        (["cluster=slrm"], "did you mean slurm?"),
        (["cluster=dask_local", "cluster.workers=0"], "cluster.workers = 0"),
    )
    for number, (overrides, named) in enumerate(cases):
        assert main(["run", *STUDY, f"out={tmp_path / str(number)}", *overrides]) == 2
        one_line(capsys.readouterr().err, named)
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert main(["run", *STUDY, f"out={tmp_path / 'none'}", *WORKERS]) == 2
    one_line(capsys.readouterr().err, "pip install 'insect-sweep[cluster]'")
