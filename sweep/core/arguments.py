"""Arguments of a command, whose mistakes are told as all others are: in one line, with what may have been meant."""

import argparse
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NoReturn

from sweep.core.errors import InputError, suggest

KINDS = {"float": "a number", "int": "a whole number", "Path": "a path"}  # as argparse calls them, and as we do


class Arguments(argparse.ArgumentParser):
    """A parser that raises `InputError`; what it does not know is refused but for what `others` says yes to."""

    def __init__(self, *given: Any, others: Callable[[str], bool] = lambda _: False, **named: Any) -> None:
        super().__init__(*given, **named)
        self.others = others
        self.register("type", Path, _path)

    def error(self, message: str) -> NoReturn:
        """End with one line that says what is wrong, see `refused`."""
        raise refused(message, self.prog, flags(self))

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[argparse.Namespace, list[str]]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """What is given, and the words that are for others. Raises `InputError`."""
        found, words = super().parse_known_args(args, namespace)
        if unknown := [word for word in words if not self.others(word)]:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return found, words


def _path(word: str) -> Path:
    """Not of an empty word, such as of a variable that is not set, which would be the folder one is in."""
    if not word:
        raise ValueError
    return Path(word)


def no_flag(word: str) -> bool:
    """Whether a word is none, as values of the configuration are."""
    return not word.startswith("-")


def flags(parser: argparse.ArgumentParser) -> list[str]:
    """All of them, short ones too."""
    return [flag for action in parser._actions for flag in action.option_strings]


def refused(message: str, command: str, known: Iterable[str]) -> InputError:
    """What argparse says of a mistake as a line of ours; `known` are the flags that an unknown one may stand for."""
    if found := re.match(r"unrecognized arguments: (-[^\s=]+)", message):
        return InputError(f"{found[1]} is unknown{suggest(found[1], {*known})}")
    if found := re.match(r"argument (\S+): invalid choice: '(.*)' \(choose from (.*)\)", message):
        return InputError(f"{found[1]} = {found[2]} is unknown{suggest(found[2], re.findall(r'[\w.-]+', found[3]))}")
    if found := re.match(r"argument (\S+): invalid (float|int|Path) value: '(.*)'", message):
        return InputError(f"{found[1]} = {found[3]} is not allowed: {KINDS[found[2]]}")
    return InputError(f"{message} (`{command} --help` tells more)")
