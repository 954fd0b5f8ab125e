"""Lazy import of `eager.evaluate_constant_function`, so that wrong input is reported before slow imports."""

from collections.abc import Callable
from typing import Any


def evaluate_with_numpy(function: Callable[[], Any]) -> Any:
    """Evaluate a JAX function of plain numbers with NumPy, without compiling it."""
    from sweep.fused import eager

    return eager.evaluate_constant_function(function)
