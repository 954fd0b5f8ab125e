"""Distributions from which axes are drawn: a few built-in ones, and every continuous one of scipy.stats."""

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from sweep.core.errors import InputError, format_name_suggestion, require_choice
from sweep.study.columns import SPREADSHEET_FORMULA_SIGNS

# what each distribution needs, and what it may have besides
DISTRIBUTIONS = {
    "uniform": (("from", "to"), ()), "log_uniform": (("from", "to"), ()), "normal": (("mean", "std"), ("from", "to")),
    "discrete": (("values",), ("weights",)),
}  # fmt: skip


@dataclass(frozen=True)
class Distribution:
    """The probability distribution of a parameter: one of `DISTRIBUTIONS`, or one of scipy.stats by its name there.

    A normal distribution and those of scipy.stats are truncated at `from` and `to` where these are given.
    """

    kind: str
    parameters: Mapping[str, Any]

    def quantile(self, share: np.ndarray) -> np.ndarray:
        """Return the quantiles of the distribution at probabilities in (0, 1)."""
        low, high = self.parameters.get("from", -math.inf), self.parameters.get("to", math.inf)
        match self.kind:
            case "uniform":
                return low + share * (high - low)
            case "log_uniform":
                return low * (high / low) ** share
            case "normal":
                from scipy.stats import truncnorm  # slow to import

                mean, std = self.parameters["mean"], self.parameters["std"]
                return truncnorm.ppf(share, (low - mean) / std, (high - mean) / std, mean, std)
            case "discrete":
                values = np.asarray(self.parameters["values"])
                weights = np.asarray(self.parameters.get("weights", np.ones(len(values))), dtype=float)
                ends = np.cumsum(weights / weights.sum())
                return values[np.minimum(np.searchsorted(ends, share, side="right"), len(values) - 1)]
            case _:
                own = {key: value for key, value in self.parameters.items() if key not in ("from", "to")}
                frozen = find_scipy_distribution(self.kind)(**own)
                below, above = frozen.cdf(low), frozen.cdf(high)
                return frozen.ppf(below + share * (above - below))

    def __str__(self) -> str:
        ends = " ".join(
            f"{key} {format_value(self.parameters[key])}" for key in ("from", "to") if key in self.parameters
        )
        others = [f"{key} {format_value(value)}" for key, value in self.parameters.items() if key not in ("from", "to")]
        return f"{self.kind.replace('_', '-')}, {', '.join([*others, ends] if ends else others)}"


def parse_distribution(key: str, config: Any) -> Distribution:
    """Parse the distribution of an axis.

    Args:
        key: Path of the distribution, for messages.
        config: Its plain keys and values.

    Returns:
        The distribution.

    Raises:
        InputError: The kind is unknown, or a number is missing or not allowed.
    """
    if not isinstance(config, Mapping):
        raise InputError(
            f"{key} = {config!r} is not allowed: keys and values, such as {{kind: uniform, from: 0, to: 1}}"
        )
    kind = str(config.get("kind"))
    if kind not in DISTRIBUTIONS:
        if find_scipy_distribution(kind) is not None:
            return _distribution_of_scipy(key, kind, config)
        raise InputError(
            f"{key}.kind = {kind!r} is unknown{format_name_suggestion(kind, (*DISTRIBUTIONS, 'any of scipy.stats'))}"
        )
    needed, optional = DISTRIBUTIONS[kind]
    config = require_known_keys(key, config, ("kind", *needed, *optional))
    for name in needed:
        if name not in config:
            raise InputError(f"{key}.{name} is missing: {kind} needs {' and '.join(needed)}")
    if kind == "discrete":
        values, weights = parse_value_list(f"{key}.values", config["values"]), config.get("weights", [1])
        if "weights" in config and (not isinstance(weights, list) or len(weights) != len(values)):
            raise InputError(f"{key}.weights = {weights!r} is not allowed: a number for each of {len(values)} values")
        if min(parse_number(f"{key}.weights", w) for w in weights) < 0 or not sum(weights):
            raise InputError(f"{key}.weights = {weights!r} is not allowed: none negative, not all zero")
        return Distribution(kind, {k: v for k, v in config.items() if k != "kind"})
    numbers = {name: parse_number(f"{key}.{name}", config[name]) for name in (*needed, *optional) if name in config}
    if numbers.get("std", 1.0) <= 0:
        raise InputError(f"{key}.std = {numbers['std']:g} is not allowed: greater than 0")
    if kind == "log_uniform" and numbers["from"] <= 0:
        raise InputError(f"{key}.from = {numbers['from']:g} is not allowed: greater than 0")
    if numbers.get("from", -math.inf) >= numbers.get("to", math.inf):
        raise InputError(f"{key}.to = {numbers['to']:g} is not allowed: greater than from = {numbers['from']:g}")
    return Distribution(kind, numbers)


def find_scipy_distribution(kind: str) -> Any:
    """Return the continuous distribution of scipy.stats with this name, or None."""
    from scipy import stats  # slow to import

    found = getattr(stats, kind, None)
    return found if isinstance(found, stats.rv_continuous) else None


def _distribution_of_scipy(key: str, kind: str, config: Mapping[str, Any]) -> Distribution:
    """Parse a distribution of scipy.stats with its shape parameters, `loc` and `scale`."""
    shapes = tuple(name.strip() for name in (find_scipy_distribution(kind).shapes or "").split(",") if name.strip())
    config = require_known_keys(key, config, ("kind", *shapes, "loc", "scale", "from", "to"))
    for name in shapes:
        if name not in config:
            raise InputError(f"{key}.{name} is missing: {kind} needs {' and '.join(shapes)}")
    found = Distribution(kind, {name: parse_number(f"{key}.{name}", v) for name, v in config.items() if name != "kind"})
    if not np.isfinite(found.quantile(np.array([0.001, 0.5, 0.999]))).all():
        raise InputError(f"{key} = {found} is not allowed: scipy.stats.{kind} has no such distribution")
    return found


def require_known_keys(path: str, mapping: Any, allowed: tuple[str, ...]) -> dict[str, Any]:
    """Raise `InputError` unless a value is a mapping with only allowed keys.

    Args:
        path: Path of the mapping, for messages.
        mapping: The value to check.
        allowed: Allowed keys.

    Returns:
        The mapping as a dict.

    Raises:
        InputError: The value is no mapping, or a key is unknown.
    """
    if not isinstance(mapping, Mapping):
        raise InputError(f"{path} = {mapping!r} is not allowed: keys and values (allowed: {', '.join(allowed)})")
    for key in mapping:
        require_choice(key, allowed, f"{path}.{key}")
    return {str(k): v for k, v in mapping.items()}


def parse_value_list(key: str, values: Any) -> list[Any]:
    """Check that a value is a list of numbers or of names, and return it.

    Args:
        key: Path of the list, for messages.
        values: The value to check.

    Returns:
        The list.

    Raises:
        InputError: The value is no such list.
    """
    if not isinstance(values, list) or not values or any(isinstance(one, list | Mapping | None) for one in values):
        raise InputError(f"{key} = {values!r} is not allowed: a list with at least one value, each a number or a name")
    if len({(isinstance(one, str), isinstance(one, bool)) for one in values}) > 1:
        raise InputError(f"{key} = {values!r} is not allowed: all numbers, or all names")
    for name in values:
        refuse_spreadsheet_formula(key, name)
    return values


def refuse_spreadsheet_formula(key: str, name: Any) -> None:
    """Raise `InputError` for a name that a spreadsheet would execute as a formula.

    Args:
        key: Path of the name, for messages.
        name: The name; other values are allowed.

    Raises:
        InputError: It starts with one of `FORMULA`.
    """
    if isinstance(name, str) and name.startswith(tuple(SPREADSHEET_FORMULA_SIGNS)):
        raise InputError(
            f"{key}: {name!r} is not allowed: a name that does not start with {' '.join(SPREADSHEET_FORMULA_SIGNS)}"
        )


def parse_number(key: str, value: Any) -> float:
    """Check that a value is a finite number, and return it.

    Args:
        key: Path of the number, for messages.
        value: The value to check.

    Returns:
        The number.

    Raises:
        InputError: The value is no number.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= sys.float_info.max:
        raise InputError(f"{key} = {str(value)[:40]} is not allowed: a number")
    return float(value)


def format_value(value: Any) -> str:
    """Format a value with six significant digits, or a list of values."""
    if isinstance(value, list | tuple):
        return format_values(tuple(value))
    return f"{value:.6g}" if isinstance(value, int | float) else str(value)


def format_values(values: tuple[Any, ...]) -> str:
    """Format values as a list; long lists are shortened to their first and last values."""
    if len(values) <= 4:
        return ", ".join(map(format_value, values))
    return (
        f"{format_value(values[0])}, {format_value(values[1])}, ... {format_value(values[-1])} ({len(values)} values)"
    )
