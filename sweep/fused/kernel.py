"""Batches through a fused program: the memory of their rollouts, tile by tile of lanes, and threads that take tiles."""

import ctypes
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array

from sweep.fused import llvm, schedule
from sweep.fused.randomness import is_key, key_words
from sweep.fused.trace import GROUP, Leaf, Traced, trace_program

ALIGN = llvm.ALIGN


class Code(NamedTuple):
    """A compiled program, as it is kept."""

    machine: bytes
    given: list[Leaf]
    carried: list[Leaf]
    recorded: dict[str, Leaf]
    scratch: int  # bytes that a thread needs
    form: Any  # the tree of what is carried, True where that is a random key
    lanes: int  # rollouts of a tile


Tick = Callable[[Any, Any, Array], tuple[Any, dict[str, Array]]]  # of a rollout: given, carried, number


def tile(width: int, cores: int) -> int:
    """Lanes for `width` rollouts: few as long as no core has two such tiles. Numbers are the same to the bit."""
    return llvm.NARROW if width <= llvm.NARROW * cores else llvm.LANES


def print_program(
    function: Tick, given: Any, carried: Any, group: int = GROUP, lanes: int = llvm.LANES
) -> tuple[Traced, llvm.CpuPrinter]:
    """A program, and its text as LLVM's assembly; see `traced`. What is given and carried share a memory, in bytes."""
    program = trace_program(function, given, carried, partial(_laid_out, lanes), together=True, group=group)
    order = schedule.order(program.top, schedule.used_nodes(program.top))
    return program, llvm.CpuPrinter(order, schedule.slots(order), group, lanes)


def compile_function(function: Tick, given: Any, carried: Any, group: int = GROUP, lanes: int = llvm.LANES) -> Code:
    """The program of a function, made at once, see `begun`."""
    return start_compilation(function, given, carried, group, lanes)()


def start_compilation(
    function: Tick, given: Any, carried: Any, group: int = GROUP, lanes: int = llvm.LANES
) -> Callable[[], Code]:
    """The rest of `compiled` once its text is there: most of the time, without Python, which can go on meanwhile."""
    program, text = print_program(function, given, carried, group, lanes)
    form = jax.tree.map(is_key, carried)

    def rest() -> Code:
        target = llvm.machine()
        machine = llvm.compile_text(text.text(target.triple), target)
        return Code(machine, program.given, program.carried, program.recorded, text.scratch, form, lanes)

    return rest


def _size(leaf: Leaf, lanes: int) -> int:
    """Bytes that a leaf takes in all lanes."""
    return leaf.size * llvm.row(leaf.dtype, lanes)


def _laid_out(lanes: int, shapes: Sequence[Any], start: int) -> tuple[list[Leaf], int]:
    """Arrays one after the other in memory, in bytes, and where the last ends."""
    leaves = []
    for x in shapes:
        leaves.append(Leaf(start, tuple(x.shape), np.dtype(x.dtype).name))
        start += llvm.round_up(_size(leaves[-1], lanes))
    return leaves, start


class Kernel:
    """A program in this process."""

    def __init__(self, code: Code):
        self.code = code
        self._kept, address = llvm.load_machine_code(code.machine, llvm.machine())
        self.run = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 3, *[ctypes.c_int64] * 3)(address)

    def enter(self, given: Any, carried: Any, width: int) -> "Tiles":
        """The memory of `width` rollouts. Leaves with one axis more than the program's differ among them."""
        tiles = Tiles(self, width)
        tiles.put(self.code.given, given)
        tiles.put(self.code.carried, carried)
        return tiles


class Tiles:
    """A batch that goes through a program. `which` picks arrays of what is carried, or trees of them."""

    def __init__(self, kernel: Kernel, width: int):
        self.code, self.width, lanes = kernel.code, width, kernel.code.lanes
        self._kernel = kernel  # whose machine code is gone when nobody holds it
        self.memory = _aligned(-(-width // lanes), _end(self.code.carried, lanes))
        tree = jax.tree.structure(self.code.form)
        self._places = jax.tree.unflatten(tree, range(tree.num_leaves))
        rooms = range(min(len(os.sched_getaffinity(0)), len(self.memory)))
        self._scratch = [_aligned(1, self.code.scratch) for _ in rooms]

    def put(self, leaves: Sequence[Leaf], tree: Any) -> None:
        """Values of a batch, or one for all of it; the last tile's idle lanes repeat the last rollout."""
        lanes = self.code.lanes
        for leaf, given in zip(leaves, jax.tree.leaves(key_words(tree)), strict=True):
            values, whole = np.asarray(given), _within(self.memory, leaf, lanes)
            if values.ndim == len(leaf.shape):
                whole[...] = values.reshape(1, leaf.size, 1)
                continue
            full, rest = divmod(self.width, lanes)
            rows = values.reshape(self.width, leaf.size)
            whole[:full] = rows[: full * lanes].reshape(full, lanes, leaf.size).transpose(0, 2, 1)
            if rest:
                whole[full, :, :rest], whole[full, :, rest:] = rows[-rest:].T, rows[-1][:, None]

    def change(self, which: Callable[[Any], Any], tree: Any) -> None:
        """Go on with other values of what `which` picks."""
        self.put([self.code.carried[place] for place in jax.tree.leaves(which(self._places))], tree)

    def advance(self, first: int, ticks: int, slots: np.ndarray | None = None) -> dict[str, np.ndarray] | None:
        """Go on by `ticks`. Records (ticks, slots, ...) of the rollouts in `slots`."""
        recorded, lanes = self.code.recorded, self.code.lanes
        size = _end([*recorded.values()], lanes)
        wanted = sorted(set(() if slots is None else (slots // lanes).tolist()))
        told: dict[Any, np.ndarray] = {tile: _aligned(ticks, size) for tile in wanted}

        def work(thread: int, threads: int) -> None:
            run, scratch, nowhere = self._kernel.run, self._scratch[thread], _aligned(1, size)
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
        rows = {name: {tile: _got(told[tile], leaf, lanes) for tile in wanted} for name, leaf in recorded.items()}
        return {name: np.stack([of[k // lanes][:, k % lanes] for k in slots], axis=1) for name, of in rows.items()}

    def leave(self) -> Any:
        """What is carried, (width, ...) each."""
        rows = self.look(lambda carried: carried)
        return jax.tree.map(lambda x, key: jax.random.wrap_key_data(x) if key else x, rows, self.code.form)

    def look(self, which: Callable[[Any], Any]) -> Any:
        """What `which` picks, (width, ...) each, without the others."""

        def rows(place: int) -> np.ndarray:
            leaf, lanes = self.code.carried[place], self.code.lanes
            return np.array(_got(self.memory, leaf, lanes).reshape(len(self.memory) * lanes, *leaf.shape)[: self.width])

        return jax.tree.map(rows, which(self._places))


def _aligned(rows: int, size: int) -> np.ndarray:
    """Memory of rows that begin where vectors may."""
    raw = np.zeros(rows * size + ALIGN, np.uint8)
    start = -raw.ctypes.data % ALIGN
    return raw[start : start + rows * size].reshape(rows, size)


def _end(leaves: Sequence[Leaf], lanes: int) -> int:
    """Bytes up to where arrays end that lie one after the other."""
    return max((leaf.place + llvm.round_up(_size(leaf, lanes)) for leaf in leaves), default=ALIGN)


def _within(memory: np.ndarray, leaf: Leaf, lanes: int) -> np.ndarray:
    """An array in memory (rows of memory, numbers, lanes)."""
    found = memory[:, leaf.place : leaf.place + _size(leaf, lanes)].view(leaf.dtype)
    return found.reshape(len(memory), leaf.size, lanes)


def _got(memory: np.ndarray, leaf: Leaf, lanes: int) -> np.ndarray:
    """Values (rows of memory, lanes, ...)."""
    return _within(memory, leaf, lanes).transpose(0, 2, 1).reshape(len(memory), lanes, *leaf.shape)
