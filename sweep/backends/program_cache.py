"""Cache of compiled programs on disk, so that a later process need not trace them again.

JAX caches what its compiler makes, but has to trace a program to find it, which takes longer than to load it. A stored
program is machine code within a pickle, since JAX serialises no other way: to load it is to run it. So programs are
loaded only from a folder and files of this user that nobody else can write, and only if their digest matches: XLA
aborts the process over a damaged program.
"""

import contextlib
import hashlib
import os
import pickle
import threading
import warnings
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.experimental.compilation_cache.compilation_cache import reset_cache
from jax.experimental.serialize_executable import deserialize_and_load, serialize
from jax.stages import Compiled

from sweep.core import files, provenance
from sweep.core.errors import InputError
from sweep.core.progress import time_compilation
from sweep.fused import driver

MAX_FILES = 200  # of about a MB each; the oldest are deleted
DIGEST_SIZE = hashlib.sha256().digest_size  # bytes before the compressed content
_jax_settings = threading.RLock()


class SerializedXlaProgram(NamedTuple):
    """An XLA program in JAX's serialized form, as the program cache stores it."""

    content: tuple[Any, ...]


def load_or_compile(
    key_parts: Any, devices: Sequence[Any], compile_programs: Callable[[], Sequence[Any]]
) -> Sequence[Any]:
    """Load compiled XLA programs from the cache, or compile and store them.

    Args:
        key_parts: all that the programs depend on, beyond the code of this package, the versions of its libraries,
            JAX's settings and the kind of the devices. Its `repr` is hashed.
        devices: devices that the programs are for.
        compile_programs: compiles the programs.

    Returns:
        The programs.

    Raises:
        InputError: Other users can write to the cached file.
    """
    with _jax_settings:  # another thread may be changing them
        folder = _folder()
        if folder is None:
            with time_compilation():
                return compile_programs()
        file = folder / f"{_key(key_parts, devices)}.programs"
        if (found := _load(file, devices)) is not None:
            return found
        with disable_compilation_caches(), time_compilation():
            made = compile_programs()
    try:
        _store(file, pickle.dumps([_serialize(part) for part in made]))
    except Exception as error:  # such as a full disk: the programs can run, and the next process compiles them again
        _warn("kept", error)
    return made


@contextlib.contextmanager
def disable_compilation_caches() -> Iterator[None]:
    """Context without the compilation caches of this package and of JAX. Only one thread at a time can be in it.

    A CPU program that JAX loads from its own cache lacks functions when it is serialised again.
    """
    with _jax_settings:
        before = jax.config.jax_enable_compilation_cache
        try:
            jax.config.update("jax_enable_compilation_cache", False)
            reset_cache()
            yield
        finally:
            jax.config.update("jax_enable_compilation_cache", before)
            reset_cache()


def _folder() -> Path | None:
    """Folder of JAX's cache if it is in use. None also where sources have changed since they were imported."""
    place = jax.config.jax_compilation_cache_dir if jax.config.jax_enable_compilation_cache else None
    if not place or provenance.sources_changed():
        return None
    folder = Path(place)
    return folder if files.ensure_private_folder(folder) else None


def _key(key_parts: Any, devices: Sequence[Any]) -> str:
    kind, version = devices[0].device_kind, devices[0].client.platform_version
    where = kind, version, driver.driver_version(), [device.id for device in devices], provenance.processor_id()
    how = sorted(jax.config.values.items()), os.environ.get("XLA_FLAGS")
    return hashlib.blake2b(
        repr((key_parts, provenance.program_version(), where, how)).encode(), digest_size=20
    ).hexdigest()


def _load(file: Path, devices: Sequence[Any]) -> Sequence[Any] | None:
    try:
        files.require_private_path(file)
        packed = file.read_bytes()
        check, content = packed[:DIGEST_SIZE], zlib.decompress(packed[DIGEST_SIZE:])
        if check != hashlib.sha256(content).digest():
            raise ValueError("its content has changed")
        if b"lapack_" in content:  # JAX registers LAPACK only once it lowers a call of it
            jax.jit(jax.lax.linalg.cholesky).lower(np.eye(1))
        parts = pickle.loads(content)
        return [
            deserialize_and_load(*part.content, execution_devices=devices)
            if isinstance(part, SerializedXlaProgram)
            else part
            for part in parts
        ]
    except FileNotFoundError:
        return None
    except InputError:
        raise
    except Exception as error:  # truncated, or made for other devices after all
        _warn("found again", error)
        return None


def _warn(action: str, error: Exception) -> None:
    """Warn that starts will be slow, since nothing else shows it."""
    warnings.warn(f"a compiled program was not {action}: {type(error).__name__}: {error}", RuntimeWarning, stacklevel=3)


def _serialize(part: Any) -> Any:
    return SerializedXlaProgram(serialize(part)) if isinstance(part, Compiled) else part


def _store(file: Path, content: bytes) -> None:
    files.write_atomically(file, hashlib.sha256(content).digest() + zlib.compress(content, level=1))
    for old in sorted(file.parent.glob("*.programs"), key=lambda f: f.stat().st_mtime)[:-MAX_FILES]:
        old.unlink(missing_ok=True)
