"""Calls of GPU kernels from XLA programs, which own memory and devices."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Int, UInt32

from sweep.fused import cuda, driver, schedule
from sweep.fused.randomness import keys_to_words, rewrap_if_key
from sweep.fused.trace import LEG_COUNT, ArrayLayout, TracedProgram, trace_program

MIN_ROLLOUTS_PER_BLOCK = (
    cuda.rollouts_per_warp(LEG_COUNT) * cuda.MAX_WARPS_PER_BLOCK
)  # smallest number of rollouts in a thread block
MAX_BLOCK_FACTOR = 25  # largest factor by which a block has more
XLA_OPTIONS = {"xla_gpu_graph_min_graph_size": 1 << 30}  # CUDA graphs do not help one long kernel


class PtxKernel(NamedTuple):
    """A GPU kernel as PTX text, with the locations of its arrays in a rollout's memory."""

    text: str
    input_leaves: list[ArrayLayout]
    carry_leaves: list[ArrayLayout]
    record_leaves: dict[str, ArrayLayout]
    words_per_rollout: int  # words of a rollout: its carry, and the kernel's own
    ticks: int
    record_capacity: int  # number of rollouts that can be recorded
    rollouts_per_block: int  # rollouts of a thread block


TickFunction = Callable[
    [Any, Any, Array], tuple[Any, dict[str, Array]]
]  # tick of one rollout: (inputs, carry, number) -> (carry, record)
PackedWords = UInt32[Array, "blocks words rollouts"]  # memory of a batch as a kernel lays it out


def compile_to_ptx(
    function: TickFunction,
    inputs: Any,
    carry: Any,
    is_over: Callable[[Any], Any],
    ticks: int,
    record_capacity: int,
    width: int,
    group: int = LEG_COUNT,
    small_batch: bool = False,
) -> PtxKernel:
    """Compile the function of a control tick to PTX, the assembly of NVIDIA GPUs.

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
        program, printer = print_llvm_program(
            function, inputs, carry, is_over, ticks, record_capacity, width, group, small_batch
        )
        text = compiler(printer.module_text())
    return PtxKernel(
        text,
        program.input_leaves,
        program.carry_leaves,
        program.record_leaves,
        printer.words,
        ticks,
        record_capacity,
        printer.rollouts,
    )


def print_llvm_program(
    function: TickFunction,
    inputs: Any,
    carry: Any,
    is_over: Callable[[Any], Any],
    ticks: int,
    record_capacity: int,
    width: int,
    group: int = LEG_COUNT,
    small_batch: bool = False,
) -> tuple[TracedProgram, cuda.GpuKernelPrinter]:
    """Trace the function of a control tick and print it as LLVM assembly for a GPU.

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
    flag = program.carry_leaves[is_over(jax.tree.unflatten(tree, range(tree.num_leaves)))].offset
    sizes = _end(program.input_leaves), _end(program.carry_leaves), _end([*program.record_leaves.values()])
    turns, needed = _rollouts_factor(width, group), schedule.used_node_numbers(program.top_block)
    return program, cuda.GpuKernelPrinter(
        program.top_block, needed, sizes, ticks, flag, record_capacity, turns, group, small_batch
    )


def run_kernel(
    code: PtxKernel, inputs: Any, carry: Any, first: Array, slots: Int[Array, " room"] | None
) -> tuple[Any, Any]:
    """Run a GPU kernel over a batch for some control ticks, from within a function that XLA compiles.

    Args:
        code: the kernel.
        inputs: tree of inputs; leaves without a batch axis are shared by all rollouts.
        carry: tree of the carry, with leading batch axis.
        first: number of the first tick.
        slots: indices of the recorded rollouts (room,); None for none.

    Returns:
        The carry after all ticks of a launch, and records (ticks, room, ...) by name.
    """
    state, record = advance_packed_batch(code, *pack_batch(code, inputs, carry), first, slots)
    return unpack_carry(code, state, carry), record


def pack_batch(code: PtxKernel, inputs: Any, carry: Any) -> tuple[PackedWords, PackedWords]:
    """Lay a batch out as a kernel reads it.

    Args:
        code: the kernel.
        inputs: tree of inputs; leaves without a batch axis are shared by all rollouts.
        carry: tree of the carry, with leading batch axis.

    Returns:
        Inputs and state in the kernel's layout.
    """
    like = jax.tree.leaves(carry)
    width = len(like[0])
    return (
        _pack(code, code.input_leaves, jax.tree.leaves(inputs), width, _end(code.input_leaves)),
        _pack(code, code.carry_leaves, like, width, code.words_per_rollout),
    )


def advance_packed_batch(
    code: PtxKernel, inputs: PackedWords, state: PackedWords, first: Array, slots: Int[Array, " room"] | None
) -> tuple[PackedWords, Any]:
    """Run a GPU kernel over a batch that is laid out for it, from within a function that XLA compiles.

    Args:
        code: the kernel.
        inputs: inputs in its layout.
        state: state in its layout; XLA changes it in place if the caller donates it.
        first: number of the first tick.
        slots: indices of the recorded rollouts (room,); None for none.

    Returns:
        The state after all ticks of a launch, and records (ticks, room, ...) by name.
    """
    operands = [inputs, jnp.asarray(first, jnp.int32), state]
    if slots is None:
        (state,) = call_kernel(code, operands)
        return state, None
    places = jnp.full(state.shape[0] * code.rollouts_per_block, code.record_capacity, jnp.int32)
    places = places.at[slots].min(jnp.arange(code.record_capacity, dtype=jnp.int32))
    numbers = _end([*code.record_leaves.values()])
    operands += [places, jnp.zeros((code.ticks, code.record_capacity + 1, numbers), jnp.uint32)]
    state, record = call_kernel(code, operands)
    record = record[:, places[slots]]
    return state, {name: _unpack(record, leaf) for name, leaf in code.record_leaves.items()}


def unpack_carry(code: PtxKernel, state: PackedWords, like: Any) -> Any:
    """Read the carry of a batch from the kernel's layout.

    Args:
        code: the kernel.
        state: state in its layout.
        like: tree of arrays, or of their shapes, as the carry has them.
    """
    leaves, tree = jax.tree.flatten(like)
    rows = _rows_of_rollouts(state)[: leaves[0].shape[0]]
    after = [rewrap_if_key(_unpack(rows, leaf), x) for leaf, x in zip(code.carry_leaves, leaves, strict=True)]
    return jax.tree.unflatten(tree, after)


def read_carry_leaf(leaf: ArrayLayout, state: PackedWords, width: int) -> Array:
    """Read one array (width, ...) of the carry from the kernel's layout.

    Args:
        leaf: location of the array, one of the kernel's `carry_leaves`.
        state: state of the batch in the kernel's layout.
        width: number of rollouts.
    """
    rows = _rows_of_rollouts(state[:, leaf.offset : leaf.offset + leaf.size])[:width]
    return _unpack(rows, ArrayLayout(0, leaf.shape, leaf.dtype))


def write_carry_leaf(leaf: ArrayLayout, state: PackedWords, values: Array) -> PackedWords:
    """Write one array (n, ...) of the carry into the kernel's layout; rollouts beyond n repeat the last.

    Args:
        leaf: location of the array, one of the kernel's `carry_leaves`.
        state: state of the batch in the kernel's layout.
        values: numbers of the array's type.
    """
    blocks, _, rollouts = state.shape
    rows = jnp.pad(_as_words(values, leaf), ((0, blocks * rollouts - len(values)), (0, 0)), mode="edge")
    words = rows.reshape(blocks, rollouts, leaf.size).transpose(0, 2, 1)
    return state.at[:, leaf.offset : leaf.offset + leaf.size].set(words)


def call_kernel(code: PtxKernel, operands: Sequence[Array]) -> Sequence[Array]:
    """Call a GPU kernel from XLA; return the rollouts' state and any recorded columns, which the kernel changes."""
    changed = [2] if len(operands) == 3 else [2, 4]
    return driver.call_kernel(driver.start_ptx_translation(code.text), 32 * cuda.MAX_WARPS_PER_BLOCK, operands, changed)


def _rollouts_factor(width: int, group: int) -> int:
    """By how much a block has more rollouts than the least, so that every multiprocessor has one block."""
    cores = getattr(jax.devices()[0], "core_count", None) or 1
    return min(MAX_BLOCK_FACTOR, -(-width // (cores * cuda.rollouts_per_warp(group) * cuda.MAX_WARPS_PER_BLOCK)))


def _lay_out(shapes: Sequence[Any], start: int) -> tuple[list[ArrayLayout], int]:
    """Lay arrays out one after the other, a word for each number."""
    leaves = []
    for x in shapes:
        leaves.append(ArrayLayout(start, tuple(x.shape), np.dtype(x.dtype).name))
        start += leaves[-1].size
    return leaves, start


def _end(leaves: Sequence[ArrayLayout]) -> int:
    return max((leaf.offset + leaf.size for leaf in leaves), default=1)


def _pack(
    code: PtxKernel, leaves: Sequence[ArrayLayout], values: Sequence[Array], width: int, size: int
) -> UInt32[Array, "blocks size rollouts"]:
    """Memory of a batch in blocks; rollouts beyond its width repeat the last."""
    rollouts = -(-width // code.rollouts_per_block) * code.rollouts_per_block

    columns = [
        jnp.broadcast_to(_as_words(x, leaf), (width, leaf.size))
        for x, leaf in zip(keys_to_words(list(values)), leaves, strict=True)
    ]
    columns.append(jnp.zeros((width, size - sum(x.shape[1] for x in columns)), jnp.uint32))
    rows = jnp.pad(jnp.concatenate(columns, axis=1), ((0, rollouts - width), (0, 0)), mode="edge")
    return rows.reshape(-1, code.rollouts_per_block, size).transpose(0, 2, 1)


def _as_words(x: Array, leaf: ArrayLayout) -> UInt32[Array, "rollouts numbers"]:
    """Bits of an array; one row where all rollouts share it."""
    bits = x.astype(jnp.uint32) if x.dtype == bool else lax.bitcast_convert_type(x, jnp.uint32)
    return bits.reshape(len(x) if x.ndim > len(leaf.shape) else 1, leaf.size)


def _rows_of_rollouts(state: PackedWords) -> UInt32[Array, "rollouts words"]:
    return state.transpose(0, 2, 1).reshape(-1, state.shape[1])


def _unpack(rows: UInt32[Array, "*batch numbers"], leaf: ArrayLayout) -> Array:
    """An array from the last axis of memory."""
    bits = rows[..., leaf.offset : leaf.offset + leaf.size].reshape(*rows.shape[:-1], *leaf.shape)
    return bits != 0 if leaf.dtype == "bool" else lax.bitcast_convert_type(bits, leaf.dtype)
