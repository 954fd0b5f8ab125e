"""Array operations expressed as operations on single numbers, or on all legs at once where they are alike.

An array is a NumPy array of nodes of the same shape. Moving elements is NumPy's own indexing and makes no operation.
Along an axis as long as the group, nodes that one operation gives for all legs are combined into one operation.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import pairwise, product
from typing import Any

import numpy as np

from sweep.fused.operations import fold_constants, simplify_to_operand
from sweep.fused.program import (
    LegIndex,
    LegReduction,
    MemoryAddress,
    MemoryRegion,
    Node,
    Program,
    Store,
    constant_value,
    is_uniform,
)

EMPTY_REDUCTIONS = {
    "add": 0,
    "mul": 1,
    "or": False,
    "and": True,
    "max": -np.inf,
    "min": np.inf,
}  # results of reductions over nothing
MAX_CHAINED_SELECTS = 64  # largest number of elements to choose among that are not in memory

Array = Any  # NumPy array of nodes


@dataclass(frozen=True, eq=False)
class RowUpdate:
    """An array in memory of which one row is replaced; writing it back stores only that row, at a computed address."""

    array: Array  # (rows, ...), unchanged in memory
    row: Node  # index of the row, within the array and the same for all rollouts
    new_row: Array  # (1, ...), the row


class UnsupportedPrimitive(Exception):
    """Raised for a JAX primitive, or a form of one, for which the fused compiler has no rule."""


class ArrayBuilder:
    """Writes operations on arrays into a `Program`, whose operations act on single numbers."""

    def __init__(self, program: Program):
        self.program, self.group = program, program.group

    def constant(self, value: Any) -> Array:
        """Make an array of constant nodes from known numbers."""
        value = np.asarray(value)
        return build_array(value.shape, lambda at: self.program.constant_node(value[at], value.dtype.name))

    def emit(self, name: str, dtype: str, *args: Node) -> Node:
        """Add an operation on numbers to the program, or return the operand that it simplifies to."""
        if all(x.op == "const" for x in args):
            value = fold_constants(name, dtype, [constant_value(x) for x in args])
            return self.program.constant_node(tuple(value) if np.ndim(value) else value, dtype)
        if (simple := simplify_to_operand(name, args)) is not None:
            return simple
        if name == "neg" and args[0].op == "neg":
            return args[0].args[0]
        return self.program.get_or_add_node(name, args, dtype)

    def map_elements(self, name: str, args: Sequence[Array], dtype: str) -> Array:
        """Apply an operation to arrays element by element; along an axis of all legs, one operation stands for all.

        Args:
            name: operation, by JAX's name.
            args: operands, arrays of one shape.
            dtype: type of the result.
        """
        whole: list[Array] = list(np.broadcast_arrays(*args)) if len(args) > 1 else list(args)
        shape = whole[0].shape
        axis = next((a for a in range(len(shape)) if shape[a] == self.group and self._over_legs(whole, a)), None)
        if axis is None:
            return build_array(shape, lambda at: self.emit(name, dtype, *(x[at] for x in whole)))
        whole = [np.moveaxis(x, axis, -1) for x in whole]
        result = np.empty(whole[0].shape, object)
        for at in np.ndindex(result.shape[:-1]):
            rows = [x[at] for x in whole]
            if (legs := self._legs(rows)) is None:
                for k in range(self.group):
                    result[(*at, k)] = self.emit(name, dtype, *[row[k] for row in rows])
            else:
                result[at] = self.split_node_by_leg(self.emit(name, dtype, *legs))
        return np.moveaxis(result, -1, axis)

    def reduce(self, name: str, x: Array, axes: Sequence[int], dtype: Any) -> Array:
        """Reduce an array along `axes` in order of the elements; the axis of legs is reduced last.

        Args:
            name: operation that combines two numbers.
            x: array of nodes.
            axes: axes to reduce.
            dtype: type of the result.
        """
        kept = [d for d in range(x.ndim) if d not in axes]
        if not x.size:
            return self.constant(np.full([x.shape[d] for d in kept], EMPTY_REDUCTIONS[name], dtype))
        rows = np.transpose(x, (*kept, *axes))
        legs = next((k for k, a in enumerate(axes) if x.shape[a] == self.group and self._over_legs([x], a)), None)
        shape = tuple(x.shape[d] for d in kept)
        if legs is None:  # along a remaining axis it may still be one operation for all legs
            parts = slices_along_axis(rows.reshape(*shape, -1), -1)
            return reduce(lambda total, one: self.map_elements(name, [total, one], np.dtype(dtype).name), parts)
        rows = np.moveaxis(rows, len(kept) + legs, -1)

        def total(index: tuple) -> Node:
            row = rows[index].reshape(-1, self.group)
            found = [self._legs([six]) for six in row]
            if any(one is None for one in found):
                return self._fold(name, list(row.ravel()))
            whole = self._fold(name, [one[0] for one in found if one is not None])
            return (
                self.program.get_or_add_node("over_legs", (whole,), whole.dtype, LegReduction(name), leg=False)
                if whole.leg
                else self._fold(name, [whole] * self.group)
            )

        return build_array(shape, total)

    def _fold(self, name: str, row: list[Node]) -> Node:
        total = row[0]
        for x in row[1:]:
            total = self.emit(name, total.dtype, total, x)
        return total

    def select_by_index(self, index: Array, cases: Sequence[Array]) -> Array:
        """For each element, choose the array with number `index` and return the element from it, as `lax.select_n`.

        Args:
            index: array of indices.
            cases: arrays of one shape.
        """
        if cases[0].size and isinstance(cases[0].flat[0], tuple):  # random keys, of two words each
            words = [
                self.select_by_index(index, [build_array(x.shape, lambda i, x=x, k=k: x[i][k]) for x in cases])
                for k in range(2)
            ]
            return build_array(cases[0].shape, lambda i: (words[0][i], words[1][i]))
        dtype = cases[0].flat[0].dtype if cases[0].size else "float32"
        if len(cases) == 2 and (not index.size or index.flat[0].dtype == "bool"):
            return self.map_elements("select", [index, cases[1], cases[0]], dtype)
        result, kind = cases[-1], index.flat[0].dtype if index.size else "int32"
        for k in reversed(_run_ends(cases)):
            first = self.map_elements("le", [index, self.constant(np.asarray(k, kind))], "bool")
            result = self.map_elements("select", [first, cases[k], result], dtype)
        return result

    # the legs

    def split_node_by_leg(self, node: Node) -> list[Node]:
        """Split a node that holds one value for each leg into separate nodes, one for each leg."""
        if not node.leg:
            return [node] * self.group
        if node.op == "const":
            return [self.program.constant_node(value, node.dtype) for value in constant_value(node)]
        if node.op in ("load", "gather"):
            places = node.extra_data_of_type(MemoryAddress).leg_addresses(self.group)
            return [self.program.get_or_add_node(node.op, node.args, node.dtype, place, leg=False) for place in places]
        return [
            self.program.get_or_add_node("part", (node,), node.dtype, LegIndex(k), leg=False) for k in range(self.group)
        ]

    def _over_legs(self, arrays: Sequence[Array], axis: int) -> bool:
        """Whether any row along `axis` is a single node for all legs."""
        rows = [np.moveaxis(x, axis, -1).reshape(-1, self.group) for x in arrays]
        return any(self._legs(alike) is not None for alike in zip(*rows, strict=True))

    def _legs(self, rows: Sequence[Array]) -> list[Node] | None:
        """Nodes for all legs in place of rows with a number for each leg; None if that saves nothing."""
        found = [self._leg(row) for row in rows]
        if not any(x is not None and x.leg for x in found):
            return None
        if any(x is None for x in found) and not any(x is not None and x.leg and x.op != "const" for x in found):
            return None
        return [self._packed(row) if x is None else x for x, row in zip(found, rows, strict=True)]

    def _packed(self, row: Array) -> Node:
        return self.program.get_or_add_node("pack", tuple(row), row[0].dtype, leg=True)

    def _leg(self, row: Array) -> Node | None:
        """One node for a row that is uniform, consists of one node's parts, or lies evenly in memory."""
        first, second = row[0], row[1]
        if all(x is first for x in row):
            return first
        if first.op != second.op:
            return None
        if first.op == "part":
            whole = first.args[0]
            return (
                whole
                if all(x.op == "part" and x.args[0] is whole and x.extra == LegIndex(k) for k, x in enumerate(row))
                else None
            )
        if first.op == "const":
            same = all(x.op == "const" for x in row)
            return self.program.constant_node(tuple(constant_value(x) for x in row), first.dtype) if same else None
        if first.op in ("load", "gather"):
            region, index, depth, _ = first.extra_data_of_type(MemoryAddress)
            step = second.extra_data_of_type(MemoryAddress).first_index - index
            for k, x in enumerate(row):
                if (
                    x.op != first.op
                    or x.args != first.args
                    or x.extra != MemoryAddress(region, index + k * step, depth, 0)
                ):
                    return None
            return self.program.get_or_add_node(
                first.op, first.args, first.dtype, MemoryAddress(region, index, depth, step), leg=True
            )
        return None

    # memory

    def load_element(self, region: MemoryRegion, index: int, depth: int) -> Node:
        """Load element `index` of a memory region (an array in memory), for a block nested in `depth` loops."""
        return self.program.get_or_add_node("load", (), region.dtype, MemoryAddress(region, index, depth, 0), leg=False)

    def load_array(self, region: Any, shape: tuple, depth: int) -> Array:
        """Load an array of `shape` from a region of memory, for code that is nested in `depth` loops."""
        at = np.arange(math.prod(shape)).reshape(shape)
        return build_array(shape, lambda i: self.load_element(region, int(at[i]), depth))

    def store_array(self, region: MemoryRegion | None, x: Array | RowUpdate, items: list[Any]) -> None:
        """Store an array to a region of memory; skip numbers that the memory already holds.

        Args:
            region: the memory; None to store nothing.
            x: array of nodes, or an update of one row.
            items: items of the block, to which the stores are added.
        """
        if region is None:
            return
        if isinstance(x, RowUpdate) and (memory := self._memory(x.array)) and memory[:2] == (region, 0):
            stores = self._stores(region, x.new_row[0, ...])
            items.extend(replace(store, row_index=x.row, row_stride=x.new_row.size) for store in stores)
            return
        for store in self._stores(region, self.apply_row_update(x)):
            unchanged = store.value.op == "load" and store.value.extra_data_of_type(MemoryAddress)[:2] == (
                region,
                store.index,
            )
            if not unchanged:
                items.append(store)

    def _stores(self, region: MemoryRegion, x: Array) -> Iterator[Store]:
        rows = (
            np.moveaxis(np.arange(x.size).reshape(x.shape), 0, -1).reshape(-1, self.group)
            if x.ndim and x.shape[0] == self.group
            else ()
        )
        done = set()
        for row in rows:
            leg = self._leg(x.ravel()[row])
            if (
                leg is not None
                and leg.leg
                and (leg.op not in ("load", "gather") or leg.extra_data_of_type(MemoryAddress).region.byte_offset < 0)
            ):
                yield Store(region, int(row[0]), leg, int(row[1] - row[0]))
                done.update(row.tolist())
        for k, node in enumerate(x.flat):
            if k not in done:
                yield Store(region, k, node)

    def _memory(self, x: Array) -> tuple[MemoryRegion, int, int] | None:
        """Region, first index and depth of an array that lies in memory unchanged; else None."""
        if not x.size or x.flat[0].op != "load":
            return None
        region, first, depth, _ = x.flat[0].extra_data_of_type(MemoryAddress)
        lies = all(
            n.op == "load" and n.extra == MemoryAddress(region, first + k, depth, 0) for k, n in enumerate(x.flat)
        )
        return (region, first, depth) if lies else None

    # indices that depend on the rollout

    def read_window(self, x: Array, starts: Sequence[Node], sizes: Sequence[int]) -> Array:
        """Return the window of `x` with shape `sizes` at `starts`, clamped as in `lax.dynamic_slice`."""
        last = [n - size for n, size in zip(x.shape, sizes, strict=True)]
        starts = [self.clamp_index(s, most) for s, most in zip(starts, last, strict=True)]
        moving = [d for d, s in enumerate(starts) if s.op != "const"]
        fixed = {d: int(constant_value(s)) for d, s in enumerate(starts) if d not in moving}
        known = tuple(slice(fixed[d], fixed[d] + size) if d in fixed else slice(None) for d, size in enumerate(sizes))
        if not moving or not math.prod(sizes):
            return x[known][tuple(slice(0, n) for n in sizes)]
        strides = [math.prod(x.shape[d + 1 :]) for d in range(x.ndim)]
        if (memory := self._memory(x)) is not None:
            region, first, depth = memory
            place: Any = None
            for d in moving:
                term = self.emit("mul", "int32", starts[d], self.program.constant_node(strides[d], "int32"))
                place = term if place is None else self.emit("add", "int32", place, term)
            at = np.arange(x.size).reshape(x.shape)[known]
            at = at[tuple(slice(0, sizes[d]) for d in range(x.ndim))]

            def gather_element(i: tuple) -> Node:
                address = MemoryAddress(region, first + int(at[i]), depth, 0)
                return self.program.get_or_add_node("gather", (place,), region.dtype, address, leg=False)

            return build_array(at.shape, gather_element)
        x = x[known]
        many = 1
        for d in moving:
            windows = [np.take(x, range(k, k + sizes[d]), axis=d) for k in range(last[d] + 1)]
            many *= len(_run_ends(windows)) + 1
            if many > MAX_CHAINED_SELECTS:
                raise UnsupportedPrimitive("a choice among many numbers that are not in memory")
            x = self.select_by_index(np.full(windows[0].shape, starts[d], object), windows)
        return x

    def apply_row_update(self, x: Array | RowUpdate) -> Array:
        """Turn a row update into a plain array whose elements select between old and new row."""
        if not isinstance(x, RowUpdate):
            return x
        result = x.array.copy()
        self.scatter_window(result, x.new_row, {0: x.row}, None)
        return result

    def update_window(self, x: Array, part: Array, starts: dict[int, Node]) -> Array | RowUpdate:
        """Replace a window of `x`; one row of an array in memory stays a `RowUpdate`.

        Args:
            x: array of nodes.
            part: new elements.
            starts: first index by axis; axes that are missing start at 0.
        """
        if not part.size:
            return x
        moving = [axis for axis, start in starts.items() if start.op != "const"]
        row = moving == [0] and part.shape == (1, *x.shape[1:]) and is_uniform(starts[0])
        if row and self._memory(x):
            return RowUpdate(x, starts[0], part)
        result = x.copy()
        self.scatter_window(result, part, starts, None)
        return result

    def scatter_window(self, x: Array, update: Array, starts: dict[int, Node], combine: str | None) -> None:
        """Write `update` into `x` in place, as `lax.scatter` does; a window that does not fit into `x` is ignored.

        Args:
            x: array of nodes.
            update: new elements.
            starts: first index by axis; axes that are missing start at 0.
            combine: operation that combines old and new elements; None to replace them.
        """
        ranges = []
        for d, (n, m) in enumerate(zip(x.shape, update.shape, strict=True)):
            start = starts.get(d)
            fixed = 0 if start is None else int(constant_value(start)) if start.op == "const" else None
            ranges.append([k for k in range(n - m + 1) if fixed in (None, k)])
        for place in product(*ranges):
            here = None
            for d, start in starts.items():
                if start.op != "const":
                    same = self.emit("eq", "bool", start, self.program.constant_node(place[d], start.dtype))
                    here = same if here is None else self.emit("and", "bool", here, same)
            window = tuple(slice(k, k + m) for k, m in zip(place, update.shape, strict=True))
            dtype = x.flat[0].dtype
            new = update if combine is None else self.map_elements(combine, [x[window], update], dtype)
            x[window] = new if here is None else self.map_elements(
                "select", [np.full(update.shape, here, object), new, x[window]], dtype)  # fmt: skip

    def clamp_index(self, start: Node, most: int) -> Node:
        """Clamp an index to 0 .. `most`."""
        if start.dtype != "int32":
            start = self.emit("convert", "int32", start)
        zero, top = (self.program.constant_node(v, "int32") for v in (0, most))
        return self.emit("min", "int32", self.emit("max", "int32", start, zero), top)


def build_array(shape: tuple, element: Callable[[tuple], Any]) -> Array:
    """Make an array of program nodes by calling `element` with each index."""
    out = np.empty(shape, object)
    for i in np.ndindex(shape):
        out[i] = element(i)
    return out


def slices_along_axis(x: Array, axis: int) -> list[Array]:
    """Return the slices of an array along an axis."""
    moved = np.moveaxis(x, axis, 0)
    return [moved[k, ...] for k in range(len(moved))]


def stack(arrays: Sequence[Array], axis: int = 0) -> Array:
    """Stack arrays along a new axis."""
    return np.stack(list(arrays), axis) if arrays else np.empty(0, object)


def _run_ends(cases: Sequence[Array]) -> list[int]:
    """Last index of each run of equal cases, except for the very last run."""
    return [
        k for k, (a, b) in enumerate(pairwise(cases)) if any(x is not y for x, y in zip(a.flat, b.flat, strict=True))
    ]
