"""Progress of long steps on the standard error: a changing line on a terminal, an occasional line in a pipe."""

import json
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

from sweep.core.errors import InputError
from sweep.core.files import cache_folder, ensure_private_folder

FIRST_LINE_AFTER_S, LINE_INTERVAL_S = (
    10.0,
    60.0,
)  # s of silence before the first line in a pipe, and between further lines
MIN_STORED_DURATION_S = 2.0  # s: shorter durations are not stored
DURATIONS_FILE = "waits.json"  # beside the compiled programs
_begun: dict[str, float] = {}  # start times of running parts, by name
_took: dict[str, float] = {}  # durations of finished parts (s), by name
_compiled = 0.0  # s that this process has spent on compiling


@dataclass(frozen=True)
class LiveProgress:
    """Progress of a run whose page reloads itself."""

    text: str
    reload_s: float  # after which the page loads its next version


@contextmanager
def show_elapsed_time(step: Callable[[], str] | str) -> Iterator[None]:
    """Print a step's description and its elapsed time to the standard error, from a thread, while this context runs."""
    done, start, terminal = threading.Event(), time.perf_counter(), sys.stderr.isatty()

    def tell() -> None:
        pause = 1.0 if terminal else FIRST_LINE_AFTER_S
        while not done.wait(pause):
            line = f"{step() if callable(step) else step}, {time.perf_counter() - start:.0f} s"
            text = f"\r\x1b[K{line}" if terminal else f"sweep: {line}\n"
            print(text, end="", file=sys.stderr, flush=True)
            pause = 1.0 if terminal else LINE_INTERVAL_S

    teller = threading.Thread(target=tell, daemon=True)
    teller.start()
    try:
        yield
    finally:
        done.set()
        teller.join()
        if terminal:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)


@contextmanager
def show_progress_counts(step: Callable[..., str], *counts: int) -> Iterator[Callable[..., None]]:
    """Print progress to standard error while this context runs, from counts that the caller updates.

    Args:
        what: Formats the counts as a phrase.
        *counts: The first counts.

    Yields:
        A function that takes new counts.
    """
    now = counts

    def count(*new: int) -> None:
        nonlocal now
        now = new

    with show_elapsed_time(lambda: step(*now)):
        yield count


@contextmanager
def measure_part_duration(name: str) -> Iterator[None]:
    """Measure the duration of this context as a named part of a longer step; parts may run concurrently."""
    start = _begun[name] = time.perf_counter()
    try:
        yield
        _took[name] = time.perf_counter() - start
    finally:
        _begun.pop(name, None)


def format_running_parts(step: str) -> str:
    """Format the running parts of a step: how long each has run, and how long it took in an earlier process."""
    now = time.perf_counter()
    texts = [
        f"{name} for {now - start:.0f} s{format_last_duration(f'{step}: {name}')}"
        for name, start in tuple(_begun.items())
    ]
    return f": {' and '.join(texts)}" if texts else ""


@contextmanager
def time_compilation() -> Iterator[None]:
    """Add the duration of this context to the compile time of the process."""
    global _compiled
    start = time.perf_counter()
    try:
        yield
    finally:
        _compiled += time.perf_counter() - start


def compilation_seconds() -> float:
    """Return the time that this process has spent on compiling so far, in seconds."""
    return _compiled


def format_compile_estimate(step: str) -> str:
    """Format as text how long compilation and first batch will take, judged by their last time on this machine."""
    waits = _load_waits()
    if waits is None:
        return f"compile time unknown: {cache_folder()}/{DURATIONS_FILE} is damaged; the next run rewrites it"
    if step not in waits:
        return "compile time unknown: not measured on this machine before"
    return f"about {waits[step]:.0f} s to compile and run the first batch, as last time on this machine"


def format_last_duration(step: str) -> str:
    """Format the duration of a step in an earlier process, such as ` (12 s last time)`; empty where it is unknown."""
    seconds = (_load_waits() or {}).get(step)
    return f" ({seconds:.0f} s last time)" if seconds else ""


def store_step_duration(step: str, seconds: float) -> None:
    """Store the duration of a step, and of its parts, in the cache folder. Durations below 2 s are not stored.

    Args:
        what: Name of the step.
        seconds: Its duration, in seconds.
    """
    took = {step: seconds, **{f"{step}: {name}": _took.pop(name) for name in tuple(_took)}}
    long = {name: round(one, 1) for name, one in took.items() if one > MIN_STORED_DURATION_S}
    if long and (folder := cache_folder()):
        with suppress(OSError, InputError):  # such as a home that cannot be written
            if ensure_private_folder(folder):
                (folder / DURATIONS_FILE).write_text(json.dumps({**(_load_waits() or {}), **long}))


def _load_waits() -> dict[str, float] | None:
    """Read the stored durations (s) by name of the step; None where the file is damaged."""
    folder = cache_folder()
    try:
        waits = json.loads((folder / DURATIONS_FILE).read_text()) if folder else {}
        return {str(name): float(seconds) for name, seconds in waits.items()}
    except OSError:
        return {}
    except (ValueError, TypeError, AttributeError):
        return None
