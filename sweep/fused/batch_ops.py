"""What JAX's primitives do to NumPy arrays, of which the last axis is over rollouts, or of length 1 where they agree.

A rule is a module's function or a ufunc, with what does not depend on the rollouts bound, so that it can be kept. None
lets a number depend on how many rollouts there are, or on which is where: sums go term by term.
"""

from collections.abc import Callable, Sequence
from math import prod
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Shaped

Values = Shaped[np.ndarray, "... b"]
BLOCK = 1 << 14  # numbers of a product that are summed at a time
COPIED = 4096  # numbers from which stretching without copying is faster


def convert(dtype: np.dtype, x: Values) -> Values:
    """Numbers of another type."""
    return x.astype(dtype)


def reinterpret(dtype: np.dtype, x: Values) -> Values:
    """The same bits as another type of the same size."""
    return x.view(dtype)


def power(exponent: int, x: Values) -> Values:
    """A whole power, by squares."""
    result, square = None, x
    for bit in bin(abs(exponent))[:1:-1]:
        if bit == "1":
            result = square if result is None else result * square
        square = square * square
    if result is None:
        return np.ones_like(x)
    return result if exponent > 0 else 1 / result


def quotient(x: Values, y: Values) -> Values:
    """Of integers, towards zero."""
    return np.trunc(x / y).astype(x.dtype)


def reciprocal_root(x: Values) -> Values:
    """One over the square root: 1 / sqrt(x)."""
    return 1 / np.sqrt(x)


def erf_inv(x: Values) -> Values:
    """The inverse of the error function."""
    from scipy.special import erfinv  # as few programs have it, and it takes long to load

    return erfinv(x)


def logistic(x: Values) -> Values:
    """The logistic function 1 / (1 + exp(-x))."""
    return 1 / (1 + np.exp(-x))


def one_minus_square(x: Values) -> Values:
    """1 - x^2, exact next to 1."""
    return (1 - x) * (1 + x)


def clamp(low: Values, x: Values, high: Values) -> Values:
    """`x`, or the nearer one of `low` and `high`."""
    return np.minimum(np.maximum(x, low), high)


def polynomial(x: Values, *coefficients: Values) -> Values:
    """By Horner's rule, of coefficients that begin with the constant."""
    total = np.broadcast_to(coefficients[-1], np.broadcast_shapes(x.shape, coefficients[-1].shape))
    for c in reversed(coefficients[:-1]):
        total = total * x + c
    return total


def select(index: Values, *cases: Values) -> Values:
    """The case of each index."""
    if len(cases) == 2:
        return np.where(index, cases[1], cases[0])
    result = cases[-1]
    for k in range(len(cases) - 2, -1, -1):
        result = np.where(index <= k, cases[k], result)
    return result


# where numbers lie; the axes of a random key's words, and that over rollouts, follow those told of


def reshape(rank: int, shape: tuple[int, ...], x: Values) -> Values:
    """In another order of axes' lengths."""
    return x.reshape(shape + x.shape[rank:])


def broadcast_in_dim(places: tuple[int, ...], shape: tuple[int, ...], x: Values) -> Values:
    """Its axes at `places` of a larger `shape`."""
    rest = x.shape[len(places) :]
    new = [1] * len(shape)
    for place, length in zip(places, x.shape, strict=False):
        new[place] = length
    whole, x = shape + rest, x.reshape((*new, *rest))
    if prod(whole) > COPIED:
        return np.broadcast_to(x, whole)
    result = np.empty(whole, x.dtype)
    result[...] = x
    return result


def tile(times: tuple[int, ...], x: Values) -> Values:
    """Again and again along axes."""
    return np.tile(x, (*times, 1))


def transpose(order: tuple[int, ...], x: Values) -> Values:
    """The same numbers, axes in another order."""
    return x.transpose(*order, *range(len(order), x.ndim))


def part(window: tuple[slice, ...], x: Values) -> Values:
    """What lies in a window of slices."""
    return x[window]


def pad(shape: tuple[int, ...], window: tuple[slice, ...], x: Values, value: Values) -> Values:
    """`x` in a window of an array of one value."""
    result = np.empty((*shape, max(x.shape[-1], value.shape[-1])), x.dtype)
    result[...] = value
    result[window] = x
    return result


def flip(axes: tuple[int, ...], x: Values) -> Values:
    """The same numbers in reverse along axes."""
    return np.flip(x, axes)


def concatenate(axis: int, *parts: Values) -> Values:
    """One after the other along an axis."""
    return np.concatenate(_of_one_width(parts), axis)


def stack(axis: int, *parts: Values) -> Values:
    """Parts side by side along a new axis."""
    return np.stack(_of_one_width(parts), axis)


def unstack(axis: int, x: Values) -> list[Values]:
    """What lies along an axis."""
    return list(np.moveaxis(x, axis, 0))


def split(axis: int, ends: tuple[int, ...], x: Values) -> list[Values]:
    """Parts of an array along an axis, by where they end."""
    return np.split(x, ends, axis)


def _of_one_width(parts: Sequence[Values]) -> list[Values]:
    width = max(x.shape[-1] for x in parts)
    return [x if x.shape[-1] == width else np.repeat(x, width, axis=-1) for x in parts]


# along axes


def sum_terms(add: np.ufunc, axes: tuple[int, ...], x: Values) -> Values:
    """Term by term along axes, of which there is something."""
    kept = [d for d in range(x.ndim) if d not in axes]
    total, *others = x.transpose(*axes, *kept).reshape(-1, *[x.shape[d] for d in kept])
    for k, term in enumerate(others):
        total = add(total, term, out=total if k else None)
    return total


def extreme(of: np.ufunc, axes: tuple[int, ...], x: Values) -> Values:
    """What does not depend on the order."""
    return of.reduce(x, axis=axes)


def iota(shape: tuple[int, ...], axis: int, dtype: np.dtype) -> Values:
    """The place of every number along an axis."""
    return np.broadcast_to(
        np.arange(shape[axis], dtype=dtype).reshape([-1 if d == axis else 1 for d in range(len(shape) + 1)]),
        (*shape, 1),
    )


def full(value: Any, dtype: np.dtype) -> Values:
    """A single number, the same for all rollouts."""
    return np.full(1, value, dtype)


def fill(shape: tuple[int, ...], value: Any, x: Values) -> Values:
    """One value, in the place of an array without numbers."""
    return np.full((*shape, 1), value, x.dtype)


def best(of: Callable, axis: int, dtype: np.dtype, x: Values) -> Values:
    """Where the first extreme is."""
    return of(x, axis=axis).astype(dtype)


def running(add: np.ufunc, axis: int, reverse: bool, x: Values) -> Values:
    """Totals so far along an axis, or from its end."""
    if reverse:
        return np.flip(add.accumulate(np.flip(x, axis), axis), axis)
    return add.accumulate(x, axis)


class Product(NamedTuple):
    """A product of matrices: orders of axes, what is summed over first, and how many of these there are."""

    left: tuple[int, ...]
    right: tuple[int, ...]
    contracted: int
    shared: int
    free: tuple[int, int]
    dtype: np.dtype


def dot_general(how: Product, a: Values, b: Values) -> Values:
    """Products of two arrays, summed term by term."""
    a, b = transpose(how.left, a), transpose(how.right, b)
    n = how.contracted + how.shared
    a = a.reshape(-1, *a.shape[how.contracted : -1], *[1] * how.free[1], a.shape[-1])
    b = b.reshape(-1, *b.shape[how.contracted : n], *[1] * how.free[0], *b.shape[n:])
    result = np.empty(np.broadcast_shapes(a.shape[1:], b.shape[1:]), how.dtype)
    _products(a, b, result)
    return result


def _products(a: Values, b: Values, result: Values) -> None:
    """Products summed term by term; block by block of what a processor has near."""
    if result.size > BLOCK and result.ndim > 1 and len(result) > 1:
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


def cholesky(x: Values) -> Values:
    """The lower triangle of Cholesky's, of the last two axes."""
    rest, result = x.copy(), np.zeros_like(x)
    for k in range(x.shape[-2]):
        column = rest[..., k:, k, :] / np.sqrt(rest[..., k, k, :])[..., None, :]
        result[..., k:, k, :] = column
        below = column[..., 1:, :]
        rest[..., k + 1 :, k + 1 :, :] -= below[..., :, None, :] * below[..., None, :, :]
    return result


class Triangle(NamedTuple):
    """How a triangular system is told."""

    left: bool  # the triangle is the left factor
    lower: bool
    transposed: bool
    unit: bool  # its diagonal is of ones


def solve_triangular(how: Triangle, a: Values, b: Values) -> Values:
    """What a triangle makes `b` of, by substitution."""
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


# where the place depends on numbers


class Places(NamedTuple):
    """Places of windows of an array."""

    shape: tuple[int, ...]  # of the array
    sizes: tuple[int, ...]  # of a window, by axis of the array
    starts: tuple[tuple[int, int], ...]  # axis of the array, and which part of an index begins there
    aligned: tuple[tuple[int, int], ...]  # axis of the array, and axis of the indices that goes along with it
    window: tuple[tuple[int, int], ...]  # axis of the array, and axis of the result that goes through a window
    batch: tuple[int, ...]  # axes of the result that go through indices
    rank: int  # of the result

    def resolve(self, indices: Values) -> tuple[list[Values], Values]:
        """For each axis of the array where every number of the result lies, and whether its window lies within."""
        count = indices.shape[:-2]
        shape = [1] * self.rank
        for axis, length in zip(self.batch, count, strict=True):
            shape[axis] = length
        within = np.ones((*shape, 1), bool)
        found = [np.zeros((1,) * (self.rank + 1), np.int64) for _ in self.shape]
        for axis, k in self.starts:
            start, last = indices[..., k, :].astype(np.int64), self.shape[axis] - self.sizes[axis]
            within = within & ((start >= 0) & (start <= last)).reshape(*shape, -1)
            found[axis] = np.clip(start, 0, last).reshape(*shape, -1)
        for axis, along in self.aligned:
            place = self.batch[along]
            found[axis] = np.arange(shape[place]).reshape([-1 if d == place else 1 for d in range(self.rank + 1)])
        for axis, through in self.window:
            ahead = np.arange(self.sizes[axis])
            found[axis] = found[axis] + ahead.reshape([-1 if d == through else 1 for d in range(self.rank + 1)])
        return found, within


def gather(places: Places, fill: Any, x: Values, indices: Values) -> Values:
    """Windows of `x`; outside of it `fill`, or the nearest if that is None."""
    at, within = places.resolve(indices)
    if all(i.shape[-1] == 1 for i in at):
        result = x[(*np.broadcast_arrays(*[i[..., 0] for i in at]), slice(None))]
    else:
        own = np.arange(indices.shape[-1]) if x.shape[-1] > 1 else np.zeros(1, int)
        result = x[(*at, own)]
    return result if fill is None else np.where(within, result, np.asarray(fill, x.dtype))


def scatter(add: np.ufunc | None, places: Places, clip: bool, x: Values, indices: Values, updates: Values) -> Values:
    """`x` with updates in windows, or added to them; outside of it nothing is done."""
    width = max(y.shape[-1] for y in (x, indices, updates))
    result = np.repeat(x, width, axis=-1) if x.shape[-1] < width else x.copy()
    at, within = places.resolve(indices)
    *at, within, updates = np.broadcast_arrays(*at, np.arange(width), within | clip, updates)
    chosen = within.all() or within
    into, new = (tuple(at), updates) if chosen is True or chosen is np.True_ else (
        tuple(i[within] for i in at), updates[within])  # fmt: skip
    if add is None:
        result[into] = new
    else:
        add.at(result, into, new)
    return result


def dynamic_slice(sizes: tuple[int, ...], x: Values, *starts: Values) -> Values:
    """A window of `x`, put within it."""
    lasts = [n - size for n, size in zip(x.shape, sizes, strict=False)]
    if all(s.shape[-1] == 1 for s in starts):
        first = [min(max(int(s[0]), 0), last) for s, last in zip(starts, lasts, strict=True)]
        return x[tuple(slice(k, k + size) for k, size in zip(first, sizes, strict=True))]
    at = _window(starts, lasts, sizes)
    return x[(*at, np.arange(max(i.shape[-1] for i in at)) if x.shape[-1] > 1 else 0)]


def dynamic_update_slice(x: Values, update: Values, *starts: Values) -> Values:
    """`x` with a window replaced, which is put within it."""
    width = max(y.shape[-1] for y in (x, update, *starts))
    result = np.repeat(x, width, axis=-1) if x.shape[-1] < width else x.copy()
    lasts = [n - size for n, size in zip(x.shape, update.shape[:-1], strict=False)]
    result[(*_window(starts, lasts, update.shape[:-1]), np.arange(width))] = update
    return result


def _window(starts: Sequence[Values], lasts: Sequence[int], sizes: Sequence[int]) -> list[Values]:
    """Places along each axis."""
    n = len(sizes)
    return [np.clip(s.astype(np.int64), 0, last) + np.arange(size).reshape([-1 if d == k else 1 for d in range(n + 1)])
            for k, (s, last, size) in enumerate(zip(starts, lasts, sizes, strict=True))]  # fmt: skip
