"""Configuration files of this package as sources of Hydra, with a simpler syntax than Hydra's own.

A file of the groups `study` and `scenario` sets the whole configuration of its `system`. Its `extends` names the file
that it starts from. The name of a group holds a choice (`scenario: pole_climb`), parameters (`obstacle: {height: 3}`),
or both (`robot: {extends: prototype, thigh: 0.3}`). A file of another group holds parameters and may have `extends`,
too. A file with a list of `defaults` is in Hydra's own syntax and stays as it is.
"""

import argparse
import io
import os
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import yaml
from hydra._internal.core_plugins.file_config_source import FileConfigSource
from hydra._internal.sources_registry import SourcesRegistry
from hydra._internal.utils import get_args_parser
from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.object_type import ObjectType
from hydra.core.plugins import Plugins
from hydra.plugins.config_source import ConfigResult, ConfigSource
from hydra.plugins.search_path_plugin import SearchPathPlugin
from omegaconf import DictConfig, OmegaConf

from sweep.core import project
from sweep.core.errors import InputError, format_name_suggestion
from sweep.core.files import os_error_text
from sweep.core.groups import GROUPS
from sweep.core.yaml_check import check_yaml, format_yaml_error
from sweep.systems import DEFAULT_SYSTEM

SOURCE_SCHEME, SYSTEM_KEY = "sweep", "system"
# functions that make the schema of a class, by group and kind (or name of the group)
SCHEMA_MAKERS: dict[str, dict[str, Callable[[], DictConfig]]] = {}


class GroupFileSource(ConfigSource):
    """Hydra source of the configuration groups: files of the project, shipped files, and defaults of the classes.

    The defaults of a class are named after its kind, with `_schema` appended. A kind without a file is a choice, too.
    """

    @staticmethod
    def scheme() -> str:
        """Return the scheme of this source in Hydra's search path."""
        return SOURCE_SCHEME

    def available(self) -> bool:
        """Return whether Hydra can read this source: always True."""
        return True

    def is_group(self, config_path: str) -> bool:
        """Return whether a path names a configuration group."""
        return config_path in GROUPS

    def is_config(self, config_path: str) -> bool:
        """Return whether `group/name` names a configuration file or a built-in kind of that group."""
        group, _, name = config_path.partition("/")
        return group in GROUPS and (
            project.find_config_file(group, name) is not None or find_schema(group, name) is not None
        )

    def list(self, config_path: str, results_filter: ObjectType | None) -> list[str]:
        """List the names of all files and kinds that a configuration group allows."""
        if results_filter == ObjectType.GROUP:
            return []
        return list_group_choices(config_path)

    def load_config(self, config_path: str) -> ConfigResult:
        """Load a configuration file of a group and translate it to Hydra's syntax. Raises `InputError`."""
        group, _, name = config_path.partition("/")
        if project.find_config_file(group, name) is None and (make_schema := find_schema(group, name)):
            return ConfigResult(self.provider, self.full_path(), make_schema(), {"package": None})
        file = project.find_config_file(group, name)
        content = read_config_file(file, quotes_words=GROUPS[group].has_free_keys)
        header = ConfigSource._get_header_dict(file.read_text(encoding="utf-8")[:512])
        refuse_code_execution_keys(config_path, content, str(header.get("package")))
        if GROUPS[group].is_global:
            header["package"] = header.get("package") or "_global_"
        for other, choice in referenced_files(group, content):
            refuse_extends_cycle(other, file, choice, (file,))
        if "defaults" not in content:
            content = (
                translate_study_or_scenario(group, file, content)
                if GROUPS[group].is_global
                else translate_group_file(group, file, content)
            )
        return ConfigResult(self.provider, self.full_path(), OmegaConf.create(content), header)


def find_schema(group: str, name: str) -> Callable[[], DictConfig] | None:
    """Return the Hydra schema that `group=name` selects if it names no file.

    Args:
        group: Configuration group.
        name: A kind, or the name of a schema, which ends in `_schema`.

    Returns:
        A function that makes the schema; None where there is none.
    """
    kind = name if GROUPS[group].has_kinds else ""
    return SCHEMA_MAKERS.get(group, {}).get(name.removesuffix("_schema") if name.endswith("_schema") else kind)


class UserFileSource(FileConfigSource):
    """Hydra source of a user's configuration files, such as those in a `--config-dir`; they can set values but not run
    code."""

    def load_config(self, config_path: str) -> ConfigResult:
        """Load a user's configuration file. Raises `InputError` if it would run code or its YAML is ambiguous."""
        file = os.path.join(self.path, self._normalize_file_name(config_path))
        if os.path.isfile(file):
            with open(file, encoding="utf-8") as opened:
                check_yaml(opened.read(), file)
        result = super().load_config(config_path)
        values = OmegaConf.to_container(result.config, resolve=False)
        refuse_code_execution_keys(config_path, values, str(result.header.get("package")))
        return result


def refuse_code_execution_keys(config_path: str, values: Any, package: str) -> None:
    """Raise `InputError` where a configuration has keys that make Hydra run code.

    Args:
        config_path: Path of the configuration, for messages.
        values: Its plain values.
        package: Hydra package of the configuration.
    """
    defaults = values.get("defaults") if isinstance(values, Mapping) else None
    where = [config_path, package, *(map(str, defaults) if isinstance(defaults, list) else ())]
    named = [key for key in _keys(values) if key in ("hydra", "_target_")]
    named += ["hydra" for text in where if re.search(r"\bhydra\b", text)]
    if named:
        raise InputError(f"{config_path} has {named[0]}, which runs code: a user's file may only set parameters")


def _keys(values: Any) -> Iterator[str]:
    if isinstance(values, Mapping):
        for key, value in values.items():
            yield str(key)
            yield from _keys(value)
    elif isinstance(values, list):
        for value in values:
            yield from _keys(value)


class GroupSearchPathPlugin(SearchPathPlugin):
    """Hydra plugin that puts the configuration groups of this package first on the search path."""

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        """Put the configuration groups of this package first on Hydra's search path."""
        search_path.prepend("sweep", f"{SOURCE_SCHEME}://")


def register_hydra_sources() -> None:
    """Register the package's two configuration sources, group files and user files, with Hydra."""
    for plugin in (GroupFileSource, GroupSearchPathPlugin):
        Plugins.instance().register(plugin)  # this replaces our source of files by Hydra's
    SourcesRegistry.instance().types[UserFileSource.scheme()] = UserFileSource


def make_hydra_parser() -> argparse.ArgumentParser:
    """Make the parser with which a Hydra application reads its command line."""
    return get_args_parser()


def read_config_file(file: Any, quotes_words: bool = False) -> dict[str, Any]:
    """Read the keys and values of a configuration file.

    Args:
        file: The file.
        quotes_words: Whether unquoted `on`, `off` and similar words are names and not truth values, as in plans.

    Returns:
        Plain values, interpolations as text.

    Raises:
        InputError: The file cannot be read, or holds no keys and values.
    """
    try:
        text = file.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise InputError(f"{file} cannot be read: it is not text in UTF-8") from None
    except OSError as error:
        raise InputError(f"{file} cannot be read: {os_error_text(error)}") from None
    try:
        check_yaml(text, str(file))
        content = OmegaConf.load(io.StringIO(project.quote_boolean_words(text) if quotes_words else text))
    except yaml.YAMLError as error:
        raise InputError(f"{file} cannot be read: {format_yaml_error(error)}") from None
    except OSError:  # OmegaConf raises it for a file with a single word
        content = None
    if not isinstance(content, DictConfig):
        raise InputError(f"{file} is not a configuration: it needs keys and values, such as `study:`")
    return OmegaConf.to_container(content, resolve=False)  # pyright: ignore[reportReturnType]


def translate_study_or_scenario(group: str, file: Any, content: Mapping[str, Any]) -> dict[str, Any]:
    """Translate a study or scenario file to Hydra's syntax: the file it extends, its choices, then its values.

    Args:
        group: `study` or `scenario`.
        file: The file; its name is the default of `study.name` or `scenario.name`.
        content: Its plain values.

    Returns:
        Values with Hydra's list of defaults.

    Raises:
        InputError: A choice is unknown, or a group has something else than a name or keys.
    """
    defaults, values = defaults_entries_of_base_files(group, file, content), {}
    for key, value in content.items():
        if key in GROUPS and not isinstance(value, str | Mapping | None):
            raise InputError(f"{file}: {key} = {value!r} is not allowed: the name of a choice, or keys and values")
        choice = value if isinstance(value, str) else value.get("extends") if isinstance(value, Mapping) else None
        if key in GROUPS and key != group and choice is not None:
            defaults.append({f"override /{key}": require_choice_of_group(file, key, choice)})
        if not isinstance(value, str) or key not in GROUPS:
            values[key] = {k: v for k, v in value.items() if k != "extends"} if isinstance(value, Mapping) else value
    about = values.pop(group, None) or {}
    if not isinstance(about, Mapping):
        raise InputError(f"{file}: {group} = {about!r} is not allowed: keys and values")
    for key in ("extends", SYSTEM_KEY):  # `system` has been read, see `find_system_name`
        values.pop(key, None)
    return {"defaults": [*defaults, "_self_"], **values, group: {"name": str(file.name).removesuffix(".yaml"), **about}}


def find_system_name(chosen: Mapping[str, str]) -> str:
    """Return the name of the system that the choices of a scenario or study select, by default `DEFAULT_SYSTEM`.

    Args:
        chosen: Chosen names by group.

    Returns:
        Name of the system, unchecked.
    """
    group, seen = "scenario" if "scenario" in chosen else "study", set()
    name: Any = chosen.get(group)
    while (
        isinstance(name, str)
        and (group, name) not in seen
        and (file := project.find_config_file(group, name)) is not None
    ):
        seen.add((group, name))
        content = read_config_file(file)
        if SYSTEM_KEY in content:
            return str(content[SYSTEM_KEY])
        scenario = content.get("scenario")
        scenario = scenario.get("extends") if isinstance(scenario, Mapping) else scenario
        group, name = ("scenario", scenario) if group == "study" and scenario else (group, content.get("extends"))
        name = resolve_relative_to_file(file, name)
    return DEFAULT_SYSTEM


def translate_group_file(group: str, file: Any, content: Mapping[str, Any]) -> dict[str, Any]:
    """Translate a configuration file of a group to Hydra's syntax, after the file it extends or its class's defaults.

    Args:
        group: Configuration group.
        file: The file.
        content: Its plain values.

    Returns:
        Values with Hydra's list of defaults.

    Raises:
        InputError: The kind is missing or unknown.
    """
    free, kind = GROUPS[group].has_free_keys, content.get("kind")
    if "extends" not in content and GROUPS[group].has_kinds and kind not in _kinds(group):
        problem = "kind is missing" if kind is None else f"kind = {kind} is unknown"
        raise InputError(f"{file}: {group}.{problem}{format_name_suggestion(str(kind or ''), _kinds(group))}")
    start = defaults_entries_of_base_files(group, file, content) or (
        [] if free else [f"/{group}/{kind or group}_schema@_here_"]
    )
    return {"defaults": [*start, "_self_"], **{k: v for k, v in content.items() if k != "extends"}}


def defaults_entries_of_base_files(group: str, file: Any, content: Mapping[str, Any]) -> list[Any]:
    """Return the files that a configuration file extends, as entries of Hydra's defaults list. Raises `InputError`."""
    names = [require_choice_of_group(file, group, name) for name in names_of_base_files(group, content)]
    return [f"/{group}/{name}@{'_global_' if GROUPS[group].is_global else '_here_'}" for name in names]


def names_of_base_files(group: str, content: Mapping[str, Any]) -> list[Any]:
    """Return the names of the files that a file extends; several are allowed for plans only."""
    if "extends" not in content:
        return []
    found = content["extends"]
    return found if GROUPS[group].has_free_keys and isinstance(found, list) else [found]


def referenced_files(group: str, content: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield group and name of each file that a file starts from, by `extends` or by Hydra's list of `defaults`."""
    yield from ((group, name) for name in names_of_base_files(group, content))
    defaults = content.get("defaults")
    for entry in defaults if isinstance(defaults, list) else ():
        pairs = entry.items() if isinstance(entry, Mapping) else [str(entry).rpartition("/")[::2]]
        for key, said in pairs:
            *_, place = str(key).split() or [""]  # after `optional` or `override`
            place = place.partition("@")[0]
            other = place.removeprefix("/") if place.startswith("/") else f"{group}/{place}".removesuffix("/")
            for name in said if isinstance(said, list) else [said]:
                if other in GROUPS and isinstance(name, str):
                    yield other, name.partition("@")[0]


def refuse_extends_cycle(group: str, file: Any, name: Any, ring: tuple[Any, ...]) -> None:
    """Raise `InputError` where a file extends itself through other files.

    Args:
        group: Configuration group of `name`.
        file: The file that is read.
        name: Name of the file that is extended.
        ring: Files from `file` to the one that extends `name`.
    """
    above = project.find_config_file(group, resolve_relative_to_file(ring[-1], name)) if isinstance(name, str) else None
    if above is None:
        return
    if os.path.samefile(above, file):
        raise InputError(f"{' extends '.join(map(str, (*ring, above)))}: a file cannot extend itself")
    if above in ring:  # a ring beyond this file, which is refused where it is read
        return
    for other, more in referenced_files(group, read_config_file(above, quotes_words=GROUPS[group].has_free_keys)):
        refuse_extends_cycle(other, file, more, (*ring, above))


def require_choice_of_group(file: Any, group: str, name: Any) -> str:
    """Return `name` if it is a file or kind of a group; else raise `InputError` with a suggestion."""
    name = resolve_relative_to_file(file, name)
    if not isinstance(name, str) or (project.find_config_file(group, name) is None and name not in _kinds(group)):
        raise InputError(
            f"{file}: {group} = {name} is unknown{format_name_suggestion(str(name), list_group_choices(group))}"
        )
    return name


def resolve_relative_to_file(file: Any, name: Any) -> Any:
    """Resolve a path that is written in a configuration file relative to that file.

    Args:
        file: The file that names it.
        name: What it names: a path ends in `.yaml`, and is searched beside `file` first, then from the working folder.

    Returns:
        The path beside `file` where that is a file; else `name` as it is.
    """
    if isinstance(name, str) and name.endswith(".yaml") and (beside := file.parent / name).is_file():
        return str(beside)
    return name


def list_group_choices(group: str) -> list[str]:
    """List the names that a configuration group allows: files of the project, shipped files, kinds of its classes."""
    return sorted({*project.project_files(group), *project.shipped_files(group), *_kinds(group)})


def _kinds(group: str) -> dict[str, Callable[[], DictConfig]]:
    return SCHEMA_MAKERS.get(group, {}) if GROUPS[group].has_kinds else {}
