"""Parameters with units and bounds: one dataclass is at once a Hydra schema, a validator and a JAX pytree.

A field made by `quantity` is a pytree leaf: a float, or an array over the batch where it is swept. A field
made by `choice` or `count` is static: changing it compiles anew.
"""

import dataclasses
import math
import types
import typing
from collections.abc import Mapping
from typing import Any, dataclass_transform

import jax
import numpy as np

from sweep.core.errors import InputError, require_choice

TYPE_NAMES: Mapping[Any, str] = {str: "a word", int: "a whole number", float: "a number", bool: "true or false"}
MAX_WHOLE_NUMBER = 10**18  # of whole numbers, which 64 bits hold
TICKS_UNIT = "ticks"  # unit of delays: whole control ticks
WHOLE_NUMBER_UNITS = (TICKS_UNIT, "steps", "index")  # units of numbers that are whole, and rounded where they are drawn
# of figures, by the ends of their names
UNIT_BY_SUFFIX = {
    "m": "m",
    "s": "s",
    "deg": "deg",
    "rad": "rad",
    "n": "N",
    "nm": "N*m",
    "j": "J",
    "mps": "m/s",
    "kg": "kg",
}


def quantity(
    default: float | None,
    unit: str,
    *,
    above: float = -math.inf,
    at_least: float = -math.inf,
    at_most: float = math.inf,
) -> Any:
    """Declare a physical quantity: a float field that can vary within a batch without recompiling.

    Args:
        default: Nominal value; None for a quantity that may stay unset.
        unit: Unit, such as `N*m`; `-` or empty for pure numbers.
        above: Exclusive lower bound.
        at_least: Inclusive lower bound.
        at_most: Inclusive upper bound.

    Returns:
        A dataclass field.
    """
    bounds = {"unit": unit, "above": above, "at_least": at_least, "at_most": at_most}
    return dataclasses.field(default=default, metadata={"role": "quantity", **bounds})


def choice(default: str, *options: str, **meanings: str) -> Any:
    """Declare a parameter whose value is one of a few names; another name needs another compiled program.

    Args:
        default: The default name.
        *options: Allowed names.
        **meanings: Further allowed names, each with its meaning for `sweep describe`.

    Returns:
        A dataclass field.
    """
    about = {"role": "choice", "options": (*options, *meanings), "meanings": meanings}
    return dataclasses.field(default=default, metadata=about)


def count(default: int, *, at_least: int = 0, at_most: float = math.inf) -> Any:
    """Declare a whole number; another value needs another compiled program.

    Args:
        default: Nominal value.
        at_least: Inclusive lower bound.
        at_most: Inclusive upper bound.

    Returns:
        A dataclass field.
    """
    bounds = {"unit": "", "above": -math.inf, "at_least": at_least, "at_most": at_most}
    return dataclasses.field(default=default, metadata={"role": "count", **bounds})


def setting(default: float, unit: str, *, above: float = -math.inf, at_most: float = math.inf) -> Any:
    """Declare a real number that is compiled in; another value needs another compiled program.

    Args:
        default: Nominal value.
        unit: Unit, such as `s`; `-` or empty for pure numbers.
        above: Exclusive lower bound.
        at_most: Inclusive upper bound.

    Returns:
        A dataclass field.
    """
    bounds = {"unit": unit, "above": above, "at_least": -math.inf, "at_most": at_most}
    return dataclasses.field(default=default, metadata={"role": "setting", **bounds})


def file_name(default: str) -> Any:
    """Declare a parameter that names a file or module of the project; another name needs another compiled program."""
    return dataclasses.field(default=default, metadata={"role": "file"})


def flag(default: bool) -> Any:
    """Declare a parameter that is true or false; the other value needs another compiled program."""
    return dataclasses.field(default=default, metadata={"role": "flag"})


def exclude_from_run_id(member: Any) -> Any:
    """Exclude a parameter that changes no row from `run_id`, the hash of how rows are simulated."""
    member.repr = False
    return member


@dataclass_transform(frozen_default=True)
def parameters[T: type](cls: T) -> T:
    """Make a class a frozen dataclass and a JAX pytree whose leaves are its quantities and nested parameter groups."""
    cls = dataclasses.dataclass(frozen=True)(cls)
    data = [f.name for f in dataclasses.fields(cls) if f.metadata.get("role", "quantity") == "quantity"]
    static = [f.name for f in dataclasses.fields(cls) if f.name not in data]
    return jax.tree_util.register_dataclass(cls, data_fields=data, meta_fields=static)


def build_instance[T](cls: type[T], values: Mapping[str, Any], path: str) -> T:
    """Make an instance of a parameter dataclass from plain values.

    Args:
        cls: The dataclass.
        values: Values by field name; fields without one keep their default.
        path: Path of the group, such as `robot`, for messages.

    Returns:
        The instance, with all values checked.

    Raises:
        InputError: A name is unknown, or a value is not allowed.
    """
    fields = {f.name: f for f in dataclasses.fields(cls)}  # pyright: ignore[reportArgumentType]
    for key in values:
        require_choice(key, fields, f"{path}.{key}")
    return cls(**{key: convert_and_check_value(fields[key], value, f"{path}.{key}") for key, value in values.items()})


def build_instance_by_kind(kinds: Mapping[str, type], values: Mapping[str, Any], path: str) -> Any:
    """Make an instance of the parameter dataclass that the value of `kind` selects.

    Args:
        kinds: Parameter dataclasses by kind.
        values: Values by field name, including `kind`.
        path: Path of the group, such as `obstacle`, for messages.

    Returns:
        The instance, with all values checked.

    Raises:
        InputError: The kind is unknown, or a value is not allowed.
    """
    kind: Any = values.get("kind")
    require_choice(kind, kinds, f"{path}.kind = {kind!r}")
    return build_instance(kinds[kind], values, path)


def convert_and_check_value(field: "dataclasses.Field[Any]", value: Any, path: str) -> Any:
    """Convert a plain value to the type of a field and check its bounds.

    Args:
        field: Field of a parameter dataclass.
        value: The plain value.
        path: Path of the parameter, such as `robot.thigh`, for messages.

    Returns:
        The converted value.

    Raises:
        InputError: Names the path, the value and what is allowed.
    """
    role = field.metadata.get("role")
    match role:
        case "choice":
            if value not in field.metadata["options"]:
                raise InputError(f"{path} = {value!r} is not allowed: one of {', '.join(field.metadata['options'])}")
            return value
        case "file":
            if not isinstance(value, str) or not value.strip():
                raise InputError(f"{path} = {value!r} is not allowed: a file of the project")
            return value
        case "flag":
            if not isinstance(value, bool):
                raise InputError(f"{path} = {value!r} is not allowed: true or false")
            return value
        case "quantity" | "count" | "setting":
            return _checked_number(field, value, path)
        case _:
            return _checked_plain(field, value, path)


def _checked_plain(field: "dataclasses.Field[Any]", value: Any, path: str) -> Any:
    """Check the type of a field that is no parameter where it is a single word, number or truth."""
    kinds = typing.get_args(field.type) if isinstance(field.type, types.UnionType) else (field.type,)
    if not {*kinds} <= {*TYPE_NAMES, type(None)}:
        return value
    fits = type(value) in kinds or (float in kinds and type(value) is int)
    if not fits:
        raise InputError(f"{path} = {value!r:.100} is not allowed: {TYPE_NAMES[kinds[0]]}")
    return value


def _checked_number(field: "dataclasses.Field[Any]", value: Any, path: str) -> float | int | None:
    whole = field.metadata["role"] == "count"
    if value is None and field.default is None:
        return None
    if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
        raise InputError(f"{path} = {value!r} is not allowed: a {'whole ' if whole else ''}number")
    if isinstance(value, int) and abs(value) > MAX_WHOLE_NUMBER:
        raise InputError(f"{path} is not allowed with {len(str(abs(value)))} digits: {bounds_text(field)}")
    if not math.isfinite(value):
        raise InputError(
            f"{path} = {value:g} is not allowed: a finite number, {bounds_text(field)}".removesuffix(", finite")
        )
    if not is_within_bounds(field, value):
        raise InputError(f"{path} = {value:g} is not allowed: {bounds_text(field)}")
    unit = field.metadata["unit"]  # only what is drawn is rounded: seconds would be no delay at all
    if (whole or unit in WHOLE_NUMBER_UNITS) and int(value) != value:
        raise InputError(
            f"{path} = {value!r} is not allowed: a whole number{' of control ticks' * (unit == TICKS_UNIT)}"
        )
    return int(value) if whole else float(value)


def is_within_bounds(field: "dataclasses.Field[Any]", value: Any) -> Any:
    """Return whether a value lies within the bounds of a parameter.

    Args:
        field: Field of a parameter dataclass.
        value: A number, or an array of any shape.

    Returns:
        A Boolean, or an array of Booleans of the shape of `value`.
    """
    meta = field.metadata
    return (value > meta["above"]) & (value >= meta["at_least"]) & (value <= meta["at_most"])


def format_unit(unit: str) -> str:
    """Format a unit for display, such as `N*m^2` as `N·m²`; empty for pure numbers."""
    return "" if unit == "-" else unit.replace("*", "·").replace("^2", "²").replace("^3", "³").replace("^4", "⁴")


def bounds_text(field: "dataclasses.Field[Any]") -> str:
    """Describe the bounds of a parameter with its unit, such as `greater than 0 m`."""
    unit = format_unit(field.metadata["unit"])
    return describe_bounds(field.metadata) + (f" {unit}" if unit else "")


def describe_bounds(bounds: Mapping[str, Any]) -> str:
    """Describe the finite ones of the bounds `above`, `at_least`, `below` and `at_most`, such as `at least 0`."""
    words = {"above": "greater than", "at_least": "at least", "below": "less than", "at_most": "at most"}
    parts = [f"{word} {bounds[key]:g}" for key, word in words.items() if math.isfinite(bounds.get(key, math.inf))]
    return " and ".join(parts) or "finite"
