"""A batch through a fused kernel on a GPU, within a program of XLA's, which has the memory and the devices."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Int, UInt32

from sweep.fused import cuda, driver, schedule
from sweep.fused.randomness import key_words, restore_keys
from sweep.fused.trace import GROUP, Leaf, Traced, trace_program

BLOCK = cuda.lanes_of(GROUP) * cuda.WARPS  # rollouts that a block of threads has at least, of robots
TURNS = 25  # times as many that it has at most
OPTIONS = {"xla_gpu_graph_min_graph_size": 1 << 30}  # no graphs of kernels, from which one long kernel gains nothing


class Ptx(NamedTuple):
    """A compiled program, and where its arrays lie in the memory of rollouts."""

    text: str
    given: list[Leaf]
    carried: list[Leaf]
    recorded: dict[str, Leaf]
    words: int  # of what is carried, and of the kernel's own
    ticks: int
    room: int  # for rollouts that are recorded
    rollouts: int  # of a block of threads


Tick = Callable[[Any, Any, Array], tuple[Any, dict[str, Array]]]  # of a rollout: given, carried, number


def compiled(
    function: Tick,
    given: Any,
    carried: Any,
    over: Callable[[Any], Any],
    ticks: int,
    room: int,
    width: int,
    group: int = GROUP,
    few: bool = False,
) -> Ptx:
    """See `trace_program`. `over` picks the array of what is carried that tells a rollout without anything to come.

    Blocks have as many rollouts as make use of all multiprocessors, of a batch of `width`; with `few` it is compiled
    sooner, as each part of it has the legs in lanes.
    """

    with cuda.compiler() as compiler:
        program, printer = print_program(function, given, carried, over, ticks, room, width, group, few)
        text = compiler(printer.text())
    return Ptx(text, program.given, program.carried, program.recorded, printer.words, ticks, room, printer.rollouts)


def print_program(
    function: Tick,
    given: Any,
    carried: Any,
    over: Callable[[Any], Any],
    ticks: int,
    room: int,
    width: int,
    group: int = GROUP,
    few: bool = False,
) -> tuple[Traced, cuda.GpuPrinter]:
    """The program and its text as LLVM's assembly for a GPU, for the arguments of `compiled`."""

    def recorded(given: Any, carried: Any, number: Array) -> tuple[Any, dict[str, Array]]:
        carried, record = function(given, carried, number)
        return carried, record if room else {}

    program = trace_program(recorded, given, carried, _laid_out, together=False, group=group)
    tree = jax.tree.structure(carried)
    flag = program.carried[over(jax.tree.unflatten(tree, range(tree.num_leaves)))].place
    sizes = _end(program.given), _end(program.carried), _end([*program.recorded.values()])
    turns, needed = _turns(width, group), schedule.used_nodes(program.top)
    return program, cuda.GpuPrinter(program.top, needed, sizes, ticks, flag, room, turns, group, few)


def run(code: Ptx, given: Any, carried: Any, first: Array, kept: Int[Array, " room"] | None) -> tuple[Any, Any]:
    """What is carried after all ticks from `first` on, and records (ticks, room, ...) of the rollouts `kept`.

    Leaves of `given` may be the same for all rollouts.
    """
    like, tree = jax.tree.flatten(carried)
    width = len(like[0])
    state = _packed(code, code.carried, like, width, code.words)
    operands = [
        _packed(code, code.given, jax.tree.leaves(given), width, _end(code.given)),
        jnp.asarray(first, jnp.int32),
        state,
    ]
    places = jnp.zeros(0, jnp.int32)
    if kept is not None:
        places = jnp.full(state.shape[0] * code.rollouts, code.room, jnp.int32)
        places = places.at[kept].min(jnp.arange(code.room, dtype=jnp.int32))
        numbers = _end([*code.recorded.values()])
        operands += [places, jnp.zeros((code.ticks, code.room + 1, numbers), jnp.uint32)]
    moved, *record = call(code, operands)
    rows = moved.transpose(0, 2, 1).reshape(-1, code.words)[:width]
    after = [restore_keys(_got(rows, leaf), x) for leaf, x in zip(code.carried, like, strict=True)]
    after = jax.tree.unflatten(tree, after)
    if kept is None:
        return after, None
    record = record[0][:, places[kept]]
    return after, {name: _got(record, leaf) for name, leaf in code.recorded.items()}


def call(code: Ptx, operands: Sequence[Array]) -> Sequence[Array]:
    """The operands that the kernel changes: state, and records where there are any."""
    changed = [2] if len(operands) == 3 else [2, 4]
    return driver.call(driver.start_translation(code.text), 32 * cuda.WARPS, operands, changed)


def _turns(width: int, group: int) -> int:
    """Times the least rollouts that a block has, so that every multiprocessor has one block."""
    cores = getattr(jax.devices()[0], "core_count", None) or 1
    return min(TURNS, -(-width // (cores * cuda.lanes_of(group) * cuda.WARPS)))


def _laid_out(shapes: Sequence[Any], start: int) -> tuple[list[Leaf], int]:
    """Arrays one after the other, each number a word."""
    leaves = []
    for x in shapes:
        leaves.append(Leaf(start, tuple(x.shape), np.dtype(x.dtype).name))
        start += leaves[-1].size
    return leaves, start


def _end(leaves: Sequence[Leaf]) -> int:
    return max((leaf.place + leaf.size for leaf in leaves), default=1)


def _packed(
    code: Ptx, leaves: Sequence[Leaf], values: Sequence[Array], width: int, size: int
) -> UInt32[Array, "blocks size rollouts"]:
    """Arrays of a batch, those of each block together; rollouts beyond its width repeat the last."""
    rollouts = -(-width // code.rollouts) * code.rollouts

    def column(x: Array, leaf: Leaf) -> Array:
        bits = x.astype(jnp.uint32) if x.dtype == bool else lax.bitcast_convert_type(x, jnp.uint32)
        rows = width if x.ndim > len(leaf.shape) else 1
        return jnp.broadcast_to(bits.reshape(rows, leaf.size), (width, leaf.size))

    columns = [column(x, leaf) for x, leaf in zip(key_words(list(values)), leaves, strict=True)]
    columns.append(jnp.zeros((width, size - sum(x.shape[1] for x in columns)), jnp.uint32))
    rows = jnp.pad(jnp.concatenate(columns, axis=1), ((0, rollouts - width), (0, 0)), mode="edge")
    return rows.reshape(-1, code.rollouts, size).transpose(0, 2, 1)


def _got(rows: UInt32[Array, "*batch numbers"], leaf: Leaf) -> Array:
    """An array from the last axis of memory."""
    bits = rows[..., leaf.place : leaf.place + leaf.size].reshape(*rows.shape[:-1], *leaf.shape)
    return bits != 0 if leaf.dtype == "bool" else lax.bitcast_convert_type(bits, leaf.dtype)
