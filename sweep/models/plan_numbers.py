"""The numbers of a plan as parameters of a case: the content of its plan file, and changed numbers by path.

`sweep/planning/plan_table.py` reads and evaluates them.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
from jaxtyping import Array

INCREMENT_PREFIX = "+"  # before a path: by how much the number there is more than what its formula says


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class PlanTable:
    """The numbers of a plan: the content of the plan file, and the numbers that a configuration changes, by path.

    The configuration makes it; axes and tuning change it. JAX traces only the changed numbers.
    """

    text: str = dataclasses.field(default="", metadata={"static": True})  # JSON; empty: as the manoeuvre's own file
    paths: tuple[str, ...] = dataclasses.field(default=(), metadata={"static": True})  # of numbers that are changed
    values: tuple[Array | float, ...] = ()

    def replace_number(self, path: str, value: Any, formulas: Mapping[str, float] | None = None) -> "PlanTable":
        """Return a copy of the plan's numbers in which the one at `path` has another value.

        Args:
            path: The number's path without `plan.`.
            value: Its new value.
            formulas: Values of formulas by path; one of these numbers is raised to `value` and keeps its formula.
        """
        if formulas and path in formulas:
            path, value = INCREMENT_PREFIX + path, value - formulas[path]
        changes = self.changed_numbers | {path: value}
        return dataclasses.replace(self, paths=tuple(changes), values=tuple(changes.values()))

    def increment_number(self, path: str, increment: Any) -> "PlanTable":
        """Return a copy of the plan's numbers with `increment` added to the one at `path`, on top of earlier ones."""
        return self.replace_number(
            INCREMENT_PREFIX + path, self.changed_numbers.get(INCREMENT_PREFIX + path, 0.0) + increment
        )

    @property
    def changed_numbers(self) -> dict[str, Any]:
        """Changed numbers of the plan, by path."""
        return dict(zip(self.paths, self.values, strict=True))
