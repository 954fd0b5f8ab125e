"""What can be studied: each system has a place here, which alone knows more of it than the contract in `base`."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from sweep.core.groups import GROUPS
from sweep.systems.base import Kinds, Nominal

COMMON = ("scenario", "study", "cluster", "out")  # keys of every configuration
DERIVED = ("model.content",)  # keys that a stored one has besides

USUAL = "hexapod"  # where a scenario names no `system`


class Kind(NamedTuple):
    """A kind of system, as a scenario names it."""

    config: str  # what Hydra composes it from
    keys: tuple[str, ...]  # of its configuration, beside the common ones
    free: tuple[str, ...] = ()  # of these, those that may be left out
    open: tuple[str, ...] = ()  # those whose parts the system alone knows

    def nominal(self, values: Mapping[str, Any], kinds: Kinds) -> Nominal:
        """The system that plain configuration `values` speak of, all of them checked. Raises `InputError`.

        `kinds` are the classes that a group's `kind` chooses from, those of users too.
        """
        if self.config == "own":
            from sweep.systems import own as system  # which is not loaded for another
        else:
            from sweep.systems import hexapod as system
        return system.nominal(values, kinds)


SYSTEMS = {
    "own": Kind(
        "own",
        ("model", "controller", "noise", "engine", "outcome"),
        ("controller", "noise"),
        ("model", "controller", "noise", "outcome"),
    ),
    "hexapod": Kind(
        "config",
        tuple(name for name in GROUPS if name not in COMMON),
        tuple(name for name, group in GROUPS.items() if group.free),
    ),
}


def kind_of(values: Mapping[str, Any]) -> Kind:
    """The kind of system that plain configuration `values` speak of: the one whose first key is among them."""
    return next((kind for kind in SYSTEMS.values() if kind.keys[0] in values), SYSTEMS[USUAL])


def describe_columns() -> dict[str, str]:
    """What the columns mean that the six-legged robot's rows have: its metrics, by name of the column."""
    from sweep.metrics import outcome

    return dict(outcome.COLUMNS)
