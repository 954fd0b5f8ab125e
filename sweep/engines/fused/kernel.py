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
from sweep.engines.fused.interpret import Interpreter
from sweep.engines.fused.program import Program, Region

LANES, ALIGN = llvm.LANES, llvm.ALIGN


class Leaf(NamedTuple):
    """Where an array of each rollout lies in a tile's memory."""

    place: int  # bytes from the start
    shape: tuple[int, ...]
    dtype: str

    @property
    def size(self) -> int:
        """Bytes, of all lanes."""
        return int(np.prod(self.shape)) * llvm.row(self.dtype)


class Code(NamedTuple):
    """A compiled program, as it is kept."""

    machine: bytes
    given: list[Leaf]  # what does not change
    carried: list[Leaf]  # what goes on from tick to tick
    recorded: dict[str, Leaf]  # of each tick, in a memory of its own
    scratch: int  # bytes that a thread needs


def compiled(function: Callable[[Any, Any, Array], tuple[Any, dict[str, Array]]], given: Any, carried: Any) -> Code:
    """The ticks `function(given, carried, number) -> (carried, record)` of one rollout, for trees of arrays like these.

    Raises `Unsupported`.
    """
    (first, tree), (second, other) = jax.tree.flatten(given), jax.tree.flatten(carried)
    n = len(first)

    def flat(*leaves: Array) -> Any:
        before = jax.tree.unflatten(tree, leaves[:n])
        now = jax.tree.unflatten(other, [_keyed(x, like) for x, like in zip(leaves[n:-1], second, strict=True)])
        moved, record = function(before, now, leaves[-1])
        return jax.tree.leaves(words(moved)), record

    shapes = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in words([*first, *second])]
    traced, (_, record) = jax.make_jaxpr(flat, return_shape=True)(*shapes, jax.ShapeDtypeStruct((), jnp.int32))
    constant, size = _laid_out(shapes[:n], 0)
    moving, _ = _laid_out(shapes[n:], size)
    names = sorted(record)  # as JAX flattens them
    recorded, _ = _laid_out([record[name] for name in names], 0)

    program = Program()
    interpreter = Interpreter(program)
    regions = [[Region(int(np.prod(x.shape)), x.dtype, depth, x.place, told) for x in leaves]
               for leaves, depth, told in ((constant, 0, False), (moving, 1, False), (recorded, 1, True))]  # fmt: skip
    with program.loop(None) as body:
        tick = np.full((), program.node("tick", (), "int32", 1), object)
        inputs = [interpreter.loaded(region, leaf.shape, region.depth)
                  for group, leaves in zip(regions[:2], (constant, moving), strict=True)
                  for region, leaf in zip(group, leaves, strict=True)]  # fmt: skip
        results = interpreter.evaluate(traced.jaxpr, traced.consts, [*inputs, tick])
        for region, value in zip((*regions[1], *regions[2]), results, strict=True):
            interpreter.save(region, value, body.stores)
    plan = schedule.plan(program.top, schedule.used(program.top))
    printed = llvm.Printer(plan, schedule.slots(plan))
    target = llvm.machine()
    machine = llvm.compiled(printed.text(target.triple), target)
    return Code(machine, constant, moving, dict(zip(names, recorded, strict=True)), printed.scratch)


def _laid_out(shapes: Sequence[Any], start: int) -> tuple[list[Leaf], int]:
    """Arrays one after the other in memory, and where the last ends."""
    leaves = []
    for x in shapes:
        leaves.append(Leaf(start, tuple(x.shape), np.dtype(x.dtype).name))
        start += llvm.rounded(leaves[-1].size)
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
        return jax.tree.unflatten(tree, [_keyed(x, one) for x, one in zip(found, like, strict=True)])

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
    return max((leaf.place + llvm.rounded(leaf.size) for leaf in leaves), default=ALIGN)


def _put_all(tiles: Tiles, leaves: Sequence[Leaf], tree: Any) -> None:
    for leaf, values in zip(leaves, jax.tree.leaves(words(tree)), strict=True):
        _put(tiles.memory, leaf, np.asarray(values), tiles.width)


def _put(memory: np.ndarray, leaf: Leaf, values: np.ndarray, width: int) -> None:
    """Values of a batch, or one for all of it; the last tile's idle lanes repeat the last rollout."""
    tiles, count = len(memory), int(np.prod(leaf.shape))
    if values.ndim > len(leaf.shape):
        lanes = np.minimum(np.arange(tiles * LANES), width - 1)
        values = values.reshape(width, count)[lanes].reshape(tiles, LANES, count).transpose(0, 2, 1)
    else:
        values = np.broadcast_to(values.reshape(1, count, 1), (tiles, count, LANES))
    values = np.ascontiguousarray(values, leaf.dtype)
    memory[:, leaf.place : leaf.place + leaf.size] = values.reshape(tiles, -1).view(np.uint8)


def _got(memory: np.ndarray, leaf: Leaf) -> np.ndarray:
    """Values (rows of memory, lanes, ...)."""
    rows, count = len(memory), int(np.prod(leaf.shape))
    values = np.ascontiguousarray(memory[:, leaf.place : leaf.place + leaf.size]).view(leaf.dtype)
    return values.reshape(rows, count, LANES).transpose(0, 2, 1).reshape(rows, LANES, *leaf.shape)


def words(tree: Any) -> Any:
    """Arrays, or their shapes, with random keys as the words that they are."""

    def one(x: Any) -> Any:
        if not _is_key(x):
            return x
        return jax.eval_shape(jax.random.key_data, x) if isinstance(x, jax.ShapeDtypeStruct) else jax.random.key_data(x)

    return jax.tree.map(one, tree)


def _keyed(x: Array, like: Any) -> Array:
    return jax.random.wrap_key_data(x) if _is_key(like) else x


def _is_key(x: Any) -> bool:
    return jnp.issubdtype(x.dtype, jax.dtypes.prng_key)
