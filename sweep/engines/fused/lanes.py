"""Before a GPU's text is printed: an order in which few values are alive, and which numbers inside it are legs'."""

from collections.abc import Iterator
from typing import Any

from sweep.engines.fused.program import LEGS, Block, Node, Region, Store, inside

LARGE = 1 << 30  # operations of a value, those of a shared operand counted for each use
Place = tuple[Region, int]  # a number, or six that are a number of each leg's


def depth_first(block: Block, needed: set[int]) -> Iterator[Any]:
    """What is to be done, a value soon before it is used: few are alive at a time."""
    straight: dict[int, Node] = {}
    for item in [*block.items, None]:
        if isinstance(item, Node):
            if item.number in needed and item.op not in ("const", "load"):
                straight[item.number] = item
            continue
        yield from _ordered(straight)
        straight = {}
        if item is not None:
            yield item


def _ordered(nodes: dict[int, Node]) -> Iterator[Node]:
    inner = {arg.number for node in nodes.values() for arg in node.args}
    size: dict[int, int] = {}
    for node in nodes.values():
        size[node.number] = min(1 + sum(size.get(arg.number, 0) for arg in node.args), LARGE)
    done: set[int] = set()
    for root in nodes.values():
        pending = [root] if root.number not in inner else []
        while pending:
            node = pending[-1]
            if node.number in done:
                pending.pop()
                continue
            left = [x for x in node.args if x.number in nodes and x.number not in done]
            if left:
                pending.extend(sorted(left, key=lambda x: size[x.number]))
                continue
            done.add(node.number)
            yield pending.pop()


def rows(top: Block, needed: set[int]) -> tuple[dict[Place, tuple[int, int, int]], list[Region]]:
    """Of inner memory, the numbers that are always read and written as six of the legs: (first, step, which).

    And the regions that have to be memory, since they are looked up by place or read in other rows than written.
    """
    rows: dict[Place, tuple[int, int, int]] = {}
    memory: dict[Region, None] = {}
    uses: list[tuple[Region, int, int]] = []
    for x in inside(top):
        if isinstance(x, Store) and x.value.leg:
            uses.append((x.region, x.index, x.step))
        elif isinstance(x, Node) and x.number in needed and x.op == "load" and x.leg:
            uses.append((x.extra[0], x.extra[1], x.extra[3]))
        elif isinstance(x, Node) and x.number in needed and x.op == "gather" and x.extra[0].place < 0:
            memory[x.extra[0]] = None
    for region, index, step in uses:
        if region.place < 0:
            for k in range(LEGS):
                if rows.setdefault((region, index + k * step), (index, step, k)) != (index, step, k):
                    memory[region] = None
    return {place: row for place, row in rows.items() if place[0] not in memory}, list(memory)
