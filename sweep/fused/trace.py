"""Tracing of a rollout's tick function with JAX, and the layout of its arrays in memory."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from sweep.fused.interpret import JaxprInterpreter
from sweep.fused.program import Block, LoopCount, MemoryRegion, Program
from sweep.fused.randomness import keys_to_words, rewrap_if_key

LEG_COUNT = 6  # the robot's legs


class ArrayLayout(NamedTuple):
    """Location of an array in a rollout's memory: the offset of its first element, which all others follow in order."""

    offset: int
    shape: tuple[int, ...]
    dtype: str

    @property
    def size(self) -> int:
        """Number of elements of the array."""
        return math.prod(self.shape)


class TracedProgram(NamedTuple):
    """The function of a control tick, traced to a program, with the memory layout of its arrays."""

    top_block: Block
    input_leaves: list[ArrayLayout]  # inputs, which do not change
    carry_leaves: list[ArrayLayout]  # carry from tick to tick
    record_leaves: dict[str, ArrayLayout]  # record of each tick, in memory of its own


LayoutFunction = Callable[
    [Sequence[Any], int], tuple[list[ArrayLayout], int]
]  # (shapes, first place) -> (leaves, end of the last)


def trace_program(
    function: Callable[[Any, Any, Array], tuple[Any, dict[str, Array]]],
    inputs: Any,
    carry: Any,
    layout: LayoutFunction,
    share_memory: bool,
    group: int,
) -> TracedProgram:
    """Trace the function of a control tick, `(inputs, carry, number) -> (carry, record)`, to a program for one rollout.

    Args:
        function: the tick function.
        inputs: tree of shapes of what does not change from tick to tick.
        carry: tree of shapes of what does.
        layout: lays arrays out in memory, from a first place on.
        share_memory: whether inputs and carry lie in the same memory.
        group: how many numbers one operation may give at once, such as the six legs; see `program`.

    Raises:
        Unsupported: A primitive has no rule.
        TypeError: The carry changes its shapes.
    """
    (first, tree), (second, other) = jax.tree.flatten(inputs), jax.tree.flatten(carry)
    n = len(first)

    def flat(*leaves: Array) -> Any:
        before = jax.tree.unflatten(tree, leaves[:n])
        now = jax.tree.unflatten(other, [rewrap_if_key(x, like) for x, like in zip(leaves[n:-1], second, strict=True)])
        moved, record = function(before, now, leaves[-1])
        return jax.tree.leaves(keys_to_words(moved)), record

    shapes = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in keys_to_words([*first, *second])]
    jaxpr, (moved, record) = jax.make_jaxpr(flat, return_shape=True)(*shapes, jax.ShapeDtypeStruct((), jnp.int32))
    both = [(old.shape, new.shape) for old, new in zip(shapes[n:], moved, strict=True)]
    if changed := [f"{old} to {new}" for old, new in both if old != new]:
        raise TypeError(f"what is carried changes its shapes: {', '.join(changed)}")
    constant, size = layout(shapes[:n], 0)
    moving, _ = layout(shapes[n:], size if share_memory else 0)
    names = sorted(record)  # as JAX flattens them
    recorded, _ = layout([record[name] for name in names], 0)

    program = Program(group)
    interpreter = JaxprInterpreter(program)
    regions = [[MemoryRegion(x.size, x.dtype, depth, x.offset, told) for x in leaves]
               for leaves, depth, told in ((constant, 0, False), (moving, 1, False), (recorded, 1, True))]  # fmt: skip
    with program.open_loop(None) as loop:
        tick = np.full((), program.get_or_add_node("tick", (), "int32", LoopCount(1)), object)
        inputs = [interpreter.load_array(region, leaf.shape, region.depth)
                  for group, leaves in zip(regions[:2], (constant, moving), strict=True)
                  for region, leaf in zip(group, leaves, strict=True)]  # fmt: skip
        results = interpreter.evaluate_jaxpr(jaxpr.jaxpr, jaxpr.consts, [*inputs, tick])
        for region, value in zip((*regions[1], *regions[2]), results, strict=True):
            interpreter.store_array(region, value, loop.body.stores)
    return TracedProgram(program.top_block, constant, moving, dict(zip(names, recorded, strict=True)))
