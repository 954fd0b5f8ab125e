"""What a user is told in one line, without a traceback. Imports nothing, so that the command line starts at once."""

from collections.abc import Iterable


class InputError(ValueError):
    """Bad input from the user: the message is one line naming the key, the value and what is allowed."""

    def __str__(self) -> str:
        return in_one_line(super().__str__())


WRONG = (Exception, SystemExit)  # what code of a user's own raises where it is wrong, `sys.exit()` among it


class Fault(RuntimeError):
    """The machine failed a sound run: disk, memory, workers."""

    def __str__(self) -> str:
        return f"{in_one_line(super().__str__())}; what is on disk stays, the same command finishes the rest"


def in_one_line(text: str) -> str:
    """`text`, which may name a file with a line break in its name, without one."""
    return text.replace("\n", "\\n")


def raised(error: BaseException) -> str:
    """Kind and first line of what code of a user's own raised."""
    return ": ".join([type(error).__name__, *str(error).splitlines()[:1]])


def suggest(word: str, allowed: Iterable[str], short: Iterable[str] = ()) -> str:
    """The tail of a message about an unknown name: what is allowed, the closest first, or one of the `short` names."""
    import difflib

    allowed = list(allowed)
    close = difflib.get_close_matches(word, [*allowed, *short], n=1, cutoff=0.6)
    hint = f": did you mean {close[0]}?" if close else ""
    return f"{hint} (allowed: {', '.join(sorted(allowed))})" if allowed else hint


def nearest(word: str, names: Iterable[str], count: int = 5) -> str:
    """Name the few names most like `word`, as the end of a message; a dotted name counts by its last part, too.

    Args:
        word: what the user wrote.
        names: all names that would be right.
        count: how many of them to list.
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


def known(word: object, allowed: Iterable[str], told: str) -> None:
    """Raise `InputError` where `word`, which a message names as `told`, is none of those that are allowed."""
    if word not in (allowed := list(allowed)):
        raise InputError(f"{told} is unknown{suggest(str(word), allowed)}")
