"""Where configuration files are: those that ship, and those of the working project, a folder with a sweep.yaml.

Imports nothing that is slow, so that `sweep list` starts at once.
"""

import functools
import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import metadata, resources
from pathlib import Path
from types import ModuleType
from typing import Any

import yaml

from sweep.core.errors import WRONG, Fault, InputError, raised
from sweep.core.groups import GROUPS
from sweep.core.yaml_check import PARSER, check_yaml

SHIPPED, FILE, ENTRY_POINTS = "sweep.conf", "sweep.yaml", "sweep.modules"
FOLDERS = {group: "studies" if group == "study" else f"{group}s" for group in GROUPS}  # of a project
KEYS = ("modules",)
LOADER = PARSER
TRUTHS = ("on", "off", "yes", "no", "true", "false")  # that YAML takes for truths


def root() -> Path | None:
    """The working project: the nearest folder, from here upwards, with a sweep.yaml."""
    here = Path.cwd()
    return next((folder for folder in (here, *here.parents) if (folder / FILE).is_file()), None)


def own(group: str) -> dict[str, Path]:
    """The working project's files of a group by name."""
    folder = root()
    return {file.stem: file for file in sorted((folder / FOLDERS[group]).glob("*.yaml"))} if folder else {}


def shipped(group: str) -> dict[str, Any]:
    """The files of a group that come with the package, by name."""
    files = (resources.files(SHIPPED) / group).iterdir()
    return {f.name.removesuffix(".yaml"): f for f in sorted(files, key=lambda f: f.name) if f.name.endswith(".yaml")}


def find(group: str, name: str) -> Any:
    """The file that `group=name` means: a path that ends in .yaml, else the project's, else what ships; or None."""
    if name.endswith(".yaml"):
        return file if (file := Path(name)).is_file() else None
    return own(group).get(name) or shipped(group).get(name)


def described(file: Any) -> str:
    """The first comment of a configuration file."""
    lines = file.read_text(encoding="utf-8", errors="replace").splitlines()
    return next((line[2:] for line in lines if line.startswith("# ") and not line.startswith("# @")), "")


def settings() -> dict[str, Any]:
    """Content of the working project's sweep.yaml; empty without one. Raises `InputError`."""
    folder = root()
    if folder is None:
        return {}
    try:
        text = (folder / FILE).read_text(encoding="utf-8")
        check_yaml(text, str(folder / FILE))
        content = yaml.load(text, LOADER) or {}
    except UnicodeDecodeError:
        raise InputError(f"{folder / FILE} cannot be read: it is no text in UTF-8") from None
    except yaml.YAMLError as error:
        raise InputError(f"{folder / FILE} cannot be read: {one_line(error)}") from None
    modules = content.get("modules", []) if isinstance(content, dict) else None
    unknown = [key for key in content if key not in KEYS] if isinstance(content, dict) else []
    if not isinstance(modules, list) or unknown:
        what = f"{unknown[0]} is unknown" if unknown else f"modules = {modules} is not allowed"
        raise InputError(f"{folder / FILE}: {what} (allowed: modules, a list of names of Python modules)")
    return {"modules": [str(module) for module in modules]}


def words(text: str) -> str:
    """The YAML of a plan with `on`, `off` and their like in quotes: they are names there. Raises `yaml.YAMLError`."""
    for event in reversed(list(yaml.parse(text, LOADER))):
        if isinstance(event, yaml.ScalarEvent) and event.implicit[0] and event.value.lower() in TRUTHS:
            text = f'{text[: event.start_mark.index]}"{event.value}"{text[event.end_mark.index :]}'
    return text


def one_line(error: yaml.YAMLError) -> str:
    """What is wrong with a YAML text, and where."""
    mark = getattr(error, "problem_mark", None)
    where = f"line {mark.line + 1}: " if mark else ""
    return where + (getattr(error, "problem", None) or str(error).splitlines()[0])


def modules() -> tuple[ModuleType, ...]:
    """The modules with obstacles and manoeuvres of users: the project's, then those of installed packages.

    A module's `OBSTACLES` and `MANOEUVRES` name its classes by their `kind`. An installed package announces one as an
    entry point of the group `sweep.modules`. Raises `InputError` where one cannot be imported.
    """
    return _imported(root() if settings().get("modules") else None, modules_named())


def modules_named() -> tuple[str, ...]:
    """Their names; nothing is imported. Raises `InputError`."""
    return (*settings().get("modules", ()), *_announced())


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
        except WRONG as error:
            raise InputError(f"module {name} cannot be imported: {raised(error)}") from None
    return tuple(found)


@contextmanager
def blaming() -> Iterator[None]:
    """Tell what code of the `modules` raises, or that it ends the process, as an `InputError` that says where."""
    try:
        yield
    except (InputError, Fault):
        raise
    except WRONG as error:
        import traceback

        own = {str(file) for name in modules_named() if name in sys.modules for file in sources(sys.modules[name])}
        for frame in reversed(traceback.extract_tb(error.__traceback__)):
            if frame.filename in own:
                raise InputError(f"{frame.filename}, line {frame.lineno}, fails: {raised(error)}") from None
        raise


def module_sources() -> Iterator[Path]:
    """The files of `modules`."""
    for module in modules():
        yield from sources(module)


def sources(module: ModuleType) -> list[Path]:
    """The files of a module, of a package and what is in one all of that, as far as they are there."""
    file = Path(str(module.__file__))
    every = sorted(file.parent.rglob("*.py")) if (file.parent / "__init__.py").exists() else [file]
    return [one for one in every if one.is_file()]
