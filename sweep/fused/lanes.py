"""Preparation of a program for a GPU kernel: order of operations with few live values, parts, and rows of legs'
values."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from sweep.fused.program import (
    Block,
    Branch,
    ConstantBits,
    Extra,
    LegIndex,
    LegReduction,
    Loop,
    MemoryAddress,
    MemoryRegion,
    Node,
    Store,
    StoredNodeReference,
    walk_block,
)

RECOMPUTED_OPERATIONS = frozenset(
    ("const", "load", "tick")
)  # operations that are repeated wherever their value is needed
MAX_OPERATION_COUNT = 1 << 30  # cap on the count of a value's operations, which counts shared operands for each use
MemoryPlace = tuple[MemoryRegion, int]  # place of a number in memory, or of the six of the legs
LegRows = dict[MemoryPlace, tuple[int, int, int]]  # see `find_per_leg_memory_rows`


class KernelSection(NamedTuple):
    """A section of a GPU kernel: operations in order, then stores to memory."""

    items: list[Any]
    stores: list[Store]
    legs_in_lanes: bool  # whether lanes of a warp have the legs; else each thread has a rollout with all legs


def block_items_depth_first(block: Block, needed: set[int]) -> Iterator[Any]:
    """Yield the items of a block so that each value is computed shortly before its use, and few are alive at a time."""
    straight: dict[int, Node] = {}
    for item in [*block.items, None]:
        if isinstance(item, Node):
            if item.number in needed and item.op not in ("const", "load"):
                straight[item.number] = item
            continue
        yield from _order_nodes(straight)
        straight = {}
        if item is not None:
            yield item


def _order_nodes(nodes: dict[int, Node]) -> Iterator[Node]:
    inner = {arg.number for node in nodes.values() for arg in node.args}
    size: dict[int, int] = {}
    for node in nodes.values():
        size[node.number] = min(1 + sum(size.get(arg.number, 0) for arg in node.args), MAX_OPERATION_COUNT)
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


def find_per_leg_memory_rows(top: Block, needed: set[int], group: int) -> tuple[LegRows, list[MemoryRegion]]:
    """Find values in a kernel's temporary memory that are always read and written together for all six legs.

    Args:
        top: outermost block.
        needed: numbers of the nodes that are used.
        group: number of legs.

    Returns:
        For each number (first index of its row, step, leg); and the regions that have to lie in memory, because they
        are indexed by place or are read in other rows than written.
    """
    rows: dict[MemoryPlace, tuple[int, int, int]] = {}
    memory: dict[MemoryRegion, None] = {}
    uses: list[tuple[MemoryRegion, int, int]] = []
    for x in walk_block(top):
        if isinstance(x, Store) and x.value.leg:
            uses.append((x.region, x.index, x.leg_stride))
        elif isinstance(x, Node) and x.number in needed and x.op == "load" and x.leg:
            region, index, _, step = x.extra_data_of_type(MemoryAddress)
            uses.append((region, index, step))
        elif (
            isinstance(x, Node)
            and x.number in needed
            and x.op == "gather"
            and x.extra_data_of_type(MemoryAddress).region.byte_offset < 0
        ):
            memory[x.extra_data_of_type(MemoryAddress).region] = None
        if isinstance(x, Store) and x.row_index and x.region.byte_offset < 0:
            memory[x.region] = None
    for region, index, step in uses:
        if region.byte_offset < 0:
            for k in range(group):
                if rows.setdefault((region, index + k * step), (index, step, k)) != (index, step, k):
                    memory[region] = None
    return {place: row for place, row in rows.items() if place[0] not in memory}, list(memory)


def split_into_kernel_sections(
    block: Block, needed: set[int], last: MemoryRegion | None, group: int, small_batch: bool, rows: LegRows
) -> list[KernelSection]:
    """Split the body of a GPU kernel into sections: its loops, and the code between them.

    A loop has the legs in lanes of a warp. What lies between loops has a thread for each rollout, unless `small_batch`.
    A result is stored as soon as it is known and nothing needs the old value.

    Args:
        block: body of the loop over ticks.
        needed: numbers of the nodes that are used.
        last: region that is stored at the end.
        group: number of legs.
        small_batch: whether all parts have the legs in lanes.
        rows: see `find_per_leg_memory_rows`.
    """
    made = [part._replace(legs_in_lanes=small_batch or part.legs_in_lanes) for part in _cut_at_loops(block, needed)]
    home: dict[int | MemoryRegion, int] = {}
    for k, part in enumerate(made):
        home |= {item.number: k for item in part.items if isinstance(item, Node)}
        home |= {
            x.region: k for item in part.items for x in (item, *iterate_nested_items(item)) if isinstance(x, Store)
        }
    asked: dict[Any, int] = {}  # last part that reads a place, or that indexes a region
    for k, part in enumerate(made):
        for node in section_operands(part, needed):
            asked |= dict.fromkeys(_places(node, group), k)
    stores = _merge_leg_stores(block.stores, rows, group)
    late = [store for store in stores if store.region is last or _is_outer_load(store.value)]
    for store in late:
        asked |= dict.fromkeys(_places(store.value, group), len(made) - 1)
    for store in stores:
        places = [
            (store.region, store.index + k * store.leg_stride) for k in (range(group) if store.value.leg else (0,))
        ]
        if store.row_index:  # it may write any row of the region
            places += [place for place in asked if isinstance(place, tuple) and place[0] is store.region]
        free = max(asked.get(place, 0) for place in (*places, store.region))
        of = store.value.extra_data_of_type(MemoryAddress).region if store.value.op == "load" else store.value.number
        k = len(made) - 1 if store in late else max(free, home.get(of, 0))
        made[k].stores.append(store)
    return [part for part in made if part.items or part.stores]


def _merge_leg_stores(stores: Sequence[Store], rows: LegRows, group: int) -> list[Store]:
    """Merge stores that each write one leg's number of a row into one store for all legs."""
    found: dict[tuple[MemoryRegion, MemoryPlace], list[Store | None]] = {}
    for store in stores:
        if store.value.op == "load" and not store.value.leg and not store.row_index:
            region, index, _, _ = store.value.extra_data_of_type(MemoryAddress)
            if row := rows.get((region, index)):
                found.setdefault((store.region, (region, row[0])), [None] * group)[row[2]] = store
    made, done = [], set()
    for (_, (region, first)), each in found.items():
        whole = [store for store in each if store]
        step = whole[1].index - whole[0].index if len(whole) == group else 0
        if step > 0 and [store.index - whole[0].index for store in whole] == [k * step for k in range(group)]:
            like = whole[0].value
            at = MemoryAddress(region, first, like.extra_data_of_type(MemoryAddress).depth, rows[region, first][1])
            value = Node("load", (), at, like.dtype, True, (like.number, "legs"), like.block)
            made.append(replace(whole[0], value=value, leg_stride=step))
            done |= {id(store) for store in whole}
    return [store for store in stores if id(store) not in done] + made


def _cut_at_loops(block: Block, needed: set[int]) -> list[KernelSection]:
    made, begun = [KernelSection([], [], False)], []
    for item in block_items_depth_first(Block(block.depth, _around_branches(block, needed)), needed):
        if isinstance(item, Store):  # the start of a loop's carry; operations may lie between it and the loop
            begun.append(item)
        elif isinstance(item, Loop):
            made += [KernelSection([*begun, item], [], True), KernelSection([], [], False)]
            begun = []
        elif isinstance(item, Branch) and _is_for_legs(item, needed):
            if not made[-1].items and len(made) > 1 and isinstance(made[-2].items[-1], Branch):
                made[-2].items.append(item)
            else:
                made += [KernelSection([item], [], True), KernelSection([], [], False)]
        else:
            made[-1].items.append(item)
    return made


def _around_branches(block: Block, needed: set[int]) -> list[Any]:
    """Order a block's items so that branches over the legs after its last loop cut it into few parts.

    Everything that does not depend on these branches goes before them, and the rest after them, so that few values pass
    from one part to the next. Operations on inputs alone wait until something needs them.
    """
    start = max((k + 1 for k, item in enumerate(block.items) if isinstance(item, Loop)), default=0)
    head, tail = block.items[:start], block.items[start:]
    branches = [x for x in tail if isinstance(x, Branch) and _is_for_legs(x, needed)]
    late: set[Any] = set()  # items that depend on such a branch, and regions that they write to
    plain: set[Any] = set()  # nodes computed from inputs alone
    early: list[Any] = []
    for item in tail:
        operands = _operands(item, needed) or [item]
        if item in branches or any(
            x in late or (x.op == "load" and x.extra_data_of_type(MemoryAddress).region in late) for x in operands
        ):
            late |= {item, *_written_regions(item)}
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


def _written_regions(item: Any) -> set[MemoryRegion]:
    """Regions that a branch or loop stores to."""
    return {x.region for x in iterate_nested_items(item) if isinstance(x, Store)}


def _operands(item: Any, needed: set[int] | None = None) -> list[Node]:
    """All operands of an item of a block, those inside a branch included; by default of all operations."""
    nodes = [
        x for x in (item, *iterate_nested_items(item)) if isinstance(x, Node) and (needed is None or x.number in needed)
    ]
    stored = [x.value for x in iterate_nested_items(item) if isinstance(x, Store)]
    decisive = item.index if isinstance(item, Branch) else item.continue_flag if isinstance(item, Loop) else None
    return [*(arg for x in nodes for arg in x.args), *stored, *([decisive] if decisive else [])]


def _is_input(node: Node, block: Block) -> bool:
    """Whether a node can be read anywhere in `block`: it lies in outer memory, or was computed before."""
    return _is_outer_load(node) or (node.op in RECOMPUTED_OPERATIONS and node.op != "load") or node.block is not block


def _is_outer_load(node: Node) -> bool:
    return node.op == "load" and node.extra_data_of_type(MemoryAddress).region.byte_offset >= 0


def _with_operands(items: list[Any], tail: list[Any], needed: set[int], among: set[Any]) -> set[Any]:
    """These items, and those of `tail` that they depend on, directly or not, as far as they are `among`."""
    found = {*items}
    for item in reversed(tail):
        if item in found or not found.isdisjoint(_written_regions(item)):
            operands = _operands(item, needed)
            read = {x.extra_data_of_type(MemoryAddress).region for x in operands if x.op == "load"}
            found |= {item} | among.intersection(operands) | among.intersection(read)
    return found


def _is_for_legs(branch: Branch, needed: set[int]) -> bool:
    """Whether most of a branch are operations for all legs at once."""
    nodes = [
        x
        for x in iterate_nested_items(branch)
        if isinstance(x, Node) and x.number in needed and x.op not in RECOMPUTED_OPERATIONS
    ]
    return 2 * sum(x.leg for x in nodes) > len(nodes)


def iterate_nested_items(item: Any) -> Iterator[Any]:
    """Yield all items inside a loop or branch, nested ones included."""
    for block in [item.body] if isinstance(item, Loop) else item.blocks if isinstance(item, Branch) else ():
        yield from walk_block(block)


def section_operands(part: KernelSection, needed: set[int]) -> Iterator[Node]:
    """Yield the operands of all operations in a section of a GPU kernel and its inner blocks, without branch indices.

    Args:
        part: the part.
        needed: numbers of the nodes that are used.
    """
    for one in [*part.items, *part.stores]:
        for item in (one, *iterate_nested_items(one)):
            if isinstance(item, Node) and item.number in needed:
                yield from (item, *item.args) if item.op == "gather" else item.args
            elif isinstance(item, Store):
                yield item.value


def _places(node: Node, group: int) -> list[Any]:
    if node.op not in ("load", "gather"):
        return []
    region, index, _, step = node.extra_data_of_type(MemoryAddress)
    if node.op == "gather":
        return [region]
    return [(region, index + k * step) for k in (range(group) if node.leg else (0,))]


class RolloutPerThreadSection:
    """A section of a GPU kernel in which each thread simulates a whole rollout, with one operation for each leg."""

    def __init__(self, part: KernelSection, needed: set[int], group: int):
        self.group = group
        self.made: dict[int, list[Node]] = {}
        self.items = [x for item in part.items for x in self._item(item, needed)]
        self.stores = [x for store in part.stores for x in self._store(store)]
        self.early = self._early_stores()

    def _early_stores(self) -> dict[int, list[Store]]:
        """Stores that need not wait for the end of the part, by the index of the item after which they can be made.

        Their values are computed by then, and nothing in the part reads their places any more.
        """
        made = {item.number: k for k, item in enumerate(self.items) if isinstance(item, Node)}
        read: dict[Any, int] = {}  # last item that reads a place, or that indexes a region
        for k, item in enumerate(self.items):
            for node in _operands(item):
                read |= dict.fromkeys(_places(node, self.group), k)
            for node in (item, *iterate_nested_items(item)):
                if isinstance(node, Node) and node.op == "gather":
                    read |= dict.fromkeys(_places(node, self.group), k)
        for store in self.stores:
            read |= dict.fromkeys(_places(store.value, self.group), len(self.items))
        early: dict[int, list[Store]] = {}
        for store in self.stores:
            k = max(read.get((store.region, store.index), 0), read.get(store.region, 0))
            if (
                store.value.number in made
                and not store.region.is_record
                and not store.row_index
                and k < len(self.items)
            ):
                early.setdefault(max(k, made[store.value.number]), []).append(store)
        return early

    def nodes_by_leg(self, node: Node) -> list[Node]:
        """Return the nodes that replace a node in this section: one for each leg, or a single node for all legs."""
        if node.number not in self.made:
            if not node.leg:
                return [node]
            match node.op:
                case "const":
                    extras = [ConstantBits((bits,)) for bits in node.extra_data_of_type(ConstantBits).value_bytes]
                case "load":
                    extras = node.extra_data_of_type(MemoryAddress).leg_addresses(self.group)
                case _:  # a node of another part
                    extras = [StoredNodeReference(node.number, k) for k in range(self.group)]
            op = node.op if node.op in RECOMPUTED_OPERATIONS else "handed_on"
            self.made[node.number] = [self._node(node, op, (), extra, k) for k, extra in enumerate(extras)]
        return self.made[node.number]

    @staticmethod
    def _node(original: Node, op: str, args: Sequence[Node], extra: Extra, k: Any) -> Node:
        return Node(op, tuple(args), extra, original.dtype, False, (original.number, k), original.block)

    def _item(self, item: Any, needed: set[int]) -> list[Any]:
        if isinstance(item, Store):
            return self._store(item)
        if isinstance(item, Loop):
            body = self._block(item.body, needed)
            return [Loop(item.length, body, self.nodes_by_leg(item.continue_flag)[0] if item.continue_flag else None)]
        if isinstance(item, Branch):
            return [Branch(self.nodes_by_leg(item.index)[0], [self._block(block, needed) for block in item.blocks])]
        args = [self.nodes_by_leg(x) for x in item.args]
        match item.op:
            case "pack":
                self.made[item.number] = [x[0] for x in args]
                return []
            case "part":
                self.made[item.number] = [args[0][item.extra_data_of_type(LegIndex).leg]]
                return []
            case "over_legs":  # opposite legs first, then the pairs in order
                x, made, half, op = args[0], [], self.group // 2, item.extra_data_of_type(LegReduction).op
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
        if isinstance(item.extra, MemoryAddress) and item.leg:
            extras = item.extra.leg_addresses(self.group)
        made = [self._node(item, item.op, [x[k % len(x)] for x in args], extras[k], k) for k in legs]
        self.made[item.number] = made
        return made

    def _block(self, block: Block, needed: set[int]) -> Block:
        made = Block(block.depth)
        made.items = [x for item in block_items_depth_first(block, needed) for x in self._item(item, needed)]
        made.stores = [x for store in block.stores for x in self._store(store)]
        return made

    def _store(self, store: Store) -> list[Store]:
        each = enumerate(self.nodes_by_leg(store.value))
        return [replace(store, index=store.index + k * store.leg_stride, value=x, leg_stride=0) for k, x in each]
