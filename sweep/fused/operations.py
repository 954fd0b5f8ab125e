"""Constant folding and simplification of operations on numbers."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from sweep.fused.program import Node, constant_value

COMPARISONS = {"eq": np.equal, "ne": np.not_equal, "lt": np.less, "le": np.less_equal, "gt": np.greater,
               "ge": np.greater_equal}  # fmt: skip
NUMPY_FUNCTIONS: dict[str, Callable] = {
    **COMPARISONS,
    **{name: getattr(np, name) for name in ("sin", "cos", "tan", "exp", "log", "sqrt", "floor", "ceil", "log1p")},
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "max": np.maximum, "min": np.minimum,
    "neg": np.negative, "abs": np.abs, "round": np.rint,
    "is_finite": np.isfinite, "select": np.where, "pow": np.power,
    "acos": np.arccos, "asin": np.arcsin, "atan": np.arctan, "atan2": np.arctan2,
    "xor": np.bitwise_xor, "and": np.bitwise_and, "or": np.bitwise_or, "shift_left": np.left_shift,
    "shift_right_logical": np.right_shift, "shift_right_arithmetic": np.right_shift,
}  # fmt: skip
REDUCTIONS = {"reduce_sum": "add", "reduce_max": "max", "reduce_min": "min", "reduce_and": "and", "reduce_or": "or",
              "reduce_prod": "mul"}  # fmt: skip


def fold_constants(name: str, dtype: str, values: Sequence[Any]) -> Any:
    """Return the result of an operation whose operands are constants.

    Args:
        name: operation, by JAX's name.
        dtype: type of the result.
        values: the constants.
    """
    with np.errstate(all="ignore"):
        match name:
            case "convert":
                result = np.asarray(values[0]).astype(dtype)
            case "not":
                result = np.logical_not(values[0]) if dtype == "bool" else np.invert(values[0])
            case "bitcast_convert_type":
                result = np.asarray(values[0]).view(dtype)
            case "div":
                whole = np.issubdtype(dtype, np.integer)
                result = np.trunc(np.divide(*values)) if whole else np.divide(*values)
            case "rem":
                result = np.fmod(*values)
            case _:
                result = NUMPY_FUNCTIONS[name](*values)
    return np.asarray(result, dtype)


def simplify_to_operand(name: str, args: Sequence[Node]) -> Node | None:
    """Return an operand that equals the operation's result bit for bit (except the sign of zero); None if there is
    none.

    Args:
        name: operation, by JAX's name.
        args: its operands.
    """
    known = [_uniform_constant(x) for x in args]
    match name, known:
        case ("add", [_, value]) | ("sub", [_, value]) if value == 0 and value is not None:
            return args[0]
        case "add", [value, _] if value == 0 and value is not None:
            return args[1]
        case ("mul", [_, value]) | ("div", [_, value]) if value == 1 and value is not None:
            return args[0]
        case "mul", [value, _] if value == 1 and value is not None:
            return args[1]
        case "mul", [_, value] if value == 0 and value is not None and _finite(args[0]):
            return args[1]
        case "mul", [value, _] if value == 0 and value is not None and _finite(args[1]):
            return args[0]
        case ("and" | "or" | "max" | "min", _) if args[0] is args[1]:
            return args[0]
        case "and", [value, _] if isinstance(value, np.bool_):
            return args[1] if value else args[0]
        case "and", [_, value] if isinstance(value, np.bool_):
            return args[0] if value else args[1]
        case "or", [value, _] if isinstance(value, np.bool_):
            return args[0] if value else args[1]
        case "or", [_, value] if isinstance(value, np.bool_):
            return args[1] if value else args[0]
        case "select", [_, _, _] if args[1] is args[2]:
            return args[1]
        case "select", [value, _, _] if isinstance(value, np.bool_):
            return args[1] if value else args[2]
        case _:
            return None


def _finite(node: Node) -> bool:
    """Whether a number is obviously neither infinite nor NaN for any rollout."""
    if not np.issubdtype(node.dtype, np.floating):
        return True
    match node.op:
        case "const":
            return bool(np.all(np.isfinite(constant_value(node))))
        case "convert":
            return not np.issubdtype(node.args[0].dtype, np.floating)
        case "select":
            return _finite(node.args[1]) and _finite(node.args[2])
        case _:
            return False


def _uniform_constant(node: Node) -> Any:
    """Value of a constant that is the same for all legs, else None."""
    return constant_value(node) if node.op == "const" and not node.leg else None
