"""Atomic writes, checked paths, digests, and the cache folder."""

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

from sweep.core.errors import Fault, InputError, escape_control_characters

# errors of a path, not of the disk
PATH_ERRORS = (errno.ENOENT, errno.EEXIST, errno.ENOTDIR, errno.EISDIR, errno.ENAMETOOLONG, errno.ELOOP, errno.EACCES,
               errno.EPERM, errno.EROFS, errno.EBADF)  # fmt: skip
MAX_SYMBOLIC_LINKS = 40  # longest chain of symbolic links, as on Linux
MAX_DECODED_BYTES = 2**28  # bytes that a text of `deflate_to_base64` may stand for
MAX_READ_BYTES = 2**28  # bytes of a file that is read as a whole
UNFINISHED_PREFIX = ".tmp-"  # prefix of files that are being written
_unfinished: set[Path] = set()  # hidden files that are being written


def write_atomically(path: Path, content: bytes | Callable[[Path], object]) -> None:
    """Write a file so that it appears complete or not at all.

    Args:
        path: The file. A symbolic link stays one; a device, such as /dev/stdout, is written to directly.
        content: Bytes, or a function that writes them to a temporary path with the suffix of `path`.

    Raises:
        InputError: The path cannot be written.
        Fault: The disk failed.
    """
    hidden = None
    try:
        if (stream := path_descriptor(path)) is not None:
            return _pass_on(stream, path.name, content)
        path = Path(os.path.realpath(path)) if path.is_symlink() else path
        hidden = path.parent / f"{UNFINISHED_PREFIX}{socket.gethostname()}-{os.getpid()}-{path.name}"
        _unfinished.add(hidden)
        to = path if path.exists() and not path.is_file() else hidden
        hidden.unlink(missing_ok=True)  # a link to another file, perhaps
        if to is hidden or path.is_dir():
            to.open("xb" if to is hidden else "wb").close()  # early, with a clear error that other libraries hide
        to.write_bytes(content) if isinstance(content, bytes) else content(to)
        if to is hidden:
            with hidden.open("rb") as written:
                os.fsync(written.fileno())  # a power cut leaves the old content or the new
            os.replace(hidden, path)
    except OSError as error:
        kind = InputError if error.errno in PATH_ERRORS else Fault
        raise kind(f"{path} cannot be written: {os_error_text(error)}") from None
    finally:
        with contextlib.suppress(OSError):  # nor can it be there where nothing can be written
            if hidden:
                _unfinished.discard(hidden)
                hidden.unlink()


def remove_unfinished_files() -> None:
    """Remove the hidden files that other threads of this process are writing, before the process is ended by force."""
    for hidden in tuple(_unfinished):
        hidden.unlink(missing_ok=True)


def path_inside_folder(folder: Path, name: str | Path) -> Path:
    """Return the path of a file inside a results folder; raise an error if the name, which may be untrusted, leads
    outside.

    Every read, write and removal in a results folder goes through this check.

    Args:
        folder: The results folder. It may itself be a symbolic link.
        name: Path below `folder`. It need not exist.

    Returns:
        `folder / name`.

    Raises:
        InputError: `name` is absolute or has `..`, a part of it is a symbolic link, or the path is a device, pipe or
            socket.
    """
    path, inside = folder / name, Path(name)
    if inside.is_absolute() or ".." in inside.parts or not inside.parts:
        raise InputError(f"{name} in {folder} is not allowed: a path below the folder")
    try:
        target = path.resolve()
        if not target.is_relative_to(folder.resolve()):
            raise InputError(f"{path} is not allowed: it leads out of the folder to {target}")
        if target != folder.resolve() / inside:  # one file of the folder would be written in the place of another
            raise InputError(f"{path} is not allowed: a symbolic link to {target}")
        if path.exists() and not (path.is_file() or path.is_dir()):
            raise InputError(f"{path} is not allowed: neither a file nor a folder")
    except OSError as error:
        raise InputError(f"{path} cannot be read: {os_error_text(error)}") from None
    except RuntimeError:  # by which Python names it
        raise InputError(f"{path} is not allowed: a ring of symbolic links") from None
    return path


def read_bytes_limited(path: Path, most: int = MAX_READ_BYTES) -> bytes:
    """Read a file of a results folder, which may be untrusted, up to a number of bytes.

    Args:
        path: The file.
        most: Largest size (bytes).

    Returns:
        Its content.

    Raises:
        InputError: The file is larger.
        OSError: It cannot be read.
    """
    with path.open("rb") as file:
        content = file.read(most + 1) if os.fstat(file.fileno()).st_size <= most else None
    if content is None or len(content) > most:
        raise InputError(f"{path} is not allowed: more than {most:,} bytes")
    return content


def path_descriptor(path: Path) -> int | None:
    """Return the number of the file descriptor that a path such as /dev/stdout or /dev/fd/3 names; else None.

    The file behind it may be appended to by other programs, so it must not be replaced.
    """
    for _ in range(MAX_SYMBOLIC_LINKS):
        if path.name.isdecimal() and path.parent.resolve() in (Path("/dev/fd"), Path(f"/proc/{os.getpid()}/fd")):
            return int(path.name)
        if not path.is_symlink():
            return None
        path = path.parent / path.readlink()
    return None


def _pass_on(stream: int, name: str, content: bytes | Callable[[Path], object]) -> None:
    # a function that writes to a path may seek, so it gets a regular file first
    if not isinstance(content, bytes):
        with tempfile.TemporaryDirectory() as folder:
            content(file := Path(folder) / name)
            content = file.read_bytes()
    sys.stdout.flush()  # earlier output comes first
    # a reader such as `head` may have closed its end
    with contextlib.suppress(BrokenPipeError), open(stream, "wb", closefd=False) as file:
        file.write(content)


def printable_name(name: str | Path) -> str:
    """Return a file name as printable text: bytes that are not UTF-8 as `\\xe9`, line breaks and the like escaped."""
    return escape_control_characters(str(name).encode(errors="surrogateescape").decode(errors="backslashreplace"))


def deflate_to_base64(content: bytes) -> str:
    """Encode bytes as text: deflate, then base64."""
    return base64.b64encode(zlib.compress(content, 9)).decode()


def inflate_base64(text: str) -> bytes:
    """Decode text from `deflate_to_base64` into bytes.

    Raises:
        ValueError: The text is damaged, or stands for more than `MAX_DECODED_BYTES` bytes.
    """
    unpacked = zlib.decompressobj()
    try:
        content = unpacked.decompress(base64.b64decode(text, validate=True), MAX_DECODED_BYTES)
    except zlib.error as error:
        raise ValueError(str(error)) from None
    if unpacked.unconsumed_tail:
        raise ValueError(f"it expands to more than {MAX_DECODED_BYTES:,} bytes")
    return content


def separate_hard_link(path: Path) -> None:
    """Replace a file that has several hard links by a copy of its own, before it is changed in place.

    Whoever made a results folder may have linked a name in it to another file, as backups by hard links do. Raises
    `InputError` and `Fault` as `write_atomically` does.
    """
    with contextlib.suppress(FileNotFoundError):
        if path.stat(follow_symlinks=False).st_nlink > 1:
            write_atomically(path, read_bytes_limited(path))


def append_line(path: Path, line: str) -> None:
    """Append text and a line break to a file, and flush it to the disk. A failed write is undone.

    Args:
        path: The file; created where it is missing.
        line: The text, which may have several lines.

    Raises:
        Fault: The file cannot be written.
    """
    separate_hard_link(path)
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
        raise Fault(f"{path} cannot be written: {os_error_text(error)}") from None


def cache_folder() -> Path | None:
    """Return the folder of compiled programs and other caches; None for a user without a home.

    XDG_CACHE_HOME is ignored where it is empty or relative.
    """
    given = Path(os.environ.get("XDG_CACHE_HOME", ""))
    try:
        return (given if given.is_absolute() else Path.home() / ".cache") / "insect-sweep"
    except RuntimeError:
        return None


def ensure_private_folder(path: Path) -> bool:
    """Create a folder for this user alone where it is missing, and return whether it is there.

    Raises `InputError` where other users can write to it: programs in it are run.
    """
    try:
        path.mkdir(parents=True, exist_ok=True, mode=0o700)
        require_private_path(path)
    except OSError:
        return False
    return True


def require_private_path(path: Path) -> None:
    """Raise `InputError` where `path` belongs to another user or others can write to it."""
    found = path.stat()
    if found.st_uid != os.geteuid() or found.st_mode & 0o022:
        whose = "belongs to another user" if found.st_uid != os.geteuid() else "can be written by others (chmod go-w)"
        raise InputError(f"{path} {whose}, and sweep runs programs from it: remove it, or set XDG_CACHE_HOME")


def os_error_text(error: OSError) -> str:
    """Return the operating system's message of an error, in one line."""
    return os.strerror(error.errno) if error.errno else str(error).splitlines()[0]


def digest(content: Buffer) -> str:
    """Return the SHA-256 as 64 hexadecimal digits, as `sha256sum` prints it."""
    return hashlib.sha256(content).hexdigest()


def digest_file(path: Path) -> str:
    """Return the SHA-256 of a file's content, read in small pieces, as 64 hexadecimal digits. Raises `OSError`."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
