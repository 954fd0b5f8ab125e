"""The fused compiler's program representation: a graph of operations on single numbers of a rollout, in nested blocks.

A program has a group, such as a robot's six legs. One node stands for the numbers that the same operation gives for all
of them, and `part` takes one leg's; that holds for inputs and tables, too. An operation stands in the outermost block
that has its operands: what does not change in a loop is computed before it.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np


class ConstantBits(NamedTuple):
    """Extra data of a `const` node: the bytes of its value."""

    value_bytes: tuple[bytes, ...]  # one, or one for each leg; bytes distinguish -0 from 0 and NaNs from each other


class MemoryAddress(NamedTuple):
    """Extra data of `load` and `gather` nodes: where a number, or the numbers of all legs, lie in memory."""

    region: "MemoryRegion"
    first_index: int  # index of the (first leg's) number; `gather` adds its operand
    depth: int  # depth of the block in which it does not change
    leg_stride: int  # from leg to leg; 0 for a number that is not a leg's

    def leg_addresses(self, group: int) -> list["MemoryAddress"]:
        """Return the address of each leg's number."""
        return [MemoryAddress(self.region, self.first_index + k * self.leg_stride, self.depth, 0) for k in range(group)]


class LoopCount(NamedTuple):
    """Extra data of `count` and `tick` nodes: the loop whose iterations are counted."""

    depth: int


class LegIndex(NamedTuple):
    """Extra data of `part` nodes, which take one leg's number from the numbers of all legs: the leg."""

    leg: int


class LegReduction(NamedTuple):
    """Extra data of `over_legs` nodes, which reduce the numbers of all legs to one: the operation, such as a sum."""

    op: str  # add, mul, max, min, and, or


class StoredNodeReference(NamedTuple):
    """Extra data of `handed_on` nodes: a node that another part of a GPU kernel has computed and stored."""

    node_number: int  # number of the node
    leg: int


type Extra = ConstantBits | MemoryAddress | LoopCount | LegIndex | LegReduction | StoredNodeReference | None


class Node:
    """An operation of the program, whose result is one number, or one for each leg.

    `extra` holds parameters of the operation that are not operands; its class depends on the operation.
    """

    __slots__ = ("args", "block", "dtype", "extra", "leg", "number", "op")

    def __init__(
        self, op: str, args: tuple["Node", ...], extra: Extra, dtype: str, leg: bool, number: Any, block: "Block"
    ):
        self.op, self.args, self.extra, self.dtype, self.leg, self.number = op, args, extra, dtype, leg, number
        self.block = block

    def extra_data_of_type[T](self, kind: type[T]) -> T:
        """Return the node's extra data, checked to be of the class `kind`."""
        assert isinstance(self.extra, kind), f"{self.op} has {self.extra}"
        return self.extra


@dataclass(eq=False)
class MemoryRegion:
    """An array in memory with numbers for several rollouts: an input, the carry of a loop, or a result."""

    size: int
    dtype: str
    depth: int  # depth of the block in which it does not change
    byte_offset: int = -1  # bytes from the start of the rollouts' memory, for inputs and results
    is_record: bool = False  # whether it lies in the record of a tick


@dataclass(eq=False)
class Store:
    """A store instruction of a block: writes a value to memory after the whole block is computed.

    With a `row`, the address is counted from the start of that row of the region, whose rows have `stride` numbers. The
    row's number is the same for all rollouts.
    """

    region: MemoryRegion
    index: int
    value: Node
    leg_stride: int = 0  # from leg to leg
    row_index: Node | None = None  # int32
    row_stride: int = 0


@dataclass(eq=False)
class Block:
    """A block of the program: nodes, loops and branches in order, then stores."""

    depth: int
    items: list[Any] = field(default_factory=list)
    stores: list[Store] = field(default_factory=list)
    node_by_key: dict[Any, Node] = field(default_factory=dict)
    is_conditional: bool = False  # it may not run, so that no operation is moved out of it
    allows_hoisting: bool = (
        False  # of a conditional block: all the same, operations that a loop around it repeats are moved out
    )


@dataclass(eq=False)
class Loop:
    """A block that runs `length` times; if that is None, as often as the caller asks, or as `continue_flag` holds."""

    length: int | None
    body: Block
    continue_flag: Node | None = None  # of the body, the same for all rollouts of a warp or vector


@dataclass(eq=False)
class Branch:
    """Several blocks, of which one runs; its number is `index`, which is equal for all rollouts."""

    index: Node
    blocks: list[Block]


def walk_block(block: Block) -> Iterator[Any]:
    """Yield all items of a block, including those of inner blocks."""
    for item in [*block.items, *block.stores]:
        yield item
        for inner in [item.body] if isinstance(item, Loop) else item.blocks if isinstance(item, Branch) else ():
            yield from walk_block(inner)


class Program:
    """A program under construction: the nested blocks from the outermost to the current one."""

    def __init__(self, group: int) -> None:
        if group < 2:
            raise ValueError(f"a group of {group}: at least 2")
        self.group = group
        self.blocks = [Block(0)]
        self._number = 0

    @property
    def top_block(self) -> Block:
        """Outermost block of the program."""
        return self.blocks[0]

    def get_or_add_node(
        self, op: str, args: Sequence[Node], dtype: str, extra: Extra = None, leg: bool | None = None
    ) -> Node:
        """Return the node of an operation; an existing equal node is reused.

        Args:
            op: operation, by JAX's name.
            args: operands.
            dtype: type of the result.
            extra: parameters that are not operands.
            leg: whether it gives a number for each leg; by default if an operand does.
        """
        args = tuple(args)
        leg = any(x.leg for x in args) if leg is None else leg
        key = op, tuple(x.number for x in args), dtype, extra
        for block in self.blocks:
            if key in block.node_by_key:
                return block.node_by_key[key]
        depth = max((x.block.depth for x in args), default=0)
        if isinstance(extra, MemoryAddress):
            depth = max(depth, extra.depth)
        elif isinstance(extra, LoopCount):
            depth = extra.depth
        for block in self.blocks if op != "const" else ():
            if block.is_conditional and not (block.allows_hoisting and depth < block.depth - 1):
                depth = max(depth, block.depth)
        home = self.blocks[depth]
        made = Node(op, args, extra, dtype, leg, self._number, home)
        self._number += 1
        home.node_by_key[key] = made
        home.items.append(made)
        return made

    def constant_node(self, value: Any, dtype: str) -> Node:
        """Return the node of a constant: one number, or a tuple with one for each leg."""
        if isinstance(value, tuple):
            if len({_bits(v, dtype) for v in value}) == 1:
                value = value[0]
            else:
                return self.get_or_add_node(
                    "const", (), dtype, ConstantBits(tuple(_bits(v, dtype) for v in value)), leg=True
                )
        return self.get_or_add_node("const", (), dtype, ConstantBits((_bits(value, dtype),)))

    @contextmanager
    def open_loop(self, length: int | None) -> Iterator[Loop]:
        """Context that opens a loop of `length` iterations: operations added in it form the loop's body."""
        loop = Loop(length, Block(len(self.blocks)))
        self.blocks.append(loop.body)
        yield loop
        self.blocks.pop()
        self.blocks[-1].items.append(loop)

    @contextmanager
    def open_branch(self, hoists: bool = False) -> Iterator[Block]:
        """Context that opens a block of a branch: operations added in it run only if the branch is taken."""
        block = Block(len(self.blocks), is_conditional=True, allows_hoisting=hoists)
        self.blocks.append(block)
        yield block
        self.blocks.pop()

    def append_item(self, item: Any) -> None:
        """Add a loop, branch or store to the current block."""
        self.blocks[-1].items.append(item)


def is_uniform(node: Node) -> bool:
    """Return whether a number is the same for all rollouts because it only depends on constants and loop counters."""
    if node.op in ("gather", "pack", "part", "over_legs"):
        return False
    return node.op in ("const", "count", "tick") or (bool(node.args) and all(is_uniform(x) for x in node.args))


def _bits(value: Any, dtype: str) -> bytes:
    return np.asarray(value, dtype).tobytes()


def constant_value(node: Node) -> Any:
    """Return the value of a constant node: a number, or an array with one for each leg."""
    found = np.frombuffer(b"".join(node.extra_data_of_type(ConstantBits).value_bytes), node.dtype)
    return found if node.leg else found[0]
