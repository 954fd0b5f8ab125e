"""A study as Slurm jobs, on a real Slurm of this one machine: `make slurm`."""

import subprocess

import one_machine_slurm
import pandas as pd
import psutil
import pytest
from small_study import BATCHES, content, one_line, start, wait_for, without_progress

from sweep.runs import store

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


def ran_by_slurm(process: psutil.Process) -> bool:
    return any("dask" in " ".join(p.cmdline()) for p in process.parents())
