"""Entry point of the command `sweep`. It imports little at first, so that an early Ctrl-C is handled."""

import atexit
import errno
import gc
import sys

from sweep.cli import streams
from sweep.cli.exits import BAD_INPUT, FAULT, INTERRUPTED
from sweep.core import interrupts, user_code
from sweep.core.errors import Fault, InputError, escape_control_characters


def main(argv: list[str] | None = None) -> int:
    """Run one command and return its exit code.

    0 done, 2 bad input, 3 invalid rows, 4 expectation not met, 5 disk, memory or workers failed, 130 interrupted.
    """
    gc.set_threshold(50_000)  # imports and tracing make a million objects, none in vain: 10 % of a start
    atexit.register(gc.freeze)  # nor are they looked through at the end, which takes as long again
    if argv is None:  # this process is the command's own
        interrupts.install_interrupt_handler()
    if sys.stdout is sys.__stdout__:  # not of a notebook, or of a test
        streams.protect_streams()
    try:
        return run_command(argv)
    finally:
        for line in user_code.take_printed_lines():  # what is in no folder's log
            print(f"sweep: {escape_control_characters(line)}", file=sys.stderr)


def run_command(argv: list[str] | None) -> int:
    """Run the subcommand in `argv` and return its exit code; print each error as one line on standard error."""
    try:
        from sweep.cli import commands  # takes a tenth of a second
        from sweep.core import project

        try:
            with project.convert_user_errors():
                return commands.execute_command(list(sys.argv[1:] if argv is None else argv))
        finally:
            sys.stdout.flush()  # here, where it is told that nothing could be written
    except InputError as error:
        print(f"sweep: {error}", file=sys.stderr)
        return BAD_INPUT
    except Fault as error:
        print(f"sweep: {error}", file=sys.stderr)
        return FAULT
    except KeyboardInterrupt:
        interrupts.print_interrupt_message()
        return INTERRUPTED
    except OSError as error:
        from sweep.core.files import PATH_ERRORS, os_error_text

        lost = "the working folder" if error.errno == errno.ENOENT else ""  # which alone has no name here
        name = error.filename2 or error.filename or lost  # of a copy the target
        print(f"sweep: {escape_control_characters(f'{name}: ' if name else '')}{os_error_text(error)}", file=sys.stderr)
        return BAD_INPUT if error.errno in PATH_ERRORS else FAULT  # such as a full disk
