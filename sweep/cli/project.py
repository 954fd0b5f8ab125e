"""`sweep init`, `list`, `describe` and `completion`, which need no simulator."""

import argparse
import re
import shlex
import shutil
import textwrap
from collections.abc import Iterator, Mapping, Sequence
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


def list_choices(args: argparse.Namespace) -> int:
    """Print the choices of all groups, of one group, or those that match words; a line for each results folder.

    Raises `InputError` where nothing matches.
    """
    if any(word not in GROUPS and ("/" in word or Path(word).exists()) for word in args.what):
        from sweep.report import overview

        terminal.print_markdown(overview.overview_text([Path(word) for word in args.what]) + "\n")
        return DONE
    group, words = (args.what[0], args.what[1:]) if args.what and args.what[0] in GROUPS else ("", args.what)
    groups = [group] if group else list(GROUPS)
    shipped = {name: matching_choices(shipped_choices(name), words) for name in groups}
    own = {
        name: matching_choices(
            {k: project.first_comment(file) for k, file in project.project_files(name).items()}, words
        )
        for name in groups
    }
    if not any(shipped.values()) and not any(own.values()):
        where = f"{group} that matches {' '.join(words)}" if group else f"group or choice called {' '.join(words)}"
        raise InputError(f"there is no {where}, and no folder: `sweep list` shows the groups")
    print_groups(shipped, brief=not args.what)
    if any(own.values()):
        print(f"\nof this project, {project.find_project()}")
        print_groups(own)
    if not args.what:
        print(
            "\nsweep list GROUP [WORD ...]   what each choice is, or those that match all words: sweep list study map"
        )
    return DONE


def matching_choices(choices: Mapping[str, str], words: Sequence[str]) -> dict[str, str]:
    """Return the choices whose name or description contains all of `words`, ignoring case."""
    return {
        name: text for name, text in choices.items() if all(word.lower() in f"{name} {text}".lower() for word in words)
    }


def print_groups(groups: Mapping[str, Mapping[str, str]], brief: bool = False) -> None:
    """Print choices by group, leaving out empty groups.

    Args:
        groups: For each group the names of choices and their descriptions.
        brief: Print only the names, but of studies, and cut each description to a line.
    """
    width = shutil.get_terminal_size((100, 0)).columns
    for group, named in groups.items():
        if not named:
            continue
        print(f"{group}=")
        if brief and group != "study":
            print(textwrap.fill(", ".join(named), width, initial_indent="  ", subsequent_indent="  "))
        elif brief:
            lines = (f"{name:20} {text}" for name, text in named.items())
            print(*(f"  {one if len(one) <= width - 2 else one[: width - 5] + '...'}" for one in lines), sep="\n")
        else:
            print_choices(named)


def print_choices(named: Mapping[str, str]) -> None:
    """Print names and descriptions of choices."""
    for name, text in named.items():
        terminal.print_markdown(f"  {name:20} {text}".rstrip() + "\n")


def describe(args: argparse.Namespace) -> int:
    """Print unit, meaning, bounds and default of parameters, or the meaning of a choice or column."""
    from sweep.config import reference

    try:
        text = reference.parameters_page() if args.name is None else reference.describe(args.name)
    except InputError as error:
        raise InputError(f"{error}{outside_of_project() if '=' in (args.name or '') else ''}") from None
    terminal.print_markdown(text + "\n", required=("meaning",))
    return DONE


def completion(args: argparse.Namespace) -> int:
    """Print the completion script for bash, or the possible completions of a line."""
    if args.line is None:
        print(SCRIPT)
        return DONE
    before = args.line.split()[1:]
    word = "" if args.line.endswith(" ") or not before else before.pop()
    kept = word.rpartition("=")[0] + "=" if "=" in word else ""  # bash takes the word to begin behind it
    for one in list_completions(before, word, args.flags()):
        if one.startswith(word):
            print(one.removeprefix(kept))
    return DONE


def list_completions(before: list[str], word: str, flags: dict[str, list[str]]) -> list[str]:
    """List completions: commands, then flags, choices `group=name`, or folders of results."""
    if not before:
        return list(flags)
    if word.startswith("-"):
        return flags.get(before[0], [])
    if before[0] != "run":
        found = sorted(str(file.parent) for file in Path().glob("results/*/study.yaml"))
        groups = GROUPS if before == ["list"] else ()
        return [*groups, *(re.sub(r"([^\w./+=:@%-])", r"\\\1", one) for one in found)]  # as bash reads it
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
