"""Parameters with units and bounds: one dataclass is a Hydra schema, a validator and a JAX pytree at once.

A field made by `quantity` is a pytree leaf: a float, or an array over the batch where it is swept. A field
made by `choice` or `count` is static: changing it compiles anew.
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, dataclass_transform

import jax
import numpy as np

from sweep.core.errors import InputError, known

LARGEST = 10**18  # of whole numbers, which 64 bits hold
TICKS = "ticks"  # unit of delays: whole control ticks
WHOLE = (TICKS, "index")  # units of numbers that are whole, and rounded where they are drawn
# of figures, by the ends of their names
UNITS = {"m": "m", "s": "s", "deg": "deg", "rad": "rad", "n": "N", "nm": "N*m", "j": "J", "mps": "m/s", "kg": "kg"}


def quantity(
    default: float | None,
    unit: str,
    *,
    above: float = -math.inf,
    at_least: float = -math.inf,
    at_most: float = math.inf,
) -> Any:
    """A physical quantity: sweepable without recompiling. One whose default is None may be left open."""
    bounds = {"unit": unit, "above": above, "at_least": at_least, "at_most": at_most}
    return dataclasses.field(default=default, metadata={"role": "quantity", **bounds})


def choice(default: str, *options: str, **meanings: str) -> Any:
    """A parameter that is one of a few names.

    Args:
        default: the name where nothing else is said.
        options: the names that are allowed.
        meanings: further names, each with what it means, for `sweep describe`.
    """
    about = {"role": "choice", "options": (*options, *meanings), "meanings": meanings}
    return dataclasses.field(default=default, metadata=about)


def count(default: int, *, at_least: int = 0, at_most: float = math.inf) -> Any:
    """A whole number that shapes the compiled program."""
    bounds = {"unit": "", "above": -math.inf, "at_least": at_least, "at_most": at_most}
    return dataclasses.field(default=default, metadata={"role": "count", **bounds})


def setting(default: float, unit: str, *, above: float = -math.inf, at_most: float = math.inf) -> Any:
    """A number that shapes the compiled program."""
    bounds = {"unit": unit, "above": above, "at_least": -math.inf, "at_most": at_most}
    return dataclasses.field(default=default, metadata={"role": "setting", **bounds})


def flag(default: bool) -> Any:
    """On or off; it shapes what is compiled."""
    return dataclasses.field(default=default, metadata={"role": "flag"})


def unhashed(member: Any) -> Any:
    """A parameter that is left out of the settings' `repr`, and so of `run_id`: it changes no row."""
    member.repr = False
    return member


@dataclass_transform(frozen_default=True)
def parameters[T: type](cls: T) -> T:
    """Frozen dataclass whose quantities (and nested parameter groups) are pytree leaves."""
    cls = dataclasses.dataclass(frozen=True)(cls)
    data = [f.name for f in dataclasses.fields(cls) if f.metadata.get("role", "quantity") == "quantity"]
    static = [f.name for f in dataclasses.fields(cls) if f.name not in data]
    return jax.tree_util.register_dataclass(cls, data_fields=data, meta_fields=static)


def build[T](cls: type[T], values: Mapping[str, Any], path: str) -> T:
    """`cls` from plain values, every one checked.

    Raises `InputError` naming `path.key`, the value and what is allowed.
    """
    fields = {f.name: f for f in dataclasses.fields(cls)}  # pyright: ignore[reportArgumentType]
    for key in values:
        known(key, fields, f"{path}.{key}")
    return cls(**{key: checked(fields[key], value, f"{path}.{key}") for key, value in values.items()})


def of_kind(kinds: Mapping[str, type], values: Mapping[str, Any], path: str) -> Any:
    """The one of `kinds` that `values` name by their `kind`, made by `build`. Raises `InputError`."""
    kind: Any = values.get("kind")
    known(kind, kinds, f"{path}.kind = {kind!r}")
    return build(kinds[kind], values, path)


def checked(field: "dataclasses.Field[Any]", value: Any, path: str) -> Any:
    """`value`, converted and inside the bounds of `field`; raises `InputError`."""
    role = field.metadata.get("role")
    match role:
        case "choice":
            if value not in field.metadata["options"]:
                raise InputError(f"{path} = {value!r} is not allowed: one of {', '.join(field.metadata['options'])}")
            return value
        case "flag":
            if not isinstance(value, bool):
                raise InputError(f"{path} = {value!r} is not allowed: true or false")
            return value
        case "quantity" | "count" | "setting":
            return _checked_number(field, value, path)
        case _:
            return value


def _checked_number(field: "dataclasses.Field[Any]", value: Any, path: str) -> float | int | None:
    whole = field.metadata["role"] == "count"
    if value is None and field.default is None:
        return None
    if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
        raise InputError(f"{path} = {value!r} is not allowed: a {'whole ' if whole else ''}number")
    if isinstance(value, int) and abs(value) > LARGEST:
        raise InputError(f"{path} is not allowed with {len(str(abs(value)))} digits: {bounds_text(field)}")
    if not math.isfinite(value):
        raise InputError(
            f"{path} = {value:g} is not allowed: a finite number, {bounds_text(field)}".removesuffix(", finite")
        )
    if not within(field, value):
        raise InputError(f"{path} = {value:g} is not allowed: {bounds_text(field)}")
    unit = field.metadata["unit"]  # only what is drawn is rounded: seconds would be no delay at all
    if (whole or unit in WHOLE) and int(value) != value:
        raise InputError(f"{path} = {value!r} is not allowed: a whole number{' of control ticks' * (unit == TICKS)}")
    return int(value) if whole else float(value)


def within(field: "dataclasses.Field[Any]", value: Any) -> Any:
    """Whether `value` (a number or an array) lies inside the bounds of `field`."""
    meta = field.metadata
    return (value > meta["above"]) & (value >= meta["at_least"]) & (value <= meta["at_most"])


def written(unit: str) -> str:
    """A unit as it is read: `N*m^2` -> `N·m²`; empty for pure numbers."""
    return "" if unit == "-" else unit.replace("*", "·").replace("^2", "²").replace("^3", "³").replace("^4", "⁴")


def bounds_text(field: "dataclasses.Field[Any]") -> str:
    """The bounds of `field` in words, with its unit."""
    unit = written(field.metadata["unit"])
    return in_words(field.metadata) + (f" {unit}" if unit else "")


def in_words(bounds: Mapping[str, Any]) -> str:
    """What numbers are allowed by `above`, `at_least`, `below` and `at_most`, as far as these are finite."""
    words = {"above": "greater than", "at_least": "at least", "below": "less than", "at_most": "at most"}
    parts = [f"{word} {bounds[key]:g}" for key, word in words.items() if math.isfinite(bounds.get(key, math.inf))]
    return " and ".join(parts) or "finite"
