"""Programs that are not worth compiling: JAX's trace of one rollout, operation by operation by NumPy for a whole batch.

What is run once a batch takes some microseconds for each of its operations, and a compiler ten thousand times that. An
array's last axis is over rollouts; it has length 1 where they agree, so that this is worked out once. A rollout's
numbers are the same in any batch and at any place in it, to the last bit.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.extend import core

from sweep.fused import batch_ops, randomness
from sweep.fused.arrays import Unsupported
from sweep.fused.batch_ops import Values
from sweep.fused.eager_rules import COMPUTED, RULES
from sweep.fused.interpret import CALLS
from sweep.fused.randomness import is_key, key_words, restore_keys

ALIAS = frozenset(("stop_gradient", "copy", "optimization_barrier", "random_wrap", "random_unwrap"))


class Operation(NamedTuple):
    """An operation on values by number."""

    rule: Callable[..., Any] | str  # or the name of what is set apart
    reads: tuple[int, ...]
    writes: tuple[int, ...]
    done: tuple[int, ...]  # what nobody reads later


class Listing(NamedTuple):
    """A program: operations in their order, on values by number."""

    size: int  # values
    known: dict[int, Values]
    given: tuple[int, ...]
    steps: list[Operation]
    made: tuple[int, ...]

    def run(self, given: Sequence[Values], apart: Mapping[str, Callable[..., Any]]) -> list[Values]:
        """What comes of what is given."""
        values: list[Any] = [None] * self.size
        for place, value in (*self.known.items(), *zip(self.given, given, strict=True)):
            values[place] = value
        for rule, reads, writes, done in self.steps:
            made = (apart[rule] if isinstance(rule, str) else rule)(*[values[k] for k in reads])
            if isinstance(made, np.ndarray):
                values[writes[0]] = made
            else:
                for place, value in zip(writes, made, strict=True):
                    values[place] = value
            for k in done:
                values[k] = None
        return [values[k] for k in self.made]


class Eager(NamedTuple):
    """A function of one rollout for a batch, as it is kept."""

    steps: Listing
    given: list[jax.ShapeDtypeStruct]  # of a rollout
    form: Any  # shapes of what it gives of a rollout
    apart: dict[str, tuple[jax.ShapeDtypeStruct, ...]]  # what is set apart, and what that is given

    def __call__(self, width: int, *given: Any, apart: Mapping[str, Callable[..., Any]] | None = None) -> Any:
        """What it gives for `width` rollouts, (width, ...) each.

        Leaves with one axis more than traced differ among them. What was set apart is done by functions of arrays whose
        last axis is over rollouts.
        """
        leaves = jax.tree.leaves(key_words(given))
        taken = [_taken(np.asarray(x, one.dtype), one.ndim) for x, one in zip(leaves, self.given, strict=True)]
        with np.errstate(all="ignore"):
            made = self.steps.run(taken, apart or {})
        rows = [np.moveaxis(np.broadcast_to(x, (*x.shape[:-1], width)), -1, 0) for x in made]
        forms, tree = jax.tree.flatten(self.form)
        return jax.tree.unflatten(tree, [restore_keys(x, form) for x, form in zip(rows, forms, strict=True)])


def trace(function: Callable[..., Any], *given: Any, apart: Collection[str] = ()) -> Eager:
    """A function of trees like `given`: shapes, or arrays of one rollout. Raises `Unsupported`.

    Calls of jitted functions of the names `apart` are set apart: others take their place as it is run.
    """
    leaves, tree = jax.tree.flatten(given)

    def flat(*of: Any) -> Any:
        return function(*jax.tree.unflatten(tree, [restore_keys(x, like) for x, like in zip(of, leaves, strict=True)]))

    shapes = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in key_words(leaves)]
    program, made = jax.make_jaxpr(flat, return_shape=True)(*shapes)
    writer = Writer(apart)
    with np.errstate(all="ignore"):
        inputs = tuple(writer.new() for _ in shapes)
        results = writer.write(program.jaxpr, program.consts, inputs)
    steps = writer.steps(inputs, results)
    asked = {step.rule: writer.asked[step.rule] for step in steps.steps if isinstance(step.rule, str)}
    return Eager(steps, shapes, made, asked)


def evaluate_constants(function: Callable[[], Any], apart: Mapping[str, Callable[..., Any]] | None = None) -> Any:
    """What a function of plain numbers gives, also while another one is traced; XLA works out what has no rule.

    `apart`: what does the calls of jitted functions of these names.
    """
    try:
        program = trace(function, apart=apart or {})
    except Unsupported:
        with jax.ensure_compile_time_eval():
            made = jax.jit(function, compiler_options={"xla_backend_optimization_level": 0})()
            return jax.tree.map(np.asarray, made)
    return jax.tree.map(lambda x: x[0], program(1, apart=apart))


class Writer:
    """Goes through what JAX traced. What is known is worked out, and what is there already is not done twice."""

    def __init__(self, apart: Collection[str] = ()):
        self.apart = apart
        self.asked: dict[str, tuple[jax.ShapeDtypeStruct, ...]] = {}
        self.known: dict[int, Values] = {}
        self._size = 0
        self._constants: dict[Any, int] = {}
        self._steps: list[tuple[Any, tuple[int, ...], tuple[int, ...]]] = []
        self._there: dict[Any, tuple[int, ...]] = {}

    def new(self) -> int:
        """The number of another value."""
        self._size += 1
        return self._size - 1

    def constant(self, value: Values) -> int:
        """The number of a known value."""
        value = np.ascontiguousarray(value)
        what = value.dtype.str, value.shape, value.tobytes()
        if what not in self._constants:
            self._constants[what] = self.new()
            self.known[self._constants[what]] = value
        return self._constants[what]

    def write(self, jaxpr: Any, consts: Sequence[Any], args: Sequence[int]) -> list[int]:
        """Numbers of the results of `jaxpr`."""
        at = dict(zip(jaxpr.invars, args, strict=True))
        at |= zip(jaxpr.constvars, (self.constant(_array(x)) for x in consts), strict=True)

        def read(atom: Any) -> int:
            if not isinstance(atom, core.Literal):
                return at[atom]
            aval: Any = atom.aval
            return self.constant(np.asarray(atom.val, aval.dtype)[..., None])

        for eqn in jaxpr.eqns:
            at |= zip(eqn.outvars, self._apply(eqn, [read(atom) for atom in eqn.invars]), strict=True)
        return [read(atom) for atom in jaxpr.outvars]

    def steps(self, given: tuple[int, ...], made: Sequence[int]) -> Listing:
        """All that is needed for the values `made`."""
        wanted, kept = set(made), []
        for rule, reads, writes in reversed(self._steps):
            if wanted.intersection(writes):
                new = set(reads) - wanted
                kept.append(Operation(rule, reads, writes, tuple(new - self.known.keys())))
                wanted |= new
        known = {k: self.known[k] for k in wanted & self.known.keys()}
        return Listing(self._size, known, given, kept[::-1], tuple(made))

    def do(self, rule: Any, reads: Sequence[int], count: int = 1) -> tuple[int, ...]:
        """An operation's results."""
        reads = tuple(reads)
        if not isinstance(rule, str) and all(k in self.known for k in reads):
            made = rule(*[self.known[k] for k in reads])
            return tuple(map(self.constant, (made,) if isinstance(made, np.ndarray) else made))
        what = (rule.func, rule.args, reads) if isinstance(rule, partial) else (rule, reads)
        try:
            if what in self._there:
                return self._there[what]
        except TypeError:  # with a program in it
            what = object()
        writes = self._there[what] = tuple(self.new() for _ in range(count))
        self._steps.append((rule, reads, writes))
        return writes

    def _apply(self, eqn: Any, args: list[int]) -> Sequence[int]:
        """Results of one operation of JAX."""
        name, params = eqn.primitive.name, eqn.params
        if name in CALLS:
            if params.get("name") in self.apart:
                return self._set_apart(params["name"], args, eqn)
            inner = params[CALLS[name]]
            return self.write(getattr(inner, "jaxpr", inner), getattr(inner, "consts", ()), args)
        if not eqn.outvars:
            return []
        if name in ALIAS:
            return args
        if name == "scan":
            return self._scan(args, eqn)
        if name == "cond":
            return self._cond(args, eqn)
        if name == "convert_element_type" and eqn.invars[0].aval.dtype == eqn.outvars[0].aval.dtype:
            return args
        if name in randomness.WRITTEN:
            return self._random(args, eqn)
        if rule := RULES.get(name):
            return self.do(rule(eqn), args, len(eqn.outvars))
        if rule := COMPUTED.get(name):
            return self.do(rule, args)
        raise Unsupported(name)

    def _set_apart(self, name: str, args: list[int], eqn: Any) -> Sequence[int]:
        """What another function does. Raises `Unsupported` where it would have to be two."""
        asked = tuple(map(_form, eqn.invars))
        if self.asked.setdefault(name, asked) != asked:
            raise Unsupported(f"{name} of several shapes")
        return self.do(name, args, len(eqn.outvars))

    def _random(self, args: list[int], eqn: Any) -> list[int]:
        """Random numbers of one key."""
        key, *others = eqn.invars
        if key.aval.shape:
            raise Unsupported("random numbers of several keys at once")
        shapes = [jax.ShapeDtypeStruct((2,), np.uint32), *map(_form, others)]
        function = randomness.WRITTEN[eqn.primitive.name]
        traced = jax.make_jaxpr(lambda *of: function(*of, **eqn.params))(*shapes)
        return self.write(traced.jaxpr, traced.consts, args)

    def _scan(self, args: list[int], eqn: Any) -> Sequence[int]:
        """Results of a loop over steps."""
        inner, length = eqn.params["jaxpr"], eqn.params["length"]
        if not length:
            raise Unsupported("a loop without steps")
        n_xs = sum(x.aval.ndim != y.aval.ndim for x, y in zip(eqn.invars, inner.jaxpr.invars, strict=True))
        n_ys = sum(x.aval.ndim != y.aval.ndim for x, y in zip(eqn.outvars, inner.jaxpr.outvars, strict=True))
        n_carry = len(eqn.outvars) - n_ys
        n_consts = len(args) - n_carry - n_xs
        body, consts = self._inner(inner, args[:n_consts])
        how = Repetition(body, length, eqn.params["reverse"], len(consts), n_carry)
        return self.do(partial(run_scan, how), [*consts, *args[n_consts:]], len(eqn.outvars))

    def _cond(self, args: list[int], eqn: Any) -> Sequence[int]:
        """One of the branches where all rollouts go the same way, else what each of them takes of all."""
        index, *operands = args
        branches = eqn.params["branches"]
        if index in self.known:
            branch = branches[min(max(int(self.known[index][0]), 0), len(branches) - 1)]
            return self.write(branch.jaxpr, branch.consts, operands)
        each = tuple(self._inner(branch, ())[0] for branch in branches)
        return self.do(partial(run_switch, each), args, len(eqn.outvars))

    def _inner(self, closed: Any, first: Sequence[int]) -> tuple[Listing, list[int]]:
        """An inner program, which has those of its `first` operands that are known, and the others of these."""
        writer = Writer()
        there = [writer.constant(self.known[k]) if k in self.known else writer.new() for k in first]
        others = [writer.new() for _ in closed.jaxpr.invars[len(first) :]]
        made = writer.write(closed.jaxpr, closed.consts, [*there, *others])
        given = [new for new, k in zip(there, first, strict=True) if k not in self.known]
        return writer.steps((*given, *others), made), [k for k in first if k not in self.known]


class Repetition(NamedTuple):
    """What goes on step by step."""

    body: Listing
    length: int
    reverse: bool
    consts: int  # operands that stay
    carry: int  # and those that a step changes; the others are looked at row by row


def run_scan(how: Repetition, *given: Values) -> list[Values]:
    """What is carried in the end, and what each step gives beside it."""
    consts, carry, rows = given[: how.consts], given[how.consts :][: how.carry], given[how.consts + how.carry :]
    beside = []
    for k in range(how.length)[:: -1 if how.reverse else 1]:
        made = how.body.run([*consts, *carry, *(x[k] for x in rows)], {})
        carry = made[: how.carry]
        beside.append(made[how.carry :])
    beside = beside[:: -1 if how.reverse else 1]
    return [*carry, *(batch_ops.stack(0, *each) for each in zip(*beside, strict=True))]


def run_switch(branches: Sequence[Listing], index: Any, *given: Values) -> list[Values]:
    """What the branch of an index gives, or for each rollout that of its own."""
    index = index.astype(int)
    if len(index) == 1:
        return branches[min(max(int(index[0]), 0), len(branches) - 1)].run(given, {})
    each = [branch.run(given, {}) for branch in branches]
    return [batch_ops.select(index, *cases) for cases in zip(*each, strict=True)]


def _taken(x: Any, rank: int) -> Values:
    """What is given, its axis over rollouts last."""
    return np.ascontiguousarray(np.moveaxis(x, 0, -1)) if x.ndim > rank else x[..., None]


def _form(atom: Any) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(atom.aval.shape, atom.aval.dtype)


def _array(value: Any) -> Values:
    """A constant, the same for all rollouts."""
    return np.asarray(jax.random.key_data(value) if is_key(value) else value)[..., None]
