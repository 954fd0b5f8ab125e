"""Batching of a single-rollout function along the last axis, so that values of neighbouring rollouts are adjacent in
memory.

`jax.vmap` puts the batch first: a foot's three coordinates then lie side by side, and neither a CPU's vector units nor
a GPU's memory can take many rollouts at a time. `batch_last_vmap` goes through the same program operation by operation
and keeps the batch last. Products of small matrices become sums of products. Primitives without a rule use `jax.vmap`.

A CPU compiler fuses a value into every loop that uses it and computes it again in each. In a long program that
multiplies: it made a physics step twelve times as slow. So a value with several uses is kept in memory if computing it
again would take `reuse_from` operations or more.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.extend import core
from jax.extend.core import ClosedJaxpr  # pyright: ignore[reportPrivateImportUsage]
from jaxtyping import Array

from sweep.fused.interpret import CALL_PRIMITIVES
from sweep.fused.jaxprs import split_scan_operands

ELEMENTWISE = frozenset("""
    abs acos acosh add add_any and asin asinh atan atan2 atanh cbrt ceil clamp convert_element_type copy cos cosh div
    eq erf erf_inv erfc exp exp2 expm1 floor ge gt integer_pow is_finite le log log1p logistic lt max min mul ne neg
    nextafter not optimization_barrier or pow real reduce_precision rem round rsqrt select_n shift_left
    shift_right_arithmetic shift_right_logical sign sin sinh sqrt square stop_gradient sub tan tanh xor
""".split())  # fmt: skip  # noqa: SIM905
REDUCTIONS = frozenset(
    ("argmax", "argmin", "reduce_and", "reduce_max", "reduce_min", "reduce_or", "reduce_prod", "reduce_sum")
)
SAME_AXES = REDUCTIONS | {
    "cummax",
    "cummin",
    "cumprod",
    "cumsum",
    "rev",
    "squeeze",
}  # primitives whose axes count from the front
OPERATION_COSTS = {"convert_element_type": 0, "copy": 0, "div": 8, "sqrt": 8, "rsqrt": 8, "sin": 20, "cos": 20,
                   "atan2": 20,         "acos": 20, "pow": 20, "exp": 20,
                   "log": 20}  # of an operation, where it is not 1  # fmt: skip


class BatchOperand(NamedTuple):
    """A value in a batched program; its last axis is the batch, unless the value is the same for the whole batch."""

    value: Any
    is_batched: bool
    cost: int = 0  # operations to compute it again from values in memory


class BatchedProgramSettings(NamedTuple):
    """Settings of one batched program: the batch size, and the cost above which computed values are kept in memory."""

    size: int
    reuse_cost: int


def batch_last_vmap(function: Callable, in_axes: Sequence[Any], reuse_from: int) -> Callable:
    """Batch a function of one rollout along the last axis, like `jax.vmap` with the batch axis last.

    Equal to `jax.vmap(function, in_axes, out_axes=-1)` to round-off.

    Args:
        function: function of one rollout.
        in_axes: for each argument None (shared), -1 (batched along the last axis), or a tree of these.
        reuse_from: number of operations from which a value with several uses is kept in memory.

    Returns:
        The batched function; all its results have the batch as last axis.
    """

    def batched(*args: Any) -> Any:
        flat, tree = jax.tree.flatten(args)
        axes = [axis for arg, given in zip(args, in_axes, strict=True) for axis in _leaf_axes(arg, given)]
        inputs = [BatchOperand(jnp.asarray(x), axis is not None) for x, axis in zip(flat, axes, strict=True)]
        size = next(x.value.shape[-1] for x in inputs if x.is_batched)
        one = [jax.ShapeDtypeStruct(x.value.shape[: x.value.ndim - x.is_batched], x.value.dtype) for x in inputs]
        trace = jax.make_jaxpr(lambda *leaves: function(*jax.tree.unflatten(tree, leaves)), return_shape=True)
        program, shape = trace(*one)
        outputs = _evaluate(program, inputs, BatchedProgramSettings(size, reuse_from))
        return jax.tree.unflatten(jax.tree.structure(shape), [_broadcast_batch(out, size) for out in outputs])

    return batched


def _leaf_axes(arg: Any, axes: Any) -> list[int | None]:
    if axes is None or axes == -1:
        return [axes] * len(jax.tree.leaves(arg))
    return jax.tree.leaves(axes, is_leaf=lambda x: x is None)


def _broadcast_batch(x: BatchOperand, size: int) -> Array:
    """The value with its last axis over the batch."""
    value = jnp.asarray(x.value)
    return value if x.is_batched else jnp.broadcast_to(value[..., None], (*value.shape, size))


def _evaluate(
    program: ClosedJaxpr, inputs: Sequence[BatchOperand], batch: BatchedProgramSettings
) -> list[BatchOperand]:
    """Results of `program` on `inputs`."""
    jaxpr = program.jaxpr
    known: dict[Any, BatchOperand] = {}
    read_by = [*(eqn.invars for eqn in jaxpr.eqns), jaxpr.outvars]
    uses = Counter(atom for atoms in read_by for atom in atoms if not isinstance(atom, core.Literal))

    def read(atom: Any) -> BatchOperand:
        return BatchOperand(atom.val, False) if isinstance(atom, core.Literal) else known[atom]

    def write(atom: Any, operand: BatchOperand) -> None:
        if operand.is_batched and operand.cost >= batch.reuse_cost and uses[atom] > 1:
            operand = BatchOperand(lax.optimization_barrier(operand.value), True)
        known[atom] = operand

    for atom, value in zip(jaxpr.constvars, program.consts, strict=True):
        write(atom, BatchOperand(value, False))
    for atom, operand in zip(jaxpr.invars, inputs, strict=True):
        write(atom, operand)
    for eqn in jaxpr.eqns:
        results = _apply(eqn, [read(atom) for atom in eqn.invars], batch)
        for atom, result in zip(eqn.outvars, results, strict=True):
            write(atom, result)
    return [read(atom) for atom in jaxpr.outvars]


def _apply(eqn: Any, args: list[BatchOperand], batch: BatchedProgramSettings) -> list[BatchOperand]:
    """Results of one operation."""
    name, params, size = eqn.primitive.name, eqn.params, batch.size
    if name in CALL_PRIMITIVES:
        return _evaluate(_closed(params[CALL_PRIMITIVES[name]]), args, batch)
    if name == "scan":
        return _scan(eqn, args, batch)
    if name == "cond":
        return (_choose_branches if args[0].is_batched else _cond)(eqn, args, batch)
    if name == "while":
        return _while(eqn, args, batch)
    if not any(x.is_batched for x in args):
        return _results(eqn.primitive.bind(*[x.value for x in args], **params), False)
    cost = sum(x.cost for x in args)
    if name in ELEMENTWISE:
        return _results(_elementwise(eqn, args), True, cost + OPERATION_COSTS.get(name, 1))
    if name in SAME_AXES:
        terms = eqn.invars[0].aval.size // max(1, eqn.outvars[0].aval.size) if name in REDUCTIONS else 1
        return _results(eqn.primitive.bind(args[0].value, **params), True, terms * (cost + 1))
    rule = RULES.get(name)
    out = rule(args, size, **params) if rule else NotImplemented
    if out is not NotImplemented:
        terms = eqn.invars[0].aval.size if name == "dot_general" else 0
        return _results(out, True, cost + terms)
    batched = jax.vmap(lambda *xs: eqn.primitive.bind(*xs, **params), [-1 if x.is_batched else None for x in args], -1)
    return _results(batched(*[x.value for x in args]), True)


def _results(out: Any, batched: bool, cost: int = 0) -> list[BatchOperand]:
    return [BatchOperand(x, batched, cost) for x in (out if isinstance(out, list | tuple) else [out])]


def _elementwise(eqn: Any, args: list[BatchOperand]) -> Any:
    """Elementwise operation on operands of one rank plus the batch axis; JAX lets scalars stand beside arrays."""
    rank = max(jnp.ndim(x.value) - x.is_batched for x in args)
    whole = eqn.primitive.name in ("select_n", "clamp", "add_any")  # these do not broadcast axes of length 1
    values = []
    for x in args:
        value, ndim = jnp.asarray(x.value), jnp.ndim(x.value) - x.is_batched
        if not x.is_batched:
            value = value[..., None]
        if ndim < rank:
            value = value.reshape((1,) * (rank - ndim) + value.shape)
        values.append(value)
    if whole:
        shape = jnp.broadcast_shapes(*[value.shape for value in values])
        values = [jnp.broadcast_to(value, shape) for value in values]
    return eqn.primitive.bind(*values, **eqn.params)


def _scan(eqn: Any, args: list[BatchOperand], batch: BatchedProgramSettings) -> list[BatchOperand]:
    """A loop over the first axis; everything that it carries becomes batched."""
    program = eqn.params["jaxpr"]
    consts, carry, xs = split_scan_operands(eqn, args)

    def body(state: list[Array], x: list[Array]) -> tuple[list[Array], list[Array]]:
        here = [BatchOperand(s, True) for s in state]
        there = [BatchOperand(v, operand.is_batched) for v, operand in zip(x, xs, strict=True)]
        values = [_broadcast_batch(v, batch.size) for v in _evaluate(_closed(program), [*consts, *here, *there], batch)]
        return values[: len(carry)], values[len(carry) :]

    loop = {key: eqn.params[key] for key in ("length", "reverse", "unroll")}
    last, ys = lax.scan(body, [_broadcast_batch(x, batch.size) for x in carry], [x.value for x in xs], **loop)
    return [BatchOperand(x, True) for x in (*last, *ys)]


def _cond(eqn: Any, args: list[BatchOperand], batch: BatchedProgramSettings) -> list[BatchOperand]:
    """A branch that is the same for the whole batch."""

    def spread(branch: ClosedJaxpr) -> list[Array]:
        return [_broadcast_batch(x, batch.size) for x in _evaluate(branch, args[1:], batch)]

    return _results(lax.switch(args[0].value, [partial(spread, branch) for branch in eqn.params["branches"]]), True)


def _choose_branches(eqn: Any, args: list[BatchOperand], batch: BatchedProgramSettings) -> list[BatchOperand]:
    """A branch of each rollout's own. A branch that no rollout takes is not computed."""
    index, operands = jnp.asarray(args[0].value, jnp.int32), args[1:]
    chosen = [jnp.zeros((*out.aval.shape, batch.size), out.aval.dtype) for out in eqn.outvars]
    for k, branch in enumerate(eqn.params["branches"]):
        mine = index == k

        def take(branch: ClosedJaxpr = branch, mine: Array = mine, others: list[Array] = chosen) -> list[Array]:
            values = [_broadcast_batch(x, batch.size) for x in _evaluate(branch, operands, batch)]
            return [jnp.where(mine, value, other) for value, other in zip(values, others, strict=True)]

        chosen = lax.cond(jnp.any(mine), take, lambda others=chosen: others)
    return _results(chosen, True)


def _while(eqn: Any, args: list[BatchOperand], batch: BatchedProgramSettings) -> list[BatchOperand]:
    """A loop that ends when it has ended for all rollouts; one that has ended keeps its values meanwhile."""
    first, second = eqn.params["cond_nconsts"], eqn.params["body_nconsts"]
    read_by_test, read_by_body = args[:first], args[first : first + second]

    def goes_on(state: list[Array]) -> Array:
        (out,) = _evaluate(eqn.params["cond_jaxpr"], [*read_by_test, *(BatchOperand(x, True) for x in state)], batch)
        return _broadcast_batch(out, batch.size)

    def body(loop: tuple[Array, list[Array]]) -> tuple[Array, list[Array]]:
        going, state = loop
        results = _evaluate(eqn.params["body_jaxpr"], [*read_by_body, *(BatchOperand(x, True) for x in state)], batch)
        values = (_broadcast_batch(x, batch.size) for x in results)
        state = [jnp.where(going, value, last) for value, last in zip(values, state, strict=True)]
        return going & goes_on(state), state

    start = [_broadcast_batch(x, batch.size) for x in args[first + second :]]
    _, last = lax.while_loop(lambda loop: jnp.any(loop[0]), body, (goes_on(start), start))
    return _results(last, True)


def _closed(program: Any) -> ClosedJaxpr:
    return program if isinstance(program, ClosedJaxpr) else ClosedJaxpr(program, ())


def _broadcast_in_dim(
    args: list[BatchOperand], size: int, shape: tuple, broadcast_dimensions: tuple, **_: Any
) -> Array:
    return lax.broadcast_in_dim(args[0].value, (*shape, size), (*broadcast_dimensions, len(shape)))


def _reshape(args: list[BatchOperand], size: int, new_sizes: tuple, **_: Any) -> Array:
    return lax.reshape(args[0].value, (*new_sizes, size))


def _transpose(args: list[BatchOperand], size: int, permutation: tuple) -> Array:
    return lax.transpose(args[0].value, (*permutation, len(permutation)))


def _slice(
    args: list[BatchOperand], size: int, start_indices: tuple, limit_indices: tuple, strides: tuple | None
) -> Array:
    return lax.slice(args[0].value, (*start_indices, 0), (*limit_indices, size), strides and (*strides, 1))


def _pad(args: list[BatchOperand], size: int, padding_config: tuple) -> Array:
    if args[1].is_batched:
        return NotImplemented
    return lax.pad(args[0].value, args[1].value, (*padding_config, (0, 0, 0)))


def _concatenate(args: list[BatchOperand], size: int, dimension: int) -> Array:
    return lax.concatenate([_broadcast_batch(x, size) for x in args], dimension)


def _dot_general(args: list[BatchOperand], size: int, dimension_numbers: tuple, **_: Any) -> Array:
    """Sum products one after the other: the matrices have a few rows, the batch is long."""
    (contract_l, contract_r), (batch_l, batch_r) = dimension_numbers
    left, right = ((jnp.asarray(x.value) if x.is_batched else jnp.asarray(x.value)[..., None]) for x in args)
    free_l = [d for d in range(left.ndim - 1) if d not in (*contract_l, *batch_l)]
    free_r = [d for d in range(right.ndim - 1) if d not in (*contract_r, *batch_r)]
    left = lax.transpose(left, (*contract_l, *batch_l, *free_l, left.ndim - 1))
    right = lax.transpose(right, (*contract_r, *batch_r, *free_r, right.ndim - 1))
    n = len(contract_l) + len(batch_l)
    left = left.reshape((*left.shape[:-1], *[1] * len(free_r), left.shape[-1]))
    right = right.reshape((*right.shape[:n], *[1] * len(free_l), *right.shape[n:]))
    return jnp.sum(left * right, axis=tuple(range(len(contract_l))))


def _gather(
    args: list[BatchOperand], size: int, dimension_numbers: Any, slice_sizes: tuple, mode: Any, **rest: Any
) -> Array:
    operand, indices = args
    dims = dimension_numbers
    if not operand.is_batched:
        return NotImplemented
    kept = {"collapsed_slice_dims": dims.collapsed_slice_dims, "start_index_map": dims.start_index_map}
    rest = {k: v for k, v in rest.items() if k in ("unique_indices", "indices_are_sorted", "fill_value")}
    axis = operand.value.ndim - 1
    if not indices.is_batched:
        out_rank = indices.value.ndim - 1 + len(dims.offset_dims)
        numbers = lax.GatherDimensionNumbers((*dims.offset_dims, out_rank), **kept,
            operand_batching_dims=dims.operand_batching_dims,
            start_indices_batching_dims=dims.start_indices_batching_dims)  # fmt: skip
        return lax.gather(operand.value, indices.value, numbers, (*slice_sizes, size), mode=mode, **rest)
    index = jnp.moveaxis(indices.value, -1, -2)  # (..., batch, index vector)
    numbers = lax.GatherDimensionNumbers(dims.offset_dims, **kept,
        operand_batching_dims=(*dims.operand_batching_dims, axis),
        start_indices_batching_dims=(*dims.start_indices_batching_dims, index.ndim - 2))  # fmt: skip
    return lax.gather(operand.value, index, numbers, (*slice_sizes, 1), mode=mode, **rest)


def _scatter(put: Callable, args: list[BatchOperand], size: int, dimension_numbers: Any, **rest: Any) -> Array:
    operand, indices, updates = args
    if indices.is_batched:
        return NotImplemented
    dims = dimension_numbers
    window = (*dims.update_window_dims, jnp.ndim(updates.value) - updates.is_batched)
    numbers = lax.ScatterDimensionNumbers(window, dims.inserted_window_dims, dims.scatter_dims_to_operand_dims,
                                          dims.operand_batching_dims, dims.scatter_indices_batching_dims)  # fmt: skip
    rest = {k: v for k, v in rest.items() if k in ("unique_indices", "indices_are_sorted", "mode")}
    return put(_broadcast_batch(operand, size), indices.value, _broadcast_batch(updates, size), numbers, **rest)


def _dynamic_update_slice(args: list[BatchOperand], size: int) -> Array:
    operand, update, *starts = args
    if any(start.is_batched for start in starts):
        return NotImplemented
    places = [jnp.asarray(start.value) for start in starts]
    return lax.dynamic_update_slice(
        _broadcast_batch(operand, size), _broadcast_batch(update, size), (*places, jnp.zeros_like(places[0]))
    )


RULES: dict[str, Callable] = {
    "broadcast_in_dim": _broadcast_in_dim, "reshape": _reshape, "transpose": _transpose, "slice": _slice, "pad": _pad,
    "concatenate": _concatenate, "dot_general": _dot_general, "gather": _gather,
    "dynamic_update_slice": _dynamic_update_slice,
    "scatter": partial(_scatter, lax.scatter), "scatter-add": partial(_scatter, lax.scatter_add),
}  # fmt: skip
