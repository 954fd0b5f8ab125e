"""The systems that studies can simulate. Other rooms use them through the contract in `base` only."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from sweep.contract.system import ClassesByKind, SystemSetup
from sweep.core.errors import require_choice
from sweep.core.groups import GROUPS

if TYPE_CHECKING:
    from sweep.formulas import Formula

COMMON_KEYS = ("scenario", "study", "cluster", "out")  # keys of every configuration
DERIVED_KEYS = ("model.content",)  # keys that a stored one has besides

DEFAULT_SYSTEM = "hexapod"  # the system of a scenario that names none
FORMER_NAMES = {"own": "mujoco"}  # words for a system that older scenarios have


class SystemKind(NamedTuple):
    """Entry of `SYSTEMS`: which configuration a kind of system (the hexapod, or a user's MuJoCo model) has."""

    config: str  # name of Hydra's primary configuration
    keys: tuple[str, ...]  # keys of its configuration, beside the common ones
    optional_keys: tuple[str, ...] = ()  # the keys that may be left out
    open_keys: tuple[str, ...] = ()  # the keys whose parts only the system knows

    def build_nominal_system(self, values: Mapping[str, Any], kinds: ClassesByKind) -> SystemSetup:
        """Build the hexapod or the MuJoCo model, at nominal parameters, from a plain configuration.

        Args:
            values: the resolved configuration.
            kinds: the classes that a group's `kind` chooses from, users' classes included.

        Returns:
            The system with engine settings and thresholds, all checked.

        Raises:
            InputError: a key or a value is not allowed.
        """
        if self.config == "mujoco":
            from sweep.systems import mujoco_model as system  # which is not loaded for another
        else:
            from sweep.systems import hexapod as system
        return system.build_nominal_system(values, kinds)


OPTIONAL = ("controller", "noise", "push", "start", "payload", "motor", "schedule")  # of a user's model
SYSTEMS = {
    "mujoco": SystemKind(
        "mujoco", ("model", *OPTIONAL, "engine", "outcome"), OPTIONAL, ("model", *OPTIONAL, "outcome")
    ),
    "hexapod": SystemKind(
        "config",
        tuple(name for name in GROUPS if name not in COMMON_KEYS),
        tuple(name for name, group in GROUPS.items() if group.has_free_keys),
    ),
}


def find_kind_by_name(name: str) -> SystemKind:
    """Return the kind of system (hexapod or MuJoCo model) that a scenario names, by its present or former name."""
    name = FORMER_NAMES.get(name, name)
    require_choice(name, SYSTEMS, f"system = {name}")
    return SYSTEMS[name]


def find_kind_by_config_keys(values: Mapping[str, Any]) -> SystemKind:
    """Return the kind of system (hexapod or MuJoCo model) to which the keys of a plain configuration belong."""
    return next((kind for kind in SYSTEMS.values() if kind.keys[0] in values), SYSTEMS[DEFAULT_SYSTEM])


def find_formula(name: str) -> "Formula":
    """Return a closed-form formula of the built-in hexapod by name. Raises `InputError`."""
    from sweep import formulas  # slow to import

    return formulas.find_formula(name)


def describe_columns() -> dict[str, str]:
    """Return the meaning of each metric column, of the built-in robot and of users' MuJoCo models."""
    from sweep.core.metric import merge_columns
    from sweep.metrics import outcome
    from sweep.systems.mujoco_model import metrics, tracking

    return merge_columns(metrics.METRICS) | tracking.COLUMNS | outcome.COLUMN_MEANINGS
