"""Operations on single numbers of a rollout, as a graph without repetitions, in blocks: the program, loops, branches.

A program has a group, such as a robot's six legs. As many numbers that the same operation gives for the legs are one
node, of which `part` takes one leg's; that holds for inputs and tables too. An operation stands in the outermost block
that has its operands: what does not change in a loop is worked out before it.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np


class Const(NamedTuple):
    """What a `const` is: its value."""

    bits: tuple[bytes, ...]  # one, or one for each leg: they tell -0 from 0 and one NaN from the next


class At(NamedTuple):
    """Of `load` and `gather`: where the number lies that is read from memory, or the numbers of all legs."""

    region: "Region"
    first: int  # index of the number, of the first leg's; `gather` adds its operand
    depth: int  # of the block in which it is as it is read
    step: int  # from leg to leg; 0 for a number of no leg's

    def each(self, group: int) -> list["At"]:
        """Where each leg's number is."""
        return [At(self.region, self.first + k * self.step, self.depth, 0) for k in range(group)]


class Count(NamedTuple):
    """Of `count` and `tick`: which loop's turns are counted."""

    depth: int


class OneOf(NamedTuple):
    """Of `part`: which leg's number it is."""

    leg: int


class Over(NamedTuple):
    """Of `over_legs`: the operation that adds up or compares."""

    op: str  # add, mul, max, min, and, or


class HandedOn(NamedTuple):
    """Of `handed_on`: what another part of a GPU's kernel has put into memory."""

    number: int  # of the node
    leg: int


type Extra = Const | At | Count | OneOf | Over | HandedOn | None


class Node:
    """A number, or one for each leg. `extra` says what its operands do not, in the class of its operation."""

    __slots__ = ("args", "block", "dtype", "extra", "leg", "number", "op")

    def __init__(
        self, op: str, args: tuple["Node", ...], extra: Extra, dtype: str, leg: bool, number: Any, block: "Block"
    ):
        self.op, self.args, self.extra, self.dtype, self.leg, self.number = op, args, extra, dtype, leg, number
        self.block = block

    def attribute[T](self, kind: type[T]) -> T:
        """Its `extra`, which has to be of a class."""
        assert isinstance(self.extra, kind), f"{self.op} has {self.extra}"
        return self.extra


@dataclass(eq=False)
class Region:
    """Numbers in memory, each of them a row of lanes: an input, what a loop carries, a result."""

    size: int
    dtype: str
    depth: int  # of the block in which it does not change
    place: int = -1  # bytes from the start of the rollouts' memory, where it is an input or a result
    record: bool = False  # in a memory of each tick's own


@dataclass(eq=False)
class Store:
    """Put a value into memory once the whole block is computed.

    With a `row`, the address is counted from the start of that row of the region, whose rows have `stride` numbers. The
    row's number is the same for all rollouts.
    """

    region: Region
    index: int
    value: Node
    step: int = 0  # from leg to leg
    row: Node | None = None  # int32
    stride: int = 0


@dataclass(eq=False)
class Block:
    """Nodes, loops and branches in order, then stores."""

    depth: int
    items: list[Any] = field(default_factory=list)
    stores: list[Store] = field(default_factory=list)
    known: dict[Any, Node] = field(default_factory=dict)
    held: bool = False  # nothing leaves it: it may not be run at all


@dataclass(eq=False)
class Loop:
    """A block run `length` times; None: as often as the caller says."""

    length: int | None
    body: Block


@dataclass(eq=False)
class Branch:
    """The block that `index`, the same for all rollouts, chooses."""

    index: Node
    blocks: list[Block]


def inside(block: Block) -> Iterator[Any]:
    """All that is in a block, and in the blocks in it."""
    for item in [*block.items, *block.stores]:
        yield item
        for inner in [item.body] if isinstance(item, Loop) else item.blocks if isinstance(item, Branch) else ():
            yield from inside(inner)


class Program:
    """A program that is being written: the blocks from the outermost to the one that grows."""

    def __init__(self, group: int) -> None:
        if group < 2:
            raise ValueError(f"a group of {group}: at least 2")
        self.group = group
        self.blocks = [Block(0)]
        self._number = 0

    @property
    def top(self) -> Block:
        """The block that all others are in."""
        return self.blocks[0]

    def node(self, op: str, args: Sequence[Node], dtype: str, extra: Extra = None, leg: bool | None = None) -> Node:
        """The node of an operation, the one that there is where it has been met before."""
        args = tuple(args)
        leg = any(x.leg for x in args) if leg is None else leg
        key = op, tuple(x.number for x in args), dtype, extra
        for block in self.blocks:
            if key in block.known:
                return block.known[key]
        depth = max((x.block.depth for x in args), default=0)
        if isinstance(extra, At):
            depth = max(depth, extra.depth)
        elif isinstance(extra, Count):
            depth = extra.depth
        for block in reversed(self.blocks):
            if block.held and op != "const":
                depth = max(depth, block.depth)
                break
        home = self.blocks[depth]
        made = Node(op, args, extra, dtype, leg, self._number, home)
        self._number += 1
        home.known[key] = made
        home.items.append(made)
        return made

    def const(self, value: Any, dtype: str) -> Node:
        """A number, or a tuple of one for each leg."""
        if isinstance(value, tuple):
            if len({_bits(v, dtype) for v in value}) == 1:
                value = value[0]
            else:
                return self.node("const", (), dtype, Const(tuple(_bits(v, dtype) for v in value)), leg=True)
        return self.node("const", (), dtype, Const((_bits(value, dtype),)))

    @contextmanager
    def loop(self, length: int | None) -> Iterator[Block]:
        """Inside, the program grows in a loop's body."""
        body = Block(len(self.blocks))
        self.blocks.append(body)
        yield body
        self.blocks.pop()
        self.blocks[-1].items.append(Loop(length, body))

    @contextmanager
    def branch(self) -> Iterator[Block]:
        """Inside, the program grows in a block that may not be run."""
        block = Block(len(self.blocks), held=True)
        self.blocks.append(block)
        yield block
        self.blocks.pop()

    def add(self, item: Any) -> None:
        """A loop, branch or store in the block that grows."""
        self.blocks[-1].items.append(item)


def is_uniform(node: Node) -> bool:
    """Whether a number is the same for all rollouts, since it follows from constants and loop counters alone."""
    if node.op in ("gather", "pack", "part", "over_legs"):
        return False
    return node.op in ("const", "count", "tick") or (bool(node.args) and all(is_uniform(x) for x in node.args))


def _bits(value: Any, dtype: str) -> bytes:
    return np.asarray(value, dtype).tobytes()


def value_of(node: Node) -> Any:
    """The number of a constant; an array of six where it has one for each leg."""
    found = np.frombuffer(b"".join(node.attribute(Const).bits), node.dtype)
    return found if node.leg else found[0]
