"""What can be studied: each system has a place here, which alone knows more of it than the contract in `base`."""

from collections.abc import Callable, Mapping
from pkgutil import resolve_name
from typing import Any, NamedTuple

from sweep.core.groups import GROUPS
from sweep.systems.base import Kinds, Nominal

COMMON = ("scenario", "study", "cluster", "out")  # keys of every configuration


USUAL = "hexapod"  # where a scenario names no `system`


class Kind(NamedTuple):
    """A kind of system; as text, so that one is not loaded for another."""

    source: str  # module:function that makes one of plain values
    config: str  # what Hydra composes it from
    keys: tuple[str, ...]  # of its configuration, beside the common ones
    free: tuple[str, ...] = ()  # of these, those that may be left out
    open: tuple[str, ...] = ()  # those whose parts the system alone knows


SYSTEMS = {
    "own": Kind(
        "sweep.systems.own:nominal",
        "own",
        ("model", "controller", "noise", "engine", "outcome"),
        ("controller", "noise"),
        ("model", "controller", "noise", "outcome"),
    ),
    "hexapod": Kind(
        "sweep.systems.hexapod:nominal",
        "config",
        tuple(name for name in GROUPS if name not in COMMON),
        tuple(name for name, group in GROUPS.items() if group.free),
    ),
}


def kind_of(values: Mapping[str, Any]) -> Kind:
    """The kind of system that plain configuration `values` speak of: the one whose first key is among them."""
    return next((kind for kind in SYSTEMS.values() if kind.keys[0] in values), SYSTEMS[USUAL])


def nominal(values: Mapping[str, Any], kinds: Kinds) -> Nominal:
    """The system that plain configuration `values` speak of, all of them checked. Raises `InputError`.

    `kinds` are the classes that a group's `kind` chooses from, those of users too.
    """
    make: Callable[[Mapping[str, Any], Kinds], Nominal] = resolve_name(kind_of(values).source)
    return make(values, kinds)
