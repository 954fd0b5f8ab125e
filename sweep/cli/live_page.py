"""Page of a study that runs: rewritten as rows arrive, until the run ends."""

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from sweep.cli.run_progress import format_minutes
from sweep.core.errors import InputError
from sweep.core.progress import LiveProgress
from sweep.runs import store

LEAST_INTERVAL_S = 5.0  # between two versions of the page
LOCK_CHECK_INTERVAL_S = 1.0  # so that the last version follows soon after the run
IDLE_SHARE = 4.0  # of the time that a version takes, until the next one: the run needs the CPU


def watch_run(folder: Path, write: Callable[[LiveProgress | None], None]) -> None:
    """Write the page of a study again and again while another process adds rows, and once after it has ended.

    Args:
        folder: Folder of the study.
        write: Writes the page, with the progress of the run, or None if no run is under way.

    Raises:
        InputError: The folder has no rows, and no process adds any.
    """
    first: tuple[int, float] | None = None
    shown = -1
    while True:
        is_running = store.is_folder_locked(folder)  # before rows are counted, so that the last version has all
        planned, done = store.count_rollouts(folder)
        began = time.monotonic()
        if done:
            first = first or (done, began)
            progress = measure_progress(planned, done, first, began) if is_running else None
            if done > shown or progress is None:
                write(progress)
                shown = done
        elif not is_running:
            raise InputError(f"{folder} has no rows, and no run adds any: start `sweep run` first")
        if not is_running:
            return
        due = time.monotonic() + max(LEAST_INTERVAL_S, IDLE_SHARE * (time.monotonic() - began))
        while time.monotonic() < due and store.is_folder_locked(folder):  # no longer than the run
            time.sleep(min(LEAST_INTERVAL_S, LOCK_CHECK_INTERVAL_S))


def start_page_process(folder: Path) -> "subprocess.Popen[bytes]":
    """Start `sweep report FOLDER --watch` as a process of its own, so that no rollout waits for a page.

    Args:
        folder: Folder of a study, whose lock the caller holds. The process ends soon after the lock is free, also
            where the caller was interrupted or killed.
    """
    command = [sys.executable, "-m", "sweep.cli", "report", str(folder), "--watch"]
    nothing = subprocess.DEVNULL
    # in a session of its own, which Ctrl-C does not end: its last page has no progress that never advances
    return subprocess.Popen(command, stdin=nothing, stdout=nothing, stderr=nothing, start_new_session=True)


def measure_progress(planned: int, done: int, first: tuple[int, float], now: float) -> LiveProgress:
    """Describe how far a run is, how fast, and how long it will take, from two counts of its rollouts.

    Args:
        planned: Rollouts of the study, as far as it is planned.
        done: Rollouts that are finished now.
        first: Number of rollouts that were finished at an earlier time, and that time (s).
        now: Present time (s).
    """
    text = f"The study runs: {done:,} of {planned:,} rollouts are done"
    earlier, since = first
    if done > earlier:
        rate = (done - earlier) / (now - since)
        text += f", {rate:,.1f} a second, about {format_minutes((planned - done) / rate)} min left"
    return LiveProgress(text, LEAST_INTERVAL_S)
