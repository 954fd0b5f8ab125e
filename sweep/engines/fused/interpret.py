"""From the program that JAX traces for one rollout to operations on single numbers.

An array is a NumPy array of nodes of the same shape; moving numbers about is NumPy's own indexing of it and makes no
operation. Where an axis of six holds what one operation gives for the legs, the operation on it is one for the legs
too. What has no rule raises `Unsupported`.
"""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise, product
from typing import Any

import jax
import numpy as np
from jax.extend import core

from sweep.engines.fused import maths, randomness
from sweep.engines.fused.operations import fold, simplified
from sweep.engines.fused.program import LEGS, Branch, Node, Program, Region, Store, value_of

CALLS = {"jit": "jaxpr", "pjit": "jaxpr", "closed_call": "call_jaxpr", "core_call": "call_jaxpr", "checkpoint": "jaxpr",
         "custom_jvp_call": "call_jaxpr", "custom_vjp_call": "call_jaxpr"}  # fmt: skip
ELEMENTWISE = frozenset("""
    abs add and ceil div eq floor ge gt is_finite le lt max min mul ne neg not or pow round shift_left
    shift_right_arithmetic shift_right_logical sqrt sub xor bitcast_convert_type
""".split())  # fmt: skip  # noqa: SIM905
ALIAS = {"stop_gradient": None, "copy": None, "optimization_barrier": None, "add_any": "add"}
REDUCTIONS = {"reduce_sum": "add", "reduce_max": "max", "reduce_min": "min", "reduce_and": "and", "reduce_or": "or",
              "reduce_prod": "mul"}  # fmt: skip
EMPTY = {"add": 0, "mul": 1, "or": False, "and": True, "max": -np.inf, "min": np.inf}  # of no numbers at all
UNROLLED = 1000  # operations up to which a loop is written out
CHAIN = 64  # places that a number may be chosen from, where it is not in memory

Array = Any  # of NumPy, of nodes


class Unsupported(Exception):
    """A primitive, or a form of it, that has no rule."""


class Interpreter:
    """Rules for JAX's primitives, writing a `Program`."""

    def __init__(self, program: Program):
        self.program = program

    def evaluate(self, jaxpr: Any, consts: Sequence[Any], args: Sequence[Array]) -> list[Array]:
        """Results of `jaxpr` on arrays of nodes."""
        known: dict[Any, Array] = {}

        def read(atom: Any) -> Array:
            if isinstance(atom, core.Literal):
                aval: Any = atom.aval
                return self.constant(np.asarray(atom.val, aval.dtype))
            return known[atom]

        known |= zip(jaxpr.constvars, (self.constant(x) for x in consts), strict=True)
        known |= zip(jaxpr.invars, args, strict=True)
        for eqn in jaxpr.eqns:
            known |= zip(eqn.outvars, self.apply(eqn, [read(atom) for atom in eqn.invars]), strict=True)
        return [read(atom) for atom in jaxpr.outvars]

    def constant(self, value: Any) -> Array:
        """An array of constants."""
        value = np.asarray(value)
        return _filled(value.shape, lambda at: self.program.const(value[at], value.dtype.name))

    def apply(self, eqn: Any, args: list[Array]) -> list[Array]:
        """Results of one operation of JAX."""
        name, params = eqn.primitive.name, eqn.params
        if name in CALLS:
            inner = params[CALLS[name]]
            return self.evaluate(getattr(inner, "jaxpr", inner), getattr(inner, "consts", ()), args)
        if not eqn.outvars:
            return []
        out = eqn.outvars[0].aval
        if name in ALIAS and ALIAS[name] is None:
            return args
        if rule := MANY.get(name):
            return rule(self, args, eqn)
        if name in ELEMENTWISE or name in ALIAS:
            return [self.lift(ALIAS.get(name) or name, args, out.dtype.name)]
        if name in REDUCTIONS:
            return [self.reduce(REDUCTIONS[name], args[0], params["axes"], out.dtype)]
        if rule := RULES.get(name):
            return [rule(self, *args, out=out, **params)]
        single = all(v.aval.dtype == np.float32 for v in eqn.invars)
        if expansion := maths.EXPANSIONS.get(name) or (single and maths.SINGLE.get(name)):
            return [self.written(expansion, args, [v.aval.dtype for v in eqn.invars])]
        if name in maths.SINGLE:
            return [self.lift(name, args, out.dtype.name)]
        raise Unsupported(name)

    def written(self, function: Callable, args: Sequence[Array], dtypes: Sequence[Any]) -> Array:
        """What `function` gives, which is written in other primitives."""
        shapes = [jax.ShapeDtypeStruct(x.shape, dtype) for x, dtype in zip(args, dtypes, strict=True)]
        traced = jax.make_jaxpr(function)(*shapes)
        return self.evaluate(traced.jaxpr, traced.consts, args)[0]

    # arithmetic

    def op(self, name: str, dtype: str, *args: Node) -> Node:
        """An operation on numbers, simplified."""
        if all(x.op == "const" for x in args):
            value = fold(name, dtype, [value_of(x) for x in args])
            return self.program.const(tuple(value) if np.ndim(value) else value, dtype)
        if (simple := simplified(name, args)) is not None:
            return simple
        if name == "neg" and args[0].op == "neg":
            return args[0].args[0]
        return self.program.node(name, args, dtype)

    def lift(self, name: str, args: Sequence[Array], dtype: str) -> Array:
        """An operation number by number, for the legs at once along an axis of theirs."""
        whole: list[Array] = list(np.broadcast_arrays(*args)) if len(args) > 1 else list(args)
        shape = whole[0].shape
        axis = next((a for a in range(len(shape)) if shape[a] == LEGS and self._over_legs(whole, a)), None)
        if axis is None:
            return _filled(shape, lambda at: self.op(name, dtype, *(x[at] for x in whole)))
        whole = [np.moveaxis(x, axis, -1) for x in whole]
        result = np.empty(whole[0].shape, object)
        for at in np.ndindex(result.shape[:-1]):
            rows = [x[at] for x in whole]
            if (legs := self._legs(rows)) is None:
                for k in range(LEGS):
                    result[(*at, k)] = self.op(name, dtype, *[row[k] for row in rows])
            else:
                result[at] = self.parts(self.op(name, dtype, *legs))
        return np.moveaxis(result, -1, axis)

    def parts(self, node: Node) -> list[Node]:
        """What a node gives for each leg."""
        if not node.leg:
            return [node] * LEGS
        if node.op == "const":
            return [self.program.const(value, node.dtype) for value in value_of(node)]
        if node.op in ("load", "gather"):
            region, index, depth, step = node.extra
            places = [(region, index + k * step, depth, 0) for k in range(LEGS)]
            return [self.program.node(node.op, node.args, node.dtype, place, leg=False) for place in places]
        return [self.program.node("part", (node,), node.dtype, k, leg=False) for k in range(LEGS)]

    def _over_legs(self, arrays: Sequence[Array], axis: int) -> bool:
        """Whether the first row along `axis` is one for the legs."""
        rows = [np.moveaxis(x, axis, -1).reshape(-1, LEGS) for x in arrays]
        return bool(rows[0].size) and self._legs([row[0] for row in rows]) is not None

    def _legs(self, rows: Sequence[Array]) -> list[Node] | None:
        """Rows of six numbers as nodes for the legs; None where that saves nothing."""
        found = [self._leg(row) for row in rows]
        if not any(x is not None and x.leg for x in found):
            return None
        if any(x is None for x in found) and not any(x is not None and x.leg and x.op != "const" for x in found):
            return None
        return [self._packed(row) if x is None else x for x, row in zip(found, rows, strict=True)]

    def _packed(self, row: Array) -> Node:
        return self.program.node("pack", tuple(row), row[0].dtype, leg=True)

    def _leg(self, row: Array) -> Node | None:
        """One node for six numbers: the same for all, parts of one, or alike in memory."""
        first, second = row[0], row[1]
        if all(x is first for x in row):
            return first
        if first.op != second.op:
            return None
        if first.op == "part":
            whole = first.args[0]
            return (
                whole
                if all(x.op == "part" and x.args[0] is whole and x.extra == k for k, x in enumerate(row))
                else None
            )
        if first.op == "const":
            same = all(x.op == "const" for x in row)
            return self.program.const(tuple(value_of(x) for x in row), first.dtype) if same else None
        if first.op in ("load", "gather"):
            region, index, depth, _ = first.extra
            step = second.extra[1] - index
            for k, x in enumerate(row):
                if x.op != first.op or x.args != first.args or x.extra != (region, index + k * step, depth, 0):
                    return None
            return self.program.node(first.op, first.args, first.dtype, (region, index, depth, step), leg=True)
        return None

    def reduce(self, name: str, x: Array, axes: Sequence[int], dtype: Any) -> Array:
        """Along `axes`, in order; over the legs last."""
        kept = [d for d in range(x.ndim) if d not in axes]
        if not x.size:
            return self.constant(np.full([x.shape[d] for d in kept], EMPTY[name], dtype))
        rows = np.transpose(x, (*kept, *axes))
        legs = next((k for k, a in enumerate(axes) if x.shape[a] == LEGS and self._over_legs([x], a)), None)
        if legs is not None:
            rows = np.moveaxis(rows, len(kept) + legs, -1)
        shape = tuple(x.shape[d] for d in kept)

        def total(at: tuple) -> Node:
            row = rows[at].reshape(-1, LEGS) if legs is not None else rows[at].reshape(-1)
            if legs is None:
                return self._fold(name, list(row))
            found = [self._legs([six]) for six in row]
            if any(one is None for one in found):
                return self._fold(name, list(row.ravel()))
            whole = self._fold(name, [one[0] for one in found if one is not None])
            return (
                self.program.node("over_legs", (whole,), whole.dtype, name, leg=False)
                if whole.leg
                else self._fold(name, [whole] * LEGS)
            )

        return _filled(shape, total)

    def _fold(self, name: str, row: list[Node]) -> Node:
        total = row[0]
        for x in row[1:]:
            total = self.op(name, total.dtype, total, x)
        return total

    # loops and branches

    def scan(self, args: list[Array], eqn: Any) -> list[Array]:
        """A loop, written out where it is short."""
        closed, length = eqn.params["jaxpr"], eqn.params["length"]
        inner = closed.jaxpr
        n_xs = sum(x.ndim != y.aval.ndim for x, y in zip(args, inner.invars, strict=True))
        n_ys = sum(x.aval.ndim != y.aval.ndim for x, y in zip(eqn.outvars, inner.outvars, strict=True))
        n_carry = len(eqn.outvars) - n_ys
        n_consts = len(args) - n_carry - n_xs
        consts, carry, xs = args[:n_consts], args[n_consts : n_consts + n_carry], args[n_consts + n_carry :]
        if n_ys or eqn.params["reverse"] or length * _operations(inner) <= UNROLLED:
            steps = range(length)
            ys = []
            for k in reversed(steps) if eqn.params["reverse"] else steps:
                results = self.evaluate(inner, closed.consts, [*consts, *carry, *(x[k, ...] for x in xs)])
                carry = results[:n_carry]
                ys.append(results[n_carry:])
            ys = ys[::-1] if eqn.params["reverse"] else ys
            return [*carry, *(_stacked(each) for each in zip(*ys, strict=True))]
        outside = len(self.program.blocks) - 1
        regions = [self._saved(x, outside + 1) for x in carry]
        tables = [self._saved(x, outside + 1) for x in xs]
        with self.program.loop(length) as body:
            count = self.program.node("count", (), "int32", body.depth)
            state = [self.loaded(r, x.shape, body.depth) for r, x in zip(regions, carry, strict=True)]
            here = [self._looked_up(r, x.shape[1:], count) for r, x in zip(tables, xs, strict=True)]
            results = self.evaluate(inner, closed.consts, [*consts, *state, *here])
            for region, result in zip(regions, results, strict=True):
                self.save(region, result, body.stores)
        return [self.loaded(r, x.shape, outside) for r, x in zip(regions, carry, strict=True)]

    def _saved(self, x: Array, depth: int) -> Region | None:
        """Memory that holds `x` from here on."""
        if not x.size:
            return None
        region = Region(x.size, x.flat[0].dtype, depth)
        self.save(region, x, self.program.blocks[-1].items)
        return region

    def save(self, region: Region | None, x: Array, items: list[Any]) -> None:
        """Have an array put into memory; what is there already is left."""
        if region is None:
            return
        rows = (
            np.moveaxis(np.arange(x.size).reshape(x.shape), 0, -1).reshape(-1, LEGS)
            if x.ndim and x.shape[0] == LEGS
            else ()
        )
        done = set()
        for row in rows:
            if (leg := self._leg(x.ravel()[row])) is not None and leg.leg and leg.op not in ("load", "gather"):
                items.append(Store(region, int(row[0]), leg, int(row[1] - row[0])))
                done.update(row.tolist())
        for k, node in enumerate(x.flat):
            unchanged = node.op == "load" and node.extra[:2] == (region, k)
            if k not in done and not unchanged:
                items.append(Store(region, k, node))

    def loaded(self, region: Any, shape: tuple, depth: int) -> Array:
        """An array in memory, as it is in the block at `depth`."""
        at = np.arange(math.prod(shape)).reshape(shape)
        return _filled(shape, lambda i: self.load(region, int(at[i]), depth))

    def load(self, region: Region, index: int, depth: int) -> Node:
        """A number in memory, as it is in the block at `depth`."""
        return self.program.node("load", (), region.dtype, (region, index, depth, 0), leg=False)

    def _looked_up(self, region: Any, shape: tuple, count: Node) -> Array:
        size = math.prod(shape)
        place = self.op("mul", "int32", count, self.program.const(size, "int32"))
        at = np.arange(size).reshape(shape)
        return _filled(shape, lambda i: self._gathered(region, int(at[i]), place))

    def _gathered(self, region: Region, index: int, place: Node) -> Node:
        return self.program.node("gather", (place,), region.dtype, (region, index, region.depth, 0), leg=False)

    def cond(self, args: list[Array], eqn: Any) -> list[Array]:
        """One of the branches where all rollouts go the same way, else all of them."""
        branches, (index, *operands) = eqn.params["branches"], args
        which = index[()]
        if not uniform(which):
            each = [self.evaluate(b.jaxpr, b.consts, operands) for b in branches]
            return [self.choose(index, list(values)) for values in zip(*each, strict=True)]
        depth = len(self.program.blocks) - 1
        shapes = [v.aval for v in eqn.outvars]
        regions = [Region(math.prod(s.shape), s.dtype.name, depth) for s in shapes]
        blocks = []
        for b in branches:
            with self.program.branch() as block:
                results = self.evaluate(b.jaxpr, b.consts, operands)
                for region, result in zip(regions, results, strict=True):
                    self.save(region, result, block.stores)
            blocks.append(block)
        self.program.add(Branch(which, blocks))
        return [self.loaded(r, s.shape, depth) for r, s in zip(regions, shapes, strict=True)]

    def choose(self, index: Array, cases: Sequence[Array]) -> Array:
        """The case of `index`."""
        dtype = cases[0].flat[0].dtype if cases[0].size else "float32"
        if len(cases) == 2 and (not index.size or index.flat[0].dtype == "bool"):
            return self.lift("select", [index, cases[1], cases[0]], dtype)
        result = cases[-1]
        for k in reversed(_ends(cases)):
            first = self.lift("le", [index, self.constant(np.int32(k))], "bool")
            result = self.lift("select", [first, cases[k], result], dtype)
        return result

    # where the place depends on the rollout

    def _memory(self, x: Array) -> tuple[Region, int, int] | None:
        """Region, first place and depth of an array that lies in memory as it is."""
        if not x.size or x.flat[0].op != "load":
            return None
        region, first, depth, _ = x.flat[0].extra
        lies = all(n.op == "load" and n.extra == (region, first + k, depth, 0) for k, n in enumerate(x.flat))
        return (region, first, depth) if lies else None

    def pick(self, x: Array, starts: Sequence[Node], sizes: Sequence[int]) -> Array:
        """The part of `x` of `sizes` that begins at `starts`, which are put within it."""
        last = [n - size for n, size in zip(x.shape, sizes, strict=True)]
        starts = [self._within(s, most) for s, most in zip(starts, last, strict=True)]
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
            return _filled(at.shape, lambda i: self.program.node(
                "gather", (place,), region.dtype, (region, first + int(at[i]), depth, 0), leg=False))  # fmt: skip
        x = x[known]
        many = 1
        for d in moving:
            windows = [np.take(x, range(k, k + sizes[d]), axis=d) for k in range(last[d] + 1)]
            many *= len(_ends(windows)) + 1
            if many > CHAIN:
                raise Unsupported("a choice among many numbers that are not in memory")
            x = self.choose(np.full(windows[0].shape, starts[d], object), windows)
        return x

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

    def _within(self, start: Node, most: int) -> Node:
        if start.dtype != "int32":
            start = self.op("convert", "int32", start)
        zero, top = (self.program.const(v, "int32") for v in (0, most))
        return self.op("min", "int32", self.op("max", "int32", start, zero), top)


def uniform(node: Node) -> bool:
    """Whether it is the same for all rollouts: worked out from constants and counters alone."""
    return node.op in ("const", "count", "tick") or (
        bool(node.args) and node.op not in ("gather", "pack") and all(uniform(x) for x in node.args)
    )


def _ends(cases: Sequence[Array]) -> list[int]:
    """The last of every run of cases that are the same, but for that of the very last."""
    return [
        k for k, (a, b) in enumerate(pairwise(cases)) if any(x is not y for x, y in zip(a.flat, b.flat, strict=True))
    ]


def _filled(shape: tuple, at: Callable[[tuple], Any]) -> Array:
    out = np.empty(shape, object)
    for i in np.ndindex(shape):
        out[i] = at(i)
    return out


def _rows(x: Array, axis: int) -> list[Array]:
    moved = np.moveaxis(x, axis, 0)
    return [moved[k, ...] for k in range(len(moved))]


def _stacked(arrays: Sequence[Array], axis: int = 0) -> Array:
    return np.stack(list(arrays), axis) if arrays else np.empty(0, object)


def _operations(jaxpr: Any) -> int:
    """Of a program on whole arrays, those of inner ones with it."""
    total = 0
    for eqn in jaxpr.eqns:
        inner = [v for v in eqn.params.values() if hasattr(v, "eqns") or hasattr(v, "jaxpr")]
        times = eqn.params.get("length", 1) if eqn.primitive.name == "scan" else 1
        total += times * sum(_operations(getattr(i, "jaxpr", i)) for i in inner) if inner else sum(
            max(1, math.prod(v.aval.shape)) for v in eqn.outvars)  # fmt: skip
    return total


# rules: a method of what is above, arrays, then the primitive's parameters


def _convert(self: Interpreter, x: Array, out: Any, **_: Any) -> Array:
    return x if not x.size or x.flat[0].dtype == out.dtype.name else self.lift("convert", [x], out.dtype.name)


def _integer_pow(self: Interpreter, x: Array, out: Any, y: int, **_: Any) -> Array:
    dtype = out.dtype.name
    if y == 0:
        return np.broadcast_to(self.constant(np.ones((), dtype)), x.shape)
    result: Any = None
    power = x
    for bit in bin(abs(y))[:1:-1]:
        if bit == "1":
            result = power if result is None else self.lift("mul", [result, power], dtype)
        power = self.lift("mul", [power, power], dtype)
    return result if y > 0 else self.lift("div", [self.constant(np.ones((), dtype)), result], dtype)


def _clamp(self: Interpreter, low: Array, x: Array, high: Array, out: Any, **_: Any) -> Array:
    return self.lift("min", [self.lift("max", [x, low], out.dtype.name), high], out.dtype.name)


def _polynomial(self: Interpreter, x: Array, *coefficients: Array, out: Any, **_: Any) -> Array:
    total = np.broadcast_to(coefficients[-1], x.shape)
    for c in reversed(coefficients[:-1]):
        total = self.lift("add", [self.lift("mul", [total, x], out.dtype.name), c], out.dtype.name)
    return total


def _broadcast_in_dim(
    self: Interpreter, x: Array, *_: Any, out: Any, shape: tuple, broadcast_dimensions: tuple, **__: Any
) -> Array:
    index = [1] * len(shape)
    for d, n in zip(broadcast_dimensions, x.shape, strict=True):
        index[d] = n
    return np.broadcast_to(x.reshape(index), shape)


def _slice(
    self: Interpreter, x: Array, out: Any, start_indices: tuple, limit_indices: tuple, strides: tuple | None
) -> Array:
    steps = strides or (1,) * x.ndim
    return x[tuple(map(slice, start_indices, limit_indices, steps))]


def _pad(self: Interpreter, x: Array, value: Array, out: Any, padding_config: tuple) -> Array:
    if any(low < 0 or high < 0 for low, high, _ in padding_config):
        raise Unsupported("pad by less than nothing")
    result = np.full(out.shape, value[()], object)
    result[tuple(slice(low, low + (n - 1) * (inner + 1) + 1 if n else low, inner + 1)
                 for (low, _, inner), n in zip(padding_config, x.shape, strict=True))] = x  # fmt: skip
    return result


def _iota(self: Interpreter, *_: Any, out: Any, dimension: int, **__: Any) -> Array:
    return self.constant(np.moveaxis(np.broadcast_to(
        np.arange(out.shape[dimension], dtype=out.dtype), (*np.delete(out.shape, dimension), out.shape[dimension])
    ), -1, dimension))  # fmt: skip


def _dot_general(self: Interpreter, a: Array, b: Array, out: Any, dimension_numbers: tuple, **_: Any) -> Array:
    (of_a, of_b), (batch_a, batch_b) = dimension_numbers
    free_a = [d for d in range(a.ndim) if d not in (*of_a, *batch_a)]
    free_b = [d for d in range(b.ndim) if d not in (*of_b, *batch_b)]
    a = np.transpose(a, (*batch_a, *free_a, *of_a))
    b = np.transpose(b, (*batch_b, *free_b, *of_b))
    n, m = len(batch_a), len(of_a)
    a = a.reshape((*a.shape[: n + len(free_a)], *[1] * len(free_b), *a.shape[a.ndim - m :]))
    b = b.reshape((*b.shape[:n], *[1] * len(free_a), *b.shape[n:]))
    products = self.lift("mul", [a, b], out.dtype.name)
    return self.reduce("add", products, tuple(range(products.ndim - m, products.ndim)), out.dtype)


def _argmax(better: str) -> Callable:
    def rule(self: Interpreter, x: Array, out: Any, axes: tuple, **_: Any) -> Array:
        (axis,) = axes
        rows = _rows(x, axis)
        best, index = rows[0], np.broadcast_to(self.constant(np.zeros((), out.dtype)), rows[0].shape)
        for k in range(1, len(rows)):
            if x.flat[0].dtype == "bool":
                here = self.lift("and", [rows[k], self.lift("not", [best], "bool")], "bool")
            else:  # the first NaN wins
                nan = self.lift(
                    "and", [self.lift("ne", [rows[k], rows[k]], "bool"), self.lift("eq", [best, best], "bool")], "bool"
                )
                here = self.lift("or", [self.lift(better, [rows[k], best], "bool"), nan], "bool")
            best = self.lift("select", [here, rows[k], best], x.flat[0].dtype)
            index = self.lift("select", [here, self.constant(np.asarray(k, out.dtype)), index], out.dtype.name)
        return index

    return rule


def _cumulative(name: str) -> Callable:
    def rule(self: Interpreter, x: Array, out: Any, axis: int, reverse: bool) -> Array:
        rows = _rows(x, axis)
        rows = rows[::-1] if reverse else rows
        for k in range(1, len(rows)):
            rows[k] = self.lift(name, [rows[k - 1], rows[k]], out.dtype.name)
        return np.moveaxis(_stacked(rows[::-1] if reverse else rows), 0, axis)

    return rule


def _dynamic_slice(self: Interpreter, x: Array, *starts: Array, out: Any, slice_sizes: tuple) -> Array:
    return self.pick(x, [s[()] for s in starts], slice_sizes)


def _dynamic_update_slice(self: Interpreter, x: Array, update: Array, *starts: Array, out: Any) -> Array:
    result = x.copy()
    within = [self._within(s[()], n - m) for s, n, m in zip(starts, x.shape, update.shape, strict=True)]
    self.put(result, update, dict(enumerate(within)), None)
    return result


def _gather(
    self: Interpreter,
    x: Array,
    indices: Array,
    out: Any,
    dimension_numbers: Any,
    slice_sizes: tuple,
    mode: Any,
    **rest: Any,
) -> Array:
    dims = dimension_numbers
    batch = [d for d in range(len(out.shape)) if d not in dims.offset_dims]
    kept = [d for d in range(x.ndim) if d not in (*dims.collapsed_slice_dims, *dims.operand_batching_dims)]
    result = np.empty(out.shape, object)
    for at in np.ndindex(*[out.shape[d] for d in batch]):
        starts = [self.program.const(0, "int32")] * x.ndim
        for k, d in enumerate(dims.start_index_map):
            starts[d] = indices[(*at, k)]
        for d, i in zip(dims.operand_batching_dims, dims.start_indices_batching_dims, strict=True):
            starts[d] = self.program.const(at[i], "int32")
        found = self.pick(x, starts, slice_sizes)
        if "FILL" in str(mode):
            inside = self.program.const(True, "bool")
            for s, n, size in zip(starts, x.shape, slice_sizes, strict=True):
                for test, edge in (("ge", 0), ("le", n - size)):
                    ok = self.op(test, "bool", s, self.program.const(edge, s.dtype))
                    inside = self.op("and", "bool", inside, ok)
            fill = rest.get("fill_value")
            empty = (
                np.nan
                if np.issubdtype(out.dtype, np.floating)
                else np.iinfo(out.dtype).min
                if out.dtype != bool
                else True
            )
            fill = self.constant(np.asarray(empty if fill is None else fill, out.dtype))
            found = self.lift(
                "select",
                [np.full(found.shape, inside, object), found, np.broadcast_to(fill, found.shape)],
                out.dtype.name,
            )
        place: list[Any] = [slice(None)] * len(out.shape)
        for d, i in zip(batch, at, strict=True):
            place[d] = i
        found = found.reshape([found.shape[d] for d in kept])
        result[tuple(place)] = found if found.ndim else found[()]
    return result


def _scatter(combine: str | None) -> Callable:
    def rule(
        self: Interpreter,
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
            raise Unsupported("scatter over batches")
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
                starts = {d: self._within(s, x.shape[d] - sizes[d]) for d, s in starts.items()}
            self.put(result, update, starts, combine)
        return result

    return rule


def _unstack(self: Interpreter, args: list[Array], eqn: Any) -> list[Array]:
    return _rows(args[0], eqn.params["axis"])


def _split(self: Interpreter, args: list[Array], eqn: Any) -> list[Array]:
    return np.split(args[0], np.cumsum(eqn.params["sizes"])[:-1], eqn.params["axis"])


MANY: dict[str, Callable] = {"scan": Interpreter.scan, "cond": Interpreter.cond, "unstack": _unstack, "split": _split}
RULES: dict[str, Callable] = {
    "convert_element_type": _convert,
    "integer_pow": _integer_pow,
    "square": lambda self, x, out, **_: self.lift("mul", [x, x], out.dtype.name),
    "rsqrt": lambda self, x, out, **_: self.lift(
        "div", [self.constant(np.ones((), out.dtype)), self.lift("sqrt", [x], out.dtype.name)], out.dtype.name
    ),
    "clamp": _clamp,
    "polynomial": _polynomial,
    "select_n": lambda self, index, *cases, out: self.choose(np.broadcast_to(index, out.shape), cases),
    "broadcast_in_dim": _broadcast_in_dim,
    "reshape": lambda self, x, *_, out, **__: x.reshape(out.shape),
    "squeeze": lambda self, x, out, **_: x.reshape(out.shape),
    "expand_dims": lambda self, x, out, **_: x.reshape(out.shape),
    "transpose": lambda self, x, out, permutation: np.transpose(x, permutation),
    "rev": lambda self, x, out, dimensions: np.flip(x, dimensions),
    "slice": _slice,
    "pad": _pad,
    "concatenate": lambda self, *xs, out, dimension: np.concatenate(xs, dimension),
    "stack": lambda self, *xs, out, axis: _stacked(xs, axis),
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
    "scatter": _scatter(None),
    "scatter-add": _scatter("add"),
    **randomness.rules(Unsupported),
}  # fmt: skip
