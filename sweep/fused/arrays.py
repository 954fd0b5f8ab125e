"""Operations on arrays of numbers, number by number, and for the legs at once where one operation gives all six.

An array is a NumPy array of nodes of the same shape; moving numbers about is NumPy's own indexing of it and makes no
operation. Where an axis as long as the group holds what one operation gives for the legs, the operation on it is one
for the legs too.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import pairwise, product
from typing import Any

import numpy as np

from sweep.fused.operations import fold, simplify
from sweep.fused.program import At, Node, OneOf, Over, Program, Region, Store, is_uniform, value_of

EMPTY = {"add": 0, "mul": 1, "or": False, "and": True, "max": -np.inf, "min": np.inf}  # of no numbers at all
CHAIN = 64  # places that a number may be chosen from, where it is not in memory

Array = Any  # of NumPy, of nodes


@dataclass(frozen=True, eq=False)
class RowUpdate:
    """An array in memory of which one row is replaced. Saved to that memory, it is a store at a computed address."""

    array: Array  # (rows, ...), as it lies in memory
    row: Node  # number of the row, within the array, the same for all rollouts
    new: Array  # (1, ...)


class Unsupported(Exception):
    """A primitive, or a form of it, that has no rule."""


class Arrays:
    """Arrays of a `Program` that is being written."""

    def __init__(self, program: Program):
        self.program, self.group = program, program.group

    def constant(self, value: Any) -> Array:
        """A constant array, of numbers that are known."""
        value = np.asarray(value)
        return build_array(value.shape, lambda at: self.program.const(value[at], value.dtype.name))

    def op(self, name: str, dtype: str, *args: Node) -> Node:
        """An operation on numbers, simplified."""
        if all(x.op == "const" for x in args):
            value = fold(name, dtype, [value_of(x) for x in args])
            return self.program.const(tuple(value) if np.ndim(value) else value, dtype)
        if (simple := simplify(name, args)) is not None:
            return simple
        if name == "neg" and args[0].op == "neg":
            return args[0].args[0]
        return self.program.node(name, args, dtype)

    def lift(self, name: str, args: Sequence[Array], dtype: str) -> Array:
        """An operation number by number, for the legs at once along an axis of theirs."""
        whole: list[Array] = list(np.broadcast_arrays(*args)) if len(args) > 1 else list(args)
        shape = whole[0].shape
        axis = next((a for a in range(len(shape)) if shape[a] == self.group and self._over_legs(whole, a)), None)
        if axis is None:
            return build_array(shape, lambda at: self.op(name, dtype, *(x[at] for x in whole)))
        whole = [np.moveaxis(x, axis, -1) for x in whole]
        result = np.empty(whole[0].shape, object)
        for at in np.ndindex(result.shape[:-1]):
            rows = [x[at] for x in whole]
            if (legs := self._legs(rows)) is None:
                for k in range(self.group):
                    result[(*at, k)] = self.op(name, dtype, *[row[k] for row in rows])
            else:
                result[at] = self.parts(self.op(name, dtype, *legs))
        return np.moveaxis(result, -1, axis)

    def reduce(self, name: str, x: Array, axes: Sequence[int], dtype: Any) -> Array:
        """Along `axes`, in order; over the legs last."""
        kept = [d for d in range(x.ndim) if d not in axes]
        if not x.size:
            return self.constant(np.full([x.shape[d] for d in kept], EMPTY[name], dtype))
        rows = np.transpose(x, (*kept, *axes))
        legs = next((k for k, a in enumerate(axes) if x.shape[a] == self.group and self._over_legs([x], a)), None)
        shape = tuple(x.shape[d] for d in kept)
        if legs is None:  # maybe for the legs at once, along an axis that is kept
            parts = slices_along(rows.reshape(*shape, -1), -1)
            return reduce(lambda total, one: self.lift(name, [total, one], np.dtype(dtype).name), parts)
        rows = np.moveaxis(rows, len(kept) + legs, -1)

        def total(at: tuple) -> Node:
            row = rows[at].reshape(-1, self.group)
            found = [self._legs([six]) for six in row]
            if any(one is None for one in found):
                return self._fold(name, list(row.ravel()))
            whole = self._fold(name, [one[0] for one in found if one is not None])
            return (
                self.program.node("over_legs", (whole,), whole.dtype, Over(name), leg=False)
                if whole.leg
                else self._fold(name, [whole] * self.group)
            )

        return build_array(shape, total)

    def _fold(self, name: str, row: list[Node]) -> Node:
        total = row[0]
        for x in row[1:]:
            total = self.op(name, total.dtype, total, x)
        return total

    def choose(self, index: Array, cases: Sequence[Array]) -> Array:
        """The case that `index` names, number by number."""
        dtype = cases[0].flat[0].dtype if cases[0].size else "float32"
        if len(cases) == 2 and (not index.size or index.flat[0].dtype == "bool"):
            return self.lift("select", [index, cases[1], cases[0]], dtype)
        result, kind = cases[-1], index.flat[0].dtype if index.size else "int32"
        for k in reversed(_ends(cases)):
            first = self.lift("le", [index, self.constant(np.asarray(k, kind))], "bool")
            result = self.lift("select", [first, cases[k], result], dtype)
        return result

    # the legs

    def parts(self, node: Node) -> list[Node]:
        """What a node gives for each leg."""
        if not node.leg:
            return [node] * self.group
        if node.op == "const":
            return [self.program.const(value, node.dtype) for value in value_of(node)]
        if node.op in ("load", "gather"):
            places = node.attribute(At).each(self.group)
            return [self.program.node(node.op, node.args, node.dtype, place, leg=False) for place in places]
        return [self.program.node("part", (node,), node.dtype, OneOf(k), leg=False) for k in range(self.group)]

    def _over_legs(self, arrays: Sequence[Array], axis: int) -> bool:
        """Whether any row along `axis` is one for the legs."""
        rows = [np.moveaxis(x, axis, -1).reshape(-1, self.group) for x in arrays]
        return any(self._legs(alike) is not None for alike in zip(*rows, strict=True))

    def _legs(self, rows: Sequence[Array]) -> list[Node] | None:
        """Rows of a number for each leg as nodes for the legs; None where that saves nothing."""
        found = [self._leg(row) for row in rows]
        if not any(x is not None and x.leg for x in found):
            return None
        if any(x is None for x in found) and not any(x is not None and x.leg and x.op != "const" for x in found):
            return None
        return [self._packed(row) if x is None else x for x, row in zip(found, rows, strict=True)]

    def _packed(self, row: Array) -> Node:
        return self.program.node("pack", tuple(row), row[0].dtype, leg=True)

    def _leg(self, row: Array) -> Node | None:
        """One node for a row: the same for all, parts of one, or alike in memory."""
        first, second = row[0], row[1]
        if all(x is first for x in row):
            return first
        if first.op != second.op:
            return None
        if first.op == "part":
            whole = first.args[0]
            return (
                whole
                if all(x.op == "part" and x.args[0] is whole and x.extra == OneOf(k) for k, x in enumerate(row))
                else None
            )
        if first.op == "const":
            same = all(x.op == "const" for x in row)
            return self.program.const(tuple(value_of(x) for x in row), first.dtype) if same else None
        if first.op in ("load", "gather"):
            region, index, depth, _ = first.attribute(At)
            step = second.attribute(At).first - index
            for k, x in enumerate(row):
                if x.op != first.op or x.args != first.args or x.extra != At(region, index + k * step, depth, 0):
                    return None
            return self.program.node(first.op, first.args, first.dtype, At(region, index, depth, step), leg=True)
        return None

    # memory

    def load(self, region: Region, index: int, depth: int) -> Node:
        """A number in memory, as it is in the block at `depth`."""
        return self.program.node("load", (), region.dtype, At(region, index, depth, 0), leg=False)

    def load_array(self, region: Any, shape: tuple, depth: int) -> Array:
        """An array in memory, as it is in the block at `depth`."""
        at = np.arange(math.prod(shape)).reshape(shape)
        return build_array(shape, lambda i: self.load(region, int(at[i]), depth))

    def save(self, region: Region | None, x: Array | RowUpdate, items: list[Any]) -> None:
        """Have an array put into memory; what is there already is left."""
        if region is None:
            return
        if isinstance(x, RowUpdate) and (memory := self._memory(x.array)) and memory[:2] == (region, 0):
            stores = self._stores(region, x.new[0, ...])
            items.extend(replace(store, row=x.row, stride=x.new.size) for store in stores)
            return
        for store in self._stores(region, self.resolve_update(x)):
            unchanged = store.value.op == "load" and store.value.attribute(At)[:2] == (region, store.index)
            if not unchanged:
                items.append(store)

    def _stores(self, region: Region, x: Array) -> Iterator[Store]:
        rows = (
            np.moveaxis(np.arange(x.size).reshape(x.shape), 0, -1).reshape(-1, self.group)
            if x.ndim and x.shape[0] == self.group
            else ()
        )
        done = set()
        for row in rows:
            if (leg := self._leg(x.ravel()[row])) is not None and leg.leg and leg.op not in ("load", "gather"):
                yield Store(region, int(row[0]), leg, int(row[1] - row[0]))
                done.update(row.tolist())
        for k, node in enumerate(x.flat):
            if k not in done:
                yield Store(region, k, node)

    def _memory(self, x: Array) -> tuple[Region, int, int] | None:
        """Region, first place and depth of an array that lies in memory as it is."""
        if not x.size or x.flat[0].op != "load":
            return None
        region, first, depth, _ = x.flat[0].attribute(At)
        lies = all(n.op == "load" and n.extra == At(region, first + k, depth, 0) for k, n in enumerate(x.flat))
        return (region, first, depth) if lies else None

    # where the place depends on the rollout

    def pick(self, x: Array, starts: Sequence[Node], sizes: Sequence[int]) -> Array:
        """The part of `x` of `sizes` that begins at `starts`, which are put within it."""
        last = [n - size for n, size in zip(x.shape, sizes, strict=True)]
        starts = [self.clamp_index(s, most) for s, most in zip(starts, last, strict=True)]
        moving = [d for d, s in enumerate(starts) if s.op != "const"]
        known = tuple(slice(0, None) if d in moving else slice(int(value_of(s)), int(value_of(s)) + sizes[d])
                      for d, s in enumerate(starts))  # fmt: skip
        if not moving or not math.prod(sizes):
            return x[known][tuple(slice(0, n) for n in sizes)]
        strides = [math.prod(x.shape[d + 1 :]) for d in range(x.ndim)]
        if (memory := self._memory(x)) is not None:
            region, first, depth = memory
            place: Any = None
            for d in moving:
                term = self.op("mul", "int32", starts[d], self.program.const(strides[d], "int32"))
                place = term if place is None else self.op("add", "int32", place, term)
            at = np.arange(x.size).reshape(x.shape)[known]
            at = at[tuple(slice(0, sizes[d]) for d in range(x.ndim))]
            return build_array(at.shape, lambda i: self.program.node(
                "gather", (place,), region.dtype, At(region, first + int(at[i]), depth, 0), leg=False))  # fmt: skip
        x = x[known]
        many = 1
        for d in moving:
            windows = [np.take(x, range(k, k + sizes[d]), axis=d) for k in range(last[d] + 1)]
            many *= len(_ends(windows)) + 1
            if many > CHAIN:
                raise Unsupported("a choice among many numbers that are not in memory")
            x = self.choose(np.full(windows[0].shape, starts[d], object), windows)
        return x

    def resolve_update(self, x: Array | RowUpdate) -> Array:
        """The array itself: every number that a row may replace is chosen by the row's number."""
        if not isinstance(x, RowUpdate):
            return x
        result = x.array.copy()
        self.put(result, x.new, {0: x.row}, None)
        return result

    def update(self, x: Array, new: Array, starts: dict[int, Node]) -> Array | RowUpdate:
        """Replace the part of `x` that begins at `starts` by `new`; a row of an array in memory stays a `RowUpdate`."""
        if not new.size:
            return x
        moving = [axis for axis, start in starts.items() if start.op != "const"]
        row = moving == [0] and new.shape == (1, *x.shape[1:]) and is_uniform(starts[0])
        if row and self._memory(x):
            return RowUpdate(x, starts[0], new)
        result = x.copy()
        self.put(result, new, starts, None)
        return result

    def put(self, x: Array, update: Array, starts: dict[int, Node], combine: str | None) -> None:
        """Put `update` into `x` where it begins at `starts`, on other axes at 0; nothing where it would not fit."""
        ranges = []
        for d, (n, m) in enumerate(zip(x.shape, update.shape, strict=True)):
            start = starts.get(d)
            fixed = 0 if start is None else int(value_of(start)) if start.op == "const" else None
            ranges.append([k for k in range(n - m + 1) if fixed in (None, k)])
        for place in product(*ranges):
            here = None
            for d, start in starts.items():
                if start.op != "const":
                    same = self.op("eq", "bool", start, self.program.const(place[d], start.dtype))
                    here = same if here is None else self.op("and", "bool", here, same)
            window = tuple(slice(k, k + m) for k, m in zip(place, update.shape, strict=True))
            dtype = x.flat[0].dtype
            new = update if combine is None else self.lift(combine, [x[window], update], dtype)
            x[window] = new if here is None else self.lift(
                "select", [np.full(update.shape, here, object), new, x[window]], dtype)  # fmt: skip

    def clamp_index(self, start: Node, most: int) -> Node:
        """A place from 0 to `most`."""
        if start.dtype != "int32":
            start = self.op("convert", "int32", start)
        zero, top = (self.program.const(v, "int32") for v in (0, most))
        return self.op("min", "int32", self.op("max", "int32", start, zero), top)


def build_array(shape: tuple, at: Callable[[tuple], Any]) -> Array:
    """An array of what `at` gives for each index."""
    out = np.empty(shape, object)
    for i in np.ndindex(shape):
        out[i] = at(i)
    return out


def slices_along(x: Array, axis: int) -> list[Array]:
    """The parts of an array along an axis."""
    moved = np.moveaxis(x, axis, 0)
    return [moved[k, ...] for k in range(len(moved))]


def stack(arrays: Sequence[Array], axis: int = 0) -> Array:
    """Arrays along a new axis."""
    return np.stack(list(arrays), axis) if arrays else np.empty(0, object)


def _ends(cases: Sequence[Array]) -> list[int]:
    """The last of every run of cases that are the same, but for that of the very last."""
    return [
        k for k, (a, b) in enumerate(pairwise(cases)) if any(x is not y for x, y in zip(a.flat, b.flat, strict=True))
    ]
