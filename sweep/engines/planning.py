"""Planning of a batch: the plans, and the state in which each rollout starts.

On a CPU, and for small batches on a GPU, NumPy executes the traced program (`fused.eager`): it runs once for each batch
and takes long to compile. Only its search for planned forces is compiled, by the fused compiler. For larger batches on
a GPU, and where a rule is missing, XLA compiles the whole program.
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

from sweep.backends import devices
from sweep.core.progress import measure_part_duration
from sweep.fused import eager, kernel
from sweep.fused.arrays import UnsupportedPrimitive
from sweep.fused.eager import NumpyProgram
from sweep.fused.kernel import Kernel, KernelCode
from sweep.models.legs import N_LEGS
from sweep.planning import forces
from sweep.planning.forces import Effort, ForceBounds, ForcePlanningPose, ForceProblem, ForceSearchState

StartFunction = Callable[..., Any]  # function of a rollout's world, belief and random key
StoredPlanning = tuple[
    NumpyProgram | Compiled, dict[str, KernelCode]
]  # of `CompiledPlanning`, as the cache stores them
POSES_PER_SLICE = 1 << 16  # poses that are in memory at a time


class CompiledPlanning(NamedTuple):
    """Compiled planning of a batch: the program that makes plans, and the kernels that search for foot forces."""

    program: NumpyProgram | Compiled
    searches: dict[str, Kernel]

    @classmethod
    def from_programs(cls, program: NumpyProgram | Compiled, searches: dict[str, KernelCode]) -> "CompiledPlanning":
        """Make the compiled planning of a batch from programs that the cache holds."""
        return cls(program, {name: Kernel(code) for name, code in searches.items()})

    def __call__(self, world: Any, belief: Any, keys: Array) -> Any:
        """Plan a batch: world and belief (numbers or arrays over the batch), and a random key for each rollout."""
        if not isinstance(self.program, NumpyProgram):
            return self.program(world, belief, keys)
        apart = {name: partial(_search_forces, search) for name, search in self.searches.items()}
        return self.program(len(keys), world, belief, keys, external=apart)


def start_compilation(
    pool: Executor,
    start: StartFunction,
    arrays: tuple[Any, Any, Array],
    batch_start: Callable[[StartFunction], StartFunction],
    has_forces: bool,
    use_numpy: bool,
) -> tuple[Any, Callable[[], StoredPlanning]]:
    """Start to compile the planning program of a batch in a thread pool.

    Args:
        pool: threads in which XLA compiles.
        start: function of a rollout's world, belief and random key.
        arrays: world, belief and keys of a batch.
        batch_start: makes a function of a batch from `start`, for XLA.
        has_forces: whether the plans have planned forces, which changes XLA's options.
        use_numpy: whether NumPy executes the program, where the fused compiler has all its rules.

    Returns:
        Shapes of the results for a batch, and a function that waits for the programs.
    """
    if use_numpy:
        with suppress(UnsupportedPrimitive), measure_part_duration("plan"):
            program = eager.trace_numpy_program(start, *single_rollout_input_shapes(arrays), external=forces.SEARCHES)
            return batch_shapes(program.result_shapes, len(arrays[2])), lambda: (program, _compile_searches(program))
    lowered = jax.jit(batch_start(start)).lower(*arrays)
    program = compile_in_pool(pool, "plan", lowered, devices.planning_compiler_options(has_forces))
    return lowered.out_info, lambda: (program.result(), {})


def evaluate_planning_function(function: Callable[[], Any]) -> Any:
    """Evaluate a planning function on plain numbers, with compiled kernels for its searches for foot forces."""

    def search_by_name(name: str, *problems: Shaped[np.ndarray, "n ... 1"]) -> Float[np.ndarray, "n 6 3 1"]:
        forms = tuple(jax.ShapeDtypeStruct(x.shape[:-1], x.dtype) for x in problems)
        return _search_forces(Kernel(_compile_search(forces.SEARCHES[name], forms)), *problems)

    return eager.evaluate_constant_function(function, {name: partial(search_by_name, name) for name in forces.SEARCHES})


def single_rollout_input_shapes(arrays: Any) -> Any:
    """Return the shapes of world, belief and random key of one rollout, from those of a batch."""
    return jax.tree.map(lambda x: jax.ShapeDtypeStruct((), x.dtype), arrays)


def batch_shapes(form: Any, width: int) -> Any:
    """Return the array shapes of a batch of `width` rollouts, given those of one rollout."""
    return jax.tree.map(lambda x: jax.ShapeDtypeStruct((width, *x.shape), x.dtype), form)


def compile_in_pool(
    pool: Executor, name: str, program: jax.stages.Lowered, options: dict[str, Any] | None = None
) -> Future[Compiled]:
    """Compile a program with XLA in a thread of `pool`, concurrently with Python.

    Args:
        pool: threads to compile in.
        name: name of the part, under which its time is reported.
        program: the lowered program.
        options: options of XLA's compiler.
    """

    def compiled() -> Compiled:
        with measure_part_duration(name):
            return program.compile(options)

    return pool.submit(compiled)


def _compile_searches(program: NumpyProgram) -> dict[str, KernelCode]:
    """Kernels for the searches that a program calls."""
    return {name: _compile_search(forces.SEARCHES[name], asked) for name, asked in program.external_functions.items()}


@cache
def _compile_search(least: Effort, problems: tuple[jax.ShapeDtypeStruct, ...]) -> KernelCode:
    """Compile the search for the forces of one pose."""

    def tick(
        problem: ForceProblem, state: ForceSearchState, number: Array
    ) -> tuple[ForceSearchState, dict[str, Array]]:
        return forces.force_search_step(least, problem, state, number), {}

    sought = _force_problem([jax.ShapeDtypeStruct(x.shape[1:], x.dtype) for x in problems])
    with measure_part_duration("search for forces"):
        return kernel.compile_function(tick, sought, _initial_search(sought.pose.arm))


def _force_problem(leaves: Any) -> ForceProblem:
    pose = len(ForcePlanningPose._fields)
    return ForceProblem(ForcePlanningPose(*leaves[:pose]), ForceBounds(*leaves[pose:]))


def _search_forces(search: Kernel, *problems: Shaped[np.ndarray, "n ... b"]) -> Float[np.ndarray, "n 6 3 b"]:
    """Forces of n poses of each rollout, in units of the robot's weight."""
    width = max(x.shape[-1] for x in problems)
    rows = [np.moveaxis(np.broadcast_to(x, (*x.shape[:-1], width)), -1, 0) for x in problems]
    sought = _force_problem([x.reshape(-1, *x.shape[2:]) for x in rows])
    force = np.empty_like(sought.pose.arm)
    for first in range(0, len(force), POSES_PER_SLICE):
        some = jax.tree.map(lambda x, first=first: x[first : first + POSES_PER_SLICE], sought)
        tiles = search.load_batch(some, _initial_search(force[0]), len(some.pose.arm))
        tiles.advance_ticks(0, len(forces.SLACK))
        force[first : first + POSES_PER_SLICE] = tiles.read_state_values(lambda state: state.force)
    return np.moveaxis(force.reshape(width, -1, *force.shape[1:]), 0, -1)


def _initial_search(force: Any) -> ForceSearchState:
    """State of the search before its first step."""
    zeros: Any = np.zeros((N_LEGS, 4), force.dtype)
    return ForceSearchState(zeros[:, :3], zeros[:, 3])
