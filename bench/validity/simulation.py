"""Physics steps without a controller, for a batch of cases under targets of joints."""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sweep.backends import devices
from sweep.dynamics import interface, tree
from sweep.dynamics.step import PhysicsState, pack_physics_state, state_at_rest, step, unpack_physics_state
from sweep.engines import physics
from sweep.engines.batch_last import batch_last_vmap
from sweep.fused import launch
from sweep.fused.kernel import Kernel, compile_function
from sweep.models.case import Case
from sweep.models.drive import position_command

Record = dict[str, Any]
Step = Callable[
    [Case, PhysicsState, jax.Array], tuple[PhysicsState, Record]
]  # of one world, under targets; and what is kept of it


class History(NamedTuple):
    """Everything after each step: first axis time, second the batch."""

    q: np.ndarray
    v: np.ndarray
    force: np.ndarray  # (t, b, 6, 3) N, on the feet
    normal: np.ndarray  # (t, b, 6) N
    foot: np.ndarray  # (t, b, 6, 3) m, before the step
    energy: np.ndarray  # (t, b) J, before the step
    residual: np.ndarray  # (t, b) N
    work: np.ndarray  # (t, b) J, of drives and loads in the step


def simulate(
    case: Case,
    nominal: Case,
    q: np.ndarray,
    references: np.ndarray,
    h: float = 2e-3,
    v: np.ndarray | None = None,
    iterations: int = 2,
    fused: bool = False,
) -> History:
    """`case` with swept leaves, its structure in `nominal`, under targets (t, 6, 3), or (t, b, 6, 3) of their own.

    It starts from configurations q (b, nq), at velocities v (b, nv) or at rest. `fused` asks for this
    package's compiler in place of XLA.
    """
    one, states = _stepping(nominal, q, h, v, iterations)
    advance = _by_kernel if fused else _by_xla
    record = advance(one, devices.to_jax_arrays(case), states, jnp.asarray(references))
    return History(**{name: np.asarray(x, float) for name, x in record.items()})


def _stepping(
    nominal: Case, q: np.ndarray, h: float, v: np.ndarray | None, iterations: int
) -> tuple[Step, PhysicsState]:
    """A step of one world, and the batch at its start."""
    devices.configure_jax()
    top = interface.build_model_topology(nominal)

    def one(case: Case, state: PhysicsState, reference: jax.Array) -> tuple[PhysicsState, Record]:
        limits = physics.drive_limits_at_step(case, jnp.int32(0), h)
        servo = position_command(case.drive, reference)
        moving, report = step(tree.tree_dynamics(case), case, limits, unpack_physics_state(state), servo, h, iterations)
        work = h * (jnp.sum(sum(report.power)) + report.external_power[0])  # pyright: ignore[reportArgumentType]
        state, before = pack_physics_state(moving), report.start
        return state, {
            "q": state.q,
            "v": state.v,
            "force": report.force.array(),
            "normal": report.normal,
            "foot": before.joints[-1].array(),
            "energy": before.energy[0],
            "residual": report.residual[0],
            "work": work,
        }

    start = jnp.asarray(q)  # of the precision in use
    v = np.zeros((len(q), top.model.nv)) if v is None else v
    return one, jax.vmap(lambda q, v: state_at_rest(top, q)._replace(v=v))(start, jnp.asarray(v, start.dtype))


def _by_xla(one: Step, case: Case, states: PhysicsState, references: jax.Array) -> Record:
    axes, own = jax.tree.map(lambda x: -1 if np.ndim(x) else None, case), references.ndim == 4
    references = jnp.moveaxis(references, 1, -1) if own else references
    batch = batch_last_vmap(one, (axes, -1, -1 if own else None), devices.recomputation_cost_threshold())
    states = jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1), states)
    # run once, it is not worth the minute or two that optimising it takes
    program = jax.jit(
        lambda *of: jax.lax.scan(lambda s, r: batch(of[0], s, r), *of[1:]),
        compiler_options={"xla_backend_optimization_level": 0},
    )
    _, record = program(case, states, references)
    return jax.tree.map(lambda x: jnp.moveaxis(x, -1, 1), record)


class Running(NamedTuple):
    """A compiled batch before its first step, and the compile time (s)."""

    advance: Callable[[], Record]  # from the start to the end, whenever it is called; what is told of it
    compile_s: float


def _by_kernel(one: Step, case: Case, states: PhysicsState, references: jax.Array) -> Record:
    table = jnp.concatenate([references[:1], references])
    return _begun(one, case, states, table, len(references), 1, np.arange(len(states.q))).advance()


def compile_batch(
    case: Case,
    nominal: Case,
    q: np.ndarray,
    v: np.ndarray,
    table: np.ndarray,
    h: float,
    iterations: int,
    every: int,
) -> Running:
    """Compile a batch with this package's compiler, for a GPU if there is one; see `simulate`."""

    def told(case: Case, state: PhysicsState, reference: jax.Array) -> tuple[PhysicsState, Record]:
        state, record = one(case, state, reference)
        return state, {name: record[name] for name in ("q", "v", "normal", "residual")}

    one, states = _stepping(nominal, q, h, v, iterations)
    of = devices.to_jax_arrays(case), states, jnp.asarray(table)
    return _begun(told, *of, len(table) - 1, every, np.zeros(1, int))


def _begun(
    one: Step, case: Case, states: PhysicsState, table: jax.Array, ticks: int, every: int, kept: np.ndarray
) -> Running:
    """`ticks` of `every` steps each, of which the last is told."""
    still = bool(np.all(table == table[0]))  # targets that stay take no memory
    table = table[:1] if still else table
    table = jnp.moveaxis(table, 1, 0) if table.ndim == 4 else table
    last = table.shape[-3] - 1

    def tick(given: tuple[Case, jax.Array], state: PhysicsState, k: jax.Array) -> tuple[PhysicsState, Record]:
        case, targets = given
        old, new = targets[jnp.minimum(k, last)], targets[jnp.minimum(k + 1, last)]

        def ahead(carry: tuple[PhysicsState, Record], j: jax.Array) -> tuple[tuple[PhysicsState, Record], None]:
            share = (j + 1).astype(old.dtype) / every
            state, record = one(case, carry[0], (1 - share) * old + share * new)
            return (state, record | {"residual": jnp.maximum(record["residual"], carry[1]["residual"])}), None

        nothing = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(one, case, state, old)[1])
        return jax.lax.scan(ahead, (state, nothing), jnp.arange(every))[0]

    def of_one(x: jax.Array, axes: int) -> jax.ShapeDtypeStruct:
        return jax.ShapeDtypeStruct(x.shape[axes:], x.dtype)

    case = jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0) if x.ndim else x, case)
    shapes = jax.tree.map(lambda x: of_one(x, min(x.ndim, 1)), case), of_one(table, table.ndim - 3)
    make = on_gpu if jax.default_backend() == "gpu" else _on_cpu
    return make(tick, (shapes, jax.tree.map(lambda x: of_one(x, 1), states)), (case, table), states, ticks, kept)


Tick = Callable[[Any, PhysicsState, jax.Array], tuple[PhysicsState, Record]]


def _on_cpu(
    tick: Tick, shapes: tuple[Any, Any], given: Any, states: PhysicsState, ticks: int, kept: np.ndarray
) -> Running:
    start = time.perf_counter()
    kernel = Kernel(compile_function(tick, *shapes))
    seconds = time.perf_counter() - start

    def advance() -> Record:
        record = kernel.load_batch(given, states, len(states.q)).advance_ticks(0, ticks, kept)
        assert record is not None
        return record

    return Running(advance, seconds)


def on_gpu(
    tick: Tick, shapes: tuple[Any, Any], given: Any, states: PhysicsState, ticks: int, kept: np.ndarray
) -> Running:
    """A batch on a GPU: all its ticks in one kernel, which ends no rollout early."""

    def endless(given: Any, carried: tuple[PhysicsState, jax.Array], k: jax.Array) -> tuple[Any, Record]:
        state, record = tick(given, carried[0], k)
        return (state, carried[1]), record

    start, width = time.perf_counter(), len(states.q)
    flag = jax.ShapeDtypeStruct((), bool)
    code = launch.compile_to_ptx(
        endless, shapes[0], (shapes[1], flag), lambda carried: carried[1], ticks, len(kept), width
    )

    def all_ticks(given: Any, states: PhysicsState) -> Any:
        return launch.run_kernel(code, given, (states, jnp.zeros(width, bool)), jnp.int32(0), jnp.asarray(kept))[1]

    program = jax.jit(all_ticks, compiler_options=launch.XLA_OPTIONS).lower(given, states).compile()
    return Running(lambda: jax.tree.map(np.asarray, program(given, states)), time.perf_counter() - start)
