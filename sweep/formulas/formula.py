"""Formulas with their inputs, outputs, units, domain and source, all read from the definition of a function.

A formula is one typed JAX function under the decorator `formula`. Its arguments are its inputs, each annotated with an
`Input`; its result is a named tuple of its outputs, each annotated with a unit; the first line of its docstring is the
formula's summary. Such a function broadcasts and gives nan outside its domain, so it can be jitted, vmapped and
differentiated. `Formula.evaluate` refuses bad input with a message of one line.
"""

import inspect
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, get_type_hints

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.core.errors import InputError, require_choice
from sweep.core.parameters import describe_bounds

type Scalar = Float[Array, "..."] | float


class NoSolution(InputError):
    """Raised if each input of a formula is in its domain, but the formula has no solution for them together."""


@dataclass(frozen=True)
class Input:
    """An input of a formula: a number, a vector of fixed size, or a choice among `options`.

    Modules create it in the annotation of an argument; `Formula.inputs` fills in that argument's name.
    """

    unit: str
    default: Any
    above: float = -math.inf
    at_least: float = -math.inf
    below: float = math.inf
    at_most: float = math.inf
    options: tuple[Any, ...] = ()
    name: str = ""

    def validate(self, value: Any, path: str) -> Any:
        """Convert a value to a float, an option or a list of floats.

        Args:
            value: What the user wrote.
            path: The formula's name, for the message.

        Raises:
            InputError: The value is of another kind or outside the domain; the message names `path.name`.
        """
        path = f"{path}.{self.name}"
        if self.options:
            if isinstance(value, bool) or value not in self.options:
                raise InputError(f"{path} = {value!r} is not allowed: one of {', '.join(map(str, self.options))}")
            return self.options[self.options.index(value)]
        if isinstance(self.default, tuple):
            size = len(self.default)
            if isinstance(value, str) or not isinstance(value, Sequence | np.ndarray) or len(value) != size:
                raise InputError(f"{path} = {value!r} is not allowed: a list of {size} numbers")
            return [self._number(element, f"{path}[{i}]") for i, element in enumerate(value)]
        return self._number(value, path)

    def _number(self, value: Any, path: str) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float | np.number):
            raise InputError(f"{path} = {value!r} is not allowed: a number")
        inside = self.above < value < self.below and self.at_least <= value <= self.at_most
        if not (math.isfinite(value) and inside):
            raise InputError(f"{path} = {value:g} is not allowed: {self.domain()}")
        return float(value)

    def domain(self) -> str:
        """Describe the allowed values in words, with the unit."""
        if self.options:
            return f"one of {', '.join(map(str, self.options))}"
        return f"{describe_bounds(vars(self))}{f' {self.unit}' if self.unit else ''}"


def positive_input(unit: str, default: float, below: float = math.inf) -> Input:
    """Make an input that must be greater than zero: a length, a mass, a duration."""
    return Input(unit, default, above=0, below=below)


@dataclass(frozen=True)
class Formula:
    """A formula with its source, inputs and outputs; the decorator `formula` makes it from a function."""

    function: Callable[..., Any]
    source: str  # "monograph" or "thesis"
    equations: tuple[str, ...]  # "2.1.4-2.1.6" is a range; a section where the text has no number
    correction: str = ""  # the error of the printed formula; empty where it is right
    condition: str = ""  # a condition on several inputs at once

    @property
    def name(self) -> str:
        """The function's name, which commands and studies use."""
        return self.function.__name__

    @property
    def summary(self) -> str:
        """The first line of the function's docstring, without the full stop and in lower case."""
        first = str(self.function.__doc__).splitlines()[0].removesuffix(".")
        return first[0].lower() + first[1:]

    @cached_property
    def _annotations(self) -> dict[str, Any]:
        return get_type_hints(inspect.unwrap(self.function), include_extras=True)

    @cached_property
    def _arguments(self) -> dict[str, Any]:
        return {name: hint for name, hint in self._annotations.items() if name != "return"}

    @cached_property
    def inputs(self) -> tuple[Input, ...]:
        """Inputs of the formula by name: field `a` of argument `prm` is `prm.a`, or `a` if `prm` is the only one."""
        result = []
        for name, hint in self._arguments.items():
            parts = {name: hint} if _metadata(hint) else get_type_hints(hint, include_extras=True)
            prefix = "" if _metadata(hint) or len(self._arguments) == 1 else f"{name}."
            result += [replace(_metadata(part)[0], name=prefix + field) for field, part in parts.items()]
        return tuple(result)

    @cached_property
    def outputs(self) -> Mapping[str, str]:
        """Units of the formula's results, by name of the result."""
        results = get_type_hints(self._annotations["return"], include_extras=True)
        return {name: _metadata(hint)[0] for name, hint in results.items()}

    @property
    def is_corrected(self) -> bool:
        """Whether the function corrects an error of the printed formula."""
        return bool(self.correction)

    @property
    def reference(self) -> str:
        """The source with its equation numbers."""
        return f"{self.source} {', '.join(f'({equations})' for equations in self.equations)}"

    @property
    def sort_key(self) -> tuple[str, tuple[int, ...]]:
        """Key that sorts formulas by source, then by the number of their first equation."""
        return self.source, _order(self.equations[0].partition("-")[0])

    @cached_property
    def _jitted(self) -> Callable[..., Any]:
        return jax.jit(self.function, static_argnames=[entry.name for entry in self.inputs if entry.options])

    def implements_equation(self, equation: str) -> bool:
        """Return whether the formula implements the equation with number `equation` of its source."""
        number = _order(equation)
        for equations in self.equations:
            first, _, last = equations.partition("-")
            if _order(first) <= number <= _order(last or first) and len(number) == len(_order(first)):
                return True
        return False

    def complete_inputs(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Validate the inputs of a formula and add defaults, by flat name such as `prm.a`. Raises `InputError`."""
        flat = dict(_flatten(values))
        names = [entry.name for entry in self.inputs]
        for name in flat:
            require_choice(name, names, f"{self.name}.{name}")
        return {entry.name: entry.validate(flat.get(entry.name, entry.default), self.name) for entry in self.inputs}

    def evaluate(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Evaluate the formula in double precision, and return plain numbers and lists. Raises `InputError`."""
        with jax.enable_x64(True):
            outputs = self.evaluate_to_arrays(values)
        if not all(np.all(np.isfinite(value)) for value in outputs.values()):
            given = ", ".join(f"{name} = {_short(value)}" for name, value in self.complete_inputs(values).items())
            raise NoSolution(f"{self.name} has no solution for {given}: {self.condition or 'a result overflows'}")
        return {name: value.tolist() for name, value in outputs.items()}

    def evaluate_to_arrays(self, values: Mapping[str, Any]) -> dict[str, np.ndarray]:
        """Evaluate the formula in JAX's default precision; NaN where there is no solution. Raises `InputError`."""
        inputs = self.complete_inputs(values)
        numbers = (inputs[each.name] if each.options else jnp.asarray(inputs[each.name]) for each in self.inputs)
        arguments = {
            name: next(numbers) if _metadata(hint) else hint(*(next(numbers) for _ in hint._fields))
            for name, hint in self._arguments.items()
        }
        return {name: np.asarray(value) for name, value in self._jitted(**arguments)._asdict().items()}


FORMULAS: dict[str, Formula] = {}


def formula[F: Callable[..., Any]](
    source: str, *equations: str, correction: str = "", condition: str = ""
) -> Callable[[F], F]:
    """Make the decorator that registers a function as a formula in `FORMULAS`.

    Args:
        source: "monograph" or "thesis".
        equations: Numbers of its equations; "2.1.4-2.1.6" is a range.
        correction: The error of the printed formula, if any.
        condition: A condition on several inputs at once, if any.
    """

    def register(function: F) -> F:
        FORMULAS[function.__name__] = Formula(function, source, equations, correction, condition)
        return function

    return register


def _metadata(hint: Any) -> tuple[Any, ...]:
    """Metadata of an `Annotated` hint; empty for a named tuple."""
    return getattr(hint, "__metadata__", ())


def _flatten(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{prefix}{name}.")
        else:
            yield prefix + str(name), value


def _order(equation: str) -> tuple[int, ...]:
    """Numbers to sort equations by: (2, 1, 4) of "2.1.4"."""
    return tuple(map(int, equation.split(".")))


def _short(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_short, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value)
