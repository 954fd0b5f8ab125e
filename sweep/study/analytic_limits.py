"""Analytic limits of a study's parameters: `study.theory` names a formula of `sweep.formulas` for each.

An input of the formula is a number or an expression of parameters, such as `drive.torque_limit / 77.4`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from sweep.core.errors import InputError, require_choice
from sweep.core.expressions import evaluate_expression
from sweep.study.distributions import require_known_keys
from sweep.systems import find_formula

LIMIT_KEYS = ("label", "formula", "output", "of", "inputs", "measured")


@dataclass(frozen=True)
class AnalyticParameterLimit:
    """A limit that a formula predicts for one parameter of a study, in the unit of that parameter.

    `of` is the path of the parameter without its side.
    """

    label: str
    formula: str
    output: str
    of: str
    inputs: Mapping[str, Any]
    measured: str  # figure to show beside; empty for none

    def compute(self, value_of: Callable[[str], Any]) -> float:
        """Compute the limit that the formula predicts for its parameter, at given parameter values.

        Args:
            value_of: Returns the value of a parameter path.

        Returns:
            The limit in the unit of the parameter `of`; NaN where the formula has none.

        Raises:
            InputError: An input is not allowed.
        """
        outputs = find_formula(self.formula).evaluate_to_arrays(self.formula_inputs(value_of))
        return float(outputs[self.output])

    def formula_inputs(self, value_of: Callable[[str], Any]) -> dict[str, Any]:
        """Return the inputs of the formula at given parameter values.

        Args:
            value_of: Returns the value of a parameter path.

        Returns:
            Inputs by name; those that are not given have their default.

        Raises:
            InputError: An input is not allowed.
        """
        given = {}
        for name, value in self.inputs.items():
            try:
                given[name] = float(evaluate_expression(value, value_of)) if isinstance(value, str) else value
            except (SyntaxError, TypeError, ValueError) as error:
                reason = error if isinstance(error, InputError) else "a number or an expression of parameters"
                raise InputError(f"study.theory.inputs.{name} = {value!r} is not allowed: {reason}") from None
        return find_formula(self.formula).complete_inputs(given)


def parse_limit(key: str, values: Any) -> AnalyticParameterLimit:
    """Parse one entry of the setting `study.theory`: a formula that predicts the limit of a parameter.

    Args:
        key: Path of the entry, for messages.
        values: Its plain keys and values.

    Returns:
        The limit.

    Raises:
        InputError: A key is missing or unknown, or the formula has no such output or input.
    """
    values = require_known_keys(key, values, LIMIT_KEYS)
    for needed in ("formula", "output", "of"):
        if needed not in values:
            raise InputError(f"{key}.{needed} is missing")
    formula = find_formula(values["formula"])
    require_choice(values["output"], formula.outputs, f"{key}.output = {values['output']}")
    inputs = require_known_keys(
        f"{key}.inputs", values.get("inputs", {}), tuple(entry.name for entry in formula.inputs)
    )
    return AnalyticParameterLimit(
        values.get("label", formula.name),
        formula.name,
        values["output"],
        values["of"],
        inputs,
        values.get("measured", ""),
    )
