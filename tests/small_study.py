"""A study of 56 rollouts in 7 batches on the fake engine, run here or in a process of its own."""

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd

from sweep.runs import store
from sweep.study.columns import TIMING_COLUMNS

STUDY = ["study=walk_map", "study.axes.friction.num=8", "study.axes.step.num=7", "engine.width=8", "study.expect=[]",
         "study.replays=0"]  # fmt: skip
BATCHES = 7
FAKE = Path(__file__).with_name("fake_engine.py")


def content(folder: Path) -> pd.DataFrame:
    """Return the rows in `folder`, without columns that differ between equal runs."""
    return store.read_rows(folder).drop(columns=list(TIMING_COLUMNS))


def start(folder: Path, *overrides: str, fake: bool = True, **environment: str) -> subprocess.Popen:
    """Start the study in a process group of its own; unless the engine is real, Dask workers use the fake one too."""
    path = os.pathsep.join([str(FAKE.parent), *os.environ.get("PYTHONPATH", "").split(os.pathsep)])
    paths = {"PYTHONPATH": path, "DASK_DISTRIBUTED__WORKER__PRELOAD": '["fake_engine"]'}
    program = [str(FAKE)] if fake else ["-m", "sweep.cli"]
    command = [sys.executable, *program, "run", *STUDY, f"out={folder}", *overrides]
    return subprocess.Popen(command, env={**os.environ, **paths, **environment}, stdout=subprocess.PIPE,
                            stderr=subprocess.PIPE, text=True, start_new_session=True)  # fmt: skip


def wait_for(folder: Path, parts: int, process: subprocess.Popen) -> None:
    """Wait until so many parts are on disk, while `process` runs."""
    deadline = time.monotonic() + 120
    while len(store.finished_batches(folder)) < parts:
        if process.poll() is not None or time.monotonic() > deadline:
            process.kill()
            raise AssertionError(process.communicate())
        time.sleep(0.01)


def without_progress(text: str) -> str:
    """Return standard error without the progress lines of a busy machine."""
    return re.sub(r"^sweep: (\w+: \d+ of \d+, .*|.* has not returned for \d+ s)\n", "", text, flags=re.MULTILINE)


def one_line(text: str, *parts: str) -> None:
    """Check that `text` is one line of this package's that names `parts`."""
    text = without_progress(text)
    assert text.count("\n") == 1, text
    assert text.startswith("sweep: ")
    assert all(part in text for part in parts), text
