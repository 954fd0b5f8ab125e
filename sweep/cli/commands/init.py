"""`sweep init`: create a project."""

import argparse
import shlex
from collections.abc import Iterator
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

from sweep.cli.command import Command, Section
from sweep.cli.exits import DONE
from sweep.core.arguments import Arguments
from sweep.core.errors import InputError
from sweep.core.files import write_atomically

COMMAND = Command(Section.LOOK_UP, "create a project: a folder for your own studies, robots and modules")
HIDDEN = {"gitignore": ".gitignore"}  # files that a package cannot hold under their name


def add_arguments(parser: Arguments) -> None:
    """Add the folder and the kind of project."""
    parser.add_argument("dir", help="a new or empty folder")
    parser.add_argument(
        "--model", action="store_true", help="with an example MuJoCo model and controller, see docs/own_model.md"
    )


def run(args: argparse.Namespace) -> int:
    """Make a project in a folder without changing existing files; an interrupted one is completed.

    Raises `InputError`.
    """
    if not str(args.dir).strip():
        raise InputError(f"dir = {str(args.dir)!r} is not allowed: a new or empty folder")
    folder = Path(args.dir)
    source, study = ("template_model", "grip") if args.model else ("template", "first")
    wanted = [(file, folder / Path(*path)) for file, path in template_files(files("sweep.cli") / source)]
    there = {path for _, path in wanted if path.exists()}
    others = [path for file, path in wanted if path in there and not has_content_of(path, file)]
    if others or len(there) == len(wanted):
        raise InputError(f"{(others or sorted(there))[0]} is there already: choose an empty folder")
    for file, path in wanted:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path not in there:
            write_atomically(path, file.read_bytes())
        print(path)
    print(f"next: cd {shlex.quote(str(folder))}; sweep run study={study}")
    return DONE


def has_content_of(path: Path, file: Traversable) -> bool:
    """Whether a file has the same content as one of the package."""
    return path.is_file() and path.read_bytes() == file.read_bytes()


def template_files(folder: Traversable, above: tuple[str, ...] = ()) -> Iterator[tuple[Traversable, tuple[str, ...]]]:
    """Yield the files of a new project with their paths in it."""
    for entry in sorted(folder.iterdir(), key=lambda e: e.name):
        if entry.is_dir() and entry.name != "__pycache__":
            yield from template_files(entry, (*above, entry.name))
        elif entry.is_file():
            yield entry, (*above, HIDDEN.get(entry.name, entry.name))
