"""Protect the standard streams against closed descriptors, full disks and readers that have gone."""

import io
import os
import sys
from typing import TextIO


class SafeStream(io.TextIOWrapper):
    """A standard stream that discards output after its first write error. Errors other than the expected `loss` are
    raised once."""

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
        """Write `text` to the stream; do nothing after an error."""
        try:
            return super().write(text)
        except OSError as error:
            self._fail(error)
            return len(text)

    def flush(self) -> None:
        """Flush the stream; do nothing after an error."""
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


def protect_streams() -> None:
    """Replace this process's standard streams, so that errors on them do not end a command.

    Closed descriptors are opened on /dev/null; otherwise the next file would take their number and receive our
    messages.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # which takes the lowest number that is free
    sys.stdout = SafeStream(
        1, "standard output", sys.stdout, BrokenPipeError
    )  # a reader, such as `head`, has seen enough
    sys.stderr = SafeStream(2, "standard error", sys.stderr, OSError)
