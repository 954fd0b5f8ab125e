"""Description of a subcommand, as its file in `sweep/cli/commands` states it. Imports nothing slow."""

from argparse import Namespace
from enum import StrEnum
from typing import NamedTuple, Protocol

from sweep.core.arguments import Arguments


class Section(StrEnum):
    """The section headings of `sweep --help`, in printed order."""

    LOOK_UP = "start and look up"
    SIMULATE = "simulate"
    READ = "read results"
    WATCH = "look at one rollout"
    CHECK = "check results"
    SHARE = "share"


class Command(NamedTuple):
    """A subcommand's entry in `sweep --help`: section and one-line help."""

    section: Section  # heading in `sweep --help`
    help: str  # one line; `sweep NAME --help` begins with it, too
    example: str = ""  # a command line at the end of `sweep NAME --help`


class CommandModule(Protocol):
    """A module with a subcommand: one file of `sweep/cli/commands`, or of an installed package."""

    COMMAND: Command

    @staticmethod
    def add_arguments(parser: Arguments) -> None:
        """Add the subcommand's arguments to its parser."""
        ...

    @staticmethod
    def run(args: Namespace) -> int:
        """Do the work and return the exit code.

        Args:
            args: Values of the arguments. Besides, `words` holds all words after the subcommand, and `overrides` those
                that the parser's `others` accepts, such as `group.name=value`.
        """
        ...
