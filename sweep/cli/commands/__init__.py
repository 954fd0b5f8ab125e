"""The subcommands of `sweep`: each is one file here, with its arguments and what it does.

The file `export_model.py` is `sweep export-model`. It defines

    COMMAND         section and line of `sweep --help`, an example
    add_arguments   adds arguments to the parser that it receives
    run             does the work and returns the exit code

Files are found by their names; no list of them exists. An installed package adds a subcommand by an entry point of the
group `sweep.commands`, whose value is a module with the same three names. Files import slow modules inside functions,
so that `sweep --help`, completion and error messages start quickly.
"""

import argparse
import shutil
import textwrap
from functools import cache
from importlib import import_module, metadata
from itertools import groupby
from pkgutil import iter_modules
from typing import cast

from sweep.cli.command import Command, CommandModule, Section
from sweep.core.arguments import Arguments
from sweep.core.errors import USER_CODE_ERRORS, InputError, escape_control_characters, format_user_exception
from sweep.core.files import printable_name
from sweep.core.terminal import wrap_line
from sweep.core.version import VERSION

ENTRY_POINTS = "sweep.commands"
REQUIRED_MEMBERS = ("COMMAND", "add_arguments", "run")  # what a module of an installed package has to define
NAME_WIDTH = 14  # of a command in `sweep --help`


def execute_command(argv: list[str]) -> int:
    """Run the subcommand at the start of `argv` and return its exit code. Raises `InputError`."""
    if strange := [word for word in argv if word.encode(errors="ignore").decode() != word]:
        raise InputError(f"{printable_name(strange[0])} is not allowed: letters in UTF-8")
    if argv and (argv[0] in shipped_command_names() or argv[0] in installed_commands()):
        name, words = argv[0], argv[1:]
    else:
        chosen = make_overview_parser().parse_args(argv)
        name, words = chosen.command, chosen.words
    args, overrides = make_parser(name).parse_known_args(words)
    args.words, args.overrides = words, overrides
    return load_command(name).run(args)


@cache
def shipped_command_names() -> tuple[str, ...]:
    """Names of the subcommands of this package, in alphabetical order."""
    return tuple(sorted(module.name.replace("_", "-") for module in iter_modules(__path__)))


@cache
def installed_commands() -> dict[str, metadata.EntryPoint]:
    """Entry points of subcommands of other installed packages, by name; a name of this package is left out."""
    found = metadata.entry_points(group=ENTRY_POINTS)
    return {one.name: one for one in sorted(found, key=lambda one: one.name) if one.name not in shipped_command_names()}


def command_names() -> list[str]:
    """Names of all subcommands: those of this package, then those of other installed packages."""
    return [*shipped_command_names(), *installed_commands()]


def load_command(name: str) -> CommandModule:
    """Import the module of a subcommand. Raises `InputError` where another package's module is not one."""
    if name in shipped_command_names():
        return cast(CommandModule, import_module(f"{__name__}.{name.replace('-', '_')}"))
    point = installed_commands()[name]
    try:
        module = point.load()
    except USER_CODE_ERRORS as error:
        raise InputError(
            f"subcommand {name} of {entry_point_package(point)} cannot be imported: {format_user_exception(error)}"
        ) from None
    if missing := [one for one in REQUIRED_MEMBERS if not hasattr(module, one)]:
        raise InputError(
            f"subcommand {name} of {entry_point_package(point)}: {point.value} does not define {missing[0]}"
        )
    return cast(CommandModule, module)


def entry_point_package(point: metadata.EntryPoint) -> str:
    """Return the name of the installed package that provides a subcommand's entry point."""
    return escape_control_characters(point.dist.name if point.dist else point.value)


def make_parser(name: str) -> Arguments:
    """Make the parser of the subcommand `name`, which `sweep NAME --help` prints."""
    command = load_command(name)
    about: Command = command.COMMAND
    parser = Arguments(
        prog=f"sweep {name}",
        description=about.help,
        epilog=f"example:\n  {about.example}" if about.example else None,
        formatter_class=HelpFormatter,
    )
    command.add_arguments(parser)
    return parser


def make_overview_parser() -> Arguments:
    """Make the parser of `sweep` without a subcommand, which `sweep --help` prints."""
    parser = OverviewParser(
        prog="sweep",
        usage="sweep [-h] [--version] command ...",
        description="Batch experiments with six-legged robots.",
        formatter_class=HelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"sweep {VERSION}")
    parser.add_argument("command", choices=command_names(), metavar="command", help="one of those below")
    parser.add_argument("words", nargs=argparse.REMAINDER, help=argparse.SUPPRESS).required = False
    return parser


class HelpFormatter(argparse.RawDescriptionHelpFormatter):
    """Help formatter that wraps paragraphs but keeps indented lines, such as commands, as they are."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        parts = []
        for is_kept, lines in groupby(text.splitlines(), lambda line: line.startswith(" ") or not line):
            found = [*lines]  # `list` is a module here
            parts += found if is_kept else [wrap_line(" ".join(found), width)]
        return "\n".join(f"{indent}{part}" for part in parts)


class OverviewParser(Arguments):
    """The parser of `sweep`, whose help lists the subcommands by section."""

    def format_help(self) -> str:
        """Format the help; this imports the files of all subcommands of this package."""
        self.epilog = list_commands(shutil.get_terminal_size().columns)
        return super().format_help()


def list_commands(width: int) -> str:
    """List all subcommands by section, with a line for each, wrapped to `width` characters."""
    abouts = {name: load_command(name).COMMAND for name in shipped_command_names()}
    lines = []
    for section in Section:
        lines += [
            f"{section}:",
            *(format_command_entry(name, one.help, width) for name, one in abouts.items() if one.section == section),
        ]
        lines.append("")
    # names only: their code runs when they are called, not before
    if others := installed_commands():
        lines += [
            "of installed packages:",
            *(format_command_entry(one, entry_point_package(at), width) for one, at in others.items()),
            "",
        ]
    return "\n".join([*lines, "`sweep COMMAND --help` explains a command."])


def format_command_entry(name: str, text: str, width: int) -> str:
    """Format a subcommand and its help for a list."""
    indent = " " * (NAME_WIDTH + 2)
    return textwrap.fill(
        text, max(width - 2, 40), initial_indent=f"  {name:{NAME_WIDTH - 1}} ", subsequent_indent=indent
    )
