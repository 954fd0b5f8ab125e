"""The closed loop of a CPU as a fused kernel, between programs that NumPy goes through."""

import functools
import sys
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.stages import Compiled
from jaxtyping import Array

from sweep.controllers.belief_update import LearnedState
from sweep.controllers.plan import Plan
from sweep.core.errors import InputError
from sweep.engines import devices
from sweep.engines.base import Watch
from sweep.engines.planning import Planning
from sweep.engines.settings import EngineSettings
from sweep.engines.states import select_columns
from sweep.fused import eager
from sweep.fused.arrays import Unsupported
from sweep.fused.eager import Eager
from sweep.fused.kernel import Kernel, Tiles
from sweep.models.case import Case


class Going(NamedTuple):
    """A batch in a kernel's memory."""

    tiles: Tiles

    @property
    def is_over(self) -> np.ndarray:
        """Which rollouts have ended."""
        return self.tiles.look(lambda carried: carried.loop.running.over)


class Fused(NamedTuple):
    """What a batch runs through."""

    begin: Planning
    kernel: Kernel
    end: Callable[..., dict[str, Array]]
    again: Callable[..., LearnedState] | None  # what plans again before each chunk, if any
    ticks: int  # of a chunk
    width: int
    watch: Watch | None

    def start(self, world: Case, belief: Case, keys: Array) -> tuple[Plan, Going]:
        """Plans, and the batch before its first tick."""
        plans, carry = self.begin(world, belief, keys)
        return plans, Going(self.kernel.enter((world, belief, plans), carry, self.width))

    def chunk(
        self, world: Case, belief: Case, plans: Plan, carry: Going, tick: int, kept: np.ndarray | None
    ) -> tuple[Going, Any]:
        """Go on from `tick`; records of the rollouts `kept`, of all there is or of the columns watched."""
        if self.again is not None:
            known = carry.tiles.look(lambda carried: (carried.loop.tracker.stage, carried.loop.learned))
            carry.tiles.change(lambda carried: carried.loop.learned, self.again(belief, plans, *known))
        record = carry.tiles.advance(tick, self.ticks, kept)
        if record is None or self.watch is None:
            return carry, record
        return carry, select_columns(world, record, self.watch.columns)

    def finish(self, world: Case, plans: Plan, carry: Going) -> dict[str, Array]:
        """Figures of a batch that has gone through its ticks."""
        return self.end(world, plans, carry.tiles.leave())


def single_rollout_shapes(arrays: tuple[Case, Case, Array], batch: Any) -> tuple[tuple[Case, Case, Plan], Any]:
    """The form of what a rollout is given, and of what it carries on; a `batch` has plans and the latter."""

    def one(x: Any, axes: int) -> jax.ShapeDtypeStruct:
        return jax.ShapeDtypeStruct(x.shape[axes:], x.dtype)

    world, belief = jax.tree.map(lambda x: one(x, x.ndim), arrays[:2])
    plan, carry = jax.tree.map(lambda x: one(x, 1), batch)
    return (world, belief, plan), carry


def eager_or(by_xla: Callable[[], Compiled], function: Callable[..., Any], *given: Any) -> Eager | Compiled:
    """A function that is run a few times for a batch, of `given` shapes of a rollout; XLA's where it has to be."""
    try:
        return eager.trace(function, *given)
    except Unsupported:
        return by_xla()


def ready(program: Eager | Compiled, width: int) -> Callable[..., Any]:
    """`program` of one rollout, or of a batch, as a function of a batch of `width`."""
    return functools.partial(*(program, width) if isinstance(program, Eager) else (devices.run, program))


def or_what_is_missing(compiled: Callable[..., tuple]) -> Callable[..., tuple]:
    """The same; or what the fused compiler has no rule for, so that this can be kept as well."""

    @functools.wraps(compiled)
    def tried(*of: Any) -> tuple:
        try:
            return compiled(*of)
        except Unsupported as missing:
            return (str(missing),)

    return tried


def give_up(settings: EngineSettings, missing: str) -> None:
    """Say that XLA compiles the closed loop. Raises `InputError` where it was to be fused."""
    why = f"the fused compiler has no rule for {missing}"
    if settings.compiler == "fused":
        raise InputError(f"engine.compiler = fused is not allowed here: {why}")
    print(f"sweep: XLA compiles the closed loop: {why}", file=sys.stderr)
