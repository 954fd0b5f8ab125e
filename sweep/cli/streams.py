"""The standard streams where they are closed or full, or their reader has gone: what a command does is done."""

import io
import os
import sys
from typing import TextIO


class Borne(io.TextIOWrapper):
    """A standard stream that goes nowhere once it has failed; of what is no `loss` `OSError` is raised, once."""

    def __init__(self, number: int, name: str, stream: TextIO | None, loss: type[OSError]) -> None:
        # kept, as it would close what it shares with this
        self.under = stream or open(number, "w", closefd=False)  # noqa: SIM115
        super().__init__(
            self.under.buffer,
            self.under.encoding,
            "backslashreplace",  # a terminal without our letters shows others instead
            line_buffering=getattr(self.under, "line_buffering", False),
            write_through=getattr(self.under, "write_through", False),
        )
        self.told, self.loss = name, loss

    def write(self, text: str, /) -> int:
        """All of `text`, or the first that fails."""
        try:
            return super().write(text)
        except OSError as error:
            self._fail(error)
            return len(text)

    def flush(self) -> None:
        """What is written goes out."""
        try:
            super().flush()
        except OSError as error:
            self._fail(error)

    def _fail(self, error: OSError) -> None:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self.fileno())
        os.close(nowhere)
        if not isinstance(error, self.loss):
            error.filename = self.told
            raise error


def bear() -> None:
    """Have this process's streams borne: what its errors and notes meet is no error, nor that the output has no reader.

    A number that is closed would go to the next file that is opened, and what is said into it.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # which takes the lowest number that is free
    sys.stdout = Borne(1, "standard output", sys.stdout, BrokenPipeError)  # a reader, such as `head`, has seen enough
    sys.stderr = Borne(2, "standard error", sys.stderr, OSError)
