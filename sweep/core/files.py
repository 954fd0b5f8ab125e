"""Files that appear whole or not at all."""

import os
import socket
from collections.abc import Callable
from pathlib import Path

from sweep.core.errors import Fault


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """`write` into a hidden file of this process, then put it in its place at once. Raises `Fault`."""
    hidden = path.parent / f".{path.name}.{socket.gethostname()}-{os.getpid()}.tmp"
    try:
        write(hidden)
        with hidden.open("rb") as written:
            os.fsync(written.fileno())  # a power cut leaves the old content or the new
        os.replace(hidden, path)
    except OSError as error:
        raise Fault(f"{path} cannot be written: {reason(error)}") from None
    finally:
        hidden.unlink(missing_ok=True)


def reason(error: OSError) -> str:
    """Why, in a few words."""
    return os.strerror(error.errno) if error.errno else str(error).splitlines()[0]
