"""JAX's primitives as functions of `batch_ops`, with the primitive's static parameters bound."""

from collections.abc import Callable
from functools import partial
from itertools import accumulate
from typing import Any

import numpy as np

from sweep.fused import batch_ops as ops
from sweep.fused.arrays import EMPTY_REDUCTIONS, UnsupportedPrimitive
from sweep.fused.batch_ops import DotDimensions, TriangularSolveParameters, WindowIndexing
from sweep.fused.operations import COMPARISONS, REDUCTIONS
from sweep.fused.rules import out_of_bounds_value

UFUNCS: dict[str, np.ufunc] = {
    **COMPARISONS,
    **{name: getattr(np, name) for name in (
        "sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "exp2", "expm1", "log", "log1p", "sqrt", "cbrt", "square",
        "floor", "ceil", "sign", "nextafter")},
    "acos": np.arccos, "asin": np.arcsin, "atan": np.arctan, "atan2": np.arctan2, "acosh": np.arccosh,
    "asinh": np.arcsinh, "atanh": np.arctanh, "add": np.add, "add_any": np.add, "sub": np.subtract, "mul": np.multiply,
    "div": np.divide, "rem": np.fmod, "pow": np.power, "max": np.maximum, "min": np.minimum, "neg": np.negative,
    "abs": np.absolute, "round": np.rint, "is_finite": np.isfinite, "and": np.bitwise_and, "or": np.bitwise_or,
    "xor": np.bitwise_xor, "not": np.invert, "shift_left": np.left_shift, "shift_right_logical": np.right_shift,
    "shift_right_arithmetic": np.right_shift,
}  # fmt: skip

CUMULATIVE = {"cumsum": "add", "cumprod": "mul", "cummax": "max", "cummin": "min"}
FUNCTIONS: dict[str, Callable[..., Any]] = {
    **UFUNCS, "rsqrt": ops.rsqrt, "logistic": ops.logistic, "one_minus_square": ops.one_minus_square,
    "clamp": ops.clamp, "cholesky": ops.cholesky, "polynomial": ops.polynomial, "select_n": ops.select_n,
    "erf_inv": ops.erf_inv,
}  # fmt: skip


def _shape(atom: Any) -> tuple[int, ...]:
    return tuple(atom.aval.shape)


def _div(eqn: Any) -> Callable:
    whole = np.issubdtype(eqn.outvars[0].aval.dtype, np.integer)
    return ops.integer_quotient if whole else np.divide


def _round(eqn: Any) -> Callable:
    if int(eqn.params["rounding_method"]) != 1:
        raise UnsupportedPrimitive("round, with halves away from zero")
    return np.rint


def _shift_right_logical(eqn: Any) -> Callable:
    if np.issubdtype(eqn.outvars[0].aval.dtype, np.signedinteger):
        raise UnsupportedPrimitive("shift_right_logical of a number with a sign")
    return np.right_shift


def _reshape(eqn: Any) -> Callable:
    return partial(ops.reshape, len(_shape(eqn.invars[0])), _shape(eqn.outvars[0]))


def _broadcast_in_dim(eqn: Any) -> Callable:
    shape, places = tuple(eqn.params["shape"]), tuple(eqn.params["broadcast_dimensions"])
    if len(eqn.invars) > 1:
        raise UnsupportedPrimitive("broadcast_in_dim to a shape that is not known")
    if int(np.prod(shape)) == int(np.prod(_shape(eqn.invars[0]))):
        return _reshape(eqn)
    return partial(ops.broadcast_in_dim, places, shape)


def _slice(eqn: Any) -> Callable:
    first, last, strides = (eqn.params[name] for name in ("start_indices", "limit_indices", "strides"))
    return partial(ops.slice_window, tuple(map(slice, first, last, strides or (1,) * len(first))))


def _pad(eqn: Any) -> Callable:
    config, lengths = eqn.params["padding_config"], _shape(eqn.invars[0])
    if any(low < 0 or high < 0 for low, high, _ in config):
        raise UnsupportedPrimitive("pad by less than nothing")
    window = tuple(slice(low, low + (n - 1) * (inner + 1) + 1 if n else low, inner + 1)
                   for (low, _, inner), n in zip(config, lengths, strict=True))  # fmt: skip
    return partial(ops.pad, _shape(eqn.outvars[0]), window)


def _split(eqn: Any) -> Callable:
    return partial(ops.split, eqn.params["axis"], tuple(accumulate(eqn.params["sizes"]))[:-1])


def _iota(eqn: Any) -> Callable:
    return partial(ops.iota, _shape(eqn.outvars[0]), eqn.params["dimension"], eqn.outvars[0].aval.dtype)


def _reduction(eqn: Any) -> Callable:
    name, axes = REDUCTIONS[eqn.primitive.name], tuple(eqn.params["axes"])
    if not all(_shape(eqn.invars[0])):
        return partial(ops.fill_empty_reduction, _shape(eqn.outvars[0]), EMPTY_REDUCTIONS[name])
    return partial(ops.reduce_in_order if name in ("add", "mul") else ops.reduce_extreme, UFUNCS[name], axes)


def _argmax(argfunc: Callable) -> Callable:
    def rule(eqn: Any) -> Callable:
        (axis,) = eqn.params["axes"]
        return partial(ops.argextreme, argfunc, axis, eqn.outvars[0].aval.dtype)

    return rule


def _cumulative(eqn: Any) -> Callable:
    return partial(ops.accumulate, UFUNCS[CUMULATIVE[eqn.primitive.name]], eqn.params["axis"], eqn.params["reverse"])


def _dot_general(eqn: Any) -> Callable:
    (of_a, of_b), (batch_a, batch_b) = eqn.params["dimension_numbers"]
    free_a = [d for d in range(len(_shape(eqn.invars[0]))) if d not in (*of_a, *batch_a)]
    free_b = [d for d in range(len(_shape(eqn.invars[1]))) if d not in (*of_b, *batch_b)]
    left, right = (*of_a, *batch_a, *free_a), (*of_b, *batch_b, *free_b)
    free = len(free_a), len(free_b)
    return partial(
        ops.dot_general, DotDimensions(left, right, len(of_a), len(batch_a), free, eqn.outvars[0].aval.dtype)
    )


def _gather(eqn: Any) -> Callable:
    dims, out = eqn.params["dimension_numbers"], eqn.outvars[0].aval
    inside = [d for d in range(len(_shape(eqn.invars[0])))
              if d not in (*dims.collapsed_slice_dims, *dims.operand_batching_dims)]  # fmt: skip
    places = WindowIndexing(
        _shape(eqn.invars[0]),
        tuple(eqn.params["slice_sizes"]),
        tuple(zip(dims.start_index_map, range(len(dims.start_index_map)), strict=True)),
        tuple(zip(dims.operand_batching_dims, dims.start_indices_batching_dims, strict=True)),
        tuple(zip(inside, dims.offset_dims, strict=True)),
        tuple(d for d in range(len(out.shape)) if d not in dims.offset_dims),
        len(out.shape),
    )
    fill = None
    if "FILL" in str(eqn.params["mode"]):
        fill = eqn.params["fill_value"]
        fill = out_of_bounds_value(out.dtype) if fill is None else fill
    return partial(ops.gather, places, fill)


def _scatter(add: np.ufunc | None) -> Callable:
    def rule(eqn: Any) -> Callable:
        dims, updates = eqn.params["dimension_numbers"], _shape(eqn.invars[2])
        taken = (*dims.inserted_window_dims, *dims.operand_batching_dims)
        windows = [d for d in range(len(_shape(eqn.invars[0]))) if d not in taken]
        sizes = [1] * len(_shape(eqn.invars[0]))
        for d, through in zip(windows, dims.update_window_dims, strict=True):
            sizes[d] = updates[through]
        over = dims.scatter_dims_to_operand_dims
        places = WindowIndexing(
            _shape(eqn.invars[0]),
            tuple(sizes),
            tuple(zip(over, range(len(over)), strict=True)),
            tuple(zip(dims.operand_batching_dims, dims.scatter_indices_batching_dims, strict=True)),
            tuple(zip(windows, dims.update_window_dims, strict=True)),
            tuple(d for d in range(len(updates)) if d not in dims.update_window_dims),
            len(updates),
        )
        return partial(ops.scatter, add, places, "CLIP" in str(eqn.params["mode"]))

    return rule


def _triangular_solve(eqn: Any) -> Callable:
    left, lower, transposed, unit = (
        bool(eqn.params[name]) for name in ("left_side", "lower", "transpose_a", "unit_diagonal")
    )
    return partial(ops.solve_triangular, TriangularSolveParameters(left, lower, transposed, unit))


def _platform_index(eqn: Any) -> Callable:
    if None not in eqn.params["platforms"]:
        raise UnsupportedPrimitive("what is for some platforms alone")
    return partial(ops.full, eqn.params["platforms"].index(None), eqn.outvars[0].aval.dtype)


RULES: dict[str, Callable[[Any], Callable[..., Any]]] = {
    "div": _div,
    "round": _round,
    "shift_right_logical": _shift_right_logical,
    "convert_element_type": lambda eqn: partial(ops.convert_dtype, eqn.outvars[0].aval.dtype),
    "bitcast_convert_type": lambda eqn: partial(ops.reinterpret_bits, eqn.outvars[0].aval.dtype),
    "integer_pow": lambda eqn: partial(ops.integer_power, eqn.params["y"]),
    "broadcast_in_dim": _broadcast_in_dim,
    **dict.fromkeys(("reshape", "squeeze", "expand_dims"), _reshape),
    "tile": lambda eqn: partial(ops.tile, tuple(eqn.params["reps"])),
    "transpose": lambda eqn: partial(ops.transpose, tuple(eqn.params["permutation"])),
    "rev": lambda eqn: partial(ops.flip, tuple(eqn.params["dimensions"])),
    "slice": _slice,
    "pad": _pad,
    "concatenate": lambda eqn: partial(ops.concatenate, eqn.params["dimension"]),
    "stack": lambda eqn: partial(ops.stack, eqn.params["axis"]),
    "unstack": lambda eqn: partial(ops.unstack, eqn.params["axis"]),
    "split": _split,
    "iota": _iota,
    **dict.fromkeys(REDUCTIONS, _reduction),
    **dict.fromkeys(CUMULATIVE, _cumulative),
    "argmax": _argmax(np.argmax),
    "argmin": _argmax(np.argmin),
    "dot_general": _dot_general,
    "dynamic_slice": lambda eqn: partial(ops.dynamic_slice, tuple(eqn.params["slice_sizes"])),
    "dynamic_update_slice": lambda _: ops.dynamic_update_slice,
    "gather": _gather,
    "scatter": _scatter(None),
    "scatter-add": _scatter(np.add),
    "triangular_solve": _triangular_solve,
    "platform_index": _platform_index,
}
