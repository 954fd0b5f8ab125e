"""Errors that end in one line without a traceback. Imports nothing slow, so that the command line starts at once."""

import re
from collections.abc import Iterable

# characters that command a terminal, break a line, or change the order in which letters are shown
CONTROL_CHARACTER_RANGES = r"\x00-\x08\x0b-\x1f\x7f-\x84\x86-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069"
CONTROL_CHARACTERS = re.compile(rf"[{CONTROL_CHARACTER_RANGES}\t\n\x85]")

MAX_LISTED_NAMES = 40  # of an error message that lists all allowed names


class InputError(ValueError):
    """An error in the user's input, with a message of one line that names the key, the value and what is allowed."""

    def __str__(self) -> str:
        return escape_control_characters(super().__str__())


USER_CODE_ERRORS = (Exception, SystemExit)  # what user code may raise, `sys.exit()` included


class Fault(RuntimeError):
    """Failure of a valid run because of the machine: its disk, memory or workers. The command can be repeated."""

    def __str__(self) -> str:
        return f"{escape_control_characters(super().__str__())}; finished rollouts are kept, repeat the command"


def escape_control_characters(text: str) -> str:
    """Escape line breaks, terminal control sequences and bidirectional marks, which untrusted file names may
    contain."""
    return CONTROL_CHARACTERS.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def format_user_exception(error: BaseException) -> str:
    """Format an exception of user code as its type and the first line of its message, such as `KeyError: 'x'`."""
    return ": ".join([type(error).__name__, *str(error).splitlines()[:1]])


def format_name_suggestion(word: str, allowed: Iterable[str], short: Iterable[str] = ()) -> str:
    """Format the end of an error message about an unknown name: the closest allowed name, then all allowed names.

    Of more than `MAX_LISTED_NAMES` allowed names the nearest few are listed.

    Args:
        word: The unknown name.
        allowed: Names that are allowed.
        short: Further names that may be suggested but are not listed.

    Returns:
        `: did you mean friction? (allowed: ...)`, or parts of it; empty where nothing is allowed or close.
    """
    import difflib

    allowed = list(allowed)
    if len(allowed) > MAX_LISTED_NAMES:
        return format_nearest_names(word, [*allowed, *short])
    close = difflib.get_close_matches(word, [*allowed, *short], n=1, cutoff=0.6)
    hint = f": did you mean {close[0]}?" if close else ""
    return f"{hint} (allowed: {', '.join(sorted(allowed))})" if allowed else hint


def format_nearest_names(word: str, names: Iterable[str], count: int = 5) -> str:
    """Format the end of an error message about an unknown name: the few names most like it.

    Args:
        word: The unknown name.
        names: All allowed names. The last part of a dotted name is compared, too.
        count: Number of names to list.

    Returns:
        `: did you mean friction? (nearest: ...)`; empty where `names` is empty.
    """
    import difflib

    def likeness(name: str) -> tuple[float, str]:
        parts = (name.rpartition(".")[2], name)
        return max((difflib.SequenceMatcher(None, word.lower(), part.lower()).ratio(), part) for part in parts)

    found = sorted(dict.fromkeys(names), key=likeness, reverse=True)[:count]
    if not found:
        return ""
    share, part = likeness(found[0])
    hint = f": did you mean {part}?" if share >= 0.6 else ""
    return f"{hint} (nearest: {', '.join(found)})"


def require_choice(word: object, allowed: Iterable[str], label: str) -> None:
    """Raise `InputError` unless a name is one of those allowed.

    Args:
        word: The name.
        allowed: Names that are allowed.
        label: How the message names `word`, such as `cluster.kind = 'x'`.

    Raises:
        InputError: `word` is none of `allowed`; the closest one is suggested.
    """
    if word not in (allowed := list(allowed)):
        raise InputError(f"{label} is unknown{format_name_suggestion(str(word), allowed)}")
