"""Command-line arguments whose errors are one line, with a suggestion."""

import argparse
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NoReturn

from sweep.core.errors import InputError, format_name_suggestion

TYPE_NAMES = {"float": "a number", "int": "a whole number", "Path": "a path"}  # as argparse calls them, and as we do


class Arguments(argparse.ArgumentParser):
    """An argument parser that raises `InputError` instead of printing the usage and exiting.

    Args:
        *given: Positional arguments of `argparse.ArgumentParser`.
        others: Accepts words that the parser itself does not know, such as `group=choice`; all others are errors.
        **named: Keyword arguments of `argparse.ArgumentParser`.
    """

    def __init__(self, *given: Any, others: Callable[[str], bool] = lambda _: False, **named: Any) -> None:
        super().__init__(*given, **named)
        self.others = others
        self.register("type", Path, _path)

    def error(self, message: str) -> NoReturn:
        """Raise `InputError` with argparse's message rewritten to one line with a suggestion."""
        raise make_usage_error(message, self.prog, list_flags(self))

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[argparse.Namespace, list[str]]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Parse the known arguments and return them with the remaining words, as in argparse.

        Args:
            args: Words of the command line; `sys.argv[1:]` if None.
            namespace: Object that receives the values; a new one if None.

        Returns:
            The values, and the remaining words that `others` accepts.

        Raises:
            InputError: A word is unknown, or a value is not allowed.
        """
        found, words = super().parse_known_args(args, namespace)
        if unknown := [word for word in words if not self.others(word)]:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return found, words


def _path(word: str) -> Path:
    # an empty word, such as an unset shell variable, would mean the working folder
    if not word:
        raise ValueError
    return Path(word)


def is_positional(word: str) -> bool:
    """Return whether a command-line word is positional, such as `group=choice`, and not a flag."""
    return not word.startswith("-")


def list_flags(parser: argparse.ArgumentParser) -> list[str]:
    """List all flags of an argument parser, long and short."""
    return [flag for action in parser._actions for flag in action.option_strings]


def make_usage_error(message: str, command: str, known: Iterable[str]) -> InputError:
    """Turn an error message of argparse into an `InputError` of one line.

    Args:
        message: The message of argparse.
        command: The command, such as `sweep stats`, whose help the error mentions.
        known: Flags that may be suggested for an unknown one.

    Returns:
        The error, to be raised by the caller.
    """
    if found := re.match(r"unrecognized arguments: (-[^\s=]+)", message):
        return InputError(f"{found[1]} is unknown{format_name_suggestion(found[1], {*known})}")
    if found := re.match(r"argument (\S+): invalid choice: '(.*)' \(choose from (.*)\)", message):
        return InputError(
            f"{found[1]} = {found[2]} is unknown{format_name_suggestion(found[2], re.findall(r'[\w.-]+', found[3]))}"
        )
    if found := re.match(r"argument (\S+): invalid (float|int|Path) value: '(.*)'", message):
        return InputError(f"{found[1]} = {found[3]} is not allowed: {TYPE_NAMES[found[2]]}")
    return InputError(f"{message} (`{command} --help` explains more)")
