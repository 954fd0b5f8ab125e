"""`sweep init`, `list`, `describe` and `completion`: what there is to work with. No simulator is loaded for a list."""

import argparse
import re
import shlex
from collections.abc import Iterator, Mapping
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

from sweep.cli.choices import choices
from sweep.cli.exits import DONE
from sweep.core import project, terminal
from sweep.core.errors import InputError
from sweep.core.files import write_atomically
from sweep.core.groups import GROUPS

HIDDEN = {"gitignore": ".gitignore"}  # files that a package cannot hold under their name


def init(given: argparse.Namespace) -> int:
    """Make a project in a folder, without touching what is there; what a full disk cut short is finished.

    Raises `InputError`.
    """
    if not str(given.dir).strip():
        raise InputError(f"dir = {str(given.dir)!r} is not allowed: a new or empty folder")
    folder = Path(given.dir)
    source, study = ("template_model", "grip") if given.model else ("template", "first")
    wanted = [(file, folder / Path(*path)) for file, path in template(files("sweep.cli") / source)]
    there = {path for _, path in wanted if path.exists()}
    others = [path for file, path in wanted if path in there and not same(path, file)]
    if others or len(there) == len(wanted):
        raise InputError(f"{(others or sorted(there))[0]} is there already: choose an empty folder")
    for file, path in wanted:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path not in there:
            write_atomically(path, file.read_bytes())
        print(path)
    print(f"next: cd {shlex.quote(str(folder))}; sweep run study={study}")
    return DONE


def same(path: Path, file: Traversable) -> bool:
    """Whether a path has the content of a file of ours."""
    return path.is_file() and path.read_bytes() == file.read_bytes()


def template(folder: Traversable, above: tuple[str, ...] = ()) -> Iterator[tuple[Traversable, tuple[str, ...]]]:
    """The files of a new project, each with its place."""
    for entry in sorted(folder.iterdir(), key=lambda e: e.name):
        if entry.is_dir() and entry.name != "__pycache__":
            yield from template(entry, (*above, entry.name))
        elif entry.is_file():
            yield entry, (*above, HIDDEN.get(entry.name, entry.name))


def show(given: argparse.Namespace) -> int:
    """Every configuration file with its first comment line; of folders of results a line each."""
    if given.dir:
        from sweep.report import overview

        terminal.print_markdown(overview.text(given.dir) + "\n")
        return DONE
    for group in GROUPS:
        print(f"{group}=")
        lines(choices(group))
    folder = project.root()
    if found := {group: project.project_files(group) for group in GROUPS if project.project_files(group)}:
        print(f"\nof this project, {folder}")
        for group, own in found.items():
            print(f"{group}=")
            lines({name: project.first_comment(file) for name, file in own.items()})
    return DONE


def lines(named: Mapping[str, str]) -> None:
    """Names and what they say of themselves."""
    for name, text in named.items():
        terminal.print_markdown(f"  {name:20} {text}".rstrip() + "\n")


def describe(given: argparse.Namespace) -> int:
    """Unit, meaning, bounds and default of parameters."""
    from sweep.study import reference

    text = reference.page() if given.name is None else reference.text(given.name)
    terminal.print_markdown(text + "\n", kept=("meaning",))
    return DONE


def completion(given: argparse.Namespace) -> int:
    """The script for bash, or how the line so far may go on."""
    if given.line is None:
        print(SCRIPT)
        return DONE
    before = given.line.split()[1:]
    word = "" if given.line.endswith(" ") or not before else before.pop()
    kept = word.rpartition("=")[0] + "=" if "=" in word else ""  # bash takes the word to begin behind it
    for one in candidates(before, word, given.flags()):
        if one.startswith(word):
            print(one.removeprefix(kept))
    return DONE


def candidates(before: list[str], word: str, flags: dict[str, list[str]]) -> list[str]:
    """Commands; then the flags of one, `group=choice` for a run, folders of results for the rest."""
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
    names = {**choices(group), **project.project_files(group)} if group in GROUPS else {}
    return [f"{group}={name}" for name in names]


SCRIPT = """_sweep() {
  mapfile -t COMPREPLY < <(sweep completion --line "${COMP_LINE:0:COMP_POINT}" 2>/dev/null)
  if [[ ${COMPREPLY[0]-} == *= ]]; then compopt -o nospace; fi
}
complete -o default -F _sweep sweep"""
