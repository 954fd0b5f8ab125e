"""Before a GPU's text is printed: an order in which few values are alive, parts, and which numbers are legs'."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from sweep.fused.program import (
    At,
    Block,
    Branch,
    Const,
    Extra,
    HandedOn,
    Loop,
    Node,
    OneOf,
    Over,
    Region,
    Store,
    inside,
)

ANEW = frozenset(("const", "load", "tick"))  # worked out again wherever it is needed
LARGE = 1 << 30  # operations of a value, those of a shared operand counted for each use
Place = tuple[Region, int]  # a number, or six that are a number of each leg's


class Part(NamedTuple):
    """A part of a block: what is to be done in order, then stores."""

    items: list[Any]
    stores: list[Store]
    together: bool  # with the legs in lanes of a warp; else each thread has all legs of a rollout


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


def rows(top: Block, needed: set[int], group: int) -> tuple[dict[Place, tuple[int, int, int]], list[Region]]:
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
            region, index, _, step = x.told(At)
            uses.append((region, index, step))
        elif isinstance(x, Node) and x.number in needed and x.op == "gather" and x.told(At).region.place < 0:
            memory[x.told(At).region] = None
    for region, index, step in uses:
        if region.place < 0:
            for k in range(group):
                if rows.setdefault((region, index + k * step), (index, step, k)) != (index, step, k):
                    memory[region] = None
    return {place: row for place, row in rows.items() if place[0] not in memory}, list(memory)


def parts(block: Block, needed: set[int], last: Region | None, group: int, few: bool) -> list[Part]:
    """A block in parts: its loops, and what is between them, which has a thread for each rollout but for `few`.

    A result is put into memory as soon as it is there and nothing asks any more for what was there; `last` at the end.
    """
    made = [part._replace(together=few or part.together) for part in _cut(block, needed)]
    home = {item.number: k for k, part in enumerate(made) for item in part.items if isinstance(item, Node)}
    asked: dict[Any, int] = {}  # the last part that reads a place, or by place somewhere in a region
    for k, part in enumerate(made):
        for node in operands(part, needed):
            asked |= dict.fromkeys(_places(node, group), k)
    late = [store for store in block.stores if store.region is last or store.value.op == "load"]
    for store in late:
        asked |= dict.fromkeys(_places(store.value, group), len(made) - 1)
    for store in block.stores:
        places = [(store.region, store.index + k * store.step) for k in (range(group) if store.value.leg else (0,))]
        free = max(asked.get(place, 0) for place in (*places, store.region))
        k = len(made) - 1 if store in late else max(free, home.get(store.value.number, 0))
        made[k].stores.append(store)
    return [part for part in made if part.items or part.stores]


def _cut(block: Block, needed: set[int]) -> list[Part]:
    made, begun = [Part([], [], False)], []
    for item in depth_first(block, needed):
        if isinstance(item, Store):  # of what a loop begins with: there may be operations between it and the loop
            begun.append(item)
        elif isinstance(item, Loop):
            made += [Part([*begun, item], [], True), Part([], [], False)]
            begun = []
        elif isinstance(item, Branch) and _of_legs(item, needed):
            made += [Part([item], [], True), Part([], [], False)]
        else:
            made[-1].items.append(item)
    return made


def _of_legs(branch: Branch, needed: set[int]) -> bool:
    """Whether most of it is one operation for the legs."""
    nodes = [x for x in within(branch) if isinstance(x, Node) and x.number in needed and x.op not in ANEW]
    return 2 * sum(x.leg for x in nodes) > len(nodes)


def within(item: Any) -> Iterator[Any]:
    """All that is in a loop or branch."""
    for block in [item.body] if isinstance(item, Loop) else item.blocks if isinstance(item, Branch) else ():
        yield from inside(block)


def operands(part: Part, needed: set[int]) -> Iterator[Node]:
    """What all of a part is worked out from, inner blocks with it, but for what branches go by."""
    for one in [*part.items, *part.stores]:
        for item in (one, *within(one)):
            if isinstance(item, Node) and item.number in needed:
                yield from (item, *item.args) if item.op == "gather" else item.args
            elif isinstance(item, Store):
                yield item.value


def _places(node: Node, group: int) -> list[Any]:
    if node.op not in ("load", "gather"):
        return []
    region, index, _, step = node.told(At)
    if node.op == "gather":
        return [region]
    return [(region, index + k * step) for k in (range(group) if node.leg else (0,))]


class Alone:
    """A part without legs: what was one operation for them is as many as there are legs."""

    def __init__(self, part: Part, needed: set[int], group: int):
        self.group = group
        self.made: dict[int, list[Node]] = {}
        self.items = [x for item in part.items for x in self._item(item, needed)]
        self.stores = [x for store in part.stores for x in self._store(store)]

    def of(self, node: Node) -> list[Node]:
        """What a node has become: one for each leg, or one."""
        if node.number not in self.made:
            if not node.leg:
                return [node]
            match node.op:
                case "const":
                    extras = [Const((bits,)) for bits in node.told(Const).bits]
                case "load":
                    extras = node.told(At).each(self.group)
                case _:  # of another part
                    extras = [HandedOn(node.number, k) for k in range(self.group)]
            op = node.op if node.op in ANEW else "handed_on"
            self.made[node.number] = [self._node(node, op, (), extra, k) for k, extra in enumerate(extras)]
        return self.made[node.number]

    @staticmethod
    def _node(like: Node, op: str, args: Sequence[Node], extra: Extra, k: Any) -> Node:
        return Node(op, tuple(args), extra, like.dtype, False, (like.number, k), like.block)

    def _item(self, item: Any, needed: set[int]) -> list[Any]:
        if isinstance(item, Store):
            return self._store(item)
        if isinstance(item, Loop):
            return [Loop(item.length, self._block(item.body, needed))]
        if isinstance(item, Branch):
            return [Branch(self.of(item.index)[0], [self._block(block, needed) for block in item.blocks])]
        args = [self.of(x) for x in item.args]
        match item.op:
            case "pack":
                self.made[item.number] = [x[0] for x in args]
                return []
            case "part":
                self.made[item.number] = [args[0][item.told(OneOf).leg]]
                return []
            case "over_legs":  # opposite legs first, then the pairs in order
                x, made, half, op = args[0], [], self.group // 2, item.told(Over).op
                for k in range(half):
                    made.append(self._node(item, op, (x[k], x[k + half]), None, k))
                for k in range(1, half):
                    pair = made[0 if k == 1 else -1], made[k]
                    made.append(self._node(item, op, pair, None, k + half - 1))
                self.made[item.number] = made[-1:]
                return made
            case _:
                pass
        legs = range(self.group) if item.leg else [0]
        extras = [item.extra] * self.group
        if isinstance(item.extra, At) and item.leg:
            extras = item.extra.each(self.group)
        made = [self._node(item, item.op, [x[k % len(x)] for x in args], extras[k], k) for k in legs]
        self.made[item.number] = made
        return made

    def _block(self, block: Block, needed: set[int]) -> Block:
        made = Block(block.depth)
        made.items = [x for item in depth_first(block, needed) for x in self._item(item, needed)]
        made.stores = [x for store in block.stores for x in self._store(store)]
        return made

    def _store(self, store: Store) -> list[Store]:
        return [Store(store.region, store.index + k * store.step, x) for k, x in enumerate(self.of(store.value))]
