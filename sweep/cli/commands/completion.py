"""`sweep completion`: complete command lines in bash."""

import argparse
import re
from pathlib import Path

from sweep.cli import commands
from sweep.cli.choices import shipped_group_choices
from sweep.cli.command import Command, Section
from sweep.cli.exits import DONE
from sweep.core import project
from sweep.core.arguments import Arguments, list_flags
from sweep.core.groups import GROUPS

COMMAND = Command(Section.LOOK_UP, "completion for bash", 'eval "$(sweep completion)"  # in .bashrc')
BASH_SCRIPT = """_sweep() {
  mapfile -t COMPREPLY < <(sweep completion --line "${COMP_LINE:0:COMP_POINT}" 2>/dev/null)
  if [[ ${COMPREPLY[0]-} == *= ]]; then compopt -o nospace; fi
}
complete -o default -F _sweep sweep"""


def add_arguments(parser: Arguments) -> None:
    """Add the argument of `sweep completion` through which the bash script passes the line to complete."""
    parser.add_argument("--line", help=argparse.SUPPRESS)


def run(args: argparse.Namespace) -> int:
    """Print the completion script for bash, or the possible completions of a line."""
    if args.line is None:
        print(BASH_SCRIPT)
        return DONE
    before = args.line.split()[1:]
    word = "" if args.line.endswith(" ") or not before else before.pop()
    kept = word.rpartition("=")[0] + "=" if "=" in word else ""  # bash takes the word to begin behind it
    for one in list_completions(before, word):
        if one.startswith(word):
            print(one.removeprefix(kept))
    return DONE


def list_completions(before: list[str], word: str) -> list[str]:
    """List completions of the word at the cursor: commands, flags, choices `group=name`, or results folders.

    Args:
        before: Words of the line before the one to complete, without `sweep`.
        word: The beginning of the word to complete.
    """
    if not before:
        return commands.command_names()
    if word.startswith("-"):
        return long_flags(before[0])
    if before[0] != "run":
        found = sorted(str(file.parent) for file in Path().glob("results/*/study.yaml"))
        groups = GROUPS if before == ["list"] else ()
        return [*groups, *(re.sub(r"([^\w./+=:@%-])", r"\\\1", one) for one in found)]  # as bash reads it
    group, sign, _ = word.partition("=")
    if not sign:
        return [f"{one}=" for one in GROUPS]
    names = {**shipped_group_choices(group), **project.project_files(group)} if group in GROUPS else {}
    return [f"{group}={name}" for name in names]


def long_flags(name: str) -> list[str]:
    """List the long flags of a subcommand; empty where no subcommand has this name."""
    if name not in commands.command_names():
        return []
    return [flag for flag in list_flags(commands.make_parser(name)) if flag.startswith("--")]
