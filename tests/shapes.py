"""A plugin of pytest that checks shapes which annotations promise, where functions are called and traced.

    PYTHONPATH=tests pytest -p shapes tests/models

All other types are pyright's: a parameter that is a number to a user is traced where it is swept.
"""

import inspect
from collections.abc import Callable
from typing import Any, get_args

from beartype import beartype
from jaxtyping import AbstractArray, install_import_hook

ROOMS = "formulas", "models", "dynamics", "controllers", "planning", "manoeuvres", "estimation"


def checked[F: Callable](function: F) -> F:
    """`function`, which refuses arrays of other kinds and shapes than it is annotated with.

    Not what makes a dataclass: a batch of plans has an axis more.
    """
    if function.__name__ == "__init__":
        return function
    hints = inspect.get_annotations(function)
    function.__annotations__ = {name: hint if _of_shape(hint) else Any for name, hint in hints.items()}
    return beartype(function)


def _of_shape(hint: Any) -> bool:
    """Whether it says anything of an array's shape."""
    return any(map(_of_shape, get_args(hint))) or (isinstance(hint, type) and issubclass(hint, AbstractArray))


install_import_hook([f"sweep.{room}" for room in ROOMS], "shapes.checked")
