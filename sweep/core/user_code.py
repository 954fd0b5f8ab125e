"""Running of user code: working folder, captured output, error locations, and notes on slow calls.

Imports nothing slow.
"""

import contextlib
import io
import os
import re
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from sweep.core.errors import format_user_exception

FIRST_REPORT_AFTER_S, REPORT_INTERVAL_S = (
    10.0,
    60.0,
)  # s until a call that does not return is reported, and until it is again
PACKAGE_FOLDER = Path(__file__).resolve().parents[1]
MAX_LINES = 100  # printed lines, all different, that are kept
_folders: dict[Path, str] = {}  # where code of a folder has changed the working folder to
_printed: dict[str, bool] = {}  # printed lines, and whether `take_printed_lines` has returned them
_tracebacks: list[str] = []
_running: dict[int, tuple[str, float, float]] = {}  # calls: what runs, its start, and after how long it is reported (s)
_watching = threading.Lock()


class _PrintedLineStream(io.TextIOBase):
    """A stream whose lines are kept, each once."""

    def __init__(self, what: str):
        self._what, self._rest = what, ""

    def write(self, text: str) -> int:
        """Collect the complete lines of `text`."""
        *lines, self._rest = f"{self._rest}{text}".split("\n")
        for line in filter(str.strip, lines):
            _keep(f"{self._what} prints: {line}")
        return len(text)

    def close(self) -> None:
        """Store the last line, which has no line break."""
        self.write("\n")
        super().close()


def _keep(line: str) -> None:
    if len(_printed) < MAX_LINES:
        _printed.setdefault(line, False)
    elif len(_printed) == MAX_LINES:
        _printed["further lines printed by user code are left out"] = False


def take_printed_lines(with_tracebacks: bool = False) -> list[str]:
    """Return the lines that user code has printed since the last call; each line is returned once per process.

    Args:
        with_tracebacks: return tracebacks of its errors, too, which are dropped otherwise.
    """
    lines = [line for line, is_taken in _printed.items() if not is_taken]
    _printed.update(dict.fromkeys(lines, True))
    lines += _tracebacks if with_tracebacks else []
    _tracebacks.clear()
    return lines


@contextlib.contextmanager
def run_user_code(what: str, folder: Path) -> Iterator[None]:
    """Context that runs user code in its own folder, captures what it prints, and names file and line of its errors.

    Relative paths are those of its folder, or of the one that it has changed to; ours stay as they are. What it prints
    is kept for `take_printed_lines`. A call that does not return is reported on the standard error.

    Args:
        what: what runs, such as `walk:policy in tick 3`.
        folder: its folder.
    """
    before = os.getcwd()
    os.chdir(_folders.get(folder, folder))
    lines = _PrintedLineStream(what.partition(" ")[0])
    try:
        with report_slow_call(what), contextlib.redirect_stdout(lines):
            yield
    finally:
        with contextlib.suppress(OSError):  # such as a folder that it has removed
            _folders[folder] = os.getcwd()
        os.chdir(before)
        lines.close()


@contextlib.contextmanager
def report_slow_call(what: str, after: float | None = None) -> Iterator[None]:
    """Context that prints a note on standard error if the code inside runs for long.

    Args:
        what: what runs.
        after: seconds until the first report; by default `FIRST_REPORT_AFTER_S`.
    """
    _start_watching()
    number = time.perf_counter_ns()
    _running[number] = what, time.monotonic(), FIRST_REPORT_AFTER_S if after is None else after
    try:
        yield
    finally:
        _running.pop(number, None)


def _start_watching() -> None:
    if _watching.acquire(blocking=False):  # and never released
        threading.Thread(target=_watch, daemon=True).start()


def _watch() -> None:
    due: dict[int, float] = {}  # s of running at which a call is reported next
    while True:
        time.sleep(0.5)
        running = dict(_running)
        due = {number: due.get(number, after) for number, (_, _, after) in running.items()}
        for number, (what, since, _) in running.items():
            seconds = time.monotonic() - since
            if seconds >= due[number]:
                due[number] = seconds + REPORT_INTERVAL_S
                start = "\r\x1b[K" if sys.stderr.isatty() else ""
                print(f"{start}sweep: {what} has not returned for {seconds:.0f} s", file=sys.stderr, flush=True)


def describe_user_error(error: BaseException, folder: Path) -> str | None:
    """Describe an exception of a user's code in a line, with file and line where it was raised.

    The traceback is kept for `take_printed_lines`.

    Args:
        error: the exception, or one of JAX's that quotes the traceback of a callback.
        folder: the project's folder.

    Returns:
        `ValueError: no way (walk.py, line 12)`, or None where no file below `folder` took part.
    """
    import traceback  # not at the start of every command

    frames = [(frame.filename, frame.lineno or 0) for frame in traceback.extract_tb(error.__traceback__)]
    reason = format_user_exception(error)
    text = str(error)
    if quoted := [(file, int(line)) for file, line in re.findall(r'File "([^"]+)", line (\d+)', text)]:
        frames, reason = quoted, text.strip().splitlines()[-1]
    own = [(Path(file), line) for file, line in frames if _is_below(Path(file), folder)]
    if not own:
        return None
    _tracebacks.extend(f"  {file}, line {line}" for file, line in own)
    _tracebacks.append(f"  {reason}")
    return f"{reason} ({own[-1][0].name}, line {own[-1][1]})"


def _is_below(file: Path, folder: Path) -> bool:
    """Whether a file is the user's own: below their folder, and in no environment there."""
    installed = {"site-packages", "dist-packages"} & {*file.parts} or file.is_relative_to(PACKAGE_FOLDER)
    return file.is_absolute() and file.is_relative_to(folder.resolve()) and not installed
