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
    """List the running parts of the step `what`, each with its duration in an earlier process."""
    told = " and ".join(name + format_last_duration(f"{what}: {name}") for name in tuple(_begun))
    return f": {told}" if told else ""


def format_last_duration(what: str) -> str:
    """Format the duration of a step in an earlier process; empty where it is unknown."""
    seconds = _waits().get(what)
    return f" ({seconds:.0f} s last time)" if seconds else ""


def remember_duration(what: str, seconds: float) -> None:
    """Store the duration of a step (s) and of its parts in the cache folder, for later processes."""
    took = {what: seconds, **{f"{what}: {name}": _took.pop(name) for name in tuple(_took)}}
    long = {name: round(one, 1) for name, one in took.items() if one > WORTH}
    if long and (folder := cache_folder()):
        with suppress(OSError, InputError):  # such as a home that cannot be written
            if ensure_private_folder(folder):
                (folder / KEPT).write_text(json.dumps({**_waits(), **long}))


def _waits() -> dict[str, float]:
    folder = cache_folder()
    with suppress(OSError, ValueError):
        return dict(json.loads((folder / KEPT).read_text())) if folder else {}
    return {}
