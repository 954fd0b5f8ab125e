"""Before a GPU's text is printed: an order in which few values are alive, parts, and which numbers are legs'."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
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
Rows = dict[Place, tuple[int, int, int]]  # see `rows`


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


def rows(top: Block, needed: set[int], group: int) -> tuple[Rows, list[Region]]:
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
            region, index, _, step = x.attribute(At)
            uses.append((region, index, step))
        elif isinstance(x, Node) and x.number in needed and x.op == "gather" and x.attribute(At).region.place < 0:
            memory[x.attribute(At).region] = None
        if isinstance(x, Store) and x.row and x.region.place < 0:
            memory[x.region] = None
    for region, index, step in uses:
        if region.place < 0:
            for k in range(group):
                if rows.setdefault((region, index + k * step), (index, step, k)) != (index, step, k):
                    memory[region] = None
    return {place: row for place, row in rows.items() if place[0] not in memory}, list(memory)


def parts(block: Block, needed: set[int], last: Region | None, group: int, few: bool, rows: Rows) -> list[Part]:
    """A block in parts: its loops, and what is between them, which has a thread for each rollout but for `few`.

    A result is put into memory as soon as it is there and nothing asks any more for what was there; `last` at the end.
    """
    made = [part._replace(together=few or part.together) for part in _cut(block, needed)]
    home: dict[int | Region, int] = {}
    for k, part in enumerate(made):
        home |= {item.number: k for item in part.items if isinstance(item, Node)}
        home |= {x.region: k for item in part.items for x in (item, *items_inside(item)) if isinstance(x, Store)}
    asked: dict[Any, int] = {}  # the last part that reads a place, or by place somewhere in a region
    for k, part in enumerate(made):
        for node in operands(part, needed):
            asked |= dict.fromkeys(_places(node, group), k)
    stores = _by_legs(block.stores, rows, group)
    late = [store for store in stores if store.region is last or _is_outer_load(store.value)]
    for store in late:
        asked |= dict.fromkeys(_places(store.value, group), len(made) - 1)
    for store in stores:
        places = [(store.region, store.index + k * store.step) for k in (range(group) if store.value.leg else (0,))]
        if store.row:  # it may be any row of the region
            places += [place for place in asked if isinstance(place, tuple) and place[0] is store.region]
        free = max(asked.get(place, 0) for place in (*places, store.region))
        of = store.value.attribute(At).region if store.value.op == "load" else store.value.number
        k = len(made) - 1 if store in late else max(free, home.get(of, 0))
        made[k].stores.append(store)
    return [part for part in made if part.items or part.stores]


def _by_legs(stores: Sequence[Store], rows: Rows, group: int) -> list[Store]:
    """These stores, with one for all legs in place of those that each put away one leg's number of a row."""
    found: dict[tuple[Region, Place], list[Store | None]] = {}
    for store in stores:
        if store.value.op == "load" and not store.value.leg and not store.row:
            region, index, _, _ = store.value.attribute(At)
            if row := rows.get((region, index)):
                found.setdefault((store.region, (region, row[0])), [None] * group)[row[2]] = store
    made, done = [], set()
    for (_, (region, first)), each in found.items():
        whole = [store for store in each if store]
        step = whole[1].index - whole[0].index if len(whole) == group else 0
        if step > 0 and [store.index - whole[0].index for store in whole] == [k * step for k in range(group)]:
            like = whole[0].value
            at = At(region, first, like.attribute(At).depth, rows[region, first][1])
            value = Node("load", (), at, like.dtype, True, (like.number, "legs"), like.block)
            made.append(replace(whole[0], value=value, step=step))
            done |= {id(store) for store in whole}
    return [store for store in stores if id(store) not in done] + made


def _cut(block: Block, needed: set[int]) -> list[Part]:
    made, begun = [Part([], [], False)], []
    for item in depth_first(Block(block.depth, _around_branches(block, needed)), needed):
        if isinstance(item, Store):  # of what a loop begins with: there may be operations between it and the loop
            begun.append(item)
        elif isinstance(item, Loop):
            made += [Part([*begun, item], [], True), Part([], [], False)]
            begun = []
        elif isinstance(item, Branch) and _of_legs(item, needed):
            if not made[-1].items and len(made) > 1 and isinstance(made[-2].items[-1], Branch):
                made[-2].items.append(item)
            else:
                made += [Part([item], [], True), Part([], [], False)]
        else:
            made[-1].items.append(item)
    return made


def _around_branches(block: Block, needed: set[int]) -> list[Any]:
    """Items of a block in an order in which the branches of the legs after its last loop cut it into few parts.

    All that does not depend on these branches goes before them, and the rest after them, so that one part has to hand
    little on to the next. Only operations on inputs alone wait until something needs them.
    """
    start = max((k + 1 for k, item in enumerate(block.items) if isinstance(item, Loop)), default=0)
    head, tail = block.items[:start], block.items[start:]
    branches = [x for x in tail if isinstance(x, Branch) and _of_legs(x, needed)]
    late: set[Any] = set()  # what depends on such a branch: items, and regions that they write to
    plain: set[Any] = set()  # nodes worked out from inputs alone
    early: list[Any] = []
    for item in tail:
        operands = _operands(item, needed) or [item]
        if item in branches or any(x in late or (x.op == "load" and x.attribute(At).region in late) for x in operands):
            late |= {item, *_written(item)}
        elif isinstance(item, Node) and all(_is_input(x, block) or x in plain for x in operands):
            plain.add(item)
        else:
            early.append(item)
    between = _with_operands(branches, tail, needed, late)
    before = _with_operands([*early, *between], tail, needed, plain) - between
    return [
        *head,
        *(x for x in tail if x in before),
        *(x for x in tail if x in between),
        *(x for x in tail if x not in before | between),
    ]


def _written(item: Any) -> set[Region]:
    """The regions that a branch or loop writes to."""
    return {x.region for x in items_inside(item) if isinstance(x, Store)}


def _operands(item: Any, needed: set[int] | None = None) -> list[Node]:
    """All that an item of a block is worked out from, what is in a branch with it; all operations by default."""
    nodes = [x for x in (item, *items_inside(item)) if isinstance(x, Node) and (needed is None or x.number in needed)]
    stored = [x.value for x in items_inside(item) if isinstance(x, Store)]
    return [*(arg for x in nodes for arg in x.args), *stored, *([item.index] if isinstance(item, Branch) else [])]


def _is_input(node: Node, block: Block) -> bool:
    """Whether it can be read anywhere in `block`: it lies in outer memory, or was worked out before."""
    return _is_outer_load(node) or (node.op in ANEW and node.op != "load") or node.block is not block


def _is_outer_load(node: Node) -> bool:
    return node.op == "load" and node.attribute(At).region.place >= 0


def _with_operands(items: list[Any], tail: list[Any], needed: set[int], among: set[Any]) -> set[Any]:
    """These items, and those of `tail` from which they are worked out, directly or not, as far as they are `among`."""
    found = {*items}
    for item in reversed(tail):
        if item in found or not found.isdisjoint(_written(item)):
            operands = _operands(item, needed)
            read = {x.attribute(At).region for x in operands if x.op == "load"}
            found |= {item} | among.intersection(operands) | among.intersection(read)
    return found


def _of_legs(branch: Branch, needed: set[int]) -> bool:
    """Whether most of it is one operation for the legs."""
    nodes = [x for x in items_inside(branch) if isinstance(x, Node) and x.number in needed and x.op not in ANEW]
    return 2 * sum(x.leg for x in nodes) > len(nodes)


def items_inside(item: Any) -> Iterator[Any]:
    """All that is in a loop or branch."""
    for block in [item.body] if isinstance(item, Loop) else item.blocks if isinstance(item, Branch) else ():
        yield from inside(block)


def operands(part: Part, needed: set[int]) -> Iterator[Node]:
    """What all of a part is worked out from, inner blocks with it, but for what branches go by."""
    for one in [*part.items, *part.stores]:
        for item in (one, *items_inside(one)):
            if isinstance(item, Node) and item.number in needed:
                yield from (item, *item.args) if item.op == "gather" else item.args
            elif isinstance(item, Store):
                yield item.value


def _places(node: Node, group: int) -> list[Any]:
    if node.op not in ("load", "gather"):
        return []
    region, index, _, step = node.attribute(At)
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
        self.early = self._early()

    def _early(self) -> dict[int, list[Store]]:
        """By the place among the items after which they can be made, stores that need not wait for the part's end.

        These are of values that are worked out by then, at places that nothing in the part reads any more.
        """
        made = {item.number: k for k, item in enumerate(self.items) if isinstance(item, Node)}
        read: dict[Any, int] = {}  # the last item that reads a place, or by place somewhere in a region
        for k, item in enumerate(self.items):
            for node in _operands(item):
                read |= dict.fromkeys(_places(node, self.group), k)
            for node in (item, *items_inside(item)):
                if isinstance(node, Node) and node.op == "gather":
                    read |= dict.fromkeys(_places(node, self.group), k)
        for store in self.stores:
            read |= dict.fromkeys(_places(store.value, self.group), len(self.items))
        early: dict[int, list[Store]] = {}
        for store in self.stores:
            k = max(read.get((store.region, store.index), 0), read.get(store.region, 0))
            if store.value.number in made and not store.region.record and not store.row and k < len(self.items):
                early.setdefault(max(k, made[store.value.number]), []).append(store)
        return early

    def values_by_leg(self, node: Node) -> list[Node]:
        """What a node has become: one for each leg, or one."""
        if node.number not in self.made:
            if not node.leg:
                return [node]
            match node.op:
                case "const":
                    extras = [Const((bits,)) for bits in node.attribute(Const).bits]
                case "load":
                    extras = node.attribute(At).each(self.group)
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
            return [Branch(self.values_by_leg(item.index)[0], [self._block(block, needed) for block in item.blocks])]
        args = [self.values_by_leg(x) for x in item.args]
        match item.op:
            case "pack":
                self.made[item.number] = [x[0] for x in args]
                return []
            case "part":
                self.made[item.number] = [args[0][item.attribute(OneOf).leg]]
                return []
            case "over_legs":  # opposite legs first, then the pairs in order
                x, made, half, op = args[0], [], self.group // 2, item.attribute(Over).op
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
        each = enumerate(self.values_by_leg(store.value))
        return [replace(store, index=store.index + k * store.step, value=x, step=0) for k, x in each]
