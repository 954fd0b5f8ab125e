"""The closed loop as fused kernels: programs of the form of XLA's, between a start and a finish that stay with XLA."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array

from sweep.controllers.plan import Plan
from sweep.engines.fused.kernel import Kernel, Tiles
from sweep.engines.states import Watch, offered
from sweep.models.case import Case


class Going(NamedTuple):
    """A batch in the kernel's memory."""

    tiles: Tiles
    kernel: Kernel

    @property
    def over(self) -> np.ndarray:
        """Which rollouts are."""
        return self.kernel.look(self.tiles, lambda carried: carried.loop.running.over)


class Fused(NamedTuple):
    """What a batch runs through; `start` and `finish` are XLA's."""

    begin: Callable
    kernel: Kernel
    end: Callable
    again: Callable | None  # what plans again before each chunk, if any
    ticks: int  # of a chunk
    width: int
    spread: Callable  # over the devices, as `finish` was compiled for
    watch: Watch | None

    def start(self, world: Case, belief: Case, keys: Array) -> tuple[Plan, Going]:
        """Plans, and the batch before its first tick."""
        plans, carry = self.begin(world, belief, keys)
        return plans, Going(self.kernel.enter((world, belief, plans), carry, self.width), self.kernel)

    def chunk(
        self, world: Case, belief: Case, plans: Plan, carry: Going, tick: int, kept: np.ndarray | None
    ) -> tuple[Going, Any]:
        """Go on from `tick`; records of the rollouts `kept`, of all there is or of the columns watched."""
        if self.again is not None:
            self.kernel.resume(carry.tiles, self.again(belief, plans, self.spread(self.kernel.leave(carry.tiles))))
        record = self.kernel.advance(carry.tiles, tick, self.ticks, kept)
        if record is None or self.watch is None:
            return carry, record
        last = {name: np.moveaxis(x, (0, 1), (-2, -1)) for name, x in record.items()}
        columns = offered(world)
        return carry, np.stack([np.asarray(columns[name](last)) for name in self.watch.columns], axis=-1)

    def finish(self, world: Case, plans: Plan, carry: Going) -> dict[str, Array]:
        """Figures."""
        return self.end(world, plans, self.spread(self.kernel.leave(carry.tiles)))
