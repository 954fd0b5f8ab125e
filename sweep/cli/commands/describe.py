"""`sweep describe`: describe parameters, choices and columns."""

import argparse
import re

from sweep.cli.choices import no_project_hint
from sweep.cli.command import Command, Section
from sweep.cli.exits import DONE
from sweep.core import terminal
from sweep.core.arguments import Arguments
from sweep.core.errors import InputError

COMMAND = Command(
    Section.LOOK_UP,
    "describe parameters: unit, meaning, bounds, default",
    "sweep describe robot; sweep describe drive.torque_limit",
)


def add_arguments(parser: Arguments) -> None:
    """Add the argument of `sweep describe`: the name of a group, choice, parameter or column."""
    parser.add_argument(
        "name",
        nargs="?",
        help="a group, a choice such as obstacle=ball, a parameter or a column (default: all parameters)",
    )


def run(args: argparse.Namespace) -> int:
    """Print unit, meaning, bounds and default of parameters, or the meaning of a choice or column."""
    from sweep.config import reference

    try:
        text = reference.parameters_page() if args.name is None else reference.describe_parameter_or_column(args.name)
    except InputError as error:
        raise InputError(f"{error}{no_project_hint() if '=' in (args.name or '') else ''}") from None
    text = re.sub(r"(?<=[^\s|])\n(?=[^\s|#*-])", " ", text)  # paragraphs, which the terminal wraps to its own width
    terminal.print_markdown(text + "\n", required=("meaning",), is_paged=True)
    return DONE
