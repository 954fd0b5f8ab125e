"""Plain values for JSON."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np


def to_json_value(value: Any) -> Any:
    """Convert a value to what JSON can hold: NumPy to Python, non-finite numbers to None, keys to text."""
    match value:
        case Mapping():
            return {str(key): to_json_value(one) for key, one in value.items()}
        case np.ndarray() | np.generic():
            return to_json_value(value.tolist())
        case list() | tuple():
            return [to_json_value(item) for item in value]
        case float():
            return value if math.isfinite(value) else None
        case None | bool() | int() | str():
            return value
        case _:
            return str(value)
