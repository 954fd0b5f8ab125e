"""Reference texts for `sweep describe`: every parameter with its unit, bounds, default and meaning.

Meanings are the comments beside the parameters in the source.
"""

import ast
import dataclasses
import inspect
import io
import textwrap
import tokenize
from collections.abc import Iterator
from itertools import takewhile
from typing import Any

import pandas as pd

from sweep import systems
from sweep.config import experiment
from sweep.core import project
from sweep.core.errors import InputError, format_name_suggestion, format_nearest_names, require_choice
from sweep.core.groups import GROUPS
from sweep.core.parameters import UNIT_BY_SUFFIX, bounds_text, format_unit
from sweep.study.columns import COLUMN_MEANINGS


def classes_by_group() -> dict[str, list[type]]:
    """Return the parameter dataclasses of each group, including those of users."""
    experiment.register_schemas()
    kinds = {group: list(kinds.values()) for group, kinds in experiment.CLASSES_BY_KIND.items()}
    return {group: [cls] for group, cls in experiment.SINGLE_CLASSES.items()} | kinds


def describe_parameter_or_column(name: str) -> str:
    """Describe a group, choice, parameter or column.

    Args:
        name: A group, a choice such as `obstacle=ball` or `robot=mine`, a parameter such as `drive.torque_limit`, or a
            column of rows such as `energy_j`.

    Returns:
        The description as Markdown.

    Raises:
        InputError: Nothing has this name.
    """
    every = classes_by_group()
    if name not in every and (meaning := column_meanings().get(name)):
        words = format_unit(UNIT_BY_SUFFIX.get(name.rpartition("_")[2], "-"))
        return f"{name}: {meaning}" + (f"\n  unit: {words}" if words else "")
    group, _, choice = name.partition("=")
    of_file = (
        choice
        and group in GROUPS
        and not GROUPS[group].number_lister
        and choice not in map(config_kind, every.get(group, []))
    )
    if of_file and (file := project.find_config_file(group, choice)):
        return f"{name}: {project.first_comment(file)}\n\n{file.read_text(encoding='utf-8').rstrip()}"
    head = name.partition(".")[0].partition("=")[0]
    if head in GROUPS and GROUPS[head].number_lister:
        return describe_plan_numbers(head, name.removeprefix(head)[1:])
    group, _, kind = name.partition("=")
    if group in every:
        kinds = [config_kind(cls) for cls in every[group]]
        if kind and not any(kinds):
            raise InputError(f"{name} is unknown{format_name_suggestion(kind, group_file_names(group))}")
        if kind:
            require_choice(kind, [*kinds, *group_file_names(group)], f"{group} = {kind}")
        return "\n\n".join(format_parameter_class(group, cls) for cls in every[group] if kind in ("", config_kind(cls)))
    group, _, key = name.partition(".")
    if group not in every:
        hint = experiment.suggest_parameter_paths(name, every)
        paths = [
            f"{one}.{line['parameter']}" for one, own in every.items() for cls in own for line in parameter_rows(cls)
        ]
        raise InputError(f"{name} is unknown{hint or format_nearest_names(name, [*every, *column_meanings(), *paths])}")
    found = [(cls, line) for cls in every[group] for line in parameter_rows(cls) if line["parameter"] == key]
    if not found:
        names = {line["parameter"] for cls in every[group] for line in parameter_rows(cls)}
        raise InputError(f"{name} is unknown{format_name_suggestion(key, names)}")
    return "\n\n".join(format_parameter(group, cls, line) for cls, line in found)


def column_meanings() -> dict[str, str]:
    """Return the meaning of every results column by name: labels and metrics of all systems."""
    return {**COLUMN_MEANINGS, **systems.describe_columns()}


def group_file_names(group: str) -> list[str]:
    """List the names of a group's files, shipped ones and the project's own."""
    return [*project.shipped_files(group), *project.project_files(group)]


def describe_plan_numbers(group: str, name: str) -> str:
    """Describe plan files: list all of them, the numbers in the plan `NAME`, or the single number `NAME.PATH`.

    Args:
        group: The configuration group, `plan`.
        name: `NAME`, `NAME.PATH`, or empty for all plans.

    Raises:
        InputError: There is no such plan or number.
    """
    files = {**project.shipped_files(group), **project.project_files(group)}
    if not name:
        return "\n".join(f"{group}.{name:20} {project.first_comment(file)}" for name, file in files.items())
    file, _, path = name.partition(".")
    require_choice(file, files, f"{group} = {file}")
    said = GROUPS[group].read_file_numbers(file, lambda other: files[other].read_text(encoding="utf-8"))
    found = {path: value if isinstance(value, str) else f"{value:g}" for path, value in said.items()}
    if path:
        require_choice(path, found, f"{group}.{name}")
        return f"{group}.{path}: {found[path]}"
    told = [line.removeprefix("#").strip() for line in takewhile(lambda line: line.startswith("#"),
            files[file].read_text(encoding="utf-8").splitlines())]  # fmt: skip
    return "\n".join([*told, "", *(f"{group}.{path:40} {value}" for path, value in found.items())])


def parameters_page() -> str:
    """Describe all parameters of all groups as a Markdown page."""
    parts = [
        "# Parameters",
        "Any of them is set by `group.name=value`, in a study as well as on the command line. "
        "The list is made by `sweep describe`.",
    ]
    for group, own in classes_by_group().items():
        parts += [f"## {group}", *(format_parameter_class(group, cls) for cls in own)]
    return "\n\n".join(parts) + "\n"


def format_parameter_class(group: str, cls: type) -> str:
    """Describe a parameter dataclass and its parameters as Markdown.

    Args:
        group: Configuration group.
        cls: The dataclass.
    """
    kind = config_kind(cls)
    lines = pd.DataFrame(list(parameter_rows(cls)))
    table = lines.to_markdown(index=False, disable_numparse=True) if len(lines) else "No parameters."
    names = [
        f"- `{name}`: {meaning}"
        for field in dataclasses.fields(cls)
        for name, meaning in choice_meanings(field).items()
    ]
    return "\n\n".join(
        [
            f"### {group}{'=' + kind if kind else ''}",
            class_docstring(cls),
            table,
            *(["\n".join(names)] if names else []),
        ]
    )


def format_parameter(group: str, cls: type, line: dict[str, str]) -> str:
    """Describe one parameter as text.

    Args:
        group: Configuration group.
        cls: Dataclass of the parameter.
        line: The parameter, as `parameter_rows` yields it.
    """
    kind = config_kind(cls)
    beside = f" (of {group}={kind})" if kind else ""
    rows = [f"{group}.{line['parameter']}{beside}: {line['meaning'] or class_docstring(cls).splitlines()[0]}"]
    rows += [f"  {key}: {line[key]}" for key in ("default", "unit", "allowed") if line[key]]
    (field,) = [one for one in dataclasses.fields(cls) if one.name == line["parameter"]]
    rows += [f"    {name}: {meaning}" for name, meaning in choice_meanings(field).items()]
    return "\n".join([*rows, f"  defined in: {cls.__module__}.{cls.__name__}, {module_summary(cls)}"])


def parameter_rows(cls: type) -> Iterator[dict[str, str]]:
    """Yield name, default, unit, bounds and meaning of each parameter of a dataclass, except for `kind`."""
    meanings = getattr(cls, "meanings", {}) | member_comments(cls)
    for field in dataclasses.fields(cls):
        role = field.metadata.get("role")
        if field.name == "kind" or (role is None and not isinstance(field.default, str | int | float | bool)):
            continue
        allowed = {
            "choice": lambda f: ", ".join(f.metadata["options"]),
            "quantity": bounds_text,
            "count": bounds_text,
            "flag": lambda f: "true, false",
        }
        yield {
            "parameter": field.name,
            "default": format_default(field),
            "unit": format_unit(field.metadata.get("unit", "")),
            "allowed": allowed[role](field) if role else "",
            "meaning": meanings.get(field.name, ""),
        }


def choice_meanings(field: "dataclasses.Field[Any]") -> dict[str, str]:
    """Return the documented meanings of the names that a `choice` parameter allows."""
    return field.metadata.get("meanings", {})


def format_default(field: "dataclasses.Field[Any]") -> str:
    """Format the default of a parameter; empty without one."""
    value = field.default if field.default is not dataclasses.MISSING else ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def config_kind(cls: type) -> str:
    """Return the `kind` of an obstacle, manoeuvre or cluster class; empty for other classes."""
    found = [f.default for f in dataclasses.fields(cls) if f.name == "kind"]
    return str(found[0]) if found else ""


def class_docstring(cls: type) -> str:
    """Return the docstring of a class."""
    return inspect.cleandoc(cls.__doc__ or "")


def module_summary(cls: type) -> str:
    """Return the first docstring line of the module that defines a class; that line cites the source."""
    return (inspect.cleandoc(inspect.getmodule(cls).__doc__ or "").splitlines() or [""])[0]


def member_comments(cls: type) -> dict[str, str]:
    """Return the source comment beside or above each member of a class, including inherited members."""
    found: dict[str, str] = {}
    for one in reversed(cls.__mro__[:-1]):
        try:
            code = textwrap.dedent(inspect.getsource(one))
        except (OSError, TypeError):
            continue
        tokens = tokenize.generate_tokens(io.StringIO(code).readline)
        said = {token.start[0]: token.string.lstrip("# ") for token in tokens if token.type == tokenize.COMMENT}
        own_lines = code.splitlines()
        (body,) = ast.parse(code).body
        for node in body.body if isinstance(body, ast.ClassDef) else ():
            if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                found[node.target.id] = said.get(node.end_lineno or 0, "") or comment_lines_above(
                    node.lineno, said, own_lines
                )
    return {name: "" if text.startswith(("fmt:", "pyright:")) else text for name, text in found.items()}


def comment_lines_above(line: int, comment_by_line: dict[int, str], code: list[str]) -> str:
    """Join the comment lines directly above a source line.

    Args:
        line: Line number.
        comment_by_line: Comments by line number.
        code: All lines of the source.
    """
    parts: list[str] = []
    while (line := line - 1) in comment_by_line and code[line - 1].lstrip().startswith("#"):
        parts.insert(0, comment_by_line[line])
    return " ".join(parts)
