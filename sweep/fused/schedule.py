"""Order of operations in a CPU kernel: groups of plain operations alternate with loops over the legs.

Even turns are plain, odd turns are loops over the legs. A leg's value that another turn needs is stored in a slot of
scratch memory.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sweep.fused.program import Block, Branch, Loop, MemoryAddress, MemoryRegion, Node, Store, walk_block

RECOMPUTED_OPERATIONS = frozenset(("const", "load"))  # operations that are repeated wherever their value is needed


@dataclass(eq=False)
class OperationGroup:
    """Consecutive operations of a schedule: either the body of a loop over the legs, or operations without legs."""

    is_leg_loop: bool
    nodes: list[Node] = field(default_factory=list)


@dataclass(eq=False)
class BlockSchedule:
    """Order in which a block's operations, stores, loops and branches are printed, with schedules of inner blocks."""

    block: Block
    steps: list[Any] = field(default_factory=list)
    inner_schedules: dict[int, list["BlockSchedule"]] = field(
        default_factory=dict
    )  # by the index of their loop or branch in `steps`


@dataclass(eq=False)
class ScratchSlots:
    """Assigns places in scratch memory to temporary values that are computed for all legs, and reuses free places.

    There are `count` slots, each of six rows of lanes of `size` bytes; `by_node` has a node's slot by its number.
    """

    by_node: dict[int, int] = field(default_factory=dict)
    free_slots: list[int] = field(default_factory=list)
    count: int = 0
    size: int = 4

    def allocate(self) -> int:
        """Return the number of a free place in scratch memory, or of a new one."""
        if self.free_slots:
            return self.free_slots.pop()
        self.count += 1
        return self.count - 1


def schedule_block(block: Block, needed: set[int]) -> BlockSchedule:
    """Group the operations of a block into loops over the legs and code between these loops.

    Args:
        block: the block.
        needed: numbers of the nodes to compute, see `used_node_numbers`.
    """
    made, straight = BlockSchedule(block), []
    for item in [*block.items, None]:
        if isinstance(item, Node):
            if item.number in needed:
                straight.append(item)
            continue
        made.steps.extend(_turns(straight))
        straight = []
        if isinstance(item, Loop):
            made.inner_schedules[len(made.steps)] = [schedule_block(item.body, needed)]
        elif isinstance(item, Branch):
            made.inner_schedules[len(made.steps)] = [schedule_block(b, needed) for b in item.blocks]
        if item is not None:
            made.steps.append(item)
    made.steps.extend(block.stores)
    return made


def _turns(nodes: list[Node]) -> Iterator[OperationGroup]:
    """Group nodes between two loops into as few turns as their operands allow."""
    here, turns = {}, {}
    for node in nodes:
        if node.op in RECOMPUTED_OPERATIONS and (node.leg or node.op == "const"):
            continue
        number = 1 if (node.leg and node.op != "pack") or node.op == "over_legs" else 0
        for arg in node.args:
            if (at := here.get(arg.number)) is None:
                continue
            if number % 2 and not (arg.leg and arg.op != "pack"):
                at += 1  # loops follow plain turns; a sum over the legs is known after its own loop
            number = max(number, at + (at + number) % 2)
        here[node.number] = number
        turns.setdefault(number, OperationGroup(number % 2 == 1)).nodes.append(node)
    for number in sorted(turns):
        yield turns[number]


def used_node_numbers(block: Block) -> set[int]:
    """Return the numbers of the nodes of a block that its results and inner blocks need."""
    needed: set[int] = set()
    pending = list(_roots(block))
    while pending:
        node = pending.pop()
        if node.number not in needed:
            needed.add(node.number)
            pending.extend(node.args)
    return needed


def _roots(block: Block) -> Iterator[Node]:
    for item in walk_block(block):
        if isinstance(item, Store):
            yield item.value
            if item.row_index:
                yield item.row_index
        elif isinstance(item, Branch):
            yield item.index
        elif isinstance(item, Loop) and item.continue_flag:
            yield item.continue_flag


def assign_scratch_slots(top: BlockSchedule) -> ScratchSlots:
    """Assign places in scratch memory to values per leg that are used outside the leg loop which computes them."""
    found = ScratchSlots()
    _assign_slots(top, found)
    return found


def _assign_slots(order: BlockSchedule, slots: ScratchSlots) -> None:
    own = {node.number for step in order.steps if isinstance(step, OperationGroup) for node in step.nodes}
    last: dict[int, int] = {}  # last step that reads a value of this block
    for at, step in enumerate(order.steps):
        last |= {number: at for number in _reads_from_memory(step, order.inner_schedules.get(at, [])) if number in own}
    done: dict[int, list[int]] = {}
    for number, at in last.items():
        done.setdefault(at, []).append(number)
    for at, step in enumerate(order.steps):
        if isinstance(step, OperationGroup):
            kept = [node for node in step.nodes if node.number in last]
            slots.by_node |= {node.number: slots.allocate() for node in kept}
            slots.size = max(slots.size, *(np.dtype(node.dtype).itemsize for node in kept), 0)
        for inner in order.inner_schedules.get(at, []):
            _assign_slots(inner, slots)
        slots.free_slots.extend(slots.by_node[number] for number in done.get(at, []))


def _reads_from_memory(step: Any, inner: list[BlockSchedule]) -> Iterator[int]:
    """Numbers of the legs' values that a step, or what is inside it, reads from slots."""
    if isinstance(step, Store):
        args = [step.value]
    elif isinstance(step, OperationGroup):
        here = {node.number for node in step.nodes} if step.is_leg_loop else set()
        args = [arg for node in step.nodes for arg in node.args if arg.number not in here]
    else:
        args = []
    yield from (arg.number for arg in args if arg.leg and arg.op not in RECOMPUTED_OPERATIONS)
    for one in inner:
        for at, each in enumerate(one.steps):
            yield from _reads_from_memory(each, one.inner_schedules.get(at, []))


def used_memory_regions(order: BlockSchedule) -> set[MemoryRegion]:
    """Return all arrays in memory that a scheduled program loads from or stores to."""
    found: set[MemoryRegion] = set()
    for at, step in enumerate(order.steps):
        if isinstance(step, OperationGroup):
            nodes = step.nodes
            found |= {n.extra.region for n in nodes if isinstance(n.extra, MemoryAddress)}
            found |= {a.extra.region for n in nodes for a in n.args if isinstance(a.extra, MemoryAddress)}
        elif isinstance(step, Store):
            found.add(step.region)
            found |= {step.value.extra.region} if isinstance(step.value.extra, MemoryAddress) else set()
        for inner in order.inner_schedules.get(at, []):
            found |= used_memory_regions(inner)
    return found
