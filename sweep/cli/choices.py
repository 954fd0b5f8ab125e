"""What each group of the configuration may be: files, and classes that need none; read as text, which is quick."""

import ast
from pathlib import Path

from sweep.core import project

CLASSES = {"obstacle": "models/obstacles", "manoeuvre": "controllers/manoeuvres"}  # folders of their sources


def choices(group: str) -> dict[str, str]:
    """Those that ship: their names, and what the first comment of the file or the first sentence of the class says."""
    found = _classes(Path(__file__).parents[1] / CLASSES[group]) if group in CLASSES else {}
    found |= {name: project.described(file) for name, file in project.shipped(group).items()}
    return dict(sorted(found.items()))


def _classes(folder: Path) -> dict[str, str]:
    """By the default of their field `kind`."""
    found = {}
    for file in folder.rglob("*.py"):
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
    return None
