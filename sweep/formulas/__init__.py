"""The closed-form results of the sources, corrected: a library of JAX functions, and all of them by name."""

from sweep.formulas.formula import Formula, Input, NoSolution
from sweep.formulas.registry import FORMULAS, covering, evaluate, find

__all__ = ["FORMULAS", "Formula", "Input", "NoSolution", "covering", "evaluate", "find"]
