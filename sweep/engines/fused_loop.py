"""The closed loop on a CPU: a kernel of the fused compiler for the control ticks, NumPy programs before and after
it."""

import functools
import sys
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.stages import Compiled
from jaxtyping import Array

from sweep.backends import devices
from sweep.contract.engine import TimeSeriesRequest
from sweep.contract.engine_settings import EngineSettings
from sweep.controllers.plan import Plan
from sweep.core.errors import InputError
from sweep.engines.planning import CompiledPlanning
from sweep.engines.states import select_columns
from sweep.estimation.belief_update import LearnedState
from sweep.fused import eager
from sweep.fused.arrays import UnsupportedPrimitive
from sweep.fused.eager import NumpyProgram
from sweep.fused.kernel import Kernel, KernelBatch
from sweep.models.case import Case


class FusedBatch(NamedTuple):
    """A batch of rollouts in the memory of a fused CPU kernel: controller, physics and metrics in one program."""

    tiles: KernelBatch

    @property
    def is_over(self) -> np.ndarray:
        """Return which rollouts have ended (width,)."""
        return self.tiles.read_state_values(lambda carried: carried.loop.running.is_over)


class FusedPrograms(NamedTuple):
    """Programs of a batch: planning, the CPU kernel of controller and physics, and the metrics at the end."""

    planning: CompiledPlanning
    kernel: Kernel
    metrics: Callable[..., dict[str, Array]]
    replan: Callable[..., LearnedState] | None  # plans again before each chunk; None if the scenario does not
    ticks: int  # control ticks of a chunk
    width: int
    watch: TimeSeriesRequest | None

    def make_initial_batch(self, world: Case, belief: Case, keys: Array) -> tuple[Plan, FusedBatch]:
        """Plan the rollouts of a batch and write them to the kernel's memory, before the first tick."""
        plans, carry = self.planning(world, belief, keys)
        return plans, FusedBatch(self.kernel.load_batch((world, belief, plans), carry, self.width))

    def simulate_chunk(
        self, world: Case, belief: Case, plans: Plan, carry: FusedBatch, tick: int, slots: np.ndarray | None
    ) -> tuple[FusedBatch, Any]:
        """Simulate a batch for one chunk of consecutive control ticks, and record the requested rollouts.

        Args:
            world: parameters of the simulated side.
            belief: parameters that the planner received.
            plans: plans of the batch.
            carry: the batch.
            tick: number of the first control tick.
            slots: rollouts to record; None for none.

        Returns:
            The batch, and records of the rollouts in `slots`: all quantities, or the requested columns.
        """
        if self.replan is not None:
            known = carry.tiles.read_state_values(lambda carried: (carried.loop.tracker.stage, carried.loop.learned))
            carry.tiles.replace_state_values(lambda carried: carried.loop.learned, self.replan(belief, plans, *known))
        record = carry.tiles.advance_ticks(tick, self.ticks, slots)
        if record is None or self.watch is None:
            return carry, record
        return carry, select_columns(world, record, self.watch.columns)

    def compute_batch_metrics(self, world: Case, plans: Plan, carry: FusedBatch) -> dict[str, Array]:
        """Compute the metrics of a batch after its last chunk of ticks."""
        return self.metrics(world, plans, carry.tiles.read_full_state())


def single_rollout_shapes(arrays: tuple[Case, Case, Array], batch: Any) -> tuple[tuple[Case, Case, Plan], Any]:
    """Return the shapes of the tick function's arguments for a single rollout, from those of a batch.

    Args:
        arrays: world, belief and random keys of a batch.
        batch: shapes of its plans and of its carry.

    Returns:
        Shapes of (world, belief, plan), and of the carry.
    """

    def one(x: Any, axes: int) -> jax.ShapeDtypeStruct:
        return jax.ShapeDtypeStruct(x.shape[axes:], x.dtype)

    world, belief = jax.tree.map(lambda x: one(x, x.ndim), arrays[:2])
    plan, carry = jax.tree.map(lambda x: one(x, 1), batch)
    return (world, belief, plan), carry


def trace_or_compile_program(
    by_xla: Callable[[], Compiled], function: Callable[..., Any], *shapes: Any
) -> NumpyProgram | Compiled:
    """Make a program that runs a few times per batch: run by NumPy where it has all operations, else compiled by XLA.

    Args:
        by_xla: compiles the function over the batch with XLA.
        function: function of one rollout.
        shapes: shapes of its arguments for one rollout.
    """
    try:
        return eager.trace_numpy_program(function, *shapes)
    except UnsupportedPrimitive:
        return by_xla()


def make_batch_function(program: NumpyProgram | Compiled, width: int) -> Callable[..., Any]:
    """Turn a program (`NumpyProgram` or `Compiled`) into a function over batches of `width` rollouts."""
    return functools.partial(*(program, width) if isinstance(program, NumpyProgram) else (devices.run_program, program))


def catch_unsupported_primitive(compile_programs: Callable[..., tuple]) -> Callable[..., tuple]:
    """Wrap a function that compiles programs: for an unsupported operation it returns the name instead of raising.

    So the cache can store that the programs cannot be fused.
    """

    @functools.wraps(compile_programs)
    def with_missing_rule(*args: Any) -> tuple:
        try:
            return compile_programs(*args)
        except UnsupportedPrimitive as missing:
            return (str(missing),)

    return with_missing_rule


def report_xla_fallback(settings: EngineSettings, missing: str) -> None:
    """Print to standard error that XLA compiles the closed loop because the fused compiler has no rule for `missing`.

    Raises:
        InputError: The settings require the fused compiler.
    """
    why = f"the fused compiler has no rule for {missing}"
    if settings.compiler == "fused":
        raise InputError(f"engine.compiler = fused is not allowed here: {why}")
    print(f"sweep: XLA compiles the closed loop: {why}", file=sys.stderr)
