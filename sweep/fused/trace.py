"""The program of one rollout's ticks from the function that JAX traces, and where its arrays lie in memory."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from sweep.fused.interpret import Interpreter
from sweep.fused.program import Block, Count, Program, Region
from sweep.fused.randomness import key_words, restore_keys

GROUP = 6  # of a robot: its legs


class Leaf(NamedTuple):
    """Where an array of each rollout lies in memory: its first number, and what follows it in order."""

    place: int
    shape: tuple[int, ...]
    dtype: str

    @property
    def size(self) -> int:
        """How many numbers it has in a rollout."""
        return math.prod(self.shape)


class Traced(NamedTuple):
    """A program, and its arrays."""

    top: Block
    given: list[Leaf]  # what does not change
    carried: list[Leaf]  # what goes on from tick to tick
    recorded: dict[str, Leaf]  # of each tick, in a memory of its own


Layout = Callable[[Sequence[Any], int], tuple[list[Leaf], int]]  # arrays one after the other, and where the last ends


def trace_program(
    function: Callable[[Any, Any, Array], tuple[Any, dict[str, Array]]],
    given: Any,
    carried: Any,
    layout: Layout,
    together: bool,
    group: int,
) -> Traced:
    """The ticks `function(given, carried, number) -> (carried, record)` of one rollout, for trees of arrays like these.

    `together`: what is given and what is carried share a memory. `group`: how many numbers are one operation's, see
    `program`. Raises `Unsupported`, and `TypeError` where what is carried changes its shapes, as its memory does not.
    """
    (first, tree), (second, other) = jax.tree.flatten(given), jax.tree.flatten(carried)
    n = len(first)

    def flat(*leaves: Array) -> Any:
        before = jax.tree.unflatten(tree, leaves[:n])
        now = jax.tree.unflatten(other, [restore_keys(x, like) for x, like in zip(leaves[n:-1], second, strict=True)])
        moved, record = function(before, now, leaves[-1])
        return jax.tree.leaves(key_words(moved)), record

    shapes = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in key_words([*first, *second])]
    jaxpr, (moved, record) = jax.make_jaxpr(flat, return_shape=True)(*shapes, jax.ShapeDtypeStruct((), jnp.int32))
    both = [(old.shape, new.shape) for old, new in zip(shapes[n:], moved, strict=True)]
    if changed := [f"{old} to {new}" for old, new in both if old != new]:
        raise TypeError(f"what is carried changes its shapes: {', '.join(changed)}")
    constant, size = layout(shapes[:n], 0)
    moving, _ = layout(shapes[n:], size if together else 0)
    names = sorted(record)  # as JAX flattens them
    recorded, _ = layout([record[name] for name in names], 0)

    program = Program(group)
    interpreter = Interpreter(program)
    regions = [[Region(x.size, x.dtype, depth, x.place, told) for x in leaves]
               for leaves, depth, told in ((constant, 0, False), (moving, 1, False), (recorded, 1, True))]  # fmt: skip
    with program.loop(None) as body:
        tick = np.full((), program.node("tick", (), "int32", Count(1)), object)
        inputs = [interpreter.load_array(region, leaf.shape, region.depth)
                  for group, leaves in zip(regions[:2], (constant, moving), strict=True)
                  for region, leaf in zip(group, leaves, strict=True)]  # fmt: skip
        results = interpreter.evaluate(jaxpr.jaxpr, jaxpr.consts, [*inputs, tick])
        for region, value in zip((*regions[1], *regions[2]), results, strict=True):
            interpreter.save(region, value, body.stores)
    return Traced(program.top, constant, moving, dict(zip(names, recorded, strict=True)))
