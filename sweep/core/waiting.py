"""What is told while one has to wait: on a terminal a line that changes, in a pipe a line now and then."""

import json
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from sweep.core.errors import InputError
from sweep.core.files import cache_folder, private

FIRST, NEXT = 15.0, 60.0  # s, of silence, before the first line in a pipe and between the others
WORTH = 2.0  # s, that a wait lasts to be remembered
KEPT = "waits.json"  # beside the compiled programs
_begun: dict[str, float] = {}  # parts of what is waited for that are under way, and since when
_took: dict[str, float] = {}  # s, of those that are done


@contextmanager
def waiting(what: Callable[[], str] | str) -> Iterator[None]:
    """Say on the standard error, after a moment, what is done and for how long."""
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
def counting(what: Callable[..., str], *counts: int) -> Iterator[Callable[..., None]]:
    """Say, as `waiting` does, what is done by `counts`, until what this gives is called with others."""
    now = counts

    def count(*new: int) -> None:
        nonlocal now
        now = new

    with waiting(lambda: what(*now)):
        yield count


@contextmanager
def part(name: str) -> Iterator[None]:
    """Inside, a part of what is waited for is under way, maybe beside others; see `parts`."""
    start = _begun[name] = time.perf_counter()
    try:
        yield
        _took[name] = time.perf_counter() - start
    finally:
        _begun.pop(name, None)


def parts(what: str) -> str:
    """Which parts of `what` are under way, and how long each took when it was last done here, in words."""
    told = " and ".join(name + last_time(f"{what}: {name}") for name in tuple(_begun))
    return f": {told}" if told else ""


def last_time(what: str) -> str:
    """How long `what` took when it was last waited for, in words; empty where that is not known."""
    seconds = _waits().get(what)
    return f" ({seconds:.0f} s last time)" if seconds else ""


def remember(what: str, seconds: float) -> None:
    """Keep how long `what` and its parts took, beside the compiled programs."""
    took = {what: seconds, **{f"{what}: {name}": _took.pop(name) for name in tuple(_took)}}
    long = {name: round(one, 1) for name, one in took.items() if one > WORTH}
    if long and (folder := cache_folder()):
        with suppress(OSError, InputError):  # such as a home that cannot be written
            if private(folder):
                (folder / KEPT).write_text(json.dumps({**_waits(), **long}))


def _waits() -> dict[str, float]:
    folder = cache_folder()
    with suppress(OSError, ValueError):
        return dict(json.loads((folder / KEPT).read_text())) if folder else {}
    return {}
