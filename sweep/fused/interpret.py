"""Translation of the program that JAX traces for one rollout into operations on single numbers.

Calls, loops and branches are handled here. A primitive without a rule raises `Unsupported`.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import numpy as np
from jax.extend import core

from sweep.fused import maths
from sweep.fused.arrays import Array, ArrayBuilder, RowUpdate, UnsupportedPrimitive, build_array, stack
from sweep.fused.jaxprs import inner_jaxprs, open_jaxpr, split_scan_operands
from sweep.fused.operations import REDUCTIONS
from sweep.fused.program import Branch, LoopCount, MemoryAddress, MemoryRegion, Node, constant_value, is_uniform
from sweep.fused.rules import MULTI_RESULT_RULES, RULES

CALL_PRIMITIVES = {"jit": "jaxpr", "pjit": "jaxpr", "closed_call": "call_jaxpr", "core_call": "call_jaxpr",
                   "checkpoint": "jaxpr", "custom_jvp_call": "call_jaxpr", "custom_vjp_call": "call_jaxpr"}  # fmt: skip
ELEMENTWISE = frozenset("""
    abs add and ceil div eq floor ge gt is_finite le lt max min mul ne neg not or pow round shift_left
    shift_right_arithmetic shift_right_logical sqrt sub xor bitcast_convert_type
""".split())  # fmt: skip  # noqa: SIM905
RENAMED_PRIMITIVES = {"stop_gradient": None, "copy": None, "optimization_barrier": None, "add_any": "add"}
MAX_UNROLLED_OPERATIONS = 1000  # operations up to which a loop is unrolled


class JaxprInterpreter(ArrayBuilder):
    """Interprets a jaxpr by the rules for its primitives and writes a `Program`."""

    def evaluate_jaxpr(
        self, jaxpr: Any, consts: Sequence[Any], args: Sequence[Array | RowUpdate]
    ) -> list[Array | RowUpdate]:
        """Add the operations of a jaxpr to the program.

        Args:
            jaxpr: the program that JAX traced.
            consts: its constants.
            args: its arguments, arrays of nodes.

        Returns:
            Its results, arrays of nodes.
        """
        known: dict[Any, Array | RowUpdate] = {}

        def read(atom: Any) -> Array | RowUpdate:
            if isinstance(atom, core.Literal):
                aval: Any = atom.aval
                return self.constant(np.asarray(atom.val, aval.dtype))
            return known[atom]

        known |= zip(jaxpr.constvars, (self.constant(x) for x in consts), strict=True)
        known |= zip(jaxpr.invars, args, strict=True)
        for eqn in jaxpr.eqns:
            known |= zip(eqn.outvars, self.apply_equation(eqn, [read(atom) for atom in eqn.invars]), strict=True)
        return [read(atom) for atom in jaxpr.outvars]

    def apply_equation(self, eqn: Any, args: list[Array | RowUpdate]) -> list[Array | RowUpdate]:
        """Add one jaxpr equation, applied to `args`, to the program."""
        name, params = eqn.primitive.name, eqn.params
        if name in CALL_PRIMITIVES:
            inner = params[CALL_PRIMITIVES[name]]
            return self.evaluate_jaxpr(open_jaxpr(inner), getattr(inner, "consts", ()), args)
        if not eqn.outvars:
            return []
        out = eqn.outvars[0].aval
        if name in RENAMED_PRIMITIVES and RENAMED_PRIMITIVES[name] is None:
            return args
        args = [self.apply_row_update(x) for x in args]
        if name in ("scan", "cond", "while"):
            return getattr(self, f"_{name}")(args, eqn)
        if rule := MULTI_RESULT_RULES.get(name):
            return rule(args, eqn)
        if name in ELEMENTWISE or name in RENAMED_PRIMITIVES:
            return [self.map_elements(RENAMED_PRIMITIVES.get(name) or name, args, out.dtype.name)]
        if name in REDUCTIONS:
            return [self.reduce(REDUCTIONS[name], args[0], params["axes"], out.dtype)]
        if rule := RULES.get(name):
            return [rule(self, *args, out=out, **params)]
        single = all(v.aval.dtype == np.float32 for v in eqn.invars)
        if expansion := maths.EXPANSIONS.get(name) or (single and maths.SINGLE_PRECISION_EXPANSIONS.get(name)):
            return [self.expand_primitive_by_tracing(expansion, args, [v.aval.dtype for v in eqn.invars])]
        if name in maths.SINGLE_PRECISION_EXPANSIONS:
            return [self.map_elements(name, args, out.dtype.name)]
        raise UnsupportedPrimitive(name)

    def expand_primitive_by_tracing(self, function: Callable, args: Sequence[Array], dtypes: Sequence[Any]) -> Array:
        """Add an operation to the program by tracing `function`, which writes it in other JAX primitives.

        Args:
            function: function of JAX arrays.
            args: operands, arrays of nodes.
            dtypes: their types.
        """
        shapes = [jax.ShapeDtypeStruct(x.shape, dtype) for x, dtype in zip(args, dtypes, strict=True)]
        traced = jax.make_jaxpr(function)(*shapes)
        return self.apply_row_update(self.evaluate_jaxpr(traced.jaxpr, traced.consts, args)[0])

    def _scan(self, args: list[Array], eqn: Any) -> list[Array]:
        """A loop; a short one is unrolled."""
        closed, length = eqn.params["jaxpr"], eqn.params["length"]
        inner = closed.jaxpr
        consts, carry, xs = split_scan_operands(eqn, args)
        n_carry = len(carry)
        if (
            n_carry < len(eqn.outvars)
            or eqn.params["reverse"]
            or length * _operations(inner) <= MAX_UNROLLED_OPERATIONS
        ):
            steps = range(length)
            ys = []
            for k in reversed(steps) if eqn.params["reverse"] else steps:
                results = self.evaluate_jaxpr(inner, closed.consts, [*consts, *carry, *(x[k, ...] for x in xs)])
                carry = results[:n_carry]
                ys.append([self.apply_row_update(y) for y in results[n_carry:]])
            ys = ys[::-1] if eqn.params["reverse"] else ys
            return [*carry, *(stack(each) for each in zip(*ys, strict=True))]
        outside = len(self.program.blocks) - 1
        regions = [self._saved(x, outside + 1) for x in carry]
        tables = [self._saved(x, outside + 1) for x in xs]
        with self.program.open_loop(length) as loop:
            body = loop.body
            count = self.program.get_or_add_node("count", (), "int32", LoopCount(body.depth))
            state = [self.load_array(r, x.shape, body.depth) for r, x in zip(regions, carry, strict=True)]
            here = [self._looked_up(r, x.shape[1:], count) for r, x in zip(tables, xs, strict=True)]
            results = self.evaluate_jaxpr(inner, closed.consts, [*consts, *state, *here])
            for region, result in zip(regions, results, strict=True):
                self.store_array(region, result, body.stores)
        return [self.load_array(r, x.shape, outside) for r, x in zip(regions, carry, strict=True)]

    def _while(self, args: list[Array], eqn: Any) -> list[Array]:
        """A loop that ends when no rollout of the warp or vector goes on; one that does not go on keeps its values.

        The body runs at least once, which changes nothing for rollouts that do not want it.
        """
        params, n_cond, n_body = eqn.params, eqn.params["cond_nconsts"], eqn.params["body_nconsts"]
        cond, body, carry = args[:n_cond], args[n_cond : n_cond + n_body], args[n_cond + n_body :]

        def goes_on(state: list[Array]) -> Node:
            (result,) = self._results(params["cond_jaxpr"], [*cond, *state])
            return result[()]

        outside = len(self.program.blocks) - 1
        carry = [np.full((), goes_on(carry), object), *carry]
        regions = [self._saved(x, outside + 1) for x in carry]
        with self.program.open_loop(None) as loop:
            flag, *state = (self.load_array(r, x.shape, loop.body.depth) for r, x in zip(regions, carry, strict=True))
            new = self._select(flag[()], state, self._results(params["body_jaxpr"], [*body, *state]))
            more = self.emit("and", "bool", flag[()], goes_on(new))
            for region, result in zip(regions, [np.full((), more, object), *new], strict=True):
                self.store_array(region, result, loop.body.stores)
            loop.continue_flag = self.program.get_or_add_node("any_rollout", (more,), "bool")
        return [self.load_array(r, x.shape, outside) for r, x in zip(regions[1:], carry[1:], strict=True)]

    def _results(self, closed: Any, args: list[Array]) -> list[Array]:
        return [self.apply_row_update(x) for x in self.evaluate_jaxpr(closed.jaxpr, closed.consts, args)]

    def _select(self, flag: Node, old: list[Array], new: list[Array]) -> list[Array]:
        """The new values where the flag is set."""
        return [self.select_by_index(np.full(x.shape, flag, object), [y, x]) for y, x in zip(old, new, strict=True)]

    def _saved(self, x: Array, depth: int) -> MemoryRegion | None:
        """Memory that holds `x` from here on."""
        if not x.size:
            return None
        region = MemoryRegion(x.size, x.flat[0].dtype, depth)
        self.store_array(region, x, self.program.blocks[-1].items)
        return region

    def _looked_up(self, region: Any, shape: tuple, count: Node) -> Array:
        size = math.prod(shape)
        place = self.emit("mul", "int32", count, self.program.constant_node(size, "int32"))
        at = np.arange(size).reshape(shape)
        return build_array(shape, lambda i: self._gathered(region, int(at[i]), place))

    def _gathered(self, region: MemoryRegion, index: int, place: Node) -> Node:
        return self.program.get_or_add_node(
            "gather", (place,), region.dtype, MemoryAddress(region, index, region.depth, 0), leg=False
        )

    def _cond(self, args: list[Array], eqn: Any) -> list[Array]:
        """One branch if all rollouts agree, else all branches, of which each rollout takes one."""
        branches, (index, *operands) = eqn.params["branches"], args
        which = index[()]
        if which.op == "const":
            branch = branches[int(constant_value(which))]
            return self.evaluate_jaxpr(branch.jaxpr, branch.consts, operands)
        shapes = [v.aval for v in eqn.outvars]
        if is_uniform(which):
            return self._branch(
                which, [partial(self.evaluate_jaxpr, b.jaxpr, b.consts, operands) for b in branches], shapes
            )
        idle = next((k for k, b in enumerate(branches) if not b.jaxpr.eqns), None)
        if len(branches) == 2 and idle is not None:
            return self._skip(which, branches, operands, idle, shapes)
        each = [self._results(b, operands) for b in branches]
        return [self.select_by_index(index, list(values)) for values in zip(*each, strict=True)]

    def _skip(
        self, which: Node, branches: Sequence[Any], operands: list[Array], idle: int, shapes: list[Any]
    ) -> list[Array]:
        """A choice between computing something and nothing, skipped where no rollout of the warp or vector computes."""
        busy = self.emit("ne", "bool", which, self.program.constant_node(idle, which.dtype))
        unchanged = partial(self._results, branches[idle], operands)

        def compute() -> list[Array]:
            return self._select(busy, unchanged(), self._results(branches[1 - idle], operands))

        anyone = self.program.get_or_add_node("any_rollout", (busy,), "bool")
        return self._branch(anyone, [unchanged, compute], shapes, hoists=True)

    def _branch(
        self, which: Node, alternatives: Sequence[Callable[[], list]], shapes: list[Any], hoists: bool = False
    ) -> list[Array]:
        """Results of the alternative of number `which`, the same for all rollouts of a warp or vector."""
        depth = len(self.program.blocks) - 1
        regions = [MemoryRegion(math.prod(s.shape), s.dtype.name, depth) for s in shapes]
        blocks = []
        for alternative in alternatives:
            with self.program.open_branch(hoists) as block:
                for region, result in zip(regions, alternative(), strict=True):
                    self.store_array(region, result, block.stores)
            blocks.append(block)
        self.program.append_item(Branch(which, blocks))
        return [self.load_array(r, s.shape, depth) for r, s in zip(regions, shapes, strict=True)]


def _operations(jaxpr: Any) -> int:
    """Number of operations on whole arrays in a jaxpr, those of inner ones included."""
    total = 0
    for eqn in jaxpr.eqns:
        inner = inner_jaxprs(eqn)
        times = eqn.params.get("length", 1) if eqn.primitive.name == "scan" else 1
        total += times * sum(map(_operations, inner)) if inner else sum(
            max(1, math.prod(v.aval.shape)) for v in eqn.outvars)  # fmt: skip
    return total
