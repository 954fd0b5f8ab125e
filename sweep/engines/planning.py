"""What comes before a batch's first tick: its plans, and how the robots stand when they begin with them.

On a CPU NumPy goes through it (`fused.eager`), as it is run once a batch and long to compile; but this package's
compiler makes the search for planned forces. Elsewhere, and where something has no rule, all is a program of XLA's.
"""

from collections.abc import Callable
from concurrent.futures import Executor, Future
from contextlib import suppress
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.stages import Compiled
from jaxtyping import Array, Float, Shaped

from sweep.controllers import forces
from sweep.controllers.forces import Bounds, Effort, ForceProblem, SearchState, StaticPose
from sweep.core.progress import timed_part
from sweep.engines import devices
from sweep.fused import eager, kernel
from sweep.fused.arrays import Unsupported
from sweep.fused.eager import Eager
from sweep.fused.kernel import Code, Kernel
from sweep.models.legs import N_LEGS

Start = Callable[..., Any]  # of a rollout's world, belief and random key
Parts = tuple[Eager | Compiled, dict[str, Code]]  # of `Planning`, as they are kept
SLICE = 1 << 16  # poses that the search has in memory at a time


class Planning(NamedTuple):
    """A start, and what searches for its forces, by the names of `forces.SEARCHES`."""

    program: Eager | Compiled
    searches: dict[str, Kernel]

    @classmethod
    def from_programs(cls, program: Eager | Compiled, searches: dict[str, Code]) -> "Planning":
        """From the programs that are kept of it on disk."""
        return cls(program, {name: Kernel(code) for name, code in searches.items()})

    def __call__(self, world: Any, belief: Any, keys: Array) -> Any:
        """What a batch starts with."""
        if not isinstance(self.program, Eager):
            return self.program(world, belief, keys)
        apart = {name: partial(_searched, search) for name, search in self.searches.items()}
        return self.program(len(keys), world, belief, keys, apart=apart)


def start_compilation(
    pool: Executor, start: Start, arrays: tuple[Any, Any, Array], many: Callable[[Start], Start], forced: bool,
    by_host: bool,
) -> tuple[Any, Callable[[], Parts]]:  # fmt: skip
    """Begins to make what a batch like `arrays` starts with; its form, and what waits for the parts of `Planning`.

    `many` makes of a rollout's start that of a batch, for XLA. Whether plans are `forced`, with planned forces, tells
    how that compiles.
    """
    if by_host:
        with suppress(Unsupported), timed_part("plan"):
            program = eager.trace(start, *single_rollout_shapes(arrays), apart=forces.SEARCHES)
            return batch_shapes(program.form, len(arrays[2])), lambda: (program, _searches(program))
    lowered = jax.jit(many(start)).lower(*arrays)
    program = compile_in_pool(pool, "plan", lowered, devices.plan_options(forced))
    return lowered.out_info, lambda: (program.result(), {})


def evaluate_plan(function: Callable[[], Any]) -> Any:
    """What a function of plain numbers gives, which may search for forces."""

    def searched(name: str, *asked: Shaped[np.ndarray, "n ... 1"]) -> Float[np.ndarray, "n 6 3 1"]:
        forms = tuple(jax.ShapeDtypeStruct(x.shape[:-1], x.dtype) for x in asked)
        return _searched(Kernel(_search(forces.SEARCHES[name], forms)), *asked)

    return eager.evaluate_constants(function, {name: partial(searched, name) for name in forces.SEARCHES})


def single_rollout_shapes(arrays: Any) -> Any:
    """The form of a rollout's worlds, beliefs and keys, of a batch's."""
    return jax.tree.map(lambda x: jax.ShapeDtypeStruct((), x.dtype), arrays)


def batch_shapes(form: Any, width: int) -> Any:
    """The form of a batch of what has this form in a rollout."""
    return jax.tree.map(lambda x: jax.ShapeDtypeStruct((width, *x.shape), x.dtype), form)


def compile_in_pool(
    pool: Executor, name: str, program: jax.stages.Lowered, options: dict[str, Any] | None = None
) -> Future[Compiled]:
    """XLA compiles a program, told as the part `name`, while Python goes on."""

    def compiled() -> Compiled:
        with timed_part(name):
            return program.compile(options)

    return pool.submit(compiled)


def _searches(program: Eager) -> dict[str, Code]:
    """What takes the place of a program's searches."""
    return {name: _search(forces.SEARCHES[name], asked) for name, asked in program.apart.items()}


@cache
def _search(least: Effort, asked: tuple[jax.ShapeDtypeStruct, ...]) -> Code:
    """The search for one pose of those for which it is `asked`."""

    def tick(sought: ForceProblem, so_far: SearchState, number: Array) -> tuple[SearchState, dict[str, Array]]:
        return forces.search_step(least, sought, so_far, number), {}

    sought = _sought([jax.ShapeDtypeStruct(x.shape[1:], x.dtype) for x in asked])
    with timed_part("search for forces"):
        return kernel.compile_function(tick, sought, _nothing(sought.pose.arm))


def _sought(leaves: Any) -> ForceProblem:
    pose = len(StaticPose._fields)
    return ForceProblem(StaticPose(*leaves[:pose]), Bounds(*leaves[pose:]))


def _searched(search: Kernel, *asked: Shaped[np.ndarray, "n ... b"]) -> Float[np.ndarray, "n 6 3 b"]:
    """Forces in weights for n poses of every rollout."""
    width = max(x.shape[-1] for x in asked)
    rows = [np.moveaxis(np.broadcast_to(x, (*x.shape[:-1], width)), -1, 0) for x in asked]
    sought = _sought([x.reshape(-1, *x.shape[2:]) for x in rows])
    force = np.empty_like(sought.pose.arm)
    for first in range(0, len(force), SLICE):
        some = jax.tree.map(lambda x, first=first: x[first : first + SLICE], sought)
        tiles = search.enter(some, _nothing(force[0]), len(some.pose.arm))
        tiles.advance(0, len(forces.SLACK))
        force[first : first + SLICE] = tiles.look(lambda so_far: so_far.force)
    return np.moveaxis(force.reshape(width, -1, *force.shape[1:]), 0, -1)


def _nothing(force: Any) -> SearchState:
    """The search before its first step."""
    zeros: Any = np.zeros((N_LEGS, 4), force.dtype)
    return SearchState(zeros[:, :3], zeros[:, 3])
