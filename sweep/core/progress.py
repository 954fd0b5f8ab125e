"""Progress of long steps on the standard error: a changing line on a terminal, an occasional line in a pipe."""

import json
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from sweep.core.errors import InputError
from sweep.core.files import cache_folder, ensure_private_folder

FIRST, NEXT = 15.0, 60.0  # s of silence before the first line in a pipe, and between further lines
WORTH = 2.0  # s: shorter durations are not stored
KEPT = "waits.json"  # beside the compiled programs
_begun: dict[str, float] = {}  # start times of running parts, by name
_took: dict[str, float] = {}  # durations of finished parts (s), by name
_compiled = 0.0  # s that this process has spent on compiling


@contextmanager
def show_wait(what: Callable[[], str] | str) -> Iterator[None]:
    """Print, from a thread, what this context is doing and for how long."""
    done, start, terminal = threading.Event(), time.perf_counter(), sys.stderr.isatty()

    def tell() -> None:
        pause = 1.0 if terminal else FIRST
        while not done.wait(pause):
            line = f"{what() if callable(what) else what}, {time.perf_counter() - start:.0f} s"
            text = f"\r\x1b[K{line}" if terminal else f"sweep: {line}\n"
            print(text, end="", file=sys.stderr, flush=True)
            pause = 1.0 if terminal else NEXT

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
def show_counts(what: Callable[..., str], *counts: int) -> Iterator[Callable[..., None]]:
    """Print progress as `show_wait` does, from counts that the caller updates.

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

    with show_wait(lambda: what(*now)):
        yield count


@contextmanager
def timed_part(name: str) -> Iterator[None]:
    """Measure this context as a named part of a longer step; parts may run side by side."""
    start = _begun[name] = time.perf_counter()
    try:
        yield
        _took[name] = time.perf_counter() - start
    finally:
        _begun.pop(name, None)


def format_running_parts(what: str) -> str:
    """List the running parts of the step `what`: for how long each has run, and its duration in an earlier process."""
    now = time.perf_counter()
    texts = [
        f"{name} for {now - start:.0f} s{format_last_duration(f'{what}: {name}')}"
        for name, start in tuple(_begun.items())
    ]
    return f": {' and '.join(texts)}" if texts else ""


@contextmanager
def timed_compilation() -> Iterator[None]:
    """Count the time within this context as compile time, see `compilation_seconds`."""
    global _compiled
    start = time.perf_counter()
    try:
        yield
    finally:
        _compiled += time.perf_counter() - start


def compilation_seconds() -> float:
    """Return how many seconds this process has spent on compiling so far."""
    return _compiled


def format_compile_estimate(what: str) -> str:
    """Estimate how long compiling `what` and its first batch takes, from the last time on this machine."""
    waits = _load_waits()
    if waits is None:
        return f"compile time unknown: {cache_folder()}/{KEPT} is damaged, and is written anew by the next run"
    if what not in waits:
        return "compile time unknown: not measured on this machine before"
    return f"about {waits[what]:.0f} s to compile and run the first batch, as last time on this machine"


def format_last_duration(what: str) -> str:
    """Format the duration of a step in an earlier process; empty where it is unknown."""
    seconds = (_load_waits() or {}).get(what)
    return f" ({seconds:.0f} s last time)" if seconds else ""


def remember_duration(what: str, seconds: float) -> None:
    """Store the duration of a step (s) and of its parts in the cache folder, for later processes."""
    took = {what: seconds, **{f"{what}: {name}": _took.pop(name) for name in tuple(_took)}}
    long = {name: round(one, 1) for name, one in took.items() if one > WORTH}
    if long and (folder := cache_folder()):
        with suppress(OSError, InputError):  # such as a home that cannot be written
            if ensure_private_folder(folder):
                (folder / KEPT).write_text(json.dumps({**(_load_waits() or {}), **long}))


def _load_waits() -> dict[str, float] | None:
    """Read the stored durations (s) by name of the step; None where the file is damaged."""
    folder = cache_folder()
    try:
        waits = json.loads((folder / KEPT).read_text()) if folder else {}
        return {str(name): float(seconds) for name, seconds in waits.items()}
    except OSError:
        return {}
    except (ValueError, TypeError, AttributeError):
        return None
