"""The choices of each configuration group, read as text so that nothing slow is imported."""

import ast
import re
from pathlib import Path

from sweep.core import project
from sweep.core.errors import InputError, require_choice
from sweep.core.groups import GROUPS

PACKAGE_FOLDER = Path(__file__).parents[1]
# end of a message about an unknown study: folders of results may be of one that does not ship
EVIDENCE_HINT = "; studies of the project's own evidence are files of its repository: study=research/studies/NAME.yaml"


def shipped_group_choices(group: str) -> dict[str, str]:
    """Return the shipped choices of a configuration group with a one-line description each, read as text without
    imports."""
    found = _classes(PACKAGE_FOLDER / GROUPS[group].source_path) if GROUPS[group].has_kinds else {}
    found |= {name: project.first_comment(file) for name, file in project.shipped_files(group).items()}
    return dict(sorted(found.items()))


def refuse_unknown_choices(overrides: list[str]) -> None:
    """Raise `InputError` if `group=name` names no choice, before Hydra and the simulator are imported.

    Names that only they know, such as those of a project's modules, are left to them.
    """
    _refuse_bare_words(overrides)
    if any(one.startswith("-") for one in overrides):  # such as a folder of configurations beside ours
        return
    for group, _, name in (one.partition("=") for one in overrides):
        if group not in GROUPS or not re.fullmatch(r"[A-Za-z_][\w./-]*", name) or name == "null":
            continue
        if name.endswith(".yaml") or project.user_module_names():
            continue
        try:
            require_choice(name, {**shipped_group_choices(group), **project.project_files(group)}, f"{group} = {name}")
        except InputError as error:
            raise InputError(f"{error}{EVIDENCE_HINT if group == 'study' else ''}{no_project_hint()}") from None


def no_project_hint() -> str:
    """Return a hint for an error message that no project was found in the working folder; empty inside a project."""
    return (
        ""
        if project.find_project()
        else "; this folder is in no project: neither it nor a folder above it has a sweep.yaml"
    )


def _refuse_bare_words(overrides: list[str]) -> None:
    """Raise `InputError` if a choice is given without its group, or as a flag: `first`, `--study first`."""
    for place, word in enumerate(overrides):
        flag, _, value = word.partition("=")
        if flag.startswith("--") and (group := flag.removeprefix("--")) in GROUPS:
            value = value or next(iter(overrides[place + 1 :]), "NAME")
            raise InputError(f"{word} is not allowed: did you mean {group}={value}?")
    if any(one.startswith("-") for one in overrides):  # whose values are words, too
        return
    for word in overrides:
        if not re.fullmatch(r"\w[\w-]*", word):
            continue
        fits = [group for group in GROUPS if word in {**shipped_group_choices(group), **project.project_files(group)}]
        if fits:
            raise InputError(f"{word} is not allowed: did you mean {' or '.join(f'{group}={word}' for group in fits)}?")
        raise InputError(f"{word} cannot be read: group=choice or group.name=value{no_project_hint()}")


def _classes(module: Path) -> dict[str, str]:
    """Map the default of a field `kind` to its class, for all classes in a folder or file."""
    found = {}
    for file in module.rglob("*.py") if module.is_dir() else [module.with_suffix(".py")]:
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and (kind := _kind(node)):
                said = (ast.get_docstring(node) or "").partition("\n")[0]
                found[kind] = said.partition(". ")[0].removesuffix(".")
    return found


def _kind(node: ast.ClassDef) -> str | None:
    for line in node.body:
        match line:
            case ast.AnnAssign(ast.Name("kind"), value=ast.Call(args=[ast.Constant(str(kind)), *_])):
                return kind
            case _:
                pass
    return None
