"""Configuration files that ship with the package, and those of the working project, a folder with a sweep.yaml.

Imports nothing slow, so that `sweep list` starts quickly.
"""

import functools
import importlib
import sys
from collections.abc import Iterator
from contextlib import chdir, contextmanager
from importlib import metadata, resources
from pathlib import Path
from types import ModuleType
from typing import Any

import yaml

from sweep.core.errors import USER_CODE_ERRORS, Fault, InputError, format_user_exception
from sweep.core.groups import GROUPS
from sweep.core.yaml_check import YAML_PARSER, check_yaml, format_yaml_error

SHIPPED_PACKAGE, PROJECT_FILE, ENTRY_POINTS = "sweep.conf", "sweep.yaml", "sweep.modules"
GROUP_FOLDERS = {group: "studies" if group == "study" else f"{group}s" for group in GROUPS}  # of a project
PROJECT_KEYS = ("modules",)
STUDY_FILE, CRATE_FILE = "study.yaml", "ro-crate-metadata.json"  # that folders of results, and crates, have
CHECKSUM_PREFIX = "# sha256 of the lines above: "  # of the last line of a study.yaml with results
CHECKSUM_LENGTH = len(CHECKSUM_PREFIX) + 64 + 1  # of that line
YAML_LOADER = YAML_PARSER
_trusted: set[Path] = set()  # of `trust_project`
BOOLEAN_WORDS = ("on", "off", "yes", "no", "true", "false")  # that YAML takes for truths


def find_project() -> Path | None:
    """Find the working project: the nearest folder with a sweep.yaml at or above the working folder; else None.

    A sweep.yaml in a folder of results or in a crate does not count, as it may come from a stranger.
    """
    here = Path.cwd()
    found = (folder for folder in (here, *here.parents) if (folder / PROJECT_FILE).is_file())
    return next((folder for folder in found if find_enclosing_results(folder / PROJECT_FILE) is None), None)


def find_enclosing_results(file: Path) -> Path | None:
    """Find the folder of results, or of a packed study (RO-Crate), that contains a file.

    Nothing in such a folder is run or taken for a project, as it may come from a stranger.

    Args:
        file: The file. Symbolic links on the way to it are looked at as they are, and where they lead.

    Returns:
        The folder; None where there is none, or where the file is in the project of a `trust_project`.
    """
    for place in dict.fromkeys((file.absolute(), file.resolve())):
        for folder in place.parents:
            if folder in _trusted:
                break
            if _ends_with_checksum(folder / STUDY_FILE) or (folder / CRATE_FILE).exists():
                return folder
    return None


@contextmanager
def trust_project(folder: Path) -> Iterator[None]:
    """Context that works in the folder of a packed study (RO-Crate) whose code the user has allowed to run."""
    _trusted.add(place := folder.resolve())
    try:
        with chdir(place):
            yield
    finally:
        _trusted.discard(place)


def _ends_with_checksum(file: Path) -> bool:
    """Whether a study.yaml is that of results; a configuration may have the same name."""
    if not file.is_file():
        return False
    with file.open("rb") as content:
        content.seek(max(0, file.stat().st_size - CHECKSUM_LENGTH))
        return content.read(CHECKSUM_LENGTH).startswith(CHECKSUM_PREFIX.encode())


def project_files(group: str) -> dict[str, Path]:
    """Return the files that the user's project has for a configuration group, by name; empty outside a project."""
    folder = find_project()
    return {file.stem: file for file in sorted((folder / GROUP_FOLDERS[group]).glob("*.yaml"))} if folder else {}


def shipped_files(group: str) -> dict[str, Any]:
    """Return the files of a configuration group that ship with the package, by name."""
    files = (resources.files(SHIPPED_PACKAGE) / group).iterdir()
    return {f.name.removesuffix(".yaml"): f for f in sorted(files, key=lambda f: f.name) if f.name.endswith(".yaml")}


def find_config_file(group: str, name: str) -> Any:
    """Find the configuration file of `group=name`.

    Args:
        group: Configuration group, such as `robot`.
        name: A path that ends in .yaml; else the name of a file of the project, or of one that ships with the package.

    Returns:
        The file; None where there is none.
    """
    if name.endswith(".yaml"):
        return file if (file := Path(name)).is_file() else None
    return project_files(group).get(name) or shipped_files(group).get(name)


def first_comment(file: Any) -> str:
    """Return the first comment line of a configuration file, which describes the file; empty without one."""
    lines = file.read_text(encoding="utf-8", errors="replace").splitlines()
    return next((line[2:] for line in lines if line.startswith("# ") and not line.startswith("# @")), "")


def read_settings(folder: Path | None = None) -> dict[str, Any]:
    """Read the settings in a sweep.yaml.

    Args:
        folder: Folder with the file; the working project by default.

    Returns:
        `modules`, a list of names; empty outside a project.

    Raises:
        InputError: The file is not allowed.
    """
    folder = folder or find_project()
    if folder is None:
        return {}
    content = read_yaml(folder / PROJECT_FILE, str(folder / PROJECT_FILE)) or {}
    modules = content.get("modules", []) if isinstance(content, dict) else None
    unknown = [key for key in content if key not in PROJECT_KEYS] if isinstance(content, dict) else []
    if not isinstance(modules, list) or unknown:
        what = f"{unknown[0]} is unknown" if unknown else f"modules = {modules} is not allowed"
        raise InputError(f"{folder / PROJECT_FILE}: {what} (allowed: modules, a list of names of Python modules)")
    return {"modules": [str(module) for module in modules]}


def read_yaml(file: Path, name: str) -> Any:
    """Read a YAML file of a user.

    Args:
        file: The file.
        name: The file, for messages.

    Returns:
        Its content as plain values; None for an empty file.

    Raises:
        InputError: The file is not text or no YAML, or `check_yaml` refuses it.
    """
    try:
        text = file.read_text(encoding="utf-8")
        check_yaml(text, name)
        return yaml.load(text, YAML_LOADER)
    except UnicodeDecodeError:
        raise InputError(f"{name} cannot be read: it is not text in UTF-8") from None
    except yaml.YAMLError as error:
        raise InputError(f"{name} cannot be read: {format_yaml_error(error)}") from None


def quote_boolean_words(text: str) -> str:
    """Quote `on`, `off`, `yes` and similar words in the YAML of a plan, where they are names and not Booleans."""
    for event in reversed(list(yaml.parse(text, YAML_LOADER))):
        if isinstance(event, yaml.ScalarEvent) and event.implicit[0] and event.value.lower() in BOOLEAN_WORDS:
            text = f'{text[: event.start_mark.index]}"{event.value}"{text[event.end_mark.index :]}'
    return text


def import_user_modules() -> tuple[ModuleType, ...]:
    """Import modules that add obstacles, manoeuvres and designs: those of the user's project, then those of packages.

    The `OBSTACLES`, `MANOEUVRES` and `DESIGNS` of a module map kinds to classes. An installed package announces a
    module as an entry point of the group `sweep.modules`. Raises `InputError` where a module cannot be imported.
    """
    return _imported(find_project() if read_settings().get("modules") else None, user_module_names())


def user_module_names() -> tuple[str, ...]:
    """Return the names of modules with user code without importing them. Raises `InputError`."""
    return (*read_settings().get("modules", ()), *_announced())


@functools.cache
def _announced() -> tuple[str, ...]:
    return tuple(entry.value for entry in metadata.entry_points(group=ENTRY_POINTS))


@functools.cache
def _imported(folder: Path | None, names: tuple[str, ...]) -> tuple[ModuleType, ...]:
    if folder and str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
    found = []
    for name in names:
        try:
            found.append(importlib.import_module(name))
        except USER_CODE_ERRORS as error:
            raise InputError(f"module {name} cannot be imported: {format_user_exception(error)}") from None
    return tuple(found)


@contextmanager
def convert_user_errors() -> Iterator[None]:
    """Turn exceptions and exits of user modules within this context into an `InputError` with file and line."""
    try:
        yield
    except (InputError, Fault):
        raise
    except USER_CODE_ERRORS as error:
        import traceback

        own = {
            str(file)
            for name in user_module_names()
            if name in sys.modules
            for file in module_source_files(sys.modules[name])
        }
        for frame in reversed(traceback.extract_tb(error.__traceback__)):
            if frame.filename in own:
                reason = format_user_exception(error)
                raise InputError(f"{frame.filename}, line {frame.lineno}, fails: {reason}") from None
        raise


def user_module_sources() -> Iterator[Path]:
    """Yield the source files of all user modules."""
    for module in import_user_modules():
        yield from module_source_files(module)


def module_source_files(module: ModuleType) -> list[Path]:
    """List the source files of a module, or of the package that contains it."""
    file = Path(str(module.__file__))
    every = sorted(file.parent.rglob("*.py")) if (file.parent / "__init__.py").exists() else [file]
    return [one for one in every if one.is_file()]
