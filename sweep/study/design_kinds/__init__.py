"""Table of the kinds of study designs, from this package and from user modules.

A module of this package, or a user module, lists its designs as `DESIGNS`, a table of classes by kind.
"""

import dataclasses
import pkgutil
from collections.abc import Callable, Mapping
from importlib import import_module
from types import ModuleType
from typing import Any

from sweep.core.errors import InputError, require_choice
from sweep.study.design_kinds.base import AdaptiveDesign, Design, SensitivityMethod

DESIGN_BY_KIND: dict[str, type[Design]] = {}  # by name, in the order of lists
DEFAULT_KIND = "monte_carlo"  # kind of a study that names none
MODULE_TABLE = "DESIGNS"  # name of a module's table


def register_designs(module: ModuleType) -> None:
    """Add the `Design` classes of a module to the kinds that `study.design.kind` allows.

    Args:
        module: A module of this package, or of a user. Its `DESIGNS`, if any, are classes by kind.

    Raises:
        InputError: The table is none, a class is no complete design, a kind exists already, or a setting differs from
            that of another kind.
    """
    if not isinstance(own := getattr(module, MODULE_TABLE, {}), Mapping):
        raise InputError(f"module {module.__name__}: {MODULE_TABLE} = {own} is not allowed: classes by kind")
    for kind, cls in own.items():
        if DESIGN_BY_KIND.get(kind) is cls:
            continue
        wrong = f"module {module.__name__}: {MODULE_TABLE} has {kind}: {cls}, "
        if not isinstance(cls, type) or not issubclass(cls, Design):
            raise InputError(f"{wrong}not a subclass of Design")
        if getattr(cls, "kind", None) != kind:
            raise InputError(f"{wrong}whose kind is {getattr(cls, 'kind', 'missing')!r}")
        required = ("meaning", "columns") if issubclass(cls, AdaptiveDesign) else ("meaning",)
        wanted = [*cls.__abstractmethods__, *(name for name in required if not hasattr(cls, name))]
        if cls.sensitivity == SensitivityMethod.ELEMENTARY_EFFECTS and cls.trajectory_grid is None:
            wanted.append("trajectory_grid")
        if wanted:
            raise InputError(f"module {module.__name__}: design {kind} has no {min(wanted)}")
        if kind in DESIGN_BY_KIND:
            raise InputError(f"module {module.__name__}: design {kind} exists already: choose another name")
        _check_settings(module, kind, cls)
        DESIGN_BY_KIND[kind] = cls
    ordered = sorted(DESIGN_BY_KIND.items(), key=lambda one: (one[1].position, one[0]))
    DESIGN_BY_KIND.clear()
    DESIGN_BY_KIND.update(ordered)


def kind_specific_settings(cls: type[Design]) -> dict[str, "dataclasses.Field[Any]"]:
    """Return the dataclass fields of a design class that not all design classes have, by name."""
    common = {member.name for member in dataclasses.fields(Design)}
    return {member.name: member for member in dataclasses.fields(cls) if member.name not in common}


def _check_settings(module: ModuleType, kind: str, cls: type[Design]) -> None:
    known = {
        name: member for other in DESIGN_BY_KIND.values() for name, member in kind_specific_settings(other).items()
    }
    for name, member in kind_specific_settings(cls).items():
        if member.default is dataclasses.MISSING:
            raise InputError(f"module {module.__name__}: setting {name} of design {kind} has no default")
        if name in known and (member.type, member.default) != (known[name].type, known[name].default):
            has = f"has another type or default than {name} of another kind"
            raise InputError(f"module {module.__name__}: setting {name} of design {kind} {has}")


def find_kind(kind: Any) -> type[Design]:
    """Return the design class for a value of `study.design.kind`. Raises `InputError`."""
    require_choice(kind, DESIGN_BY_KIND, f"study.design.kind = {kind!r}")
    return DESIGN_BY_KIND[kind]


def is_adaptive_kind(kind: Any) -> bool:
    """Return whether a value of `study.design.kind` names a design that searches for failures adaptively."""
    return issubclass(DESIGN_BY_KIND.get(kind, Design), AdaptiveDesign)


def list_kinds(matches: Callable[[type[Design]], bool]) -> list[str]:
    """List the design kinds whose class matches a condition, for error messages."""
    return [kind for kind, cls in DESIGN_BY_KIND.items() if matches(cls)]


def kinds_by_setting() -> dict[str, list[str]]:
    """Return the design kinds that have a setting, for each setting that not all kinds have."""
    found: dict[str, list[str]] = {}
    for kind, cls in DESIGN_BY_KIND.items():
        for name in kind_specific_settings(cls):
            found.setdefault(name, []).append(kind)
    return found


def make_schema() -> type:
    """Make the Hydra schema of `study.design`: a frozen dataclass with the settings of all kinds."""
    own = {name: member for cls in DESIGN_BY_KIND.values() for name, member in kind_specific_settings(cls).items()}
    common = {member.name: member for member in dataclasses.fields(Design)}
    grid, num, correlation = (common[name] for name in ("grid", "num", "correlation"))
    members = [(member.name, member.type, member.default) for member in (num, *own.values(), correlation)]
    return dataclasses.make_dataclass(
        "DesignSchema",
        [
            (grid.name, grid.type, dataclasses.field(default=grid.default)),
            ("kind", str, dataclasses.field(default=DEFAULT_KIND)),
            *((name, type_, dataclasses.field(default=default)) for name, type_, default in members),
        ],
        frozen=True,
    )


for _found in pkgutil.iter_modules(__path__):
    register_designs(import_module(f"{__name__}.{_found.name}"))
