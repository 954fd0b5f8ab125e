"""Parsing of configuration groups whose entries have names, such as pushes."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

from sweep.core.errors import InputError, require_choice


def iterate_named_entries(
    group: str, given: Any, such: str, allowed: Collection[str], needed: Sequence[str]
) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield name and content of each entry in a configuration group. Raises `InputError` for a wrong name or key.

    Args:
        group: Name of the group.
        given: What the configuration says of it.
        such: What is allowed, with an example, for messages.
        allowed: Keys of an entry.
        needed: Keys that an entry needs.
    """
    if not isinstance(given, Mapping) or not all(isinstance(one, Mapping) for one in given.values()):
        raise InputError(f"{group} = {given!r:.80} is not allowed: {such}")
    for name, said in given.items():
        if not str(name).isidentifier():
            raise InputError(f"{group}.{name} is not allowed: a name has letters, digits and _")
        for key in said:
            require_choice(key, allowed, f"{group}.{name}: {key}")
        if missing := [key for key in needed if key not in said]:
            raise InputError(f"{group}.{name} needs the key {missing[0]}")
        yield str(name), said
