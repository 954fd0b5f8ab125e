"""What is worked out leg by leg: a block's operations in turns, plain ones and those of all legs.

Turns with even numbers are plain, those with odd ones a loop over the legs. A value of a leg that another turn needs is
kept in memory, in a slot that is free by then.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sweep.fused.program import At, Block, Branch, Loop, Node, Region, Store, inside

ANEW = frozenset(("const", "load"))  # worked out again wherever it is needed


@dataclass(eq=False)
class Turn:
    """Operations of one turn, in order."""

    legs: bool
    nodes: list[Node] = field(default_factory=list)


@dataclass(eq=False)
class Order:
    """A block in order: turns, stores, loops and branches with orders of theirs."""

    block: Block
    steps: list[Any] = field(default_factory=list)
    inner: dict[int, list["Order"]] = field(default_factory=dict)  # by the place of their loop or branch among `steps`


@dataclass(eq=False)
class Slots:
    """Where values of legs are kept, by number of node; `count` slots, each of six rows of lanes of `size` bytes."""

    of: dict[int, int] = field(default_factory=dict)
    free: list[int] = field(default_factory=list)
    count: int = 0
    size: int = 4

    def take(self) -> int:
        """The number of a slot that is free, or of a new one."""
        if self.free:
            return self.free.pop()
        self.count += 1
        return self.count - 1


def order(block: Block, needed: set[int]) -> Order:
    """The order of all that is `needed`, see `used`."""
    made, straight = Order(block), []
    for item in [*block.items, None]:
        if isinstance(item, Node):
            if item.number in needed:
                straight.append(item)
            continue
        made.steps.extend(_turns(straight))
        straight = []
        if isinstance(item, Loop):
            made.inner[len(made.steps)] = [order(item.body, needed)]
        elif isinstance(item, Branch):
            made.inner[len(made.steps)] = [order(b, needed) for b in item.blocks]
        if item is not None:
            made.steps.append(item)
    made.steps.extend(block.stores)
    return made


def _turns(nodes: list[Node]) -> Iterator[Turn]:
    """Nodes that follow each other without a loop between them, in as few turns as their operands allow."""
    here, turns = {}, {}
    for node in nodes:
        if node.op in ANEW and (node.leg or node.op == "const"):
            continue
        number = 1 if (node.leg and node.op != "pack") or node.op == "over_legs" else 0
        for arg in node.args:
            if (at := here.get(arg.number)) is None:
                continue
            if number % 2 and not (arg.leg and arg.op != "pack"):
                at += 1  # a loop comes after what is plain; a sum over the legs is there when its own loop is over
            number = max(number, at + (at + number) % 2)
        here[node.number] = number
        turns.setdefault(number, Turn(number % 2 == 1)).nodes.append(node)
    for number in sorted(turns):
        yield turns[number]


def used_nodes(block: Block) -> set[int]:
    """Numbers of the nodes that results and inner blocks need."""
    needed: set[int] = set()
    pending = list(_roots(block))
    while pending:
        node = pending.pop()
        if node.number not in needed:
            needed.add(node.number)
            pending.extend(node.args)
    return needed


def _roots(block: Block) -> Iterator[Node]:
    for item in inside(block):
        if isinstance(item, Store):
            yield item.value
            if item.row:
                yield item.row
        elif isinstance(item, Branch):
            yield item.index


def slots(top: Order) -> Slots:
    """Slots for the values of legs that leave the turn in which they are worked out."""
    found = Slots()
    _assign(top, found)
    return found


def _assign(one: Order, found: Slots) -> None:
    own = {node.number for step in one.steps if isinstance(step, Turn) for node in step.nodes}
    last: dict[int, int] = {}  # step that is the last to read a value of this block
    for at, step in enumerate(one.steps):
        last |= {number: at for number in _read(step, one.inner.get(at, [])) if number in own}
    done: dict[int, list[int]] = {}
    for number, at in last.items():
        done.setdefault(at, []).append(number)
    for at, step in enumerate(one.steps):
        if isinstance(step, Turn):
            kept = [node for node in step.nodes if node.number in last]
            found.of |= {node.number: found.take() for node in kept}
            found.size = max(found.size, *(np.dtype(node.dtype).itemsize for node in kept), 0)
        for inner in one.inner.get(at, []):
            _assign(inner, found)
        found.free.extend(found.of[number] for number in done.get(at, []))


def _read(step: Any, inner: list[Order]) -> Iterator[int]:
    """Numbers of the values of legs that a step, or what is in it, reads from memory."""
    if isinstance(step, Store):
        args = [step.value]
    elif isinstance(step, Turn):
        here = {node.number for node in step.nodes} if step.legs else set()
        args = [arg for node in step.nodes for arg in node.args if arg.number not in here]
    else:
        args = []
    yield from (arg.number for arg in args if arg.leg and arg.op not in ANEW)
    for one in inner:
        for at, each in enumerate(one.steps):
            yield from _read(each, one.inner.get(at, []))


def regions(one: Order) -> set[Region]:
    """All memory that is stored to or read."""
    found: set[Region] = set()
    for at, step in enumerate(one.steps):
        if isinstance(step, Turn):
            nodes = step.nodes
            found |= {n.extra.region for n in nodes if isinstance(n.extra, At)}
            found |= {a.extra.region for n in nodes for a in n.args if isinstance(a.extra, At)}
        elif isinstance(step, Store):
            found.add(step.region)
            found |= {step.value.extra.region} if isinstance(step.value.extra, At) else set()
        for inner in one.inner.get(at, []):
            found |= regions(inner)
    return found
