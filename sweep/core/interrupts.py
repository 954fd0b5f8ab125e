"""Handling of Ctrl-C: the process ends soon even while a compiler or another library holds the main thread."""

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

GRACE_PERIOD_S = 1.0  # s, from a Ctrl-C until the process is ended by force
INTERRUPT_EXIT_CODE = 130  # exit code of an interrupted command
INTERRUPT_MESSAGE = "sweep: interrupted; finished rollouts are kept, repeat the command"
_patient = threading.Event()  # set while ending in an orderly way matters more than ending soon
_said = threading.Event()


def install_interrupt_handler() -> None:
    """Make Ctrl-C end this process within `GRACE_PERIOD_S` seconds, with its child processes and exit code 130.

    Python raises `KeyboardInterrupt` in the main thread only after that thread returns from C code, and it exits only
    after all threads have ended. A compilation can delay both by minutes. The thread that is started here wakes on the
    signal and ends the process after `GRACE_PERIOD_S` seconds, unless it has ended by then. Does nothing outside the
    main thread, or where the process ignores or handles Ctrl-C itself.
    """
    in_main = threading.current_thread() is threading.main_thread()
    if not in_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        return
    read, write = os.pipe()
    os.set_blocking(write, False)
    signal.set_wakeup_fd(write, warn_on_full_buffer=False)
    threading.Thread(target=_end_after_interrupt, args=(read,), daemon=True).start()


def print_interrupt_message() -> None:
    """Print to the standard error that the command was interrupted; only the first call prints."""
    if not _said.is_set():
        _said.set()
        with suppress(OSError, ValueError):
            print(INTERRUPT_MESSAGE, file=sys.stderr, flush=True)


@contextmanager
def suspend_forced_exit() -> Iterator[None]:
    """Suspend the forced exit after Ctrl-C within this context, so that cleanup such as cancelling jobs can finish."""
    _patient.set()
    try:
        yield
    finally:
        _patient.clear()


def _end_after_interrupt(read: int) -> None:
    while signal.SIGINT not in os.read(read, 1):
        pass
    time.sleep(GRACE_PERIOD_S)
    while _patient.is_set():
        time.sleep(0.1)
    print_interrupt_message()
    kill_descendants(os.getpid())
    if files := sys.modules.get("sweep.core.files"):  # nothing is written before it is imported
        files.remove_unfinished_files()
    os._exit(INTERRUPT_EXIT_CODE)


def kill_descendants(parent: int) -> None:
    """Kill all descendants of the process `parent`, on systems that list processes in /proc."""
    children: dict[int, list[int]] = {}
    for process in filter(str.isdecimal, os.listdir("/proc") if os.path.isdir("/proc") else ()):
        with suppress(OSError, IndexError), open(f"/proc/{process}/stat", errors="replace") as stat:
            after_name = stat.read().rpartition(")")[2].split()  # empty of a process that has just ended
            children.setdefault(int(after_name[1]), []).append(int(process))
    pending = list(children.get(parent, ()))
    while pending:
        process = pending.pop()
        pending += children.get(process, ())
        with suppress(OSError):
            os.kill(process, signal.SIGKILL)
