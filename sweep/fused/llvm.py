"""CPU code: the program as LLVM assembly with rollouts in vector lanes, and its compilation for this processor.

A rollout's results depend neither on its neighbours nor on their number.
"""

from collections.abc import Sequence
from typing import Any

import llvmlite.binding as llvm
import numpy as np

from sweep.fused.program import (
    Branch,
    LegIndex,
    LegReduction,
    Loop,
    LoopCount,
    MemoryAddress,
    MemoryRegion,
    Node,
    Store,
    constant_value,
)
from sweep.fused.schedule import BlockSchedule, OperationGroup, ScratchSlots, used_memory_regions
from sweep.fused.text import LLVM_TYPES, LlvmFunctionPrinter

TILE_LANES, NARROW_TILE_LANES = 16, 4  # rollouts of a tile; a narrow tile takes half as long
ALIGNMENT_BYTES = 64  # bytes
REDUCTION_STARTS = {
    "add": -0.0,
    "mul": 1,
    "max": -np.inf,
    "min": np.inf,
    "and": True,
    "or": False,
}  # start of a reduction over the legs


def lane_vector_bytes(dtype: str, lanes: int) -> int:
    """Return the size in bytes of a vector that holds a number for each of several rollouts (lanes)."""
    return lanes * np.dtype(dtype).itemsize


def round_to_alignment(size: int) -> int:
    """Round bytes up to a multiple of the alignment."""
    return -(-size // ALIGNMENT_BYTES) * ALIGNMENT_BYTES


class CpuKernelPrinter(LlvmFunctionPrinter):
    """Prints a program as an LLVM function `run(rollouts, scratch, record, stride, first, ticks)`.

    `record` advances by `stride` bytes each tick; `first` is the number of the first tick.
    """

    def __init__(self, top: BlockSchedule, slots: ScratchSlots, group: int, lanes: int):
        super().__init__(lanes)
        self.group = group
        self.slots = slots
        self.names: dict[int, str] = {}
        self.counts: dict[int, str] = {}  # counters of the open loops, by depth
        self.row = lanes * slots.size
        self.scratch = round_to_alignment(slots.count * self.group * self.row)
        self.places: dict[MemoryRegion, int] = {}
        for region in sorted((r for r in used_memory_regions(top) if r.byte_offset < 0), key=id):
            self.places[region] = self.scratch
            self.scratch += round_to_alignment(region.size * self.lane_vector_bytes(region.dtype))
        self._order(top)

    def module_text(self, triple: str) -> str:
        """Return the program as LLVM assembly for a CPU."""
        head = "define void @run(ptr noalias %rollouts, ptr noalias %scratch, ptr noalias %record, i64 %stride, "
        declared = "\n".join(sorted(self.declared))
        start = f'target triple = "{triple}"\n{declared}\n{head}i64 %first, i64 %ticks) {{\nentry:\n'
        return f"{start}{self.printed_lines()}\n  ret void\n}}\n"

    # blocks

    def _order(self, order: BlockSchedule) -> None:
        for at, step in enumerate(order.steps):
            if isinstance(step, OperationGroup):
                (self._legs_turn if step.is_leg_loop else self._plain_turn)(step)
            elif isinstance(step, Store):
                self._store(step)
            elif isinstance(step, Loop):
                self._loop(step, order.inner_schedules[at][0])
            elif isinstance(step, Branch):
                self._branch(step, order.inner_schedules[at])

    def _loop(self, loop: Loop, body: BlockSchedule) -> None:
        self._fresh += 1
        name, before = f"L{self._fresh}", self.label
        self.lines.append(f"br label %{name}")
        self.start_block(name)
        count, following = f"%{name}_k", f"%{name}_n"
        at = len(self.lines)
        self.lines.append("")
        self.counts[body.block.depth] = count
        self._order(body)
        length = "%ticks" if loop.length is None else str(loop.length)
        self.emit(f"add i64 {count}, 1", following)
        if loop.continue_flag:
            more = self.emit(f"extractelement {self.vector_type('bool')} {self.value_name(loop.continue_flag)}, i32 0")
            self.emit(f"xor i1 {more}, true", f"%{name}_c")
        else:
            self.emit(f"icmp eq i64 {following}, {length}", f"%{name}_c")
        self.lines[at] = f"{count} = phi i64 [0, %{before}], [{following}, %{self.label}]"
        self.lines.append(f"br i1 %{name}_c, label %{name}_x, label %{name}")
        self.start_block(f"{name}_x")

    def _branch(self, branch: Branch, orders: Sequence[BlockSchedule]) -> None:
        self._fresh += 1
        name = f"B{self._fresh}"
        index = self.value_name(branch.index)  # of all rollouts alike
        first = self.emit(f"extractelement {self.vector_type(branch.index.dtype)} {index}, i32 0")
        self.print_switch(LLVM_TYPES[branch.index.dtype], first, name, len(orders))
        for k, one in enumerate(orders):
            self.start_block(f"{name}_{k}")
            names = dict(self.names)
            self._order(one)
            self.names = names
            self.lines.append(f"br label %{name}_x")
        self.start_block(f"{name}_x")

    def _plain_turn(self, turn: OperationGroup) -> None:
        for node in turn.nodes:
            if node.op == "pack":
                for k, x in enumerate(node.args):
                    self._put(self.value_name(x), node.dtype, "%scratch", str(self.scratch_offset(node) + k * self.row))
            else:
                self.names[node.number] = self._work(node, [self.value_name(x) if not x.leg else "" for x in node.args])

    def _legs_turn(self, turn: OperationGroup) -> None:
        self._fresh += 1
        name, before = f"T{self._fresh}", self.label
        leg = LegLoopValues(self, f"%{name}_k")
        sums = [n for n in turn.nodes if n.op == "over_legs"]
        self.lines.append(f"br label %{name}")
        self.start_block(name)
        self.lines.append(f"%{name}_k = phi i64 [0, %{before}], [%{name}_n, %{name}]")
        totals = []
        for k, node in enumerate(sums):
            op = node.extra_data_of_type(LegReduction).op
            first = REDUCTION_STARTS[op]
            if not np.issubdtype(node.dtype, np.floating) and not isinstance(first, bool):
                first = {"add": 0, "mul": 1, "max": np.iinfo(node.dtype).min, "min": np.iinfo(node.dtype).max}[op]
            start = self.literal(np.asarray(first, node.dtype))
            totals.append(
                self.emit(f"phi {self.vector_type(node.dtype)} [{start}, %{before}], [%{name}_s{k}, %{name}]")
            )
        for node in turn.nodes:
            if node.op == "over_legs":
                k = sums.index(node)
                op = node.extra_data_of_type(LegReduction).op
                total = self.print_arithmetic(
                    op, node.dtype, [totals[k], leg.value_name(node.args[0])], [node.dtype] * 2
                )
                self.emit(
                    f"select i1 true, {self.vector_type(node.dtype)} {total}, {self.vector_type(node.dtype)} {total}",
                    f"%{name}_s{k}",
                )
                self.names[node.number] = f"%{name}_s{k}"
                continue
            value = leg.here[node.number] = self._work(node, [leg.value_name(x) for x in node.args], leg)
            if node.number in self.slots.by_node:
                self._put(value, node.dtype, "%scratch", leg.leg_offset(self.row, self.scratch_offset(node)))
        self.emit(f"add i64 %{name}_k, 1", f"%{name}_n")
        self.emit(f"icmp eq i64 %{name}_n, {self.group}", f"%{name}_c")
        self.lines.append(f"br i1 %{name}_c, label %{name}_x, label %{name}")
        self.start_block(f"{name}_x")

    def scratch_offset(self, node: Node) -> int:
        """Return where a node's values for the legs lie in scratch memory: the offset (bytes) of the first."""
        return self.slots.by_node[node.number] * self.group * self.row

    # memory

    def lane_vector_bytes(self, dtype: str) -> int:
        """Return the size in bytes of a vector that holds a number for each of several rollouts (lanes)."""
        return lane_vector_bytes(dtype, self.lanes)

    def region_pointer(self, region: MemoryRegion) -> tuple[str, int]:
        """Return the LLVM pointer to the memory that holds an array, and the array's offset in bytes from it."""
        if region in self.places:
            return "%scratch", self.places[region]
        return "%rollouts", region.byte_offset

    def _store(self, store: Store) -> None:
        region, value = store.region, store.value
        base, place = self.region_pointer(region)
        size = self.lane_vector_bytes(region.dtype)
        if region.is_record:
            count = self.counts[1]
            moved = self.emit(f"mul i64 {count}, %stride")
            base = self.emit(f"getelementptr i8, ptr %record, i64 {moved}")
        if store.row_index:
            row = self.emit(f"extractelement {self.vector_type('int32')} {self.value_name(store.row_index)}, i32 0")
            moved = self.emit(f"mul i64 {self.emit(f'sext i32 {row} to i64')}, {store.row_stride * size}")
            base = self.emit(f"getelementptr i8, ptr {base}, i64 {moved}")
        if not value.leg:
            self._put(self.value_name(value), region.dtype, base, str(place + store.index * size))
            return
        for k in range(self.group):
            one = self.leg_value_name(value, k)
            self._put(one, region.dtype, base, str(place + (store.index + k * store.leg_stride) * size))

    def leg_value_name(self, node: Node, k: int) -> str:
        """Return the LLVM name of one leg's value, from a node that stands for all legs."""
        if node.op == "const":
            return self.literal(constant_value(node)[k])
        if node.op == "load":
            region, index, _, step = node.extra_data_of_type(MemoryAddress)
            base, place = self.region_pointer(region)
            return self.print_number_load(
                region.dtype, base, str(place + (index + k * step) * self.lane_vector_bytes(region.dtype))
            )
        return self.print_number_load(node.dtype, "%scratch", str(self.scratch_offset(node) + k * self.row))

    def _put(self, value: str, dtype: str, base: str, offset: str) -> None:
        at = self.emit(f"getelementptr i8, ptr {base}, i64 {offset}")
        if dtype == "bool":
            value = self.emit(f"zext {self.vector_type('bool')} {value} to {self.vector_type('int8')}")
        stored = self.vector_type("int8" if dtype == "bool" else dtype)
        self.lines.append(f"store {stored} {value}, ptr {at}, align {min(64, self.lane_vector_bytes(dtype))}")

    def print_number_load(self, dtype: str, base: str, offset: str, name: str | None = None) -> str:
        """Print the load of a number from memory, `offset` bytes from a pointer.

        Args:
            dtype: type of the number.
            base: the pointer.
            offset: bytes from there.
            name: name of the value; by default a new one.
        """
        at = self.emit(f"getelementptr i8, ptr {base}, i64 {offset}")
        if dtype == "bool":
            found = self.emit(f"load {self.vector_type('int8')}, ptr {at}, align {self.lanes}")
            return self.emit(f"icmp ne {self.vector_type('int8')} {found}, zeroinitializer", name)
        return self.emit(
            f"load {self.vector_type(dtype)}, ptr {at}, align {min(64, self.lane_vector_bytes(dtype))}", name
        )

    def print_number_gather(self, node: Node, place: str, offset: str) -> str:
        """Print the load of a number from a different address for each rollout, plus `offset` bytes."""
        region = node.extra_data_of_type(MemoryAddress).region
        base, _ = self.region_pointer(region)
        size, wide = self.lane_vector_bytes(region.dtype), self.vector_type("int64")
        lanes = ", ".join(f"i64 {k * np.dtype(region.dtype).itemsize}" for k in range(self.lanes))
        far = self.emit(f"sext {self.vector_type('int32')} {place} to {wide}")
        moved = self.emit(f"mul {wide} {far}, {self.splat('i64', size)}")
        moved = self.emit(f"add {wide} {moved}, <{lanes}>")
        start = self.emit(f"getelementptr i8, ptr {base}, i64 {offset}")
        where = self.emit(f"getelementptr i8, ptr {start}, {wide} {moved}")
        kept = "i8" if region.dtype == "bool" else LLVM_TYPES[region.dtype]
        short = {"float": "f32", "double": "f64"}.get(kept, kept)
        function = f"@llvm.masked.gather.v{self.lanes}{short}.v{self.lanes}p0"
        vector = f"<{self.lanes} x {kept}>"
        self.declared.add(
            f"declare {vector} {function}(<{self.lanes} x ptr>, i32, {self.vector_type('bool')}, {vector})"
        )
        every = f"{self.vector_type('bool')} {self.splat('i1', 'true')}"
        given = f"<{self.lanes} x ptr> {where}, i32 1, {every}"
        found = self.emit(f"call {vector} {function}({given}, {vector} poison)")
        return self.emit(f"icmp ne {vector} {found}, zeroinitializer") if region.dtype == "bool" else found

    # values

    def value_name(self, node: Node) -> str:
        """Return the LLVM name of a node's value, for nodes that do not stand for all legs."""
        return self.literal(constant_value(node)) if node.op == "const" else self.names[node.number]

    def _work(self, node: Node, args: list[str], leg: "LegLoopValues | None" = None) -> str:
        """Print a node's operation."""
        match node.op:
            case "load":
                region, index, _, _ = node.extra_data_of_type(MemoryAddress)
                base, place = self.region_pointer(region)
                return self.print_number_load(
                    region.dtype, base, str(place + index * self.lane_vector_bytes(region.dtype))
                )
            case "gather":
                region, index, _, step = node.extra_data_of_type(MemoryAddress)
                _, place = self.region_pointer(region)
                offset = place + index * self.lane_vector_bytes(region.dtype)
                at = (
                    leg.leg_offset(step * self.lane_vector_bytes(region.dtype), offset)
                    if leg and node.leg
                    else str(offset)
                )
                return self.print_number_gather(node, args[0], at)
            case "part":
                return self.leg_value_name(node.args[0], node.extra_data_of_type(LegIndex).leg)
            case "any_rollout":
                return self._any(args[0])
            case "count":
                return self._whole(self.counts[node.extra_data_of_type(LoopCount).depth])
            case "tick":
                return self._whole(self.emit(f"add i64 {self.counts[1]}, %first"))
            case _:
                return self.print_arithmetic(node.op, node.dtype, args, [x.dtype for x in node.args])

    def _any(self, flags: str) -> str:
        """In all lanes, whether a flag is set in any."""
        if self.lanes == 1:
            return flags
        vector = self.vector_type("bool")
        function = f"@llvm.vector.reduce.or.v{self.lanes}i1"
        self.declared.add(f"declare i1 {function}({vector})")
        found = self.emit(f"call i1 {function}({vector} {flags})")
        one = self.emit(f"insertelement {vector} poison, i1 {found}, i32 0")
        return self.emit(f"shufflevector {vector} {one}, {vector} poison, <{self.lanes} x i32> zeroinitializer")

    def _whole(self, number: str) -> str:
        short = self.emit(f"trunc i64 {number} to i32")
        wide = self.vector_type("int32")
        one = self.emit(f"insertelement {wide} poison, i32 {short}, i32 0")
        return self.emit(f"shufflevector {wide} {one}, {wide} poison, {wide} zeroinitializer")


class LegLoopValues:
    """Looks up names of LLVM values inside a printed loop over the legs."""

    def __init__(self, printer: CpuKernelPrinter, count: str):
        self.printer, self.count = printer, count
        self.here: dict[int, str] = {}
        self.steps: dict[int, str] = {}

    def leg_offset(self, step: int, start: int) -> str:
        """Return the offset (bytes) in memory of the current leg's number in a loop over the legs."""
        if step not in self.steps:
            self.steps[step] = self.printer.emit(f"mul i64 {self.count}, {step}")
        return self.printer.emit(f"add i64 {self.steps[step]}, {start}")

    def value_name(self, node: Node) -> str:
        """Return the LLVM name of a node's value for the current leg."""
        printer = self.printer
        if not node.leg:
            return printer.value_name(node)
        if node.number not in self.here:
            self.here[node.number] = self._found(node)
        return self.here[node.number]

    def _found(self, node: Node) -> str:
        printer = self.printer
        if node.op == "const":
            values = constant_value(node)
            value = printer.literal(values[-1])
            for k in range(printer.group - 2, -1, -1):
                test = self._is(k)
                kind = printer.vector_type(node.dtype)
                value = printer.emit(f"select i1 {test}, {kind} {printer.literal(values[k])}, {kind} {value}")
            return value
        if node.op == "load":
            region, index, _, step = node.extra_data_of_type(MemoryAddress)
            base, place = printer.region_pointer(region)
            size = printer.lane_vector_bytes(region.dtype)
            return printer.print_number_load(region.dtype, base, self.leg_offset(step * size, place + index * size))
        return printer.print_number_load(
            node.dtype, "%scratch", self.leg_offset(printer.row, printer.scratch_offset(node))
        )

    def _is(self, k: int) -> str:
        key = -1 - k
        if key not in self.steps:
            self.steps[key] = self.printer.emit(f"icmp eq i64 {self.count}, {k}")
        return self.steps[key]


def target_machine() -> llvm.TargetMachine:
    """Return this processor as an LLVM target machine."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    features = llvm.get_host_cpu_features().flatten()
    target = llvm.Target.from_default_triple()
    return target.create_target_machine(llvm.get_host_cpu_name(), features, opt=2, codemodel="default", jit=True)


def compile_llvm_assembly(text: str, target: llvm.TargetMachine) -> bytes:
    """Compile LLVM assembly to an object file."""
    module = llvm.parse_assembly(text)
    module.verify()
    return target.emit_object(module)


def load_machine_code(code: bytes, target: llvm.TargetMachine) -> tuple[Any, int]:
    """Load an object file into this process; return an object that keeps its function `run` alive, and the function's
    address."""
    jit = llvm.create_lljit_compiler(target, use_jit_link=True, suppress_errors=False)
    library = llvm.JITLibraryBuilder().add_object_img(code).export_symbol("run").add_current_process()
    kept = library.link(jit, "rollouts")
    return (jit, kept), kept["run"]
