"""A study as Slurm jobs, on a real Slurm of this one machine: `make slurm`."""

import os
import subprocess
import sys
import time
from pathlib import Path

import one_machine_slurm
import pandas as pd
import psutil
import pytest
from small_study import BATCHES, FAKE, STUDY, content, one_line, start, wait_for, without_progress

from sweep.runs import store

ROOT = Path(__file__).parents[1]
pytestmark = [
    pytest.mark.slurm,
    pytest.mark.usefixtures("fake_engine"),
    pytest.mark.skipif(
        bool(one_machine_slurm.missing_programs()),
        reason=f"needs Debian's slurm-wlm and munge: no {', '.join(one_machine_slurm.missing_programs())}",
    ),
]


@pytest.fixture(scope="module")
def slurm(tmp_path_factory):
    with one_machine_slurm.run_slurm(tmp_path_factory.mktemp("slurm"), cpus=2) as environment:
        yield environment


def jobs(environment) -> list[str]:
    return one_machine_slurm.output(["squeue", "--noheader", "--format=%A %T"], environment).splitlines()


def asked(tmp_path) -> list[str]:
    return ["cluster=slurm", "cluster.workers=2", "cluster.memory=1GB", f"cluster.logs={tmp_path / 'logs'}"]


def test_a_study_as_slurm_jobs_survives_a_killed_worker_and_a_cancelled_job(tmp_path, slurm, whole):
    out = tmp_path / "out"
    process = start(out, *asked(tmp_path), **slurm, FAKE_SECONDS="1.5")
    wait_for(out, 1, process)
    assert len([job for job in jobs(slurm) if "RUNNING" in job]) == 2
    workers = [p for p in psutil.process_iter() if "spawn_main" in " ".join(p.cmdline()) and ran_by_slurm(p)]
    workers[0].kill()
    wait_for(out, 3, process)
    subprocess.run(["scancel", jobs(slurm)[0].split()[0]], env=slurm, check=True)
    assert len(store.finished_batches(out)) < BATCHES
    _, error = process.communicate(timeout=300)
    assert process.returncode == 0, error
    assert without_progress(error).count("\n") == 1, error
    pd.testing.assert_frame_equal(content(out), whole)
    assert not [job for job in jobs(slurm) if "COMPLETING" not in job and "CANCELLED" not in job]


def test_a_job_that_slurm_would_never_take_is_refused(tmp_path, slurm):
    process = start(tmp_path / "out", *asked(tmp_path), "cluster.queue=nowhere", **slurm)
    _, error = process.communicate(timeout=120)
    assert process.returncode == 2
    one_line(error, "invalid partition specified: nowhere")


def test_a_batch_job_that_is_requeued_ends_with_the_rows_of_an_undisturbed_one(tmp_path, slurm, whole):
    """An urgent job takes both processors at once; then the batch job is warned twice, and requeues itself."""
    out, command = tmp_path / "out", tmp_path / "bin/sweep"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\n[ "$1" = report ] || exec {sys.executable} {FAKE} "$@"\n')
    command.chmod(0o755)
    path = os.pathsep.join((str(command.parent), slurm["PATH"]))
    environment = {**slurm, "PATH": path, "PYTHONPATH": str(FAKE.parent), "FAKE_SECONDS": "1.5"}
    environment["DASK_DISTRIBUTED__WORKER__PRELOAD"] = '["fake_engine"]'
    small = [*STUDY[1:], "cluster.workers=1", "cluster.cores=1", "cluster.memory=1GB", "cluster.directives=[]"]
    sbatch = ["sbatch", "--parsable", f"--output={tmp_path}/log"]
    job = one_machine_slurm.output([*sbatch, str(ROOT / "jobs/slurm.sh"), str(out), *small], environment).strip()

    def wait_until(done):
        deadline = time.monotonic() + 240
        while not done():
            assert jobs(slurm), (tmp_path / "log").read_text()
            assert time.monotonic() < deadline, (jobs(slurm), (tmp_path / "log").read_text())
            time.sleep(0.2)

    def start_urgent_job() -> None:
        urgent = [*sbatch[:2], "--partition=urgent", "--ntasks=2", "--output=/dev/null", "--wrap=sleep 1"]
        other = one_machine_slurm.output(urgent, environment).strip()
        wait_until(lambda: not any(line.startswith(other) for line in jobs(slurm)))

    def warn(name: str) -> None:
        subprocess.run(["scancel", "--batch", f"--signal={name}", job], env=slurm, check=True)
        wait_until(lambda: f"{job} PENDING" in jobs(slurm))

    for disturb in (start_urgent_job, lambda: warn("USR1"), lambda: warn("TERM")):
        before = len(store.finished_batches(out)) if out.exists() else 0
        wait_until(lambda before=before: len(store.finished_batches(out)) > before)
        disturb()
        assert len(store.finished_batches(out)) < BATCHES
        # Slurm holds a requeued job back for two minutes; one that starts in the same second has no valid credential
        subprocess.run(["scontrol", "update", f"JobId={job}", "StartTime=now+3"], env=slurm, check=True)
    while jobs(slurm):
        time.sleep(0.2)
    assert "CANCELLED" in (tmp_path / "log").read_text()  # by the urgent job
    pd.testing.assert_frame_equal(content(out), whole)


def ran_by_slurm(process: psutil.Process) -> bool:
    return any("dask" in " ".join(p.cmdline()) for p in process.parents())
