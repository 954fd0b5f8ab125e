"""`sweep list`: list choices of the configuration groups, or folders of results."""

import argparse
import shutil
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path

from sweep.cli.choices import shipped_group_choices
from sweep.cli.command import Command, Section
from sweep.cli.exits import DONE
from sweep.core import project, terminal
from sweep.core.arguments import Arguments
from sweep.core.errors import InputError
from sweep.core.groups import GROUPS

COMMAND = Command(
    Section.LOOK_UP,
    "list scenarios, studies, robots and other choices, or folders of results",
    "sweep list study map; sweep list robot; sweep list ball; sweep list results/",
)


def add_arguments(parser: Arguments) -> None:
    """Add the argument of `sweep list`: words that select configuration groups, choices or folders."""
    wanted = "a group and words to filter its choices, or folders of results such as results/"
    parser.add_argument("what", nargs="*", help=wanted)


def run(args: argparse.Namespace) -> int:
    """Print the choices of configuration groups, of one group or matching words; or a line for each results folder.

    Raises `InputError` where nothing matches.
    """
    if any(word not in GROUPS and ("/" in word or Path(word).exists()) for word in args.what):
        from sweep.report import overview

        text = overview.overview_text([Path(word) for word in args.what]) + "\n"
        terminal.print_markdown(text, required=("folder", "rollouts", "succeed", "date"), is_paged=True)
        return DONE
    group, words = (args.what[0], args.what[1:]) if args.what and args.what[0] in GROUPS else ("", args.what)
    groups = [group] if group else list(GROUPS)
    shipped = {name: matching_choices(shipped_group_choices(name), words) for name in groups}
    own = {
        name: matching_choices(
            {k: project.first_comment(file) for k, file in project.project_files(name).items()}, words
        )
        for name in groups
    }
    if not any(shipped.values()) and not any(own.values()):
        where = f"{group} that matches {' '.join(words)}" if group else f"group or choice called {' '.join(words)}"
        raise InputError(f"there is no {where}, and no folder of that name: `sweep list` shows the groups")
    lines = format_group_choices(shipped, brief=not args.what)
    if any(own.values()):
        lines += ["", f"of this project, {project.find_project()}", *format_group_choices(own)]
    if not args.what:
        lines += [
            "",
            "sweep list GROUP [WORD ...]   what each choice is, or those that match all words: sweep list study map",
        ]
    terminal.print_markdown("\n".join(lines) + "\n", is_paged=True)
    return DONE


def matching_choices(choices: Mapping[str, str], words: Sequence[str]) -> dict[str, str]:
    """Return the choices whose name or description contains all of `words`, ignoring case."""
    return {
        name: text for name, text in choices.items() if all(word.lower() in f"{name} {text}".lower() for word in words)
    }


def format_group_choices(groups: Mapping[str, Mapping[str, str]], brief: bool = False) -> list[str]:
    """Format choices by group as lines, leaving out empty groups.

    Args:
        groups: For each group the names of choices and their descriptions.
        brief: Only the names, except those of studies, and each description cut to a line.

    Returns:
        The lines.
    """
    width, lines = shutil.get_terminal_size((100, 0)).columns, []
    for group, named in groups.items():
        if not named:
            continue
        lines.append(f"{group}=")
        if brief and group != "study":
            lines += textwrap.wrap(", ".join(named), width, initial_indent="  ", subsequent_indent="  ")
            continue
        described = [f"  {name:20} {text}".rstrip() for name, text in named.items()]
        lines += [one if len(one) <= width else f"{one[: width - 3]}..." for one in described] if brief else described
    return lines
