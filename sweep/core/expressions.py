"""Row conditions such as `friction > 0.8 and engine.name == "mjx"`, and formulas, evaluated without executing Python
code."""

import ast
import operator
import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from sweep.core.errors import InputError, format_nearest_names

if TYPE_CHECKING:
    import pandas as pd

AXIS_NAMES_KEY = "axes"  # key of `DataFrame.attrs`: columns by the names that the study gives to its axes
MAX_CHARACTERS = 5000  # characters of an expression
QUOTE_HINT = ' (a word is written in quotes: "{}")'
_COMPARE: dict[type, Callable[[Any, Any], Any]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: lambda a, b: _close(a, b),
    ast.NotEq: lambda a, b: ~_close(a, b),
    ast.In: lambda a, b: np.any([_close(a, one) for one in b], axis=0),
    ast.NotIn: lambda a, b: ~np.any([_close(a, one) for one in b], axis=0),
}
_ARITHMETIC: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.BitAnd: operator.and_,
    ast.BitOr: operator.or_,
}
_FUNCTIONS = {"sqrt": "sqrt", "sin": "sin", "cos": "cos", "tan": "tan", "asin": "arcsin", "acos": "arccos",
              "rad": "radians", "deg": "degrees"}  # fmt: skip
_OF_TWO = {"max": "maximum", "min": "minimum"}
_UNARY: dict[type, Callable[[Any], Any]] = {
    ast.Not: operator.invert,
    ast.Invert: operator.invert,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}


def condition_mask(frame: "pd.DataFrame", condition: str | None) -> np.ndarray:
    """Return the mask of the table rows that meet a condition.

    Args:
        frame: Rows of a study.
        condition: Such as `friction > 0.8`; all rows meet None or an empty one. Columns are named in full, or by an
            unambiguous end of their dotted name.

    Returns:
        A Boolean (n,) for the n rows.

    Raises:
        InputError: The text is no condition, or names no column.
    """
    if not condition:
        return np.ones(len(frame), dtype=bool)
    found = evaluate_condition(
        condition,
        lambda name: frame[find_column(frame, name, QUOTE_HINT.format(name))].to_numpy(),
        *_message_parts(condition),
    )
    return np.broadcast_to(found, (len(frame),))


def condition_columns(frame: "pd.DataFrame", condition: str | None) -> list[str]:
    """Return the names of the table columns that a condition uses.

    Args:
        frame: A table with the columns of a study's rows; it may be empty.
        condition: See `condition_mask`.

    Raises:
        InputError: The text is no condition, or names no column.
    """
    empty, used = frame.iloc[:0].astype(object), dict[str, None]()

    def look_up(name: str) -> np.ndarray:
        used[found := find_column(frame, name, QUOTE_HINT.format(name))] = None
        return empty[found].to_numpy()

    if condition:
        evaluate_condition(condition, look_up, *_message_parts(condition))
    return [*used]


def _message_parts(condition: str) -> tuple[str, str]:
    """How messages name a condition on rows, and an example of one."""
    shown = repr(condition) if len(condition) < 200 else f"{condition[:200]!r}..."
    return f"where = {shown}", "'friction > 0.8 and replicate == 0'"


def evaluate_condition(condition: str, look_up: Callable[[str], Any], label: str, example: str) -> np.ndarray:
    """Evaluate a condition such as `tilt_max_deg > 60` on values that `look_up` returns by name.

    Args:
        condition: The text.
        look_up: Returns the values of a dotted name.
        label: How messages name the condition, such as `where = 'x > 1'`.
        example: An example of a condition, for messages.

    Returns:
        Booleans of the shape of the values.

    Raises:
        InputError: The text is no condition, or compares words with numbers.
    """
    try:
        found = np.asarray(evaluate_expression(condition, look_up))
        if found.dtype != bool:
            raise SyntaxError
        return found
    except SyntaxError:
        equals = " (equality is written ==)" if re.search(r"(?<![=<>!])=(?!=)", condition) else ""
        raise InputError(f"{label} is not a condition{equals}, such as {example}") from None
    except InputError as error:
        raise InputError(f"{label.partition(' = ')[0]}: {error}") from None
    except (TypeError, ValueError):
        raise InputError(f"{label} cannot be computed: it mixes words and numbers") from None


def evaluate_expression(
    expression: str, look_up: Callable[[str], Any], maths: Callable[[Any], Any] = lambda x: np
) -> Any:
    """Evaluate an expression of names, numbers, operators and a few functions.

    Args:
        expression: The text, which is parsed and never executed as Python.
        look_up: Returns the value of a dotted name.
        maths: Returns the module, such as NumPy, whose functions apply to a value.

    Returns:
        The value, of the type that `look_up` returns.

    Raises:
        SyntaxError: The text is no expression.
        InputError: The expression contains something that is not allowed, or has no value.
    """
    if len(expression) > MAX_CHARACTERS:
        raise InputError(f"an expression of {len(expression)} characters is not allowed: at most {MAX_CHARACTERS}")
    try:
        with np.errstate(all="ignore"):
            return _value(ast.parse(expression, mode="eval").body, look_up, maths)
    except (RecursionError, MemoryError):
        raise InputError(f"{expression[:20]!r}... is not allowed: nested too deeply") from None
    except ArithmeticError as error:
        raise InputError(f"{expression[:200]!r} has no value: {error}") from None


def find_column(frame: "pd.DataFrame", name: str, hint: str = "") -> str:
    """Find the column that a user means by a name.

    Args:
        frame: Rows of a study; `frame.attrs[AXES]` maps the names of its axes to columns, where they are known.
        name: A column, the name of an axis, or the last part of a dotted column.
        hint: Text for the message where no column is found.

    Returns:
        The name of the column.

    Raises:
        InputError: No column, or several columns match.
    """
    if name in frame.columns:
        return name
    found = [c for c in frame.columns if c.endswith(f".{name}")]
    if (axis := frame.attrs.get(AXIS_NAMES_KEY, {}).get(name)) in frame.columns:
        if axis in found or not found:  # such as `axis.radius` beside the `robot.radius` that is made from it
            return axis
        found.append(axis)
    if len(found) > 1:
        raise InputError(f"column {name} is ambiguous (allowed: {', '.join(found)})")
    if not found:
        axes = frame.attrs.get(AXIS_NAMES_KEY, {})
        names = [*axes, *(c for c in frame.columns if c not in axes.values())]
        raise InputError(f"column {name} is unknown{hint}{format_nearest_names(name, names)}")
    return found[0]


def _value(node: ast.expr, look_up: Callable[[str], Any], maths: Callable[[Any], Any]) -> Any:
    def value(node: ast.expr) -> Any:
        return _value(node, look_up, maths)

    match node:
        case ast.Constant(value=constant):
            return constant
        case ast.Name() | ast.Attribute():
            return look_up(ast.unparse(node))
        case ast.List(elts=items) | ast.Tuple(elts=items):
            return [value(item) for item in items]
        case ast.UnaryOp(op=op, operand=operand) if type(op) in _UNARY:
            return _UNARY[type(op)](value(operand))
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _ARITHMETIC:
            return _ARITHMETIC[type(op)](_number(value(left)), _number(value(right)))
        case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]) if name in _FUNCTIONS:
            x = value(argument)
            return getattr(maths(x), _FUNCTIONS[name])(x)
        case ast.Call(func=ast.Name(id=name), args=[one, other], keywords=[]) if name in _OF_TWO:
            x, y = value(one), value(other)
            return getattr(maths(x + y), _OF_TWO[name])(x, y)
        case ast.BoolOp(op=op, values=values):
            combine = np.logical_and if isinstance(op, ast.And) else np.logical_or
            return combine.reduce([value(v) for v in values])
        case ast.Compare(left=left, ops=ops, comparators=others) if all(type(op) in _COMPARE for op in ops):
            values = [value(v) for v in (left, *others)]
            pairs = zip(ops, values[:-1], values[1:], strict=True)
            return np.logical_and.reduce([_COMPARE[type(op)](a, b) for op, a, b in pairs])
        case _:
            raise InputError(
                f"{ast.unparse(node)!r} is not allowed: names, numbers, + - * /, comparisons, and/or/not, sqrt()"
            )


def _number(value: Any) -> Any:
    """Return a number or array unchanged; refuse lists and words, which Python would repeat when multiplied."""
    if isinstance(value, list | str | bytes):
        raise TypeError("words and lists cannot be computed with")
    return value


def _close(a: Any, b: Any) -> Any:
    """Compare for equality; numbers up to rounding, so that `0.3` matches a grid's 0.30000000000000004."""
    if all(np.issubdtype(np.asarray(v).dtype, np.number) for v in (a, b)):
        return np.isclose(np.asarray(a, dtype=float), np.asarray(b, dtype=float), rtol=1e-9, atol=1e-12)
    return np.asarray(a == b)
