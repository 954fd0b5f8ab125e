"""Versions of code and libraries that produced a row."""

import ast
import contextlib
import functools
import hashlib
import json
import platform
import subprocess
import sys
from collections.abc import Iterator, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import yaml

from sweep.core import files, project
from sweep.core.errors import Fault, InputError
from sweep.core.version import PROCESS_START_S

SOURCE_FOLDER = Path(__file__).parents[1]
WORKER_MODULES = ("sweep.runs.runner",)  # what it imports can change a row
PROGRAM_MODULES = (
    "sweep.engines",
    "sweep.manoeuvres",
    "sweep.systems.mujoco_model.kernel_engine",
)  # what they import can change a compiled program
SEARCH_MODULES = (
    *WORKER_MODULES,
    "sweep.runs.tuning",
    "sweep.cli.plan_rollouts",
    "sweep.planning.score",
)  # can change what a search of a plan's numbers finds
WHOLE_PACKAGES = (  # packages that import each of their modules, without naming them
    "sweep.core.shared_metrics",
    "sweep.metrics",
    "sweep.study.design_kinds",
    "sweep.systems.mujoco_model.metrics",
)
LIBRARIES = ("mujoco", "mujoco-mjx", "jax", "jaxlib", "llvmlite", "numpy", "scipy", "SALib")
CPU_INFO = Path("/proc/cpuinfo")
_parsed: dict[str, tuple[list[str], str]] = {}  # see `_read`


@functools.cache
def processor_id() -> str:
    """Return the processor's name and a hash of its features, on which compiled programs depend."""
    if not CPU_INFO.exists():
        return platform.processor() or platform.machine()
    lines = CPU_INFO.read_text(encoding="utf-8", errors="replace").splitlines()
    told = {key: value.strip() for key, _, value in (line.partition(":") for line in reversed(lines))}
    told = {key.strip(): value for key, value in told.items()}
    name = told.get("model name") or platform.machine()
    features = " ".join(sorted((told.get("flags") or told.get("Features") or "").split()))
    return f"{name} {hashlib.blake2b(features.encode(), digest_size=4).hexdigest()}"


@functools.cache
def code_version() -> str:
    """Return a hash of all source files and library versions that can change a row."""
    return _version(WORKER_MODULES, library_versions())


@functools.cache
def plan_search_version() -> str:
    """Return a hash of all source files and library versions that can change the result of `sweep tune`."""
    cma = next((one.version for one in metadata.distributions(name="cma")), "")  # which may be missing
    return _version(SEARCH_MODULES, {**library_versions(), "cma": cma})


def is_current_code(version: str, libraries: Mapping[str, str]) -> bool:
    """Return whether a stored code version (a hash) equals that of the installed source files.

    Args:
        version: The stored hash.
        libraries: Versions of the libraries that were stored with it.

    Returns:
        Whether the source files are unchanged; the installed libraries may differ.
    """
    return version == _version(WORKER_MODULES, libraries)


@functools.cache
def program_version() -> str:
    """Return a hash of all source files and library versions that can change a compiled program."""
    return _version(PROGRAM_MODULES, library_versions())


def sources_changed() -> bool:
    """Return whether a source file of compiled programs has changed on disk since this process started."""
    plans = (Path(str(file)) for file in project.shipped_files("plan").values())
    return any(
        file.stat().st_ctime > PROCESS_START_S
        for file in (*list_source_files(PROGRAM_MODULES), *plans, *project.user_module_sources())
    )


def _version(modules: tuple[str, ...], libraries: Mapping[str, str]) -> str:
    """Hash source files without comments and docstrings, plans that are files, and library versions."""
    content = hashlib.blake2b(digest_size=6)
    for file in list_source_files(modules):
        content.update(f"{file.relative_to(SOURCE_FOLDER)}\n{_read(file)[1]}\n".encode())
    content.update(_plans())
    for file in project.user_module_sources():
        content.update(_read(file)[1].encode())
    content.update(repr(libraries).encode())
    _store_parsed()
    return content.hexdigest()


@functools.cache
def _plans() -> bytes:
    """Return names and values of all plans that are files."""
    loader, shipped = getattr(yaml, "CSafeLoader", yaml.SafeLoader), project.shipped_files("plan").items()
    plans = ((name, yaml.load(file.read_text(encoding="utf-8"), loader)) for name, file in shipped)
    return "".join(f"{name}\n{json.dumps(plan)}\n" for name, plan in plans).encode()


@functools.cache
def list_source_files(modules: tuple[str, ...]) -> tuple[Path, ...]:
    """List the source files of some modules and of the package's modules that they import, directly or indirectly."""
    found: dict[str, Path] = {}
    todo = list(modules)
    while todo:
        parts = todo.pop().split(".")
        for name in (".".join(parts[: k + 1]) for k in range(len(parts))):
            if name not in found and (file := _file(name)):
                found[name] = file
                todo += _read(file)[0]
                if name in WHOLE_PACKAGES:
                    todo += [f"{name}.{module.stem}" for module in file.parent.glob("*.py") if module != file]
    return tuple(sorted(found.values()))


@functools.cache
def _file(module: str) -> Path | None:
    package, *rest = module.split(".")
    path = SOURCE_FOLDER.joinpath(*rest)
    candidates = (path / "__init__.py", path.with_suffix(".py")) if package == SOURCE_FOLDER.name else ()
    return next((file for file in candidates if file.is_file()), None)


@functools.cache
def _read(file: Path) -> tuple[list[str], str]:
    """Return the names that a source file imports, and its source in one format."""
    content = file.read_bytes()
    key = hashlib.blake2b(f"{file.parent == SOURCE_FOLDER} ".encode() + content, digest_size=16).hexdigest()
    _parsed[key] = imports, said = _load_parsed().get(key) or _parse(file, content)
    return imports, said


def _parse(file: Path, content: bytes) -> tuple[list[str], str]:
    tree = ast.parse(content)
    # what the package itself imports when called is for notebooks, not for a worker
    nodes = tree.body if file.parent == SOURCE_FOLDER else None
    said, every = _format_tree(tree)
    return [name for node in nodes or every for name in _imported(node)], said


@functools.cache
def _load_parsed() -> dict[str, tuple[list[str], str]]:
    """Load what earlier processes parsed, by hash of the source. Parsing all sources takes a second."""
    with contextlib.suppress(OSError, ValueError, InputError):
        if file := _parsed_cache_file():
            files.require_private_path(file)
            return json.loads(file.read_bytes())
    return {}


def _store_parsed() -> None:
    """Store what was parsed for later processes, if anything is new."""
    with contextlib.suppress(Fault, InputError):
        if (
            not _parsed.keys() <= _load_parsed().keys()
            and (file := _parsed_cache_file())
            and files.ensure_private_folder(file.parent)
        ):
            files.write_atomically(file, json.dumps(_parsed).encode())


def _parsed_cache_file() -> Path | None:
    """Return the file of parsed sources. Its name depends on the Python version, which formats sources differently."""
    folder, where = files.cache_folder(), hashlib.blake2b(f"{SOURCE_FOLDER} {sys.version}".encode(), digest_size=8)
    return folder and folder / f"sources-{where.hexdigest()}.json"


def _imported(node: ast.AST) -> list[str]:
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    return [f"{node.module}.{alias.name}" for alias in node.names] if isinstance(node, ast.ImportFrom) else []


def normalize_source(source: str) -> str:
    """Reformat Python source, without comments and docstrings, so that equal code gives equal text."""
    return _format_tree(ast.parse(source))[0]


def _format_tree(tree: ast.Module) -> tuple[str, list[ast.AST]]:
    every = [tree, *_within(tree)]
    for node in every:
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node, clean=False):
            node.body = node.body[1:] or [ast.Pass()]
    return ast.unparse(tree), every


def _within(node: ast.AST) -> Iterator[ast.AST]:
    """Yield all nested statements; expressions contain none."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.stmt | ast.excepthandler | ast.match_case):
            yield child
            yield from _within(child)


def library_versions() -> dict[str, str]:
    """Return the installed versions of the libraries that results depend on."""
    return {name: metadata.version(name) for name in LIBRARIES}


def version_record() -> dict[str, Any]:
    """Return code hash, commit and library versions, as `study.yaml` stores them."""
    return {"code": code_version(), "commit": find_commit(), "versions": library_versions()}


@functools.cache
def find_commit() -> str:
    """Return the Git commit from which the package was installed, or that of its checkout; empty if unknown.

    Ends in `-dirty` where sources or configurations differ from the commit.
    """
    installed = (
        SOURCE_FOLDER / "commit.txt"
    )  # written into a wheel: a folder around it may be a checkout of something else
    if installed.exists():
        return installed.read_text().strip()
    name = _git("describe", "--always", "--abbrev=12")
    return f"{name}-dirty" if _git("diff", "--name-only", "HEAD", "--", ".", "../conf") else name


def _git(*words: str) -> str:
    """Return the output of a git command in the package's folder; empty outside a checkout and without git."""
    try:
        result = subprocess.run(["git", *words], cwd=SOURCE_FOLDER, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        return ""
    return result.stdout.strip()
