"""The closed-form results of the sources, corrected: a library of JAX functions, and all of them by name.

A module that defines some is named here, and nowhere else.
"""

from collections.abc import Mapping
from typing import Any

from sweep.core.errors import known
from sweep.formulas import (  # noqa: F401  whose formulas are put among them as they are read
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

__all__ = ["FORMULAS", "Formula", "Input", "NoSolution", "covering", "evaluate", "find"]

# in the order of their sources
FORMULAS: Mapping[str, Formula] = dict(sorted(defined.FORMULAS.items(), key=lambda item: item[1].place))


def find(name: str) -> Formula:
    """The formula called `name`; raises `InputError` with what is allowed."""
    known(name, FORMULAS, f"formula {name}")
    return FORMULAS[name]


def evaluate(name: str, inputs: Mapping[str, Any]) -> dict[str, Any]:
    """Outputs of formula `name` as plain numbers and lists; inputs left out take their defaults.

    In double precision, whatever JAX's default is. Raises `InputError`: an unknown name, an input outside its
    domain, or inputs for which the formula has no solution (`NoSolution`).
    """
    return find(name).evaluate(inputs)


def covering(equation: str) -> list[Formula]:
    """Formulas that hold equation `equation` ("2.1.6" of the monograph, "14" of the thesis)."""
    return [formula for formula in FORMULAS.values() if formula.covers(equation)]
