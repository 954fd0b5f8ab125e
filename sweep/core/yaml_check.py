"""Checks of YAML text before it is loaded: ambiguous numbers, and aliases that contain themselves or expand too far."""

import re

import yaml

from sweep.core.errors import CONTROL_CHARACTER_RANGES, InputError

YAML_PARSER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # the fast one where it is built
# numbers that YAML 1.1 reads otherwise than people do: octal ones, and sexagesimal ones such as 1:30
LEADING_ZERO = re.compile(r"[-+]?0[0-9_]+")
SEXAGESIMAL = re.compile(r"[-+]?[0-9][0-9_]*(:[0-5]?[0-9])+(\.[0-9_]*)?")
UNPRINTABLE = re.compile(f"[{CONTROL_CHARACTER_RANGES}]")
MAX_ALIASED_ITEMS, MAX_NESTING_DEPTH = 100_000, 100  # items that aliases may stand for, in all, and levels of nesting


def explain_ambiguous_number(text: str) -> str:
    """Explain why an unquoted YAML word such as `010` or `1:30` is ambiguous as a number; empty for other words."""
    if not LEADING_ZERO.fullmatch(text) and not SEXAGESIMAL.fullmatch(text):
        return ""
    value = yaml.load(text, YAML_PARSER)
    said = f"YAML reads it as {value}" if not isinstance(value, str) else "it begins with 0"
    return f"{said}: write a decimal number, or quotes around a name"


def format_yaml_error(error: yaml.YAMLError) -> str:
    """Format a YAML error as one line: line number and problem."""
    mark = getattr(error, "problem_mark", None)
    where = f"line {mark.line + 1}: " if mark else ""
    return where + (getattr(error, "problem", None) or str(error).splitlines()[0])


def check_yaml(text: str, name: str, numbers: bool = True) -> None:
    """Raise an error for YAML that has ambiguous numbers, or that takes too much memory when loaded.

    Args:
        text: The content of a file.
        name: The file, for messages.
        numbers: Whether to refuse ambiguous numbers, such as `010` and `1:30`; False for files that this package wrote.

    Raises:
        InputError: A number is ambiguous, an anchor contains itself, or aliases expand too far.
        yaml.YAMLError: The text is no YAML.
    """
    sizes: dict[str, int] = {}  # items of finished anchors
    levels: list[_OpenCollection] = []
    aliased = 0
    for event in yaml.parse(text, YAML_PARSER):
        size = 1
        match event:
            case yaml.MappingStartEvent() | yaml.SequenceStartEvent():
                levels.append(_OpenCollection(event.anchor, isinstance(event, yaml.MappingStartEvent)))
                if len(levels) > MAX_NESTING_DEPTH:
                    raise InputError(
                        f"{name}, line {_line(event)} is nested too deeply: at most {MAX_NESTING_DEPTH} levels"
                    )
                continue
            case yaml.MappingEndEvent() | yaml.SequenceEndEvent():
                ended = levels.pop()
                size = ended.size
                if ended.anchor:
                    sizes[ended.anchor] = size
            case yaml.ScalarEvent():
                if event.anchor:
                    sizes[event.anchor] = 1
                if found := UNPRINTABLE.search(event.value):  # written as an escape such as \\e
                    raise InputError(f"{name}, line {_line(event)} is not allowed: it has the character {found[0]!r}")
                why = explain_ambiguous_number(event.value) if numbers and event.implicit[0] else ""
                if why:
                    key = ".".join(one.key for one in levels if one.key)
                    what = f"{key} = {event.value}" if key else event.value
                    raise InputError(f"{name}, line {_line(event)}: {what} is not allowed: {why}")
            case yaml.AliasEvent():
                if any(one.anchor == event.anchor for one in levels):
                    raise InputError(f"{name}, line {_line(event)}: the anchor &{event.anchor} contains itself")
                size = sizes.get(event.anchor, 1)  # an unknown one is refused where it is loaded
                aliased += size
                if aliased > MAX_ALIASED_ITEMS:
                    raise InputError(
                        f"{name}, line {_line(event)}: *{event.anchor} is not allowed: aliases stand for at most "
                        f"{MAX_ALIASED_ITEMS:,} items"
                    )
            case _:
                continue
        if levels:
            levels[-1].count_item(size, event.value if isinstance(event, yaml.ScalarEvent) else "")


class _OpenCollection:
    """A mapping or sequence whose end has not been parsed yet."""

    def __init__(self, anchor: str | None, is_mapping: bool):
        self.anchor, self.is_mapping = anchor, is_mapping
        self.size, self.key, self._at_key = 1, "", True

    def count_item(self, size: int, text: str) -> None:
        """Count an item of `size`, and remember it if it is a key of a mapping, where keys and values alternate."""
        self.size += size
        if self.is_mapping:
            self.key = text if self._at_key else ""
            self._at_key = not self._at_key


def _line(event: yaml.Event) -> int:
    return event.start_mark.line + 1
