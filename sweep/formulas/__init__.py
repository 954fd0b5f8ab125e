"""Closed-form results of the sources, corrected: JAX functions, and a table of them by name.

Importing a module registers its formulas, so each module of this package is imported here.
"""

from collections.abc import Mapping
from typing import Any

from sweep.core.errors import require_choice
from sweep.formulas import (  # noqa: F401  their import registers formulas
    ball,
    ball_meeting,
    ball_reach,
    corner,
    crossing,
    drag,
    drive,
    kinematics,
    ladder,
    mass_centre,
    raft_drift,
    raft_dynamics,
    raft_statics,
    thesis,
)
from sweep.formulas import formula as defined
from sweep.formulas.formula import Formula, Input, NoSolution

__all__ = ["FORMULAS", "Formula", "Input", "NoSolution", "evaluate", "find_by_equation", "find_formula"]

# in the order of their sources
FORMULAS: Mapping[str, Formula] = dict(sorted(defined.FORMULAS.items(), key=lambda item: item[1].sort_key))


def find_formula(name: str) -> Formula:
    """Look up a formula by its name; an unknown name raises `InputError` with the known ones."""
    require_choice(name, FORMULAS, f"formula {name}")
    return FORMULAS[name]


def evaluate(name: str, inputs: Mapping[str, Any]) -> dict[str, Any]:
    """Evaluate a formula in double precision, whatever JAX's default precision is.

    Args:
        name: The formula's name, as in `sweep formula`.
        inputs: Values by input name, in the inputs' units; inputs that are missing take their defaults.

    Returns:
        Outputs by name, as plain numbers and lists, in the units of `Formula.outputs`.

    Raises:
        InputError: An unknown name, an input outside its domain, or, as `NoSolution`, inputs that have no solution.
    """
    return find_formula(name).evaluate(inputs)


def find_by_equation(equation: str) -> list[Formula]:
    """List the formulas that implement an equation ("2.1.6" of the monograph, "14" of the thesis)."""
    return [formula for formula in FORMULAS.values() if formula.implements_equation(equation)]
