"""An own model's files: what MuJoCo compiles, and the Python functions that control it."""

import functools
import hashlib
import importlib
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from sweep.core import project
from sweep.core.errors import InputError, suggest


class Controller(NamedTuple):
    """What a user's module says."""

    begin: Callable[..., Any] | None
    policy: Callable[..., Any]
    parameters: Mapping[str, float]  # its own numbers, which are axes: `PARAMETERS`
    believes: Mapping[str, str]  # paths of the model's numbers that it is told, by name: `BELIEVES`
    digest: str  # of its source and of what lies beside it in a package


def place() -> Path:
    """Where a project's files are named from."""
    return project.root() or Path.cwd()


def model(mjcf: str) -> mujoco.MjModel:
    """The compiled model of a file, MJCF or URDF. Raises `InputError`."""
    file = place() / mjcf
    if not mjcf or not file.is_file():
        near = [str(f.relative_to(place())) for f in sorted(place().glob("**/*.xml"))[:50]]
        raise InputError(f"model.mjcf = {mjcf!r} is not a file{suggest(mjcf, near) if near else ''}")
    return _compiled(file, file.stat().st_mtime_ns)


@functools.lru_cache(maxsize=4)
def _compiled(file: Path, changed: int) -> mujoco.MjModel:
    try:
        return mujoco.MjSpec.from_file(str(file)).compile()
    except (ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"model.mjcf = {file.name} does not compile: {reason}") from None


def digest(compiled: mujoco.MjModel) -> str:
    """Of all numbers of a model, its meshes among them."""
    content = np.zeros(mujoco.mj_sizeModel(compiled), np.uint8)
    mujoco.mj_saveModel(compiled, None, content)
    return hashlib.blake2b(content.tobytes(), digest_size=8).hexdigest()


def controller(name: str) -> Controller:
    """The functions that `module:policy` names. Raises `InputError`."""
    module_name, sign, function = name.partition(":")
    if not (sign and module_name and function):
        raise InputError(f"model.controller = {name!r} is not allowed: as my.walk:policy, a module and its function")
    if str(place()) not in sys.path:
        sys.path.insert(0, str(place()))
    try:
        module = importlib.import_module(module_name)
    except Exception as error:  # whatever a user's module raises
        reason = (str(error).splitlines() or [""])[0]
        raise InputError(f"model.controller = {name} cannot be imported: {type(error).__name__}: {reason}") from None
    if not callable(getattr(module, function, None)):
        known = [key for key, value in vars(module).items() if callable(value) and not key.startswith("_")]
        raise InputError(f"model.controller = {name}: {function} is unknown{suggest(function, known)}")
    begin = getattr(module, "begin", None)
    parameters, believes = (getattr(module, key, {}) for key in ("PARAMETERS", "BELIEVES"))
    if both := {*parameters} & {*believes}:
        raise InputError(f"model.controller = {name}: {min(both)} is both in PARAMETERS and in BELIEVES")
    return Controller(begin, getattr(module, function), parameters, believes, _source(module))


def _source(module: Any) -> str:
    file = Path(str(module.__file__))
    inside = file.parent if (file.parent / "__init__.py").exists() else None
    content = [f.read_bytes() for f in (sorted(inside.rglob("*.py")) if inside else [file])]
    return hashlib.blake2b(b"\0".join(content), digest_size=8).hexdigest()
