"""Files that appear whole or not at all, and the digests that tell whether they stayed as they were written."""

import base64
import contextlib
import errno
import hashlib
import os
import socket
import sys
import tempfile
import zlib
from collections.abc import Buffer, Callable
from pathlib import Path

from sweep.core.errors import Fault, InputError

# where the path is to blame, not the disk
UNFIT = (errno.ENOENT, errno.EEXIST, errno.ENOTDIR, errno.EISDIR, errno.ENAMETOOLONG, errno.ELOOP,
         errno.EACCES, errno.EPERM, errno.EROFS, errno.EBADF)  # fmt: skip
LINKS = 40  # that lead on from one to the next, at most, as Linux has it
HIDDEN = ".tmp-"  # begins the name of a file that is not whole yet
_unfinished: set[Path] = set()  # hidden files that are being written


def write_whole(path: Path, content: bytes | Callable[[Path], object]) -> None:
    """Put `content`, or what it writes to the path that it is given, in the place of `path` at once.

    The path given ends as `path` does, so that what goes by a file's suffix can write there. A link stays one, and a
    device is written to as it is, /dev/stdout after what is there. Raises `InputError` where the path is to blame,
    else `Fault`.
    """
    hidden = None
    try:
        if (stream := descriptor(path)) is not None:
            return _pass_on(stream, path.name, content)
        path = path.resolve() if path.is_symlink() else path
        hidden = path.parent / f"{HIDDEN}{socket.gethostname()}-{os.getpid()}-{path.name}"
        _unfinished.add(hidden)
        to = path if path.exists() and not path.is_file() else hidden
        if to is hidden or path.is_dir():
            to.open("wb").close()  # what is wrong with a path others' writers do not tell
        to.write_bytes(content) if isinstance(content, bytes) else content(to)
        if to is hidden:
            with hidden.open("rb") as written:
                os.fsync(written.fileno())  # a power cut leaves the old content or the new
            os.replace(hidden, path)
    except OSError as error:
        kind = InputError if error.errno in UNFIT else Fault
        raise kind(f"{path} cannot be written: {reason(error)}") from None
    finally:
        with contextlib.suppress(OSError):  # nor can it be there where nothing can be written
            if hidden:
                _unfinished.discard(hidden)
                hidden.unlink()


def remove_unfinished() -> None:
    """Remove the hidden files that other threads of this process are writing, before the process is ended by force."""
    for hidden in tuple(_unfinished):
        hidden.unlink(missing_ok=True)


def path_in(folder: Path, name: str | Path) -> Path:
    """Return the path of a file or folder inside a results folder, which may come from a stranger.

    Every read, write and removal in a results folder goes through this check.

    Args:
        folder: The results folder. It may itself be a symbolic link.
        name: Path below `folder`. It need not exist.

    Returns:
        `folder / name`.

    Raises:
        InputError: `name` is absolute or has `..`, a symbolic link leads out of `folder`, or the path is a device,
            pipe or socket.
    """
    path, inside = folder / name, Path(name)
    if inside.is_absolute() or ".." in inside.parts or not inside.parts:
        raise InputError(f"{name} in {folder} is not allowed: a path below the folder")
    try:
        target = path.resolve()
        if not target.is_relative_to(folder.resolve()):
            raise InputError(f"{path} is not allowed: it leads out of the folder, to {target}")
        if path.exists() and not (path.is_file() or path.is_dir()):
            raise InputError(f"{path} is not allowed: neither a file nor a folder")
    except OSError as error:  # such as a ring of links
        raise InputError(f"{path} cannot be read: {reason(error)}") from None
    return path


def descriptor(path: Path) -> int | None:
    """The number of the open file that `path` stands for, such as /dev/stdout or /dev/fd/3; None of any other path.

    Behind it may be a file that others append to: to put another in its place would lose what they write.
    """
    for _ in range(LINKS):
        if path.name.isdecimal() and path.parent.resolve() in (Path("/dev/fd"), Path(f"/proc/{os.getpid()}/fd")):
            return int(path.name)
        if not path.is_symlink():
            return None
        path = path.parent / path.readlink()
    return None


def _pass_on(stream: int, name: str, content: bytes | Callable[[Path], object]) -> None:
    """Write to a descriptor; what writes to a path of its own may have to seek there, so that it has a file first."""
    if not isinstance(content, bytes):
        with tempfile.TemporaryDirectory() as folder:
            content(file := Path(folder) / name)
            content = file.read_bytes()
    sys.stdout.flush()  # what was said before
    # a reader, such as `head`, has seen enough
    with contextlib.suppress(BrokenPipeError), open(stream, "wb", closefd=False) as file:
        file.write(content)


def legible(name: str | Path) -> str:
    """A name as text that can be written anywhere: bytes of it that are no UTF-8 as `\\xe9`."""
    return str(name).encode(errors="surrogateescape").decode(errors="backslashreplace")


def as_text(content: bytes) -> str:
    """Bytes as text: deflated, in base64."""
    return base64.b64encode(zlib.compress(content, 9)).decode()


def from_text(text: str) -> bytes:
    """Bytes from the text that `as_text` made of them."""
    return zlib.decompress(base64.b64decode(text))


def append(path: Path, line: str) -> None:
    """Add a line, or a few, on disk when this returns, or not at all. Raises `Fault`."""
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


def cache_folder() -> Path | None:
    """Where is kept what spares a start, such as compiled programs; None for a user without a home.

    Empty and relative settings count for none.
    """
    given = Path(os.environ.get("XDG_CACHE_HOME", ""))
    try:
        return (given if given.is_absolute() else Path.home() / ".cache") / "insect-sweep"
    except RuntimeError:
        return None


def private(path: Path) -> bool:
    """Whether there is a folder at `path`, made for this user alone where it is missing.

    Raises `InputError` where others can put files there: what is kept in it is run.
    """
    try:
        path.mkdir(parents=True, exist_ok=True, mode=0o700)
        own(path)
    except OSError:
        return False
    return True


def own(path: Path) -> None:
    """Raises `InputError` where `path` belongs to another user or others may write it."""
    found = path.stat()
    if found.st_uid != os.geteuid() or found.st_mode & 0o022:
        whose = "belongs to another user" if found.st_uid != os.geteuid() else "can be written by others (chmod go-w)"
        raise InputError(f"{path} {whose}, and what is kept there is run: remove it, or set XDG_CACHE_HOME")


def reason(error: OSError) -> str:
    """What the system says of `error`, in one line."""
    return os.strerror(error.errno) if error.errno else str(error).splitlines()[0]


def digest(content: Buffer) -> str:
    """SHA-256 (64 hexadecimal digits), as `sha256sum` gives it."""
    return hashlib.sha256(content).hexdigest()
