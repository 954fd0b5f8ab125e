"""GPU code generation: prints a program as LLVM assembly for one kernel that runs all ticks.

Loops, such as those of physics, have a lane of a warp for each leg, five rollouts in a warp; each lane computes what
the legs share. The parts between them, where legs have less to do, have a thread for each rollout if the batch is
large: one operation for all legs is six operations there, and takes as long to compile. Parts pass values on in memory.
Sums over the legs have one order, so that a rollout's results depend neither on its neighbours nor on their number.
Kernels for small and for large batches may round differently.
"""

import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from subprocess import PIPE
from typing import Any, NamedTuple

import numpy as np

from sweep.fused import lanes
from sweep.fused.arrays import UnsupportedPrimitive
from sweep.fused.lanes import RECOMPUTED_OPERATIONS, KernelSection, MemoryPlace
from sweep.fused.program import (
    Block,
    Branch,
    LegIndex,
    LegReduction,
    Loop,
    LoopCount,
    MemoryAddress,
    MemoryRegion,
    Node,
    Store,
    StoredNodeReference,
    constant_value,
)
from sweep.fused.text import INTRINSICS, LLVM_TYPES, LlvmFunctionPrinter

WARP_SIZE = 32  # threads of a warp
MAX_WARPS_PER_BLOCK = 8  # warps of a block, as many as registers allow
ALL_LANES_MASK = "i32 -1"  # mask of all lanes
NATIVE_FUNCTIONS = {"sqrt", "floor", "ceil", "round"}
ZERO, HALF, ONE = "0.0", "0.5", "1.0"


class StoredValueLocation(NamedTuple):
    """Location in a rollout's memory of a value that one part of a GPU kernel computes for later parts."""

    word: int
    words_per_leg: int  # words from leg to leg
    node: Node
    is_per_leg: bool  # whether there is one for each leg
    has_own_memory: bool  # whether it has room of its own, outside of the state's arrays


class GpuKernelPrinter(LlvmFunctionPrinter):
    """Prints a program as a GPU kernel `run(given, first, state)`, optionally with recorded columns.

    A launch runs `ticks` ticks. `given` and `state` are tiles of memory. `kept` holds each rollout's place among the
    recorded ones, or -1. If none is recorded, a warp leaves its rollouts as they are once all of them are over.
    """

    def __init__(
        self,
        top: Block,
        needed: set[int],
        sizes: tuple[int, int, int],
        ticks: int,
        is_over: int,
        record_capacity: int,
        turns: int,
        group: int,
        small_batch: bool,
    ):
        super().__init__(1)
        self.group, self.beside = group, rollouts_per_warp(group)
        self.needed, self.sizes, self.ticks, self.over, self.room = needed, sizes, ticks, is_over, record_capacity
        self.rollouts = self.beside * MAX_WARPS_PER_BLOCK * turns  # rollouts of a block
        self.row = 4 * self.rollouts  # bytes of one number for all rollouts of a block
        self.names: dict[Any, str] = {}
        self.found: dict[Any, Any] = {}  # names of values in this basic block
        self.rollout = self.given = self.state = ""  # names in this part
        self.alone: lanes.RolloutPerThreadSection | None = None  # this part, if each thread has a rollout
        self.counts: dict[int, str] = {}
        self.tables: list[str] = []
        self.here: dict[MemoryPlace, str] = {}  # present values of inner memory
        self.rows, self.inner = lanes.find_per_leg_memory_rows(top, needed, group)
        self.words = sizes[1]  # words of a rollout: its state, then indexed memory, then values passed between parts
        self.scratch: dict[MemoryRegion, int] = {}
        for region in self.inner:
            self.scratch[region] = self.words
            self.words += region.size
        self.kept: dict[int | MemoryPlace, StoredValueLocation] = {}  # values that parts pass on
        self.home: dict[int | MemoryPlace, KernelSection] = {}
        (loop,) = (item for item in top.items if isinstance(item, Loop))
        before = [item for item in lanes.block_items_depth_first(top, needed) if item is not loop]
        flag = next(
            (s.region for s in loop.body.stores if s.region.byte_offset == is_over and not s.region.is_record), None
        )
        parts = [
            KernelSection(before, top.stores, False),
            *lanes.split_into_kernel_sections(loop.body, needed, flag, group, small_batch, self.rows),
        ]
        self._keep(parts)
        self._head()
        self._ticks(*parts)

    def module_text(self) -> str:
        """Return the program as LLVM assembly for a GPU."""
        told = ["readonly %kept_", "%record_"] if self.room else []
        operands = ", ".join(f"ptr noalias {x}" for x in ("readonly %given_", "readonly %first_", "%state_", *told))
        return "\n".join([
            'target triple = "nvptx64-nvidia-cuda"', *sorted(self.declared), *self.tables,
            f"define ptx_kernel void @run({operands}) {{\nentry:\n{self.printed_lines()}\n  ret void\n}}",
            "!nvvm.annotations = !{!0}",
            f'!0 = !{{ptr @run, !"maxntidx", i32 {32 * MAX_WARPS_PER_BLOCK}, !"minctasm", i32 1}}', "",
        ])  # fmt: skip

    def _nvvm(self, name: str, kind: str, *args: str, to: str | None = None) -> str:
        """Call one of NVIDIA's intrinsics."""
        self.declared.add(f"declare {kind} @llvm.nvvm.{name}({', '.join(x.split()[0] for x in args)})")
        call = f"call {kind} @llvm.nvvm.{name}({', '.join(args)})"
        if kind != "void":
            return self.emit(call, to)
        self.lines.append(call)
        return ""

    def _head(self) -> None:
        """Compute which leg of which rollout this lane has, and which rollouts this block has."""
        thread = self._nvvm("read.ptx.sreg.tid.x", "i32", to="%thread")
        block = self._nvvm("read.ptx.sreg.ctaid.x", "i32", to="%block")
        lane, warp = self.emit(f"and i32 {thread}, 31"), self.emit(f"lshr i32 {thread}, 5", "%warp")
        group = self.emit(f"udiv i32 {lane}, {self.group}")
        beyond = self.emit(f"icmp ugt i32 {group}, {self.beside - 1}")
        group = self.emit(f"select i1 {beyond}, i32 {self.beside - 1}, i32 {group}")
        leg = self.emit(f"urem i32 {lane}, {self.group}", "%leg")
        base = self.emit(f"mul i32 {group}, {self.group}", "%base")
        across = self.emit(f"urem i32 {self.emit(f'add i32 {leg}, {self.group // 2}')}, {self.group}")
        self.emit(f"add i32 {base}, {across}", "%across")
        self.emit(f"add i32 {self.emit(f'mul i32 {warp}, {self.beside}')}, {group}", "%own")
        wide = self.emit(f"zext i32 {block} to i64")
        for name, words in (("given", self.sizes[0]), ("state", self.words)):
            self.emit(
                f"getelementptr i8, ptr %{name}_, i64 {self.emit(f'mul i64 {wide}, {words * self.row}')}", f"%{name}"
            )
        self.emit("load i32, ptr %first_", "%first")

    # blocks

    def _items(self, items: Iterable[Any]) -> None:
        for item in items:
            if isinstance(item, Node):
                if item.op not in RECOMPUTED_OPERATIONS and item.op != "any_rollout":
                    self.names[item.number] = self._work(item)
            elif isinstance(item, Store):
                self._stores([item])
            elif isinstance(item, Loop):
                self._loop(item)
            else:
                self._branch(item)

    def _thread_items(self, alone: lanes.RolloutPerThreadSection, part: KernelSection) -> None:
        """Print a part with one rollout in each thread; it stores values early, so that few are alive at a time."""
        ready = {}  # words for later parts, by the number of a node
        for key, (word, step, node, _, apart) in self.kept.items():
            if self.home[key] is part and apart and isinstance(key, int):
                for k, x in enumerate(alone.nodes_by_leg(node)):
                    ready.setdefault(x.number, []).append((word + k * step, x))
        done: set[int] = set()
        for k, item in enumerate(alone.items):
            self._items([item])
            if isinstance(item, Node):
                for word, node in ready.pop(item.number, ()):
                    self._put_word(word, 0, node.dtype, self.value_name(node))
            for store in alone.early.get(k, ()):
                self._put_word(
                    self._start_of(store.region) + store.index, 0, store.region.dtype, self.value_name(store.value)
                )
                done.add(id(store))
        for pairs in ready.values():
            for word, node in pairs:
                self._put_word(word, 0, node.dtype, self.value_name(node))
        self._stores([store for store in alone.stores if id(store) not in done], part)

    def _block(self, block: Block) -> None:
        self._items(block.items if self.alone else lanes.block_items_depth_first(block, self.needed))
        self._stores(block.stores)

    def _start(self, label: str) -> None:
        self.start_block(label)
        self.found = {}

    def _keep(self, parts: Sequence[KernelSection]) -> None:
        """Allocate room for the values that a part passes on and that the state does not hold anyway."""
        stored: dict[int | MemoryPlace, StoredValueLocation] = {}
        for part in parts:
            for node in lanes.section_operands(part, self.needed):
                if node.op == "load" and not self._is_outer(node.extra_data_of_type(MemoryAddress).region):
                    key, leg = (place := self._row(*node.extra_data_of_type(MemoryAddress)[:2])[0]), place in self.rows
                elif node.op not in RECOMPUTED_OPERATIONS:
                    key, leg = node.number, node.leg
                else:
                    continue
                if self.home.get(key, part) is not part and key not in self.kept:
                    self.kept[key] = stored.get(key) or StoredValueLocation(
                        self.words, 1 if leg else 0, node, leg, True
                    )
                    self.words += (self.group if leg else 1) * self.kept[key].has_own_memory
            self.home |= {item.number: part for item in part.items if isinstance(item, Node)}
            self.home |= dict.fromkeys(self._changed_places(part.items), part)
            if part is not parts[0]:
                stored |= dict(self._in_state(part))

    def _in_state(self, part: KernelSection) -> Iterator[tuple[int | MemoryPlace, "StoredValueLocation"]]:
        """Values that a part stores to the state anyway, from where later parts can read them."""
        for store in part.stores:
            node, region = store.value, store.region
            key, leg = node.number, node.leg
            if node.op == "load":
                key = self._row(*node.extra_data_of_type(MemoryAddress)[:2])[0]
                leg = key in self.rows
            fixed = self._is_outer(region) and not region.is_record and not store.row_index
            if self.home.get(key) is part and leg == node.leg and fixed:
                yield (
                    key,
                    StoredValueLocation(
                        self._start_of(region) + store.index, store.leg_stride if leg else 0, node, leg, False
                    ),
                )

    def _ticks(self, before: KernelSection, *parts: KernelSection) -> None:
        """Print all ticks, part by part: a block's rollouts all go through one part before the next."""
        self._part("P", before)
        at, entered = len(self.lines) + 2, self.label
        self.lines.append("br label %tick")
        self._start("tick")
        for k, part in enumerate(parts):
            self._part(f"P{k}", part)
        self.lines.insert(at, f"%k = phi i32 [0, %{entered}], [%next, %{self.label}]")
        self.emit("add i32 %k, 1", "%next")
        more = self.emit(f"icmp ult i32 %next, {self.ticks}")
        self.lines.append(f"br i1 {more}, label %tick, label %end")
        self._start("end")

    def _part(self, name: str, part: KernelSection) -> None:
        """Print a part for all rollouts of a block, a few at a time; warps run side by side and share instructions."""
        size = self.beside * MAX_WARPS_PER_BLOCK if part.legs_in_lanes else 32 * MAX_WARPS_PER_BLOCK
        turns, ragged = -(-self.rollouts // size), self.rollouts % size > 0
        if not part.legs_in_lanes:
            self._nvvm("barrier0", "void")
        at, entered = len(self.lines) + 2, self.label
        self.lines.append(f"br label %{name}")
        self._start(name)
        if part.legs_in_lanes:
            self._nvvm("barrier0", "void")
        self.names, self.here = {}, {}
        start, idle = self.emit(f"mul i32 %{name}_t, {size}"), "false"
        self.rollout = self.emit(f"add i32 {start}, {'%own' if part.legs_in_lanes else '%thread'}")
        if ragged:
            idle = self.emit(
                f"icmp uge i32 {self.emit(f'add i32 {start}, {self.emit("shl i32 %warp, 5")}')}, {self.rollouts}"
            )
            self.rollout = self.call_intrinsic("umin", "int32", [self.rollout, str(self.rollouts - 1)])
        bytes_ = self.emit(f"zext i32 {self.emit(f'shl i32 {self.rollout}, 2')} to i64")
        self.given, self.state = (
            self.emit(f"getelementptr i8, ptr %{base}, i64 {bytes_}") for base in ("given", "state")
        )
        if not self.room:
            over = self.emit(f"icmp ne i32 {self._get(self.state, self.over * self.row, 'i32')}, 0")
            every = self._nvvm("vote.all.sync", "i1", ALL_LANES_MASK, f"i1 {over}")
            idle = self.emit(f"or i1 {idle}, {every}") if ragged else every
        self.lines.append(f"br i1 {idle}, label %{name}_d, label %{name}_g")
        self._start(f"{name}_g")
        self.alone = None if part.legs_in_lanes else lanes.RolloutPerThreadSection(part, self.needed, self.group)
        if self.alone:
            self._thread_items(self.alone, part)
        else:
            self._items(part.items)
            self._stores(part.stores, part)
        self.lines.append(f"br label %{name}_d")
        self._start(f"{name}_d")
        following = self.emit(f"add i32 %{name}_t, 1")
        self.lines.insert(at, f"%{name}_t = phi i32 [0, %{entered}], [{following}, %{name}_d]")
        more = self.emit(f"icmp ult i32 {following}, {turns}")
        self.lines.append(f"br i1 {more}, label %{name}, label %{name}_x")
        self._start(f"{name}_x")

    def _loop(self, loop: Loop) -> None:
        self._fresh += 1
        name, before, at = f"L{self._fresh}", self.label, len(self.lines) + 2
        self.lines.append(f"br label %{name}")
        self._start(name)
        count, following = f"%{name}_k", f"%{name}_n"
        moving = [place for place in self._changed_places([*loop.body.items, *loop.body.stores]) if place in self.here]
        old = {place: self.here[place] for place in moving}
        self.here |= {place: f"%{name}_{k}" for k, place in enumerate(moving)}
        self.counts[loop.body.depth] = count
        self._block(loop.body)
        self.emit(f"add i32 {count}, 1", following)
        again = (
            self._uniform(loop.continue_flag)
            if loop.continue_flag
            else self.emit(f"icmp ult i32 {following}, {loop.length}")
        )
        phis = [f"{count} = phi i32 [0, %{before}], [{following}, %{self.label}]"]
        for k, place in enumerate(moving):
            kind = LLVM_TYPES[place[0].dtype]
            phis.append(f"%{name}_{k} = phi {kind} [{old[place]}, %{before}], [{self.here[place]}, %{self.label}]")
        self.lines[at:at] = phis
        self.lines.append(f"br i1 {again}, label %{name}, label %{name}_x")
        self._start(f"{name}_x")

    def _branch(self, branch: Branch) -> None:
        self._fresh += 1
        name = f"B{self._fresh}"
        self.print_switch(LLVM_TYPES[branch.index.dtype], self._uniform(branch.index), name, len(branch.blocks))
        before, ends = dict(self.here), []
        for k, block in enumerate(branch.blocks):
            self._start(f"{name}_{k}")
            self.here = dict(before)
            self._block(block)
            ends.append((self.label, self.here))
            self.lines.append(f"br label %{name}_x")
        self._start(f"{name}_x")
        self.here = before
        for place in {place: None for _, here in ends for place in here if here[place] != before.get(place)}:
            values = ", ".join(f"[{here.get(place, 'poison')}, %{label}]" for label, here in ends)
            self.here[place] = self.emit(f"phi {LLVM_TYPES[place[0].dtype]} {values}")

    def _uniform(self, node: Node) -> str:
        """Compute a value that decides a branch where the branch needs it.

        Parts pass nothing on for warps whose rollouts are all over. Lanes of the next part's warps that read such a
        value from different warps could take different branches, and would wait for each other for ever.
        """
        if node.op == "any_rollout":
            return self._nvvm("vote.any.sync", "i1", ALL_LANES_MASK, f"i1 {self.value_name(node.args[0])}")
        if node.op in RECOMPUTED_OPERATIONS or node.op == "count":
            return (
                self.counts[node.extra_data_of_type(LoopCount).depth] if node.op == "count" else self.value_name(node)
            )
        args = [self._uniform(x) for x in node.args]
        return self.print_arithmetic(node.op, node.dtype, args, [x.dtype for x in node.args])

    def _changed_places(self, items: Iterable[Any]) -> Iterator[MemoryPlace]:
        """Places in inner memory that are stored to, each once."""
        stores = (x for item in items for x in (item, *lanes.iterate_nested_items(item)) if isinstance(x, Store))
        yield from dict.fromkeys(self._place(x.region, x.index) for x in stores if not self._is_outer(x.region))

    # memory

    def _row(self, region: MemoryRegion, index: int) -> tuple[MemoryPlace, int]:
        """First place of the legs' row that a place in inner memory belongs to, and the leg of this place."""
        first, _, leg = self.rows.get((region, index), (index, 0, 0))
        return (region, first), leg

    def _place(self, region: MemoryRegion, index: int) -> MemoryPlace:
        return (region, index) if self.alone else self._row(region, index)[0]

    def _stores(self, stores: Sequence[Store], part: KernelSection | None = None) -> None:
        """Store values that are all computed; at the end of a part also those that later parts need."""
        values = [(store, self.value_name(store.value)) for store in stores]
        told = [pair for pair in values if pair[0].region.is_record]
        if told:
            self._record(told)
        outer = [pair for pair in values if self._is_outer(pair[0].region) and not pair[0].region.is_record]
        handed = [*self._outgoing_values(part)] if part else []
        if outer or handed:
            self._nvvm("bar.warp.sync", "void", ALL_LANES_MASK)
        for store, value in values:
            if not self._is_outer(store.region):
                self._set(store, value)
        for store, value in outer:
            word, base = self._start_of(store.region) + store.index, ""
            if store.row_index:
                moved = self.emit(f"mul i32 {self._uniform(store.row_index)}, {store.row_stride * self.row}")
                base = self.emit(f"getelementptr i8, ptr {self.state}, i32 {moved}")
            self._put_word(word, store.leg_stride if store.value.leg else 0, store.region.dtype, value, base)
        for word, step, dtype, value in handed:
            self._put_word(word, step, dtype, value)
        if outer or handed:
            self._nvvm("bar.warp.sync", "void", ALL_LANES_MASK)
            self.found = {key: x for key, x in self.found.items() if not isinstance(key, tuple)}

    def _outgoing_values(self, part: KernelSection) -> Iterator[tuple[int, int, str, str]]:
        """Values that this part passes on: word, step from leg to leg, type and name."""
        for key, (word, step, node, leg, apart) in self.kept.items():
            if self.home[key] is not part or not apart or (self.alone and isinstance(key, int)):
                continue
            if isinstance(key, int):
                values = [self.value_name(node)]
            else:
                region, first = key
                apart_by = self.rows[key][1] if leg else 0
                values = [
                    self.here[region, first + k * apart_by] for k in (range(self.group) if leg and self.alone else (0,))
                ]
            for k, value in enumerate(values):
                yield word + k * step, 0 if self.alone else step, node.dtype, value

    def _incoming_value(self, key: int | MemoryPlace, leg: int | None = None) -> str:
        """Value that an earlier part computed, for this lane or for a leg."""
        if (key, leg) not in self.found:
            word, step, node, legs, _ = self.kept[key]
            base = self._leg(self.state, step) if legs and leg is None else self.state
            self.found[key, leg] = self._read(node.dtype, base, (word + (leg or 0) * step) * self.row)
        return self.found[key, leg]

    def _set(self, store: Store, value: str) -> None:
        place, row = self._place(store.region, store.index), self.rows.get((store.region, store.index))
        if row and not store.value.leg and not self.alone:
            kind = LLVM_TYPES[store.region.dtype]
            here = self.emit(f"icmp eq i32 %leg, {row[2]}")
            value = self.emit(f"select i1 {here}, {kind} {value}, {kind} {self.here.get(place, 'poison')}")
        self.here[place] = value

    def _record(self, values: Sequence[tuple[Store, str]]) -> None:
        """Store to the record if any rollout of this warp is recorded; the others write to a spare place."""
        self._fresh += 1
        name = f"R{self._fresh}"
        number = self.emit(f"add i32 {self.emit(f'mul i32 %block, {self.rollouts}')}, {self.rollout}")
        place = self.emit(f"load i32, ptr {self.emit(f'getelementptr i32, ptr %kept_, i32 {number}')}")
        none = self._nvvm("vote.all.sync", "i1", ALL_LANES_MASK, f"i1 {self.emit(f'icmp eq i32 {place}, {self.room}')}")
        self.lines.append(f"br i1 {none}, label %{name}_x, label %{name}")
        self._start(name)
        row = self.emit(f"add i32 {self.emit(f'mul i32 %k, {self.room + 1}')}, {place}")
        start = self.emit(f"mul i64 {self.emit(f'zext i32 {row} to i64')}, {4 * self.sizes[2]}")
        base = self.emit(f"getelementptr i8, ptr %record_, i64 {start}")
        for store, value in values:
            at = base
            if store.value.leg:
                offset = self.emit(f"mul i32 %leg, {4 * store.leg_stride}")
                at = self.emit(f"getelementptr i8, ptr {base}, i32 {offset}")
            self._put(at, 4 * (store.region.byte_offset + store.index), store.region.dtype, value)
        self.lines.append(f"br label %{name}_x")
        self._start(f"{name}_x")

    def _is_outer(self, region: MemoryRegion) -> bool:
        return region.byte_offset >= 0 or region in self.scratch

    def _start_of(self, region: MemoryRegion) -> int:
        return self.scratch.get(region, region.byte_offset)

    def _base(self, region: MemoryRegion) -> str:
        return self.given if region.byte_offset >= 0 and region.depth == 0 else self.state

    def _leg(self, base: str, step: int) -> str:
        """Address of this leg's number; legs are `step` numbers apart."""
        key = f"{base} {step}"
        if key not in self.found:
            offset = self.emit(f"mul i32 %leg, {step * self.row}")
            self.found[key] = self.emit(f"getelementptr i8, ptr {base}, i32 {offset}")
        return self.found[key]

    def _get(self, base: str, offset: int | str, kind: str) -> str:
        at = self.emit(f"getelementptr i8, ptr {base}, i32 {offset}")
        return self.emit(f"load {kind}, ptr {at}, align 4")

    def _put(self, base: str, offset: int, dtype: str, value: str) -> None:
        at = self.emit(f"getelementptr i8, ptr {base}, i32 {offset}")
        kind = LLVM_TYPES[dtype]
        if kind == "i1":
            kind, value = "i32", self.emit(f"zext i1 {value} to i32")
        self.lines.append(f"store {kind} {value}, ptr {at}, align 4")

    def _put_word(self, word: int, step: int, dtype: str, value: str, base: str = "") -> None:
        """Store a number to this rollout's state, with a step to this leg's; or to the memory at `base`."""
        base = base or self.state
        self._put(self._leg(base, step) if step else base, word * self.row, dtype, value)

    def _read(self, dtype: str, base: str, offset: int | str) -> str:
        kind = LLVM_TYPES[dtype]
        if kind not in ("i1", "i32", "float"):
            raise UnsupportedPrimitive(f"{dtype} on a GPU")
        if kind != "i1":
            return self._get(base, offset, kind)
        return self.emit(f"icmp ne i32 {self._get(base, offset, 'i32')}, 0")

    # values

    def value_name(self, node: Node) -> str:
        """Return the LLVM name of a node's value; for a value per leg, that of the leg which the thread computes."""
        if node.op == "const" and not node.leg:
            return self.literal(constant_value(node))
        if node.op == "handed_on":
            return self._incoming_value(*node.extra_data_of_type(StoredNodeReference))
        if node.op not in RECOMPUTED_OPERATIONS:
            return self.names.get(node.number) or self._incoming_value(node.number)
        if node.op == "load" and not self._is_outer(node.extra_data_of_type(MemoryAddress).region):
            return self._register_value(node)
        key = node.number, "memory"
        if key not in self.found:
            again = {"const": self._table, "load": self._load, "tick": self._tick}
            self.found[key] = again[node.op](node)
        return self.found[key]

    def _register_value(self, node: Node) -> str:
        """Value of a number of inner memory, which is held in a register."""
        region, index, _, _ = node.extra_data_of_type(MemoryAddress)
        (first, leg), there = self._row(region, index), self._place(region, index)
        if self.alone:
            return self.here.get(there) or self._incoming_value(first, leg)
        value = self.here.get(there) or self._incoming_value(first)
        whole = node.leg or (region, index) not in self.rows
        return value if whole else self._shuffle(value, region.dtype, self._lane(leg))

    def _load(self, node: Node) -> str:
        region, index, _, step = node.extra_data_of_type(MemoryAddress)
        base = self._base(region)
        offset = (self._start_of(region) + index) * self.row
        return self._read(region.dtype, self._leg(base, step) if node.leg else base, offset)

    def _tick(self, _: Node) -> str:
        return self.emit("add i32 %k, %first")

    def _table(self, node: Node) -> str:
        values, kind = constant_value(node), LLVM_TYPES[node.dtype]
        if kind == "i1":
            bits = sum(1 << k for k, x in enumerate(values) if x)
            return self.emit(f"trunc i32 {self.emit(f'lshr i32 {bits}, %leg')} to i1")
        name = f"@table{len(self.tables)}"
        listed = ", ".join(f"{kind} {self.literal(x)}" for x in values)
        self.tables.append(f"{name} = private addrspace(4) constant [{self.group} x {kind}] [{listed}]")
        at = self.emit(f"getelementptr {kind}, ptr addrspace(4) {name}, i32 %leg")
        return self.emit(f"load {kind}, ptr addrspace(4) {at}")

    def _lane(self, leg: int) -> str:
        key = f"lane {leg}"
        if leg and key not in self.found:
            self.found[key] = self.emit(f"add i32 %base, {leg}")
        return self.found[key] if leg else "%base"

    def _shuffle(self, value: str, dtype: str, lane: str) -> str:
        """Value that another lane holds."""
        kind = LLVM_TYPES[dtype]
        if kind == "i1":
            wide = self.emit(f"zext i1 {value} to i32")
            moved = self._nvvm("shfl.sync.idx.i32", "i32", ALL_LANES_MASK, f"i32 {wide}", f"i32 {lane}", "i32 31")
            return self.emit(f"icmp ne i32 {moved}, 0")
        short = {"float": "f32"}.get(kind, kind)
        return self._nvvm(f"shfl.sync.idx.{short}", kind, ALL_LANES_MASK, f"{kind} {value}", f"i32 {lane}", "i32 31")

    def _over_legs(self, node: Node) -> str:
        """Reduce over the legs: opposite legs first, then the pairs in order."""
        value, kinds, op = self.value_name(node.args[0]), [node.dtype] * 2, node.extra_data_of_type(LegReduction).op
        pair = self.print_arithmetic(op, node.dtype, [value, self._shuffle(value, node.dtype, "%across")], kinds)
        total = self._shuffle(pair, node.dtype, self._lane(0))
        for k in range(1, self.group // 2):
            one = self._shuffle(pair, node.dtype, self._lane(k))
            total = self.print_arithmetic(op, node.dtype, [total, one], kinds)
        return total

    def _work(self, node: Node) -> str:
        """Print a node's operation."""
        match node.op:
            case "gather":
                region, index, _, step = node.extra_data_of_type(MemoryAddress)
                base = self._base(region)
                place = self.emit(f"mul i32 {self.value_name(node.args[0])}, {self.row}")
                offset = self.emit(f"add i32 {place}, {(self._start_of(region) + index) * self.row}")
                return self._read(region.dtype, self._leg(base, step) if node.leg else base, offset)
            case "part":
                whole = node.args[0]
                return self._shuffle(
                    self.value_name(whole), whole.dtype, self._lane(node.extra_data_of_type(LegIndex).leg)
                )
            case "pack":
                value, kind = self.value_name(node.args[-1]), LLVM_TYPES[node.dtype]
                for k in range(self.group - 2, -1, -1):
                    here = self.emit(f"icmp eq i32 %leg, {k}")
                    value = self.emit(f"select i1 {here}, {kind} {self.value_name(node.args[k])}, {kind} {value}")
                return value
            case "over_legs":
                return self._over_legs(node)
            case "count":
                return self.counts[node.extra_data_of_type(LoopCount).depth]
            case _ if node.op in INTRINSICS and node.op not in NATIVE_FUNCTIONS:
                raise UnsupportedPrimitive(f"{node.op} of {node.dtype} on a GPU")
            case _:
                args = [self.value_name(x) for x in node.args]
                return self.print_arithmetic(node.op, node.dtype, args, [x.dtype for x in node.args])

    def print_arithmetic(self, op: str, dtype: str, args: list[str], kinds: Sequence[str]) -> str:
        """Print an operation without branches, which would split this basic block.

        Args:
            op: operation, by JAX's name.
            dtype: type of the result.
            args: names of the operands.
            kinds: their types.
        """
        if dtype == "float32" and op == "div":
            return self._quotient(*args)
        if dtype in ("int32", "uint32") and op == "add":
            # not `add`: one of LLVM's passes compares each sum with all others, 20 s for the words of noise
            return self.emit(f"sub i32 {args[0]}, {self.emit(f'sub i32 0, {args[1]}')}")
        return (
            self._root(*args)
            if dtype == "float32" and op == "sqrt"
            else super().print_arithmetic(op, dtype, args, kinds)
        )

    def _quotient(self, a: str, b: str) -> str:
        """a / b with IEEE rounding, if neither 1 / b nor the quotient overflows or underflows."""
        if (b, "inverse") not in self.found:
            near = self._nvvm("rcp.approx.ftz.f", "float", f"float {b}")
            minus = self.emit(f"fneg float {b}")
            error = self.call_intrinsic("fma", "float32", [minus, near, ONE])
            self.found[b, "inverse"] = near, minus, self.call_intrinsic("fma", "float32", [near, error, near])
        near, minus, inverse = self.found[b, "inverse"]
        first = self.emit(f"fmul float {a}, {near}")
        left = self.call_intrinsic("fma", "float32", [minus, first, a])
        quotient = self.call_intrinsic("fma", "float32", [left, inverse, first])
        odd = self.emit(f"fcmp uno float {quotient}, {quotient}")  # for 0, infinity and NaN
        return self.emit(f"select i1 {odd}, float {first}, float {quotient}")

    def _root(self, x: str) -> str:
        """Square root with IEEE rounding; a small number is scaled by 2^64 first."""
        small = self.emit(f"fcmp olt float {x}, {self.literal(np.float32(2**-96))}")
        scale = [self.literal(np.float32(2.0**k)) for k in (64, -32)]
        up, down = (self.emit(f"select i1 {small}, float {by}, float {ONE}") for by in scale)
        scaled = self.emit(f"fmul float {x}, {up}")
        inverse = self._nvvm("rsqrt.approx.ftz.f", "float", f"float {scaled}")
        root, half = self.emit(f"fmul float {scaled}, {inverse}"), self.emit(f"fmul float {inverse}, {HALF}")
        left = self.call_intrinsic("fma", "float32", [self.emit(f"fneg float {root}"), root, scaled])
        root = self.emit(f"fmul float {self.call_intrinsic('fma', 'float32', [left, half, root])}, {down}")
        odd = self.emit(f"fcmp uno float {root}, {root}")  # for 0 and infinity, too
        itself = self.emit(f"and i1 {odd}, {self.emit(f'fcmp oge float {x}, {ZERO}')}")
        return self.emit(f"select i1 {itself}, float {x}, float {root}")

    def print_max_or_min(self, op: str, dtype: str, args: list[str]) -> str:
        """Print the LLVM code for the maximum or minimum of two numbers; NaN if either is NaN.

        Args:
            op: `max` or `min`.
            dtype: type of the numbers.
            args: names of the operands.
        """
        return self.call_intrinsic("maximum" if op == "max" else "minimum", dtype, args)


def rollouts_per_warp(group: int) -> int:
    """Return how many rollouts a GPU warp simulates if each thread computes one leg; spare threads repeat other work.

    Raises:
        Unsupported: The number of legs is odd, or too large for a warp.
    """
    if group % 2 or not 0 < group <= WARP_SIZE:
        raise UnsupportedPrimitive(f"a group of {group} on a GPU")
    return WARP_SIZE // group


@contextmanager
def ptx_compiler() -> Iterator[Callable[[str], str]]:
    """Context that starts a background process and yields a function that compiles LLVM assembly to PTX in it.

    Raises:
        Unsupported: LLVM cannot compile the module.
    """
    asked = [sys.executable, "-P", str(Path(__file__).with_name("nvptx.py"))]
    with subprocess.Popen(asked, stdin=PIPE, stdout=PIPE, stderr=PIPE, text=True) as process:

        def compiled(text: str) -> str:
            made, failed = process.communicate(text)
            if process.returncode:
                raise UnsupportedPrimitive((failed.strip().splitlines() or ["what ends LLVM"])[-1])
            return made

        try:
            yield compiled
        except BaseException:  # such as an interrupt, or an operation without a rule
            process.kill()
            raise
