"""JAX's primitives as NumPy functions of arrays whose last axis is the batch, or has length 1 if all rollouts agree.

A rule is a function of this module or a ufunc with all static parameters bound, so that it can be pickled. No result
depends on the number of rollouts or on their order: sums go term by term.
"""

from collections.abc import Callable, Sequence
from math import prod
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Shaped

BatchArray = Shaped[np.ndarray, "... b"]
BLOCK_SIZE = 1 << 14  # numbers of a product that are in cache at a time
MIN_VIEW_SIZE = 4096  # size from which broadcasting without a copy is faster


def convert_dtype(dtype: np.dtype, x: BatchArray) -> BatchArray:
    """Convert numbers to another type."""
    return x.astype(dtype)


def reinterpret_bits(dtype: np.dtype, x: BatchArray) -> BatchArray:
    """Reinterpret bits as another type of the same size."""
    return x.view(dtype)


def integer_power(exponent: int, x: BatchArray) -> BatchArray:
    """Raise `x` to an integer power by repeated squaring."""
    result, square = None, x
    for bit in bin(abs(exponent))[:1:-1]:
        if bit == "1":
            result = square if result is None else result * square
        square = square * square
    if result is None:
        return np.ones_like(x)
    return result if exponent > 0 else 1 / result


def integer_quotient(x: BatchArray, y: BatchArray) -> BatchArray:
    """Integer division that rounds towards zero."""
    return np.trunc(x / y).astype(x.dtype)


def rsqrt(x: BatchArray) -> BatchArray:
    """One over the square root: 1 / sqrt(x)."""
    return 1 / np.sqrt(x)


def erf_inv(x: BatchArray) -> BatchArray:
    """Inverse of the error function."""
    from scipy.special import erfinv  # slow to import, and few programs need it

    return erfinv(x)


def logistic(x: BatchArray) -> BatchArray:
    """The logistic function 1 / (1 + exp(-x))."""
    return 1 / (1 + np.exp(-x))


def one_minus_square(x: BatchArray) -> BatchArray:
    """1 - x^2, accurate near 1."""
    return (1 - x) * (1 + x)


def clamp(low: BatchArray, x: BatchArray, high: BatchArray) -> BatchArray:
    """Clamp `x` to the range from `low` to `high`."""
    return np.minimum(np.maximum(x, low), high)


def polynomial(x: BatchArray, *coefficients: BatchArray) -> BatchArray:
    """Evaluate a polynomial by Horner's rule; the list of coefficients begins with the constant."""
    total = np.broadcast_to(coefficients[-1], np.broadcast_shapes(x.shape, coefficients[-1].shape))
    for c in reversed(coefficients[:-1]):
        total = total * x + c
    return total


def select_n(index: BatchArray, *cases: BatchArray) -> BatchArray:
    """For each element, choose the array with number `index` and return the element from it."""
    if len(cases) == 2:
        return np.where(index, cases[1], cases[0])
    result = cases[-1]
    for k in range(len(cases) - 2, -1, -1):
        result = np.where(index <= k, cases[k], result)
    return result


# layout; the axis of a random key's words and that of the batch come after the axes in the parameters


def reshape(rank: int, shape: tuple[int, ...], x: BatchArray) -> BatchArray:
    """Reshape all axes but the batch."""
    return x.reshape(shape + x.shape[rank:])


def broadcast_in_dim(places: tuple[int, ...], shape: tuple[int, ...], x: BatchArray) -> BatchArray:
    """Broadcast to a larger `shape`, with the axes of `x` at `places`."""
    rest = x.shape[len(places) :]
    new = [1] * len(shape)
    for place, length in zip(places, x.shape, strict=False):
        new[place] = length
    whole, x = shape + rest, x.reshape((*new, *rest))
    if prod(whole) > MIN_VIEW_SIZE:
        return np.broadcast_to(x, whole)
    result = np.empty(whole, x.dtype)
    result[...] = x
    return result


def tile(times: tuple[int, ...], x: BatchArray) -> BatchArray:
    """Repeat an array along its axes."""
    return np.tile(x, (*times, 1))


def transpose(order: tuple[int, ...], x: BatchArray) -> BatchArray:
    """Permute all axes but the batch."""
    return x.transpose(*order, *range(len(order), x.ndim))


def slice_window(window: tuple[slice, ...], x: BatchArray) -> BatchArray:
    """Return a window (slice) of an array along all axes but the batch."""
    return x[window]


def pad(shape: tuple[int, ...], window: tuple[slice, ...], x: BatchArray, value: BatchArray) -> BatchArray:
    """Put `x` into a window of an array that is filled with `value`."""
    result = np.empty((*shape, max(x.shape[-1], value.shape[-1])), x.dtype)
    result[...] = value
    result[window] = x
    return result


def flip(axes: tuple[int, ...], x: BatchArray) -> BatchArray:
    """Reverse the elements along axes."""
    return np.flip(x, axes)


def concatenate(axis: int, *parts: BatchArray) -> BatchArray:
    """Concatenate arrays along an axis."""
    return np.concatenate(_broadcast_widths(parts), axis)


def stack(axis: int, *parts: BatchArray) -> BatchArray:
    """Stack arrays along a new axis."""
    return np.stack(_broadcast_widths(parts), axis)


def unstack(axis: int, x: BatchArray) -> list[BatchArray]:
    """Return the slices of an array along an axis."""
    return list(np.moveaxis(x, axis, 0))


def split(axis: int, ends: tuple[int, ...], x: BatchArray) -> list[BatchArray]:
    """Split an array along an axis at `ends`."""
    return np.split(x, ends, axis)


def _broadcast_widths(parts: Sequence[BatchArray]) -> list[BatchArray]:
    width = max(x.shape[-1] for x in parts)
    return [x if x.shape[-1] == width else np.repeat(x, width, axis=-1) for x in parts]


# reductions


def reduce_in_order(add: np.ufunc, axes: tuple[int, ...], x: BatchArray) -> BatchArray:
    """Reduce an array along axes term by term, in a fixed order, so that rounding is reproducible."""
    kept = [d for d in range(x.ndim) if d not in axes]
    total, *others = x.transpose(*axes, *kept).reshape(-1, *[x.shape[d] for d in kept])
    for k, term in enumerate(others):
        total = add(total, term, out=total if k else None)
    return total


def reduce_extreme(ufunc: np.ufunc, axes: tuple[int, ...], x: BatchArray) -> BatchArray:
    """Reduce along axes by a maximum or minimum, whose order does not matter."""
    return ufunc.reduce(x, axis=axes)


def iota(shape: tuple[int, ...], axis: int, dtype: np.dtype) -> BatchArray:
    """Return an array of `shape` that holds the index of each element along an axis."""
    return np.broadcast_to(
        np.arange(shape[axis], dtype=dtype).reshape([-1 if d == axis else 1 for d in range(len(shape) + 1)]),
        (*shape, 1),
    )


def full(value: Any, dtype: np.dtype) -> BatchArray:
    """Make an array with the constant `value`, shared by all rollouts of a batch."""
    return np.full(1, value, dtype)


def fill_empty_reduction(shape: tuple[int, ...], value: Any, x: BatchArray) -> BatchArray:
    """Return an array filled with one value, the result of a reduction over no elements."""
    return np.full((*shape, 1), value, x.dtype)


def argextreme(argfunc: Callable, axis: int, dtype: np.dtype, x: BatchArray) -> BatchArray:
    """Return the index of the first maximum or minimum along an axis."""
    return argfunc(x, axis=axis).astype(dtype)


def accumulate(add: np.ufunc, axis: int, reverse: bool, x: BatchArray) -> BatchArray:
    """Cumulative reduction along an axis, from its start or its end."""
    if reverse:
        return np.flip(add.accumulate(np.flip(x, axis), axis), axis)
    return add.accumulate(x, axis)


class DotDimensions(NamedTuple):
    """Static parameters of a dot product: orders of axes, and how many axes are contracted, batched and free."""

    left: tuple[int, ...]
    right: tuple[int, ...]
    contracted: int
    shared: int
    free: tuple[int, int]
    dtype: np.dtype


def dot_general(how: DotDimensions, a: BatchArray, b: BatchArray) -> BatchArray:
    """Product of two arrays as `lax.dot_general`, summed term by term."""
    a, b = transpose(how.left, a), transpose(how.right, b)
    n = how.contracted + how.shared
    a = a.reshape(-1, *a.shape[how.contracted : -1], *[1] * how.free[1], a.shape[-1])
    b = b.reshape(-1, *b.shape[how.contracted : n], *[1] * how.free[0], *b.shape[n:])
    result = np.empty(np.broadcast_shapes(a.shape[1:], b.shape[1:]), how.dtype)
    _products(a, b, result)
    return result


def _products(a: BatchArray, b: BatchArray, result: BatchArray) -> None:
    """Sum products term by term, in blocks that fit into a processor's cache."""
    if result.size > BLOCK_SIZE and result.ndim > 1 and len(result) > 1:
        half = len(result) // 2
        for rows in (slice(0, half), slice(half, None)):
            left, right = (x if x.shape[1] == 1 else x[:, rows] for x in (a, b))
            _products(left, right, result[rows])
        return
    if not len(a):
        result[...] = 0
        return
    np.multiply(a[0], b[0], out=result)
    more = np.empty_like(result)
    for x, y in zip(a[1:], b[1:], strict=True):
        result += np.multiply(x, y, out=more)


def cholesky(x: BatchArray) -> BatchArray:
    """Return the lower Cholesky factors of matrices, which lie in the two axes before the batch axis."""
    rest, result = x.copy(), np.zeros_like(x)
    for k in range(x.shape[-2]):
        column = rest[..., k:, k, :] / np.sqrt(rest[..., k, k, :])[..., None, :]
        result[..., k:, k, :] = column
        below = column[..., 1:, :]
        rest[..., k + 1 :, k + 1 :, :] -= below[..., :, None, :] * below[..., None, :, :]
    return result


class TriangularSolveParameters(NamedTuple):
    """Static parameters of a triangular system of equations."""

    left: bool  # whether the triangle is the left factor
    lower: bool
    transposed: bool
    unit: bool  # whether its diagonal is all ones


def solve_triangular(how: TriangularSolveParameters, a: BatchArray, b: BatchArray) -> BatchArray:
    """Solve a triangular system of linear equations by substitution."""
    if how.transposed == how.left:
        a = a.swapaxes(-3, -2)
    if not how.left:
        b = b.swapaxes(-3, -2)
    shape = np.broadcast_shapes(a.shape[:-3], b.shape[:-3])
    x = np.empty((*shape, *b.shape[-3:-1], max(a.shape[-1], b.shape[-1])), b.dtype)
    x[...] = b
    down, n = how.lower != (how.transposed == how.left), x.shape[-3]
    for k in range(n) if down else range(n - 1, -1, -1):
        if not how.unit:
            x[..., k, :, :] /= a[..., k, k, :][..., None, :]
        rest = slice(k + 1, None) if down else slice(None, k)
        x[..., rest, :, :] -= a[..., rest, k, :][..., None, :] * x[..., k, None, :, :]
    return x if how.left else x.swapaxes(-3, -2)


# indices that are data


class WindowIndexing(NamedTuple):
    """Static parameters of a gather or scatter, which determine where its windows lie in an array."""

    shape: tuple[int, ...]  # shape of the array
    sizes: tuple[int, ...]  # sizes of a window, by axis of the array
    starts: tuple[tuple[int, int], ...]  # axis of the array, and the component of the index that gives its start
    batching_axes: tuple[tuple[int, int], ...]  # axis of the array, and the batching axis of the indices
    window_axes: tuple[tuple[int, int], ...]  # axis of the array, and the axis of the result that runs over a window
    batch_axes: tuple[int, ...]  # axes of the result that run over the indices
    rank: int  # rank of the result

    def element_indices(self, indices: BatchArray) -> tuple[list[BatchArray], BatchArray]:
        """Compute the index in the array for each element of the windows.

        Args:
            indices: start of each window.

        Returns:
            Index of every element along each axis of the array, and whether its window lies within the array.
        """
        count = indices.shape[:-2]
        shape = [1] * self.rank
        for axis, length in zip(self.batch_axes, count, strict=True):
            shape[axis] = length
        within = np.ones((*shape, 1), bool)
        found = [np.zeros((1,) * (self.rank + 1), np.int64) for _ in self.shape]
        for axis, k in self.starts:
            start, last = indices[..., k, :].astype(np.int64), self.shape[axis] - self.sizes[axis]
            within = within & ((start >= 0) & (start <= last)).reshape(*shape, -1)
            found[axis] = np.clip(start, 0, last).reshape(*shape, -1)
        for axis, along in self.batching_axes:
            place = self.batch_axes[along]
            found[axis] = np.arange(shape[place]).reshape([-1 if d == place else 1 for d in range(self.rank + 1)])
        for axis, through in self.window_axes:
            ahead = np.arange(self.sizes[axis])
            found[axis] = found[axis] + ahead.reshape([-1 if d == through else 1 for d in range(self.rank + 1)])
        return found, within


def gather(places: WindowIndexing, fill: Any, x: BatchArray, indices: BatchArray) -> BatchArray:
    """Return windows of `x` at `indices`. Elements outside the array are `fill`, or clamped to the nearest if `fill` is
    None."""
    at, within = places.element_indices(indices)
    if all(i.shape[-1] == 1 for i in at):
        result = x[(*np.broadcast_arrays(*[i[..., 0] for i in at]), slice(None))]
    else:
        own = np.arange(indices.shape[-1]) if x.shape[-1] > 1 else np.zeros(1, int)
        result = x[(*at, own)]
    return result if fill is None else np.where(within, result, np.asarray(fill, x.dtype))


def scatter(
    add: np.ufunc | None, places: WindowIndexing, clip: bool, x: BatchArray, indices: BatchArray, updates: BatchArray
) -> BatchArray:
    """Write updates into windows of `x`, or add them; windows outside of the array are ignored."""
    width = max(y.shape[-1] for y in (x, indices, updates))
    result = np.repeat(x, width, axis=-1) if x.shape[-1] < width else x.copy()
    at, within = places.element_indices(indices)
    *at, within, updates = np.broadcast_arrays(*at, np.arange(width), within | clip, updates)
    chosen = within.all() or within
    into, new = (tuple(at), updates) if chosen is True or chosen is np.True_ else (
        tuple(i[within] for i in at), updates[within])  # fmt: skip
    if add is None:
        result[into] = new
    else:
        add.at(result, into, new)
    return result


def dynamic_slice(sizes: tuple[int, ...], x: BatchArray, *starts: BatchArray) -> BatchArray:
    """Return a window of `x` with shape `sizes`, at start indices that are clamped to keep it inside the array."""
    lasts = [n - size for n, size in zip(x.shape, sizes, strict=False)]
    if all(s.shape[-1] == 1 for s in starts):
        first = [min(max(int(s[0]), 0), last) for s, last in zip(starts, lasts, strict=True)]
        return x[tuple(slice(k, k + size) for k, size in zip(first, sizes, strict=True))]
    at = _window(starts, lasts, sizes)
    return x[(*at, np.arange(max(i.shape[-1] for i in at)) if x.shape[-1] > 1 else 0)]


def dynamic_update_slice(x: BatchArray, update: BatchArray, *starts: BatchArray) -> BatchArray:
    """Replace a window of `x` by `update`, at start indices that are clamped to keep it inside the array."""
    width = max(y.shape[-1] for y in (x, update, *starts))
    result = np.repeat(x, width, axis=-1) if x.shape[-1] < width else x.copy()
    lasts = [n - size for n, size in zip(x.shape, update.shape[:-1], strict=False)]
    result[(*_window(starts, lasts, update.shape[:-1]), np.arange(width))] = update
    return result


def _window(starts: Sequence[BatchArray], lasts: Sequence[int], sizes: Sequence[int]) -> list[BatchArray]:
    """Index along each axis of a window."""
    n = len(sizes)
    return [np.clip(s.astype(np.int64), 0, last) + np.arange(size).reshape([-1 if d == k else 1 for d in range(n + 1)])
            for k, (s, last, size) in enumerate(zip(starts, lasts, sizes, strict=True))]  # fmt: skip
