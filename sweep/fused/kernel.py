"""CPU kernels: the memory of a batch in tiles of vector lanes, and the threads that process tiles."""

import ctypes
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array

from sweep.fused import llvm, schedule
from sweep.fused.cores import count_cores
from sweep.fused.randomness import is_key, keys_to_words
from sweep.fused.trace import LEG_COUNT, ArrayLayout, TracedProgram, trace_program

ALIGNMENT_BYTES = llvm.ALIGNMENT_BYTES


class KernelCode(NamedTuple):
    """A compiled CPU kernel as the cache stores it."""

    machine_code: bytes
    input_leaves: list[ArrayLayout]
    carry_leaves: list[ArrayLayout]
    record_leaves: dict[str, ArrayLayout]
    scratch_bytes: int  # bytes of scratch memory of a thread
    random_key_tree: Any  # tree of the carry: True for random keys
    lanes: int  # rollouts of a tile


TickFunction = Callable[
    [Any, Any, Array], tuple[Any, dict[str, Array]]
]  # tick of one rollout: (inputs, carry, number) -> (carry, record)


def choose_lane_count(width: int, cores: int) -> int:
    """Return how many rollouts a vector of the kernel holds: fewer for small batches. Results do not depend on it.

    Args:
        width: number of rollouts.
        cores: number of CPU cores.
    """
    return llvm.NARROW_TILE_LANES if width <= llvm.NARROW_TILE_LANES * cores else llvm.TILE_LANES


def print_llvm_program(
    function: TickFunction, inputs: Any, carry: Any, group: int = LEG_COUNT, lanes: int = llvm.TILE_LANES
) -> tuple[TracedProgram, llvm.CpuKernelPrinter]:
    """Trace the function of one control tick and print it as LLVM assembly for a CPU.

    Args:
        function: tick of one rollout, `(inputs, carry, number) -> (carry, record)`.
        inputs: shapes of what does not change from tick to tick.
        carry: shapes of what does.
        group: how many numbers one operation may give at once, such as the six legs; see `program`.
        lanes: rollouts of a tile.

    Returns:
        The program, and a printer that holds its text. Inputs and carry share a memory, whose layout is in bytes.
    """
    program = trace_program(function, inputs, carry, partial(_lay_out, lanes), share_memory=True, group=group)
    order = schedule.schedule_block(program.top_block, schedule.used_node_numbers(program.top_block))
    return program, llvm.CpuKernelPrinter(order, schedule.assign_scratch_slots(order), group, lanes)


def compile_function(
    function: TickFunction, inputs: Any, carry: Any, group: int = LEG_COUNT, lanes: int = llvm.TILE_LANES
) -> KernelCode:
    """Compile the function of one control tick to machine code for this CPU.

    Args:
        function: tick of one rollout, `(inputs, carry, number) -> (carry, record)`.
        inputs: shapes of what does not change from tick to tick.
        carry: shapes of what does.
        group: how many numbers one operation may give at once, such as the six legs; see `program`.
        lanes: rollouts of a tile.
    """
    return start_compilation(function, inputs, carry, group, lanes)()


def start_compilation(
    function: TickFunction, inputs: Any, carry: Any, group: int = LEG_COUNT, lanes: int = llvm.TILE_LANES
) -> Callable[[], KernelCode]:
    """Print the function of a control tick as LLVM assembly; return a function that compiles it, for use in a thread.

    Args:
        function: tick of one rollout, `(inputs, carry, number) -> (carry, record)`.
        inputs: shapes of what does not change from tick to tick.
        carry: shapes of what does.
        group: how many numbers one operation may give at once, such as the six legs; see `program`.
        lanes: rollouts of a tile.
    """
    program, text = print_llvm_program(function, inputs, carry, group, lanes)
    form = jax.tree.map(is_key, carry)

    def rest() -> KernelCode:
        target = llvm.target_machine()
        machine = llvm.compile_llvm_assembly(text.module_text(target.triple), target)
        return KernelCode(
            machine, program.input_leaves, program.carry_leaves, program.record_leaves, text.scratch, form, lanes
        )

    return rest


def _size(leaf: ArrayLayout, lanes: int) -> int:
    """Bytes of a leaf in all lanes."""
    return leaf.size * llvm.lane_vector_bytes(leaf.dtype, lanes)


def _lay_out(lanes: int, shapes: Sequence[Any], start: int) -> tuple[list[ArrayLayout], int]:
    """Lay arrays out one after the other. Returns their places in bytes, and the end of the last."""
    leaves = []
    for x in shapes:
        leaves.append(ArrayLayout(start, tuple(x.shape), np.dtype(x.dtype).name))
        start += llvm.round_to_alignment(_size(leaves[-1], lanes))
    return leaves, start


class Kernel:
    """A compiled CPU kernel loaded into this process."""

    def __init__(self, code: KernelCode):
        self.code = code
        self._kept, address = llvm.load_machine_code(code.machine_code, llvm.target_machine())
        self.run = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 3, *[ctypes.c_int64] * 3)(address)

    def load_batch(self, inputs: Any, carry: Any, width: int) -> "KernelBatch":
        """Write inputs and start state of a batch to memory in the kernel's layout, and return that memory.

        Args:
            inputs: tree of inputs; leaves with one more axis than the kernel's differ among rollouts.
            carry: tree of the carry, likewise.
            width: number of rollouts.
        """
        tiles = KernelBatch(self, width)
        tiles.write_arrays(self.code.input_leaves, inputs)
        tiles.write_arrays(self.code.carry_leaves, carry)
        return tiles


class KernelBatch:
    """A batch in a CPU kernel's memory, with methods that read, replace and advance the rollouts' state."""

    def __init__(self, kernel: Kernel, width: int):
        self.code, self.width, lanes = kernel.code, width, kernel.code.lanes
        self._kernel = kernel  # keeps its machine code alive
        self.memory = _allocate_aligned(-(-width // lanes), _end(self.code.carry_leaves, lanes))
        tree = jax.tree.structure(self.code.random_key_tree)
        self._places = jax.tree.unflatten(tree, range(tree.num_leaves))
        rooms = range(min(count_cores(), len(self.memory)))
        self._scratch = [_allocate_aligned(1, self.code.scratch_bytes) for _ in rooms]

    def write_arrays(self, leaves: Sequence[ArrayLayout], tree: Any) -> None:
        """Write arrays of a batch, or values shared by all rollouts, to the given places of the kernel's memory."""
        lanes = self.code.lanes
        for leaf, given in zip(leaves, jax.tree.leaves(keys_to_words(tree)), strict=True):
            values, whole = np.asarray(given), _view(self.memory, leaf, lanes)
            if values.ndim == len(leaf.shape):
                whole[...] = values.reshape(1, leaf.size, 1)
                continue
            full, rest = divmod(self.width, lanes)
            rows = values.reshape(self.width, leaf.size)
            whole[:full] = rows[: full * lanes].reshape(full, lanes, leaf.size).transpose(0, 2, 1)
            if rest:
                whole[full, :, :rest], whole[full, :, rest:] = rows[-rest:].T, rows[-1][:, None]

    def replace_state_values(self, select: Callable[[Any], Any], tree: Any) -> None:
        """Overwrite part of the rollouts' state: the arrays that `select` picks from it become those of `tree`."""
        self.write_arrays([self.code.carry_leaves[place] for place in jax.tree.leaves(select(self._places))], tree)

    def advance_ticks(self, first: int, ticks: int, slots: np.ndarray | None = None) -> dict[str, np.ndarray] | None:
        """Run control ticks on all rollouts of the batch; record the columns of the rollouts `slots`.

        Args:
            first: number of the first tick.
            ticks: how many.
            slots: rollouts to record; None for none.

        Returns:
            Records (ticks, slots, ...) by name; None without slots.
        """
        recorded, lanes = self.code.record_leaves, self.code.lanes
        size = _end([*recorded.values()], lanes)
        wanted = sorted(set(() if slots is None else (slots // lanes).tolist()))
        told: dict[Any, np.ndarray] = {tile: _allocate_aligned(ticks, size) for tile in wanted}

        def work(thread: int, threads: int) -> None:
            run, scratch, nowhere = self._kernel.run, self._scratch[thread], _allocate_aligned(1, size)
            for tile in range(thread, len(self.memory), threads):
                into = told.get(tile)
                record, stride = (nowhere, 0) if into is None else (into, size)
                run(self.memory[tile].ctypes.data, scratch.ctypes.data, record.ctypes.data, stride, first, ticks)

        if (threads := len(self._scratch) if ticks > 1 else 1) > 1:
            with ThreadPoolExecutor(threads) as pool:
                list(pool.map(work, range(threads), [threads] * threads))
        else:
            work(0, 1)
        if slots is None:
            return None
        rows = {name: {tile: _unpack(told[tile], leaf, lanes) for tile in wanted} for name, leaf in recorded.items()}
        return {name: np.stack([of[k // lanes][:, k % lanes] for k in slots], axis=1) for name, of in rows.items()}

    def read_full_state(self) -> Any:
        """Return the state of all rollouts after the last tick, an array (width, ...) for each leaf."""
        rows = self.read_state_values(lambda carry: carry)
        return jax.tree.map(lambda x, key: jax.random.wrap_key_data(x) if key else x, rows, self.code.random_key_tree)

    def read_state_values(self, select: Callable[[Any], Any]) -> Any:
        """Return the arrays (width, ...) that `select` picks from the state of the rollouts."""

        def rows(place: int) -> np.ndarray:
            leaf, lanes = self.code.carry_leaves[place], self.code.lanes
            return np.array(
                _unpack(self.memory, leaf, lanes).reshape(len(self.memory) * lanes, *leaf.shape)[: self.width]
            )

        return jax.tree.map(rows, select(self._places))


def _allocate_aligned(rows: int, size: int) -> np.ndarray:
    """Memory whose rows are aligned for vectors."""
    raw = np.zeros(rows * size + ALIGNMENT_BYTES, np.uint8)
    start = -raw.ctypes.data % ALIGNMENT_BYTES
    return raw[start : start + rows * size].reshape(rows, size)


def _end(leaves: Sequence[ArrayLayout], lanes: int) -> int:
    """Bytes up to the end of arrays that lie one after the other."""
    return max((leaf.offset + llvm.round_to_alignment(_size(leaf, lanes)) for leaf in leaves), default=ALIGNMENT_BYTES)


def _view(memory: np.ndarray, leaf: ArrayLayout, lanes: int) -> np.ndarray:
    """View of an array in memory: (rows of memory, numbers, lanes)."""
    found = memory[:, leaf.offset : leaf.offset + _size(leaf, lanes)].view(leaf.dtype)
    return found.reshape(len(memory), leaf.size, lanes)


def _unpack(memory: np.ndarray, leaf: ArrayLayout, lanes: int) -> np.ndarray:
    """Values of an array: (rows of memory, lanes, ...)."""
    return _view(memory, leaf, lanes).transpose(0, 2, 1).reshape(len(memory), lanes, *leaf.shape)
