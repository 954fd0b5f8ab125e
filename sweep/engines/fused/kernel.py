"""Batches through a fused program: the memory of their rollouts, tile by tile of lanes, and threads that take tiles."""

import ctypes
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from sweep.engines.fused import llvm, schedule
from sweep.engines.fused.trace import Leaf, keyed, traced, words

LANES, ALIGN = llvm.LANES, llvm.ALIGN


class Code(NamedTuple):
    """A compiled program, as it is kept."""

    machine: bytes
    given: list[Leaf]
    carried: list[Leaf]
    recorded: dict[str, Leaf]
    scratch: int  # bytes that a thread needs


def compiled(function: Callable[[Any, Any, Array], tuple[Any, dict[str, Array]]], given: Any, carried: Any) -> Code:
    """See `traced`; what is given and carried share a memory, in bytes."""
    program = traced(function, given, carried, _laid_out, together=True)
    plan = schedule.plan(program.top, schedule.used(program.top))
    printed = llvm.Printer(plan, schedule.slots(plan))
    target = llvm.machine()
    machine = llvm.compiled(printed.text(target.triple), target)
    return Code(machine, program.given, program.carried, program.recorded, printed.scratch)


def _size(leaf: Leaf) -> int:
    """Bytes, of all lanes."""
    return leaf.count * llvm.row(leaf.dtype)


def _laid_out(shapes: Sequence[Any], start: int) -> tuple[list[Leaf], int]:
    """Arrays one after the other in memory, in bytes, and where the last ends."""
    leaves = []
    for x in shapes:
        leaves.append(Leaf(start, tuple(x.shape), np.dtype(x.dtype).name))
        start += llvm.rounded(_size(leaves[-1]))
    return leaves, start


class Kernel:
    """A program in this process, and the batch that goes through it."""

    def __init__(self, code: Code):
        self.code = code
        self._kept, address = llvm.loaded(code.machine, llvm.machine())
        self._run = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 3, *[ctypes.c_int64] * 3)(address)
        self._threads = len(os.sched_getaffinity(0))

    def enter(self, given: Any, carried: Any, width: int) -> "Tiles":
        """The memory of `width` rollouts. Leaves with one axis more than the program's differ among them."""
        tiles = Tiles(_aligned(-(-width // LANES), _end(self.code.carried)), width, carried)
        _put_all(tiles, self.code.given, given)
        self.resume(tiles, carried)
        return tiles

    def resume(self, tiles: "Tiles", carried: Any) -> None:
        """Go on from another state."""
        _put_all(tiles, self.code.carried, carried)

    def advance(self, tiles: "Tiles", first: int, ticks: int, slots: np.ndarray | None) -> dict[str, np.ndarray] | None:
        """Go on by `ticks`. Records (ticks, slots, ...) of the rollouts in `slots`."""
        recorded = self.code.recorded
        size = _end([*recorded.values()])
        wanted = sorted(set(() if slots is None else (slots // LANES).tolist()))
        told: dict[Any, np.ndarray] = {tile: _aligned(ticks, size) for tile in wanted}

        def work(tiles_of_one: range) -> None:
            scratch, nowhere = _aligned(1, self.code.scratch), _aligned(1, size)
            for tile in tiles_of_one:
                into = told.get(tile)
                record, stride = (nowhere, 0) if into is None else (into, size)
                self._run(tiles.memory[tile].ctypes.data, scratch.ctypes.data, record.ctypes.data, stride, first, ticks)

        count = len(tiles.memory)
        with ThreadPoolExecutor(self._threads) as pool:
            list(pool.map(work, [range(k, count, self._threads) for k in range(min(self._threads, count))]))
        if slots is None:
            return None
        rows = {name: {tile: _got(told[tile], leaf) for tile in wanted} for name, leaf in recorded.items()}
        return {name: np.stack([of[k // LANES][:, k % LANES] for k in slots], axis=1) for name, of in rows.items()}

    def leave(self, tiles: "Tiles") -> Any:
        """What is carried, (width, ...) each."""
        like, tree = jax.tree.flatten(tiles.like)
        found = [jnp.asarray(self._rows(tiles, leaf)) for leaf in self.code.carried]
        return jax.tree.unflatten(tree, [keyed(x, one) for x, one in zip(found, like, strict=True)])

    def look(self, tiles: "Tiles", which: Callable[[Any], int]) -> np.ndarray:
        """The array (width, ...) that `which` picks of what is carried, without the others."""
        tree = jax.tree.structure(tiles.like)
        return self._rows(tiles, self.code.carried[which(jax.tree.unflatten(tree, range(tree.num_leaves)))])

    def _rows(self, tiles: "Tiles", leaf: Leaf) -> np.ndarray:
        return _got(tiles.memory, leaf).reshape(len(tiles.memory) * LANES, *leaf.shape)[: tiles.width]


class Tiles(NamedTuple):
    """A batch in memory."""

    memory: np.ndarray  # (tiles, bytes)
    width: int
    like: Any  # what is carried, as it was at first


def _aligned(rows: int, size: int) -> np.ndarray:
    """Memory of rows that begin where vectors may."""
    raw = np.zeros(rows * size + ALIGN, np.uint8)
    start = -raw.ctypes.data % ALIGN
    return raw[start : start + rows * size].reshape(rows, size)


def _end(leaves: Sequence[Leaf]) -> int:
    """Bytes up to where arrays end that lie one after the other."""
    return max((leaf.place + llvm.rounded(_size(leaf)) for leaf in leaves), default=ALIGN)


def _put_all(tiles: Tiles, leaves: Sequence[Leaf], tree: Any) -> None:
    for leaf, values in zip(leaves, jax.tree.leaves(words(tree)), strict=True):
        _put(tiles.memory, leaf, np.asarray(values), tiles.width)


def _put(memory: np.ndarray, leaf: Leaf, values: np.ndarray, width: int) -> None:
    """Values of a batch, or one for all of it; the last tile's idle lanes repeat the last rollout."""
    tiles, count = len(memory), leaf.count
    if values.ndim > len(leaf.shape):
        lanes = np.minimum(np.arange(tiles * LANES), width - 1)
        values = values.reshape(width, count)[lanes].reshape(tiles, LANES, count).transpose(0, 2, 1)
    else:
        values = np.broadcast_to(values.reshape(1, count, 1), (tiles, count, LANES))
    values = np.ascontiguousarray(values, leaf.dtype)
    memory[:, leaf.place : leaf.place + _size(leaf)] = values.reshape(tiles, -1).view(np.uint8)


def _got(memory: np.ndarray, leaf: Leaf) -> np.ndarray:
    """Values (rows of memory, lanes, ...)."""
    rows, count = len(memory), leaf.count
    values = np.ascontiguousarray(memory[:, leaf.place : leaf.place + _size(leaf)]).view(leaf.dtype)
    return values.reshape(rows, count, LANES).transpose(0, 2, 1).reshape(rows, LANES, *leaf.shape)
