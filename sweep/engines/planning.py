"""What comes before a batch's first tick, compiled: its plans, and how the robots stand when they begin with them.

On a CPU this package's compiler makes what XLA takes long to compile or to run: how a robot stands, and the search for
planned forces. Where that is, XLA's program of a plan is taken apart, into one that ends with the poses, and one that
begins with their forces.
"""

from collections.abc import Callable
from concurrent.futures import Executor, Future
from contextlib import suppress
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, Literal, jaxpr_as_fun  # pyright: ignore[reportPrivateImportUsage]
from jax.stages import Compiled
from jaxtyping import Array, Float

from sweep.controllers import forces
from sweep.controllers.forces import Bounds, Effort, Search, Sought, StaticPose
from sweep.core.waiting import part
from sweep.engines import devices
from sweep.fused import kernel
from sweep.fused.arrays import Unsupported
from sweep.fused.kernel import Code, Kernel, Once
from sweep.models.legs import N_LEGS

Start = Callable[..., Any]  # of a rollout's world, belief and random key, and maybe more
Parts = tuple[Compiled, Code | None, Compiled | None, Once | None]  # of `Planning`, as they are kept
Many = Callable[[Start, int], Start]  # the same of a batch, for a start with so many arguments more
SLICE = 1 << 16  # poses that the search has in memory at a time


class Planning(NamedTuple):
    """A compiled start: a program of XLA's, or two with the search between them; then how a robot stands, if apart."""

    before: Compiled
    search: Kernel | None
    after: Compiled | None
    stand: Callable[..., Any] | None

    @classmethod
    def of(cls, before: Compiled, search: Code | None, after: Compiled | None, stand: Once | None) -> "Planning":
        """From what is kept of it."""
        return cls(before, search and Kernel(search), after, stand and stand.loaded())

    def __call__(self, world: Any, belief: Any, keys: Array) -> Any:
        """What a batch starts with."""
        planned = self._planned(world, belief, keys)
        if self.stand is None:
            return planned
        return planned[0], self.stand(len(keys), world, belief, *planned, keys)

    def _planned(self, *args: Any) -> Any:
        if self.search is None or self.after is None:
            return self.before(*args)
        sought, kept = self.before(*args)
        return devices.run(self.after, *args, kept, _searched(self.search, sought))


class Lowered(NamedTuple):
    """A start of a batch, traced."""

    out_info: Any  # what it gives, as shapes
    programs: tuple[jax.stages.Lowered, ...]  # of XLA's
    options: dict[str, Any]
    search: Callable[[], Code] | None = None

    def compiled(self, pool: Executor) -> Callable[[], Parts]:
        """Begins to compile; what it gives waits until that is done, for the parts of `Planning`."""
        begun = [compiling(pool, "plan", program, self.options) for program in self.programs]

        def parts() -> Parts:
            search = self.search and self.search()
            before, *after = (program.result() for program in begun)
            return before, search, after[0] if after else None, None

        return parts


def compiling(
    pool: Executor, name: str, program: jax.stages.Lowered, options: dict[str, Any] | None = None
) -> Future[Compiled]:
    """XLA compiles a program, told as the part `name`, while Python goes on."""

    def compiled() -> Compiled:
        with part(name):
            return program.compile(options)

    return pool.submit(compiled)


def begun(
    pool: Executor,
    plan: Start,
    stand: Callable[..., Any],
    arrays: tuple[Any, Any, Array],
    many: Many,
    searches: bool,
    by_host: bool,
) -> tuple[Any, Callable[[], Parts]]:
    """Begins to compile what a batch like `arrays` starts with; its form, and what waits for the parts of `Planning`.

    `plan` gives a plan and what was learned for it, of a rollout's world, belief and random key; of all these `stand`
    gives what the rollout starts with.
    """
    if by_host:
        found = lowered(plan, arrays, many, searches, by_host)
        parts, width = found.compiled(pool), len(arrays[2])
        world, belief, key = jax.tree.map(lambda x: jax.ShapeDtypeStruct((), x.dtype), arrays)
        planned = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), found.out_info)
        with suppress(Unsupported):  # or all is XLA's
            code = kernel.compiled_once(stand, world, belief, *planned, key)
            made = jax.eval_shape(stand, world, belief, *planned, key)
            made = jax.tree.map(lambda x: jax.ShapeDtypeStruct((width, *x.shape), x.dtype), made)
            return (found.out_info[0], made), lambda: (*parts()[:-1], code)

    def start(world: Any, belief: Any, key: Array) -> Any:
        planned = plan(world, belief, key)
        return planned[0], stand(world, belief, *planned, key)

    found = lowered(start, arrays, many, searches, by_host)
    return found.out_info, found.compiled(pool)


def lowered(start: Start, arrays: tuple[Any, Any, Array], many: Many, searches: bool, by_host: bool) -> Lowered:
    """A `start` for a batch like `arrays` of worlds, beliefs and keys, which `searches` for forces, or does not.

    It is taken apart where the kernels are run `by_host`.
    """
    parts = _apart(start, arrays) if searches and by_host else None
    if parts is None:
        whole = jax.jit(many(start, 0)).lower(*arrays)
        return Lowered(whole.out_info, (whole,), devices.plan_options(searches))
    before, after, least = parts
    first = jax.jit(many(before, 0)).lower(*arrays)
    sought, kept = first.out_info
    last = jax.jit(many(after, 2)).lower(*arrays, kept, sought.pose.arm)  # forces have its shape
    leaves, tree = jax.tree.flatten(jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[2:], x.dtype), sought))
    return Lowered(last.out_info, (first, last), {}, partial(_search, least, tuple(leaves), tree))


@cache
def _search(least: Effort, leaves: tuple[jax.ShapeDtypeStruct, ...], tree: Any) -> Code:
    def tick(sought: Sought, so_far: Search, number: Array) -> tuple[Search, dict[str, Array]]:
        return forces.step(least, sought, so_far, number), {}

    sought = jax.tree.unflatten(tree, leaves)
    with part("search for forces"):
        return kernel.compiled(tick, sought, _nothing(sought.pose.arm))


def _searched(search: Kernel, sought: Sought) -> Float[np.ndarray, "b n 6 3"]:
    """Forces in weights for n poses of every rollout."""
    flat = jax.tree.map(lambda x: np.asarray(x).reshape(-1, *x.shape[2:]), sought)
    force = np.empty_like(flat.pose.arm)
    for first in range(0, len(force), SLICE):
        here = slice(first, first + SLICE)
        some = Sought(*jax.tree.map(lambda x, here=here: x[here], flat))
        tiles = search.enter(some, _nothing(force[0]), len(some.pose.arm))
        tiles.advance(0, len(forces.SLACK))
        force[here] = tiles.look(lambda so_far: so_far.force)
    return force.reshape(sought.pose.arm.shape)


def _nothing(force: Any) -> Search:
    """Before the first step."""
    zeros: Any = np.zeros((N_LEGS, 4), force.dtype)
    return Search(zeros[:, :3], zeros[:, 3])


def _apart(start: Start, arrays: tuple[Any, Any, Array]) -> tuple[Start, Start, Effort] | None:
    """A start up to its search for forces, from there on, and which these are.

    The second takes, beside what the first does, what the first keeps for it and the forces. None where there is not
    just one search, or all rollouts share it, which XLA does once.
    """
    one = jax.tree.map(lambda x: jax.ShapeDtypeStruct((), x.dtype), arrays)
    program, shape = jax.make_jaxpr(start, return_shape=True)(*one)
    eqns = _needed(program)
    places = [k for k, eqn in enumerate(eqns) if eqn.params.get("name") in forces.SEARCHES]
    if len(places) != 1:
        return None
    place, search, end = places[0], eqns[places[0]], program.jaxpr.outvars
    differs = {x for x, given in zip(program.jaxpr.invars, jax.tree.leaves(arrays), strict=True) if given.ndim}
    for eqn in eqns[:place]:
        if _of(eqn) & differs:
            differs.update(eqn.outvars)
    if not _of(search) & differs:
        return None
    made = {x for eqn in eqns[:place] for x in eqn.outvars}
    read = [*(x for eqn in eqns[place + 1 :] for x in eqn.invars), *end]
    kept = list(dict.fromkeys(x for x in read if not isinstance(x, Literal) and x in made))
    pose, asked = len(StaticPose._fields), len(search.invars)

    def part(inputs: list[Any], some: list[Any], outputs: list[Any]) -> Callable[..., list[Array]]:
        whole = program.jaxpr.replace(invars=inputs, eqns=some, outvars=outputs)
        return jaxpr_as_fun(ClosedJaxpr(whole, program.consts))

    first = part(program.jaxpr.invars, eqns[:place], [*search.invars, *kept])
    last = part([*program.jaxpr.invars, *kept, *search.outvars], eqns[place + 1 :], end)

    def before(*given: Any) -> tuple[Sought, list[Array]]:
        found = first(*jax.tree.leaves(given))
        return Sought(StaticPose(*found[:pose]), Bounds(*found[pose:asked])), found[asked:]

    def after(*given: Any) -> Any:
        return jax.tree.unflatten(jax.tree.structure(shape), last(*jax.tree.leaves(given)))

    return before, after, forces.SEARCHES[search.params["name"]]


def _needed(program: ClosedJaxpr) -> list[Any]:
    """The operations of which something comes: learning plans once for the poses of its calibration alone."""
    wanted, kept = {x for x in program.jaxpr.outvars if not isinstance(x, Literal)}, []
    for eqn in reversed(program.jaxpr.eqns):
        if wanted.intersection(eqn.outvars):
            kept.append(eqn)
            wanted |= _of(eqn)
    return kept[::-1]


def _of(eqn: Any) -> set[Any]:
    """The values that an operation works on."""
    return {x for x in eqn.invars if not isinstance(x, Literal)}
