"""Execution by NumPy of programs that are not worth compiling, from JAX's trace of one rollout, for a whole batch.

Executing an operation takes some microseconds, compiling it ten thousand times as long, so this pays for what runs once
a batch. The last axis of an array is the batch; it has length 1 where all rollouts agree, so that this is computed
once. A rollout's results are equal to the last bit in any batch and at any place in it.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.extend import core

from sweep.fused import batch_ops, randomness
from sweep.fused.arrays import UnsupportedPrimitive
from sweep.fused.batch_ops import BatchArray
from sweep.fused.eager_rules import FUNCTIONS, RULES
from sweep.fused.interpret import CALL_PRIMITIVES
from sweep.fused.jaxprs import open_jaxpr, split_scan_operands
from sweep.fused.randomness import is_key, keys_to_words, rewrap_if_key

IDENTITY_PRIMITIVES = frozenset(("stop_gradient", "copy", "optimization_barrier", "random_wrap", "random_unwrap"))


class Operation(NamedTuple):
    """One operation of a program, with the numbers of its operands and results in the list of values."""

    rule: Callable[..., Any] | str  # or the name of an external function
    reads: tuple[int, ...]
    writes: tuple[int, ...]
    last_reads: tuple[int, ...]  # values that nothing reads later


class OperationList(NamedTuple):
    """A program as a list of operations on numbered values."""

    size: int  # number of values
    constants: dict[int, BatchArray]
    inputs: tuple[int, ...]
    operations: list[Operation]
    outputs: tuple[int, ...]

    def execute(self, args: Sequence[BatchArray], external: Mapping[str, Callable[..., Any]]) -> list[BatchArray]:
        """Run the program on argument values and return its results.

        Args:
            args: values of its inputs.
            external: functions that replace external calls, by name.

        Returns:
            Values of its outputs.
        """
        values: list[Any] = [None] * self.size
        for place, value in (*self.constants.items(), *zip(self.inputs, args, strict=True)):
            values[place] = value
        for rule, reads, writes, done in self.operations:
            made = (external[rule] if isinstance(rule, str) else rule)(*[values[k] for k in reads])
            if isinstance(made, np.ndarray):
                values[writes[0]] = made
            else:
                for place, value in zip(writes, made, strict=True):
                    values[place] = value
            for k in done:
                values[k] = None
        return [values[k] for k in self.outputs]


class NumpyProgram(NamedTuple):
    """A traced function of one rollout that NumPy executes for a batch; it can be pickled."""

    operation_list: OperationList
    argument_shapes: list[jax.ShapeDtypeStruct]  # of the arguments, for one rollout
    result_shapes: Any  # tree of the results' shapes, for one rollout
    external_functions: dict[str, tuple[jax.ShapeDtypeStruct, ...]]  # shapes of the arguments of external functions

    def __call__(self, width: int, *args: Any, external: Mapping[str, Callable[..., Any]] | None = None) -> Any:
        """Evaluate the function for a batch.

        Args:
            width: number of rollouts.
            args: trees like those of the trace; leaves with one more axis differ among rollouts.
            external: functions that replace external calls, by name; the last axis of their arrays is the batch.

        Returns:
            The results, with a leading axis (width, ...).
        """
        leaves = jax.tree.leaves(keys_to_words(args))
        taken = [
            _batch_axis_last(np.asarray(x, one.dtype), one.ndim)
            for x, one in zip(leaves, self.argument_shapes, strict=True)
        ]
        with np.errstate(all="ignore"):
            made = self.operation_list.execute(taken, external or {})
        rows = [np.moveaxis(np.broadcast_to(x, (*x.shape[:-1], width)), -1, 0) for x in made]
        forms, tree = jax.tree.flatten(self.result_shapes)
        return jax.tree.unflatten(tree, [rewrap_if_key(x, form) for x, form in zip(rows, forms, strict=True)])


def trace_numpy_program(function: Callable[..., Any], *shapes: Any, external: Collection[str] = ()) -> NumpyProgram:
    """Trace a function of one rollout so that NumPy can execute it for batches.

    Args:
        function: the function.
        shapes: its arguments: trees of shapes, or of arrays of one rollout.
        external: names of jitted functions that are not traced; another function takes the place of each when it runs.

    Raises:
        Unsupported: A primitive has no rule.
    """
    leaves, tree = jax.tree.flatten(shapes)

    def flat(*of: Any) -> Any:
        return function(*jax.tree.unflatten(tree, [rewrap_if_key(x, like) for x, like in zip(of, leaves, strict=True)]))

    leaf_shapes = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in keys_to_words(leaves)]
    program, results_shape = jax.make_jaxpr(flat, return_shape=True)(*leaf_shapes)
    writer = OperationListWriter(external)
    with np.errstate(all="ignore"):
        inputs = tuple(writer.new_value() for _ in leaf_shapes)
        results = writer.write_jaxpr(program.jaxpr, program.consts, inputs)
    steps = writer.pruned_operation_list(inputs, results)
    asked = {step.rule: writer.asked[step.rule] for step in steps.operations if isinstance(step.rule, str)}
    return NumpyProgram(steps, leaf_shapes, results_shape, asked)


def evaluate_constant_function(
    function: Callable[[], Any], external: Mapping[str, Callable[..., Any]] | None = None
) -> Any:
    """Evaluate a function of constants with NumPy, even during a JAX trace; XLA does it if a primitive has no rule.

    Args:
        function: function without arguments.
        external: functions that replace calls of jitted functions of these names.
    """
    try:
        program = trace_numpy_program(function, external=external or {})
    except UnsupportedPrimitive:
        with jax.ensure_compile_time_eval():
            made = jax.jit(function, compiler_options={"xla_backend_optimization_level": 0})()
            return jax.tree.map(np.asarray, made)
    return jax.tree.map(lambda x: x[0], program(1, external=external))


class OperationListWriter:
    """Makes an `OperationList` from JAX's trace, folding constants and merging equal operations."""

    def __init__(self, external: Collection[str] = ()):
        self.apart = external
        self.asked: dict[str, tuple[jax.ShapeDtypeStruct, ...]] = {}
        self.known: dict[int, BatchArray] = {}
        self._size = 0
        self._constants: dict[Any, int] = {}
        self._steps: list[tuple[Any, tuple[int, ...], tuple[int, ...]]] = []
        self._there: dict[Any, tuple[int, ...]] = {}

    def new_value(self) -> int:
        """Return the number for a new value of the program."""
        self._size += 1
        return self._size - 1

    def constant_value(self, value: BatchArray) -> int:
        """Add a constant to the program, and return the number of its value."""
        value = np.ascontiguousarray(value)
        what = value.dtype.str, value.shape, value.tobytes()
        if what not in self._constants:
            self._constants[what] = self.new_value()
            self.known[self._constants[what]] = value
        return self._constants[what]

    def write_jaxpr(self, jaxpr: Any, consts: Sequence[Any], args: Sequence[int]) -> list[int]:
        """Add the operations of a jaxpr.

        Args:
            jaxpr: the program.
            consts: its constants.
            args: numbers of its arguments.

        Returns:
            Numbers of its results.
        """
        at = dict(zip(jaxpr.invars, args, strict=True))
        at |= zip(jaxpr.constvars, (self.constant_value(_array(x)) for x in consts), strict=True)

        def read(atom: Any) -> int:
            if not isinstance(atom, core.Literal):
                return at[atom]
            aval: Any = atom.aval
            return self.constant_value(np.asarray(atom.val, aval.dtype)[..., None])

        for eqn in jaxpr.eqns:
            at |= zip(eqn.outvars, self._apply(eqn, [read(atom) for atom in eqn.invars]), strict=True)
        return [read(atom) for atom in jaxpr.outvars]

    def pruned_operation_list(self, inputs: tuple[int, ...], outputs: Sequence[int]) -> OperationList:
        """Return the program that computes the values `outputs` from `inputs`, without needless operations."""
        wanted, kept = set(outputs), []
        for rule, reads, writes in reversed(self._steps):
            if wanted.intersection(writes):
                new = set(reads) - wanted
                kept.append(Operation(rule, reads, writes, tuple(new - self.known.keys())))
                wanted |= new
        known = {k: self.known[k] for k in wanted & self.known.keys()}
        return OperationList(self._size, known, inputs, kept[::-1], tuple(outputs))

    def emit(self, rule: Any, reads: Sequence[int], count: int = 1) -> tuple[int, ...]:
        """Add an operation on the values numbered `reads`, and return the numbers of its `count` results."""
        reads = tuple(reads)
        if not isinstance(rule, str) and all(k in self.known for k in reads):
            made = rule(*[self.known[k] for k in reads])
            return tuple(map(self.constant_value, (made,) if isinstance(made, np.ndarray) else made))
        what = (rule.func, rule.args, reads) if isinstance(rule, partial) else (rule, reads)
        try:
            if what in self._there:
                return self._there[what]
        except TypeError:  # parameters that contain a program cannot be hashed
            what = object()
        writes = self._there[what] = tuple(self.new_value() for _ in range(count))
        self._steps.append((rule, reads, writes))
        return writes

    def _apply(self, eqn: Any, args: list[int]) -> Sequence[int]:
        """Add one of JAX's operations."""
        name, params = eqn.primitive.name, eqn.params
        if name in CALL_PRIMITIVES:
            if params.get("name") in self.apart:
                return self._call_external(params["name"], args, eqn)
            inner = params[CALL_PRIMITIVES[name]]
            return self.write_jaxpr(open_jaxpr(inner), getattr(inner, "consts", ()), args)
        if not eqn.outvars:
            return []
        if name in IDENTITY_PRIMITIVES:
            return args
        if name == "scan":
            return self._scan(args, eqn)
        if name == "cond":
            return self._cond(args, eqn)
        if name == "while":
            return self._while(args, eqn)
        if name == "convert_element_type" and eqn.invars[0].aval.dtype == eqn.outvars[0].aval.dtype:
            return args
        if name in randomness.EXPANSIONS:
            return self._random(args, eqn)
        if rule := RULES.get(name):
            return self.emit(rule(eqn), args, len(eqn.outvars))
        if rule := FUNCTIONS.get(name):
            return self.emit(rule, args)
        raise UnsupportedPrimitive(name)

    def _call_external(self, name: str, args: list[int], eqn: Any) -> Sequence[int]:
        """Add a call of an external function. Raises `Unsupported` if two calls differ in shapes."""
        asked = tuple(map(_form, eqn.invars))
        if self.asked.setdefault(name, asked) != asked:
            raise UnsupportedPrimitive(f"{name} of several shapes")
        return self.emit(name, args, len(eqn.outvars))

    def _random(self, args: list[int], eqn: Any) -> list[int]:
        """Random numbers of one key."""
        key, *others = eqn.invars
        if key.aval.shape:
            raise UnsupportedPrimitive("random numbers of several keys at once")
        shapes = [jax.ShapeDtypeStruct((2,), np.uint32), *map(_form, others)]
        function = randomness.EXPANSIONS[eqn.primitive.name]
        traced = jax.make_jaxpr(lambda *of: function(*of, **eqn.params))(*shapes)
        return self.write_jaxpr(traced.jaxpr, traced.consts, args)

    def _scan(self, args: list[int], eqn: Any) -> Sequence[int]:
        """Loop over steps."""
        inner, length = eqn.params["jaxpr"], eqn.params["length"]
        if not length:
            raise UnsupportedPrimitive("a loop without steps")
        consts, carry, xs = split_scan_operands(eqn, args)
        body, consts = self._inner(inner, consts)
        how = ScanParameters(body, length, eqn.params["reverse"], len(consts), len(carry))
        return self.emit(partial(run_scan, how), [*consts, *carry, *xs], len(eqn.outvars))

    def _cond(self, args: list[int], eqn: Any) -> Sequence[int]:
        """One branch if all rollouts agree, else all branches, of which each rollout takes one."""
        index, *operands = args
        branches = eqn.params["branches"]
        if index in self.known:
            branch = branches[min(max(int(self.known[index][0]), 0), len(branches) - 1)]
            return self.write_jaxpr(branch.jaxpr, branch.consts, operands)
        each = tuple(self._inner(branch, ())[0] for branch in branches)
        return self.emit(partial(run_switch, each), args, len(eqn.outvars))

    def _while(self, args: list[int], eqn: Any) -> Sequence[int]:
        """Loop until the last rollout has ended it."""
        tests, bodies = eqn.params["cond_nconsts"], eqn.params["body_nconsts"]
        test, test_consts = self._inner(eqn.params["cond_jaxpr"], args[:tests])
        body, body_consts = self._inner(eqn.params["body_jaxpr"], args[tests : tests + bodies])
        how = WhileParameters(test, body, len(test_consts), len(body_consts))
        operands = [*test_consts, *body_consts, *args[tests + bodies :]]
        return self.emit(partial(run_while, how), operands, len(eqn.outvars))

    def _inner(self, closed: Any, first: Sequence[int]) -> tuple[OperationList, list[int]]:
        """Listing of an inner program, and its other operands: constants among the `first` ones are folded into it."""
        writer = OperationListWriter()
        there = [writer.constant_value(self.known[k]) if k in self.known else writer.new_value() for k in first]
        others = [writer.new_value() for _ in closed.jaxpr.invars[len(first) :]]
        made = writer.write_jaxpr(closed.jaxpr, closed.consts, [*there, *others])
        given = [new for new, k in zip(there, first, strict=True) if k not in self.known]
        return writer.pruned_operation_list((*given, *others), made), [k for k in first if k not in self.known]


class ScanParameters(NamedTuple):
    """Static parameters of a `lax.scan` loop."""

    body: OperationList
    length: int
    reverse: bool
    const_count: int  # number of constant operands
    carry_count: int  # number of carried operands; the others are scanned row by row


def run_scan(how: ScanParameters, *args: BatchArray) -> list[BatchArray]:
    """Run a `lax.scan` loop; return the carry at the end and the stacked outputs."""
    consts, carry, rows = (
        args[: how.const_count],
        args[how.const_count :][: how.carry_count],
        args[how.const_count + how.carry_count :],
    )
    beside = []
    for k in range(how.length)[:: -1 if how.reverse else 1]:
        made = how.body.execute([*consts, *carry, *(x[k] for x in rows)], {})
        carry = made[: how.carry_count]
        beside.append(made[how.carry_count :])
    beside = beside[:: -1 if how.reverse else 1]
    return [*carry, *(batch_ops.stack(0, *each) for each in zip(*beside, strict=True))]


class WhileParameters(NamedTuple):
    """Static parameters of a `lax.while_loop`."""

    test: OperationList
    body: OperationList
    test_consts: int  # number of constant operands of the condition
    body_consts: int


def run_while(how: WhileParameters, *args: BatchArray) -> list[BatchArray]:
    """Run a `lax.while_loop` until no rollout continues; return the carry, frozen for each rollout when its condition
    fails."""
    first, rest = args[: how.test_consts], args[how.test_consts :]
    consts, carry = rest[: how.body_consts], list(rest[how.body_consts :])
    while True:
        (going,) = how.test.execute([*first, *carry], {})
        if not going.any():
            return carry
        made = how.body.execute([*consts, *carry], {})
        carry = made if going.all() else [np.where(going, new, old) for new, old in zip(made, carry, strict=True)]


def run_switch(branches: Sequence[OperationList], index: Any, *args: BatchArray) -> list[BatchArray]:
    """Run the branch whose number is `index`, as `lax.switch`; if rollouts differ, run all and select for each."""
    index = index.astype(int)
    if len(index) == 1:
        return branches[min(max(int(index[0]), 0), len(branches) - 1)].execute(args, {})
    each = [branch.execute(args, {}) for branch in branches]
    return [batch_ops.select_n(index, *cases) for cases in zip(*each, strict=True)]


def _batch_axis_last(x: Any, rank: int) -> BatchArray:
    """The value with its batch axis last."""
    return np.ascontiguousarray(np.moveaxis(x, 0, -1)) if x.ndim > rank else x[..., None]


def _form(atom: Any) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(atom.aval.shape, atom.aval.dtype)


def _array(value: Any) -> BatchArray:
    """A constant that all rollouts share."""
    return np.asarray(jax.random.key_data(value) if is_key(value) else value)[..., None]
