"""`sweep init`, `list`, `describe` and `completion`. A list needs no simulator."""

import argparse
import re
import shlex
from collections.abc import Iterator, Mapping
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

from sweep.cli.choices import outside_of_project, shipped_choices
from sweep.cli.exits import DONE
from sweep.core import project, terminal
from sweep.core.errors import InputError
from sweep.core.files import write_atomically
from sweep.core.groups import GROUPS

HIDDEN = {"gitignore": ".gitignore"}  # files that a package cannot hold under their name


def init(args: argparse.Namespace) -> int:
    """Make a project in a folder without touching existing files; finish one that a full disk cut short.

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
    """Whether a path has the same content as a file of the package."""
    return path.is_file() and path.read_bytes() == file.read_bytes()


def template_files(folder: Traversable, above: tuple[str, ...] = ()) -> Iterator[tuple[Traversable, tuple[str, ...]]]:
    """Yield the files of a new project, each with its place."""
    for entry in sorted(folder.iterdir(), key=lambda e: e.name):
        if entry.is_dir() and entry.name != "__pycache__":
            yield from template_files(entry, (*above, entry.name))
        elif entry.is_file():
            yield entry, (*above, HIDDEN.get(entry.name, entry.name))


def list_choices(args: argparse.Namespace) -> int:
    """Print each configuration file with its first comment; for folders of results, a line each."""
    if args.dir:
        from sweep.report import overview

        terminal.print_markdown(overview.overview_text(args.dir) + "\n")
        return DONE
    for group in GROUPS:
        print(f"{group}=")
        print_choices(shipped_choices(group))
    folder = project.root()
    if found := {group: project.project_files(group) for group in GROUPS if project.project_files(group)}:
        print(f"\nof this project, {folder}")
        for group, own in found.items():
            print(f"{group}=")
            print_choices({name: project.first_comment(file) for name, file in own.items()})
    return DONE


def print_choices(named: Mapping[str, str]) -> None:
    """Print names and what they say of themselves."""
    for name, text in named.items():
        terminal.print_markdown(f"  {name:20} {text}".rstrip() + "\n")


def describe(args: argparse.Namespace) -> int:
    """Print unit, meaning, bounds and default of parameters, or what a choice or a column is."""
    from sweep.study import reference

    try:
        text = reference.page() if args.name is None else reference.text(args.name)
    except InputError as error:
        raise InputError(f"{error}{outside_of_project() if '=' in args.name else ''}") from None
    terminal.print_markdown(text + "\n", kept=("meaning",))
    return DONE


def completion(args: argparse.Namespace) -> int:
    """Print the script for bash, or possible completions of a line."""
    if args.line is None:
        print(SCRIPT)
        return DONE
    before = args.line.split()[1:]
    word = "" if args.line.endswith(" ") or not before else before.pop()
    kept = word.rpartition("=")[0] + "=" if "=" in word else ""  # bash takes the word to begin behind it
    for one in candidates(before, word, args.flags()):
        if one.startswith(word):
            print(one.removeprefix(kept))
    return DONE


def candidates(before: list[str], word: str, flags: dict[str, list[str]]) -> list[str]:
    """Commands, then the flags of one: `group=choice` for a run, folders of results for the others."""
    if not before:
        return list(flags)
    if word.startswith("-"):
        return flags.get(before[0], [])
    if before[0] != "run":
        found = sorted(str(file.parent) for file in Path().glob("results/*/study.yaml"))
        return [re.sub(r"([^\w./+=:@%-])", r"\\\1", one) for one in found]  # as bash reads it
    group, sign, _ = word.partition("=")
    if not sign:
        return [f"{one}=" for one in GROUPS]
    names = {**shipped_choices(group), **project.project_files(group)} if group in GROUPS else {}
    return [f"{group}={name}" for name in names]


SCRIPT = """_sweep() {
  mapfile -t COMPREPLY < <(sweep completion --line "${COMP_LINE:0:COMP_POINT}" 2>/dev/null)
  if [[ ${COMPREPLY[0]-} == *= ]]; then compopt -o nospace; fi
}
complete -o default -F _sweep sweep"""
