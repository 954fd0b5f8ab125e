"""Progress of a run: a bar on a terminal, else a line from time to time."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext

import pandas as pd
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TimeElapsedColumn
from rich.text import Text

from sweep.core.progress import (
    compilation_seconds,
    format_last_duration,
    format_running_parts,
    show_elapsed_time,
    store_step_duration,
)
from sweep.runs import runner
from sweep.study.clusters import WorkerStatus


class RemainingTimeEstimate:
    """Estimate of a run's remaining time from its finished batches, without compile time."""

    def __init__(self, total: int):
        self.total, self.done = total, 0
        self.start = self.last = time.perf_counter()
        self._compiled, self._first = compilation_seconds(), (0, 0.0)

    def add_finished_rollouts(self, rollouts: int) -> None:
        """Add a number of finished rollouts to the estimate."""
        self.done, self.last = self.done + rollouts, time.perf_counter()
        if not self._first[0]:
            self._first = rollouts, self.last

    def remaining_s(self) -> float | None:
        """Return the remaining time (s); None before the first batch is finished."""
        first, since = self._first
        if not first:
            return None
        if self.done > first:
            seconds = (self.last - since) / (self.done - first)
        else:
            seconds = max(0.0, since - self.start - (compilation_seconds() - self._compiled)) / first
        return max(0.0, seconds * (self.total - self.done) - (time.perf_counter() - self.last))

    def remaining_text(self) -> str:
        """Format the remaining time as minutes and seconds, or dashes while it is unknown."""
        seconds = self.remaining_s()
        return f"{'-:--' if seconds is None else format_minutes(seconds)} left"


def format_minutes(seconds: float) -> str:
    """Format a duration as minutes and seconds, such as `2:05`."""
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"


class LiveProgressColumn(ProgressColumn):
    """Column of a progress bar whose text is updated every second."""

    max_refresh = 1.0  # s

    def __init__(self, text: Callable[[], str]):
        super().__init__()
        self.text = text

    def render(self, task: Task) -> Text:
        """Return the present text of the progress bar's column."""
        return Text(self.text(), no_wrap=True)


@contextmanager
def report_progress(
    name: str, total: int, program: str, watched: WorkerStatus | None = None
) -> Iterator[runner.ProgressCallback]:
    """Context that shows the progress of a run: a bar on a terminal, else an occasional line."""
    console = Console(stderr=True)
    start, done, pace = time.perf_counter(), 0, RemainingTimeEstimate(total)
    counts = dict.fromkeys(("success", "failure", "invalid"), 0)
    # numbers first: a narrow terminal cuts the end of the line off
    columns = (
        MofNCompleteColumn(),
        LiveProgressColumn(pace.remaining_text),
        TimeElapsedColumn(),
        BarColumn(bar_width=10),
        LiveProgressColumn(lambda: f"{name}: {note()}"),
    )

    def note() -> str:
        if not done:
            return f"compiling {program}{format_last_duration(program)}{format_running_parts(program)}"
        left = f", about {pace.remaining_s():.0f} s left" if not console.is_terminal else ""
        workers = f", {watched.workers} workers" if watched and watched.workers is not None else ""
        # counts, since shares of a search for failures, of a refined map or of an unfinished grid are no rates
        outcomes = f"{counts['success']:,} succeeded, {counts['failure']:,} failed"
        invalid = f", {counts['invalid']:,} invalid" if counts["invalid"] else ""
        return f"{done / (time.perf_counter() - start):.1f} rollouts/s, {outcomes}{invalid}{left}{workers}"

    silent = nullcontext() if console.is_terminal else show_elapsed_time(lambda: f"{name}: {done} of {total}, {note()}")
    with silent, Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task(name, total=total)

        def report(rows: pd.DataFrame) -> None:
            nonlocal done
            if not done:
                store_step_duration(program, time.perf_counter() - start)
            pace.add_finished_rollouts(len(rows))
            done += len(rows)
            for outcome in counts:
                counts[outcome] += int((rows["outcome"] == outcome).sum())
            bar.update(task, completed=done)

        yield report
