"""Rules by which the fused compiler translates JAX's primitives, except elementwise operations.

A rule is a function of the program's arrays, the operands and the primitive's parameters.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from sweep.fused import randomness
from sweep.fused.arrays import Array, ArrayBuilder, UnsupportedPrimitive, slices_along_axis, stack


def _convert(self: ArrayBuilder, x: Array, out: Any, **_: Any) -> Array:
    return x if not x.size or x.flat[0].dtype == out.dtype.name else self.map_elements("convert", [x], out.dtype.name)


def _integer_pow(self: ArrayBuilder, x: Array, out: Any, y: int, **_: Any) -> Array:
    dtype = out.dtype.name
    if y == 0:
        return np.broadcast_to(self.constant(np.ones((), dtype)), x.shape)
    result: Any = None
    power = x
    for bit in bin(abs(y))[:1:-1]:
        if bit == "1":
            result = power if result is None else self.map_elements("mul", [result, power], dtype)
        power = self.map_elements("mul", [power, power], dtype)
    return result if y > 0 else self.map_elements("div", [self.constant(np.ones((), dtype)), result], dtype)


def _clamp(self: ArrayBuilder, low: Array, x: Array, high: Array, out: Any, **_: Any) -> Array:
    return self.map_elements("min", [self.map_elements("max", [x, low], out.dtype.name), high], out.dtype.name)


def _polynomial(self: ArrayBuilder, x: Array, *coefficients: Array, out: Any, **_: Any) -> Array:
    total = np.broadcast_to(coefficients[-1], x.shape)
    for c in reversed(coefficients[:-1]):
        total = self.map_elements("add", [self.map_elements("mul", [total, x], out.dtype.name), c], out.dtype.name)
    return total


def _broadcast_in_dim(
    self: ArrayBuilder, x: Array, *_: Any, out: Any, shape: tuple, broadcast_dimensions: tuple, **__: Any
) -> Array:
    index = [1] * len(shape)
    for d, n in zip(broadcast_dimensions, x.shape, strict=True):
        index[d] = n
    return np.broadcast_to(x.reshape(index), shape)


def _slice(
    self: ArrayBuilder, x: Array, out: Any, start_indices: tuple, limit_indices: tuple, strides: tuple | None
) -> Array:
    steps = strides or (1,) * x.ndim
    return x[tuple(map(slice, start_indices, limit_indices, steps))]


def _pad(self: ArrayBuilder, x: Array, value: Array, out: Any, padding_config: tuple) -> Array:
    if any(low < 0 or high < 0 for low, high, _ in padding_config):
        raise UnsupportedPrimitive("pad by less than nothing")
    result = np.full(out.shape, value[()], object)
    result[tuple(slice(low, low + (n - 1) * (inner + 1) + 1 if n else low, inner + 1)
                 for (low, _, inner), n in zip(padding_config, x.shape, strict=True))] = x  # fmt: skip
    return result


def _iota(self: ArrayBuilder, *_: Any, out: Any, dimension: int, **__: Any) -> Array:
    return self.constant(np.moveaxis(np.broadcast_to(
        np.arange(out.shape[dimension], dtype=out.dtype), (*np.delete(out.shape, dimension), out.shape[dimension])
    ), -1, dimension))  # fmt: skip


def _dot_general(self: ArrayBuilder, a: Array, b: Array, out: Any, dimension_numbers: tuple, **_: Any) -> Array:
    (of_a, of_b), (batch_a, batch_b) = dimension_numbers
    free_a = [d for d in range(a.ndim) if d not in (*of_a, *batch_a)]
    free_b = [d for d in range(b.ndim) if d not in (*of_b, *batch_b)]
    a = np.transpose(a, (*batch_a, *free_a, *of_a))
    b = np.transpose(b, (*batch_b, *free_b, *of_b))
    n, m = len(batch_a), len(of_a)
    a = a.reshape((*a.shape[: n + len(free_a)], *[1] * len(free_b), *a.shape[a.ndim - m :]))
    b = b.reshape((*b.shape[:n], *[1] * len(free_a), *b.shape[n:]))
    products = self.map_elements("mul", [a, b], out.dtype.name)
    return self.reduce("add", products, tuple(range(products.ndim - m, products.ndim)), out.dtype)


def _argmax(better: str) -> Callable:
    def rule(self: ArrayBuilder, x: Array, out: Any, axes: tuple, **_: Any) -> Array:
        (axis,) = axes
        rows = slices_along_axis(x, axis)
        best, index = rows[0], np.broadcast_to(self.constant(np.zeros((), out.dtype)), rows[0].shape)
        for k in range(1, len(rows)):
            if x.flat[0].dtype == "bool":
                here = self.map_elements("and", [rows[k], self.map_elements("not", [best], "bool")], "bool")
            else:  # the first NaN wins
                nan = self.map_elements(
                    "and",
                    [
                        self.map_elements("ne", [rows[k], rows[k]], "bool"),
                        self.map_elements("eq", [best, best], "bool"),
                    ],
                    "bool",
                )
                here = self.map_elements("or", [self.map_elements(better, [rows[k], best], "bool"), nan], "bool")
            best = self.map_elements("select", [here, rows[k], best], x.flat[0].dtype)
            index = self.map_elements("select", [here, self.constant(np.asarray(k, out.dtype)), index], out.dtype.name)
        return index

    return rule


def _cumulative(name: str) -> Callable:
    def rule(self: ArrayBuilder, x: Array, out: Any, axis: int, reverse: bool) -> Array:
        rows = slices_along_axis(x, axis)
        rows = rows[::-1] if reverse else rows
        for k in range(1, len(rows)):
            rows[k] = self.map_elements(name, [rows[k - 1], rows[k]], out.dtype.name)
        return np.moveaxis(stack(rows[::-1] if reverse else rows), 0, axis)

    return rule


def _dynamic_slice(self: ArrayBuilder, x: Array, *starts: Array, out: Any, slice_sizes: tuple) -> Array:
    return self.read_window(x, [s[()] for s in starts], slice_sizes)


def _dynamic_update_slice(self: ArrayBuilder, x: Array, update: Array, *starts: Array, out: Any) -> Array:
    within = [self.clamp_index(s[()], n - m) for s, n, m in zip(starts, x.shape, update.shape, strict=True)]
    return self.update_window(x, update, dict(enumerate(within)))


def _gather(
    self: ArrayBuilder,
    x: Array,
    indices: Array,
    out: Any,
    dimension_numbers: Any,
    slice_sizes: tuple,
    mode: Any,
    fill_value: Any = None,
    **_: Any,
) -> Array:
    dims = dimension_numbers
    batch = [d for d in range(len(out.shape)) if d not in dims.offset_dims]
    kept = [d for d in range(x.ndim) if d not in (*dims.collapsed_slice_dims, *dims.operand_batching_dims)]
    result = np.empty(out.shape, object)
    for at in np.ndindex(*[out.shape[d] for d in batch]):
        starts = [self.program.constant_node(0, "int32")] * x.ndim
        for k, d in enumerate(dims.start_index_map):
            starts[d] = indices[(*at, k)]
        for d, i in zip(dims.operand_batching_dims, dims.start_indices_batching_dims, strict=True):
            starts[d] = self.program.constant_node(at[i], "int32")
        found = self.read_window(x, starts, slice_sizes)
        if "FILL" in str(mode):
            inside = self.program.constant_node(True, "bool")
            for s, n, size in zip(starts, x.shape, slice_sizes, strict=True):
                for test, edge in (("ge", 0), ("le", n - size)):
                    ok = self.emit(test, "bool", s, self.program.constant_node(edge, s.dtype))
                    inside = self.emit("and", "bool", inside, ok)
            fill = self.constant(
                np.asarray(out_of_bounds_value(out.dtype) if fill_value is None else fill_value, out.dtype)
            )
            cases = [np.full(found.shape, inside, object), found, np.broadcast_to(fill, found.shape)]
            found = self.map_elements("select", cases, out.dtype.name)
        place: list[Any] = [slice(None)] * len(out.shape)
        for d, i in zip(batch, at, strict=True):
            place[d] = i
        found = found.reshape([found.shape[d] for d in kept])
        result[tuple(place)] = found if found.ndim else found[()]
    return result


def _platform_index(self: ArrayBuilder, out: Any, platforms: tuple) -> Array:
    """Index of the branch that any platform can take."""
    if None not in platforms:
        raise UnsupportedPrimitive("what is for some platforms alone")
    return self.constant(np.asarray(platforms.index(None), out.dtype))


def out_of_bounds_value(dtype: np.dtype) -> Any:
    """Return JAX's default value for elements gathered from outside an array."""
    if dtype.kind == "f":
        return np.nan
    return True if dtype.kind == "b" else np.iinfo(dtype).min


def _scatter(combine: str | None) -> Callable:
    def rule(
        self: ArrayBuilder,
        x: Array,
        indices: Array,
        updates: Array,
        out: Any,
        dimension_numbers: Any,
        mode: Any,
        **_: Any,
    ) -> Array:
        dims = dimension_numbers
        if dims.operand_batching_dims:
            raise UnsupportedPrimitive("scatter over batches")
        batch = [d for d in range(updates.ndim) if d not in dims.update_window_dims]
        windows = [d for d in range(x.ndim) if d not in dims.inserted_window_dims]
        result = x.copy()
        for at in np.ndindex(*[updates.shape[d] for d in batch]):
            pick: list[Any] = [slice(None)] * updates.ndim
            for d, i in zip(batch, at, strict=True):
                pick[d] = i
            update = updates[(*pick, ...)]
            sizes = [1] * x.ndim
            for d, n in zip(windows, update.shape, strict=True):
                sizes[d] = n
            update = update.reshape(sizes)
            starts = {d: indices[(*at, k)] for k, d in enumerate(dims.scatter_dims_to_operand_dims)}
            if "CLIP" in str(mode):
                starts = {d: self.clamp_index(s, x.shape[d] - sizes[d]) for d, s in starts.items()}
            self.scatter_window(result, update, starts, combine)
        return result

    return rule


def _unstack(args: list[Array], eqn: Any) -> list[Array]:
    return slices_along_axis(args[0], eqn.params["axis"])


def _split(args: list[Array], eqn: Any) -> list[Array]:
    return np.split(args[0], np.cumsum(eqn.params["sizes"])[:-1], eqn.params["axis"])


MULTI_RESULT_RULES: dict[str, Callable] = {"unstack": _unstack, "split": _split}
RULES: dict[str, Callable] = {
    "convert_element_type": _convert,
    "integer_pow": _integer_pow,
    "square": lambda self, x, out, **_: self.map_elements("mul", [x, x], out.dtype.name),
    "rsqrt": lambda self, x, out, **_: self.map_elements(
        "div", [self.constant(np.ones((), out.dtype)), self.map_elements("sqrt", [x], out.dtype.name)], out.dtype.name
    ),
    "clamp": _clamp,
    "polynomial": _polynomial,
    "select_n": lambda self, index, *cases, out: self.select_by_index(np.broadcast_to(index, out.shape), cases),
    "broadcast_in_dim": _broadcast_in_dim,
    "reshape": lambda self, x, *_, out, **__: x.reshape(out.shape),
    "squeeze": lambda self, x, out, **_: x.reshape(out.shape),
    "expand_dims": lambda self, x, out, **_: x.reshape(out.shape),
    "transpose": lambda self, x, out, permutation: np.transpose(x, permutation),
    "rev": lambda self, x, out, dimensions: np.flip(x, dimensions),
    "slice": _slice,
    "pad": _pad,
    "concatenate": lambda self, *xs, out, dimension: np.concatenate(xs, dimension),
    "stack": lambda self, *xs, out, axis: stack(xs, axis),
    "iota": _iota,
    "dot_general": _dot_general,
    "argmax": _argmax("gt"),
    "argmin": _argmax("lt"),
    "cumsum": _cumulative("add"),
    "cumprod": _cumulative("mul"),
    "cummax": _cumulative("max"),
    "cummin": _cumulative("min"),
    "dynamic_slice": _dynamic_slice,
    "dynamic_update_slice": _dynamic_update_slice,
    "gather": _gather,
    "platform_index": _platform_index,
    "scatter": _scatter(None),
    "scatter-add": _scatter("add"),
    **randomness.random_primitive_rules(),
}  # fmt: skip
