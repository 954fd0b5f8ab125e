"""Compiled programs kept between processes, so that a later start need not even trace them.

JAX keeps what its compiler makes, but has to trace a program to find it again, which takes longer than to load it.
A kept program is machine code within a pickle, as JAX serialises no other way: to load one is to run it. So they are
loaded only from a folder and files of this user that nobody else can write, and only where a digest of their content
is as it was written: XLA aborts the process over a damaged program.
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
from sweep.core.progress import timed_compilation
from sweep.fused import driver

MOST = 200  # files, of about a MB each
DIGEST = hashlib.sha256().digest_size  # bytes before the compressed content
_jax_settings = threading.RLock()


class Serialized(NamedTuple):
    """A program of XLA's, as JAX gives it; all others are kept as they are."""

    what: tuple[Any, ...]


def programs(made_of: Any, devices: Sequence[Any], compiled: Callable[[], Sequence[Any]]) -> Sequence[Any]:
    """What `compiled` gives for `devices`, or gave in an earlier process.

    The text of `made_of`, the code of this package, its libraries' versions, JAX's settings and the devices' kind have
    to be all that the programs depend on.
    """
    with _jax_settings:  # which another thread may be changing
        folder = _folder()
        if folder is None:
            with timed_compilation():
                return compiled()
        file = folder / f"{_key(made_of, devices)}.programs"
        if (found := _load(file, devices)) is not None:
            return found
        with without_cache(), timed_compilation():
            made = compiled()
    try:
        _store(file, pickle.dumps([_saved(part) for part in made]))
    except Exception as error:  # such as a full disk: what is made can run, and the next start makes it again
        _tell("kept", error)
    return made


@contextlib.contextmanager
def without_cache() -> Iterator[None]:
    """Inside, nothing is kept or found, by JAX neither; one thread at a time.

    A program for a CPU that JAX has from a file of its own lacks functions when it is kept once more.
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
    """Where JAX keeps its own, if it does. Sources that changed meanwhile are not what was traced."""
    place = jax.config.jax_compilation_cache_dir if jax.config.jax_enable_compilation_cache else None
    if not place or provenance.sources_changed():
        return None
    folder = Path(place)
    return folder if files.ensure_private_folder(folder) else None


def _key(made_of: Any, devices: Sequence[Any]) -> str:
    kind, version = devices[0].device_kind, devices[0].client.platform_version
    where = kind, version, driver.version(), [device.id for device in devices], provenance.processor()
    how = sorted(jax.config.values.items()), os.environ.get("XLA_FLAGS")
    return hashlib.blake2b(
        repr((made_of, provenance.program_version(), where, how)).encode(), digest_size=20
    ).hexdigest()


def _load(file: Path, devices: Sequence[Any]) -> Sequence[Any] | None:
    try:
        files.require_private(file)
        packed = file.read_bytes()
        check, content = packed[:DIGEST], zlib.decompress(packed[DIGEST:])
        if check != hashlib.sha256(content).digest():
            raise ValueError("its content has changed")
        if b"lapack_" in content:  # whose functions JAX looks up when it first lowers a call of one, and not before
            jax.jit(jax.lax.linalg.cholesky).lower(np.eye(1))
        parts = pickle.loads(content)
        return [
            deserialize_and_load(*part.what, execution_devices=devices) if isinstance(part, Serialized) else part
            for part in parts
        ]
    except FileNotFoundError:
        return None
    except InputError:
        raise
    except Exception as error:  # cut short, or not for these devices after all
        _tell("found again", error)
        return None


def _tell(what: str, error: Exception) -> None:
    """Once, as starts are slow without anything else to see."""
    warnings.warn(f"a compiled program was not {what}: {type(error).__name__}: {error}", RuntimeWarning, stacklevel=3)


def _saved(part: Any) -> Any:
    return Serialized(serialize(part)) if isinstance(part, Compiled) else part


def _store(file: Path, content: bytes) -> None:
    files.write_atomically(file, hashlib.sha256(content).digest() + zlib.compress(content, level=1))
    for old in sorted(file.parent.glob("*.programs"), key=lambda f: f.stat().st_mtime)[:-MOST]:
        old.unlink(missing_ok=True)
