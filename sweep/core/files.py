"""Files that appear whole or not at all, and the digests that tell whether they stayed as they were written."""

import hashlib
import os
import socket
from collections.abc import Callable
from pathlib import Path

from sweep.core.errors import Fault

HIDDEN = ".tmp-"  # begins the name of a file that is not whole yet


def write_whole(path: Path, content: bytes | Callable[[Path], object]) -> None:
    """Put `content`, or what it writes to the path that it is given, in the place of `path` at once. Raises `Fault`.

    The path given ends as `path` does, so that what goes by a file's suffix can write there.
    """
    hidden = path.with_name(f"{HIDDEN}{socket.gethostname()}-{os.getpid()}-{path.name}")
    try:
        hidden.write_bytes(content) if isinstance(content, bytes) else content(hidden)
        with hidden.open("rb") as written:
            os.fsync(written.fileno())  # a power cut leaves the old content or the new
        os.replace(hidden, path)
    except OSError as error:
        raise Fault(f"{path} cannot be written: {reason(error)}") from None
    finally:
        hidden.unlink(missing_ok=True)


def append(path: Path, line: str) -> None:
    """Add one line, which is on disk when this returns, or not at all. Raises `Fault`."""
    try:
        with path.open("ab", buffering=0) as file:
            before = file.tell()
            try:
                file.write(f"{line}\n".encode())
                os.fsync(file.fileno())
            except OSError:
                file.truncate(before)
                raise
    except OSError as error:
        raise Fault(f"{path} cannot be written: {reason(error)}") from None


def reason(error: OSError) -> str:
    """What the system says of `error`, in one line."""
    return os.strerror(error.errno) if error.errno else str(error).splitlines()[0]


def digest(content: bytes) -> str:
    """SHA-256 (64 hexadecimal digits), as `sha256sum` gives it."""
    return hashlib.sha256(content).hexdigest()
