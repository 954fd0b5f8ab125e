"""What each group of the configuration may be: files, and classes that need none; read as text, which is quick."""

import ast
import re
from pathlib import Path

from sweep.core import project
from sweep.core.errors import known
from sweep.core.groups import GROUPS

PACKAGE = Path(__file__).parents[1]


def choices(group: str) -> dict[str, str]:
    """Those that ship: their names, and what the first comment of the file or the first sentence of the class says."""
    found = _classes(PACKAGE / GROUPS[group].sources) if GROUPS[group].kinds else {}
    found |= {name: project.described(file) for name, file in project.shipped(group).items()}
    return dict(sorted(found.items()))


def refuse_unknown(overrides: list[str]) -> None:
    """Raise `InputError` where `group=name` names no choice: at once, as Hydra and the simulator take a second to load.

    Names that only they know, such as those of a project's modules, are left to them.
    """
    if any(one.startswith("-") for one in overrides):  # such as a folder of configurations beside ours
        return
    for group, _, name in (one.partition("=") for one in overrides):
        if group not in GROUPS or not re.fullmatch(r"[A-Za-z_][\w./-]*", name) or name == "null":
            continue
        if name.endswith(".yaml") or project.modules_named():
            continue
        known(name, {**choices(group), **project.own(group)}, f"{group} = {name}")


def _classes(module: Path) -> dict[str, str]:
    """Of a folder or a file, by the default of their field `kind`."""
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
