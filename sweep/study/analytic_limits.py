"""Closed forms that a study's maps are compared with: `study.theory` names a formula of `sweep.formulas` as a limit.

An input of the formula is a number or an expression of parameters, such as `drive.torque_limit / 77.4`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from sweep import formulas
from sweep.core.errors import InputError, require_choice
from sweep.core.expressions import evaluate
from sweep.study.distributions import require_keys

KEYS = ("label", "formula", "output", "of", "inputs", "measured")


@dataclass(frozen=True)
class AnalyticLimit:
    """`output` of `formula` as a limit of the parameter `of`, a path without its side, in that parameter's unit."""

    label: str
    formula: str
    output: str
    of: str
    inputs: Mapping[str, Any]
    measured: str  # figure to show beside; empty for none

    def compute(self, value_of: Callable[[str], Any]) -> float:
        """The limit where parameters have the values that `value_of` gives for their paths; nan where there is none.

        Raises `InputError`.
        """
        outputs = formulas.find(self.formula).compute(self.formula_inputs(value_of))
        return float(outputs[self.output])

    def formula_inputs(self, value_of: Callable[[str], Any]) -> dict[str, Any]:
        """The formula's inputs. Raises `InputError`."""
        given = {}
        for name, value in self.inputs.items():
            try:
                given[name] = float(evaluate(value, value_of)) if isinstance(value, str) else value
            except (SyntaxError, TypeError, ValueError) as error:
                reason = error if isinstance(error, InputError) else "a number or an expression of parameters"
                raise InputError(f"study.theory.inputs.{name} = {value!r} is not allowed: {reason}") from None
        return formulas.find(self.formula).complete(given)


def parse_limit(key: str, values: Any) -> AnalyticLimit:
    """From plain values. Raises `InputError`."""
    values = require_keys(key, values, KEYS)
    for needed in ("formula", "output", "of"):
        if needed not in values:
            raise InputError(f"{key}.{needed} is missing")
    formula = formulas.find(values["formula"])
    require_choice(values["output"], formula.outputs, f"{key}.output = {values['output']}")
    inputs = require_keys(f"{key}.inputs", values.get("inputs", {}), tuple(entry.name for entry in formula.inputs))
    return AnalyticLimit(
        values.get("label", formula.name),
        formula.name,
        values["output"],
        values["of"],
        inputs,
        values.get("measured", ""),
    )
