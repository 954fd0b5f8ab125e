"""GPU kernels: a batch goes through a fused kernel inside an XLA program, which owns memory and devices."""

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

BLOCK = cuda.rollouts_per_warp(GROUP) * cuda.WARPS  # smallest number of rollouts in a thread block
TURNS = 25  # largest factor by which a block has more
OPTIONS = {"xla_gpu_graph_min_graph_size": 1 << 30}  # CUDA graphs do not help one long kernel


class Ptx(NamedTuple):
    """A GPU kernel as PTX text, and the places of its arrays in the memory of a rollout."""

    text: str
    given: list[Leaf]
    carried: list[Leaf]
    recorded: dict[str, Leaf]
    words: int  # words of a rollout: its carry, and the kernel's own
    ticks: int
    room: int  # number of rollouts that can be recorded
    rollouts: int  # rollouts of a thread block


Tick = Callable[
    [Any, Any, Array], tuple[Any, dict[str, Array]]
]  # tick of one rollout: (inputs, carry, number) -> (carry, record)


def compile_to_ptx(
    function: Tick,
    inputs: Any,
    carry: Any,
    is_over: Callable[[Any], Any],
    ticks: int,
    record_capacity: int,
    width: int,
    group: int = GROUP,
    small_batch: bool = False,
) -> Ptx:
    """Compile a tick function for an NVIDIA GPU.

    Args:
        function: tick of one rollout, `(inputs, carry, number) -> (carry, record)`.
        inputs: shapes of what does not change from tick to tick.
        carry: shapes of what does.
        is_over: picks from the carry the flag of a rollout that has ended.
        ticks: number of ticks in one launch.
        record_capacity: number of rollouts that can be recorded.
        width: number of rollouts; blocks are sized so that all multiprocessors are busy.
        group: how many numbers one operation may give at once, such as the six legs; see `program`.
        small_batch: whether all parts have the legs in lanes of a warp, which compiles sooner.
    """

    with cuda.ptx_compiler() as compiler:
        program, printer = print_program(
            function, inputs, carry, is_over, ticks, record_capacity, width, group, small_batch
        )
        text = compiler(printer.text())
    return Ptx(
        text, program.given, program.carried, program.recorded, printer.words, ticks, record_capacity, printer.rollouts
    )


def print_program(
    function: Tick,
    inputs: Any,
    carry: Any,
    is_over: Callable[[Any], Any],
    ticks: int,
    record_capacity: int,
    width: int,
    group: int = GROUP,
    small_batch: bool = False,
) -> tuple[Traced, cuda.GpuPrinter]:
    """Trace a tick function and print it as LLVM assembly for a GPU, see `compile_to_ptx`.

    Args:
        function: tick of one rollout.
        inputs: shapes of what does not change from tick to tick.
        carry: shapes of what does.
        is_over: picks from the carry the flag of a rollout that has ended.
        ticks: number of ticks in one launch.
        record_capacity: number of rollouts that can be recorded.
        width: number of rollouts.
        group: how many numbers one operation may give at once.
        small_batch: whether all parts have the legs in lanes of a warp.

    Returns:
        The program, and a printer that holds its text.
    """

    def tick_with_record(inputs: Any, carry: Any, number: Array) -> tuple[Any, dict[str, Array]]:
        carry, record = function(inputs, carry, number)
        return carry, record if record_capacity else {}

    program = trace_program(tick_with_record, inputs, carry, _lay_out, share_memory=False, group=group)
    tree = jax.tree.structure(carry)
    flag = program.carried[is_over(jax.tree.unflatten(tree, range(tree.num_leaves)))].place
    sizes = _end(program.given), _end(program.carried), _end([*program.recorded.values()])
    turns, needed = _rollouts_factor(width, group), schedule.used_nodes(program.top)
    return program, cuda.GpuPrinter(program.top, needed, sizes, ticks, flag, record_capacity, turns, group, small_batch)


def run_kernel(code: Ptx, inputs: Any, carry: Any, first: Array, slots: Int[Array, " room"] | None) -> tuple[Any, Any]:
    """Run a GPU kernel over a batch, within a function that XLA compiles.

    Args:
        code: the kernel.
        inputs: tree of inputs; leaves without a batch axis are shared by all rollouts.
        carry: tree of the carry, with leading batch axis.
        first: number of the first tick.
        slots: indices of the recorded rollouts (room,); None for none.

    Returns:
        The carry after all ticks of a launch, and records (ticks, room, ...) by name.
    """
    like, tree = jax.tree.flatten(carry)
    width = len(like[0])
    state = _pack(code, code.carried, like, width, code.words)
    operands = [
        _pack(code, code.given, jax.tree.leaves(inputs), width, _end(code.given)),
        jnp.asarray(first, jnp.int32),
        state,
    ]
    places = jnp.zeros(0, jnp.int32)
    if slots is not None:
        places = jnp.full(state.shape[0] * code.rollouts, code.room, jnp.int32)
        places = places.at[slots].min(jnp.arange(code.room, dtype=jnp.int32))
        numbers = _end([*code.recorded.values()])
        operands += [places, jnp.zeros((code.ticks, code.room + 1, numbers), jnp.uint32)]
    moved, *record = call_kernel(code, operands)
    rows = moved.transpose(0, 2, 1).reshape(-1, code.words)[:width]
    after = [restore_keys(_unpack(rows, leaf), x) for leaf, x in zip(code.carried, like, strict=True)]
    after = jax.tree.unflatten(tree, after)
    if slots is None:
        return after, None
    record = record[0][:, places[slots]]
    return after, {name: _unpack(record, leaf) for name, leaf in code.recorded.items()}


def call_kernel(code: Ptx, operands: Sequence[Array]) -> Sequence[Array]:
    """Call the kernel from XLA. Returns the operands that it changes: the state, and the records if any."""
    changed = [2] if len(operands) == 3 else [2, 4]
    return driver.call_kernel(driver.start_translation(code.text), 32 * cuda.WARPS, operands, changed)


def _rollouts_factor(width: int, group: int) -> int:
    """By how much a block has more rollouts than the least, so that every multiprocessor has one block."""
    cores = getattr(jax.devices()[0], "core_count", None) or 1
    return min(TURNS, -(-width // (cores * cuda.rollouts_per_warp(group) * cuda.WARPS)))


def _lay_out(shapes: Sequence[Any], start: int) -> tuple[list[Leaf], int]:
    """Lay arrays out one after the other, a word for each number."""
    leaves = []
    for x in shapes:
        leaves.append(Leaf(start, tuple(x.shape), np.dtype(x.dtype).name))
        start += leaves[-1].size
    return leaves, start


def _end(leaves: Sequence[Leaf]) -> int:
    return max((leaf.place + leaf.size for leaf in leaves), default=1)


def _pack(
    code: Ptx, leaves: Sequence[Leaf], values: Sequence[Array], width: int, size: int
) -> UInt32[Array, "blocks size rollouts"]:
    """Memory of a batch in blocks; rollouts beyond its width repeat the last."""
    rollouts = -(-width // code.rollouts) * code.rollouts

    def column(x: Array, leaf: Leaf) -> Array:
        bits = x.astype(jnp.uint32) if x.dtype == bool else lax.bitcast_convert_type(x, jnp.uint32)
        rows = width if x.ndim > len(leaf.shape) else 1
        return jnp.broadcast_to(bits.reshape(rows, leaf.size), (width, leaf.size))

    columns = [column(x, leaf) for x, leaf in zip(key_words(list(values)), leaves, strict=True)]
    columns.append(jnp.zeros((width, size - sum(x.shape[1] for x in columns)), jnp.uint32))
    rows = jnp.pad(jnp.concatenate(columns, axis=1), ((0, rollouts - width), (0, 0)), mode="edge")
    return rows.reshape(-1, code.rollouts, size).transpose(0, 2, 1)


def _unpack(rows: UInt32[Array, "*batch numbers"], leaf: Leaf) -> Array:
    """An array from the last axis of memory."""
    bits = rows[..., leaf.place : leaf.place + leaf.size].reshape(*rows.shape[:-1], *leaf.shape)
    return bits != 0 if leaf.dtype == "bool" else lax.bitcast_convert_type(bits, leaf.dtype)
