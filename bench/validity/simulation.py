"""Physics steps without a controller, for a batch of cases under targets of joints."""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sweep.dynamics import interface, tree
from sweep.dynamics.step import State, from_state, rest, step, to_state
from sweep.engines import batching, devices
from sweep.engines.batch_last import batch_last_vmap
from sweep.fused.kernel import Kernel, Tiles, compiled
from sweep.models.case import Case
from sweep.models.drive import position_mode

Record = dict[str, Any]
Step = Callable[[Case, State, jax.Array], tuple[State, Record]]  # of one world, under targets; and what is kept of it


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
    record = advance(one, devices.as_arrays(case), states, jnp.asarray(references))
    return History(**{name: np.asarray(x, float) for name, x in record.items()})


def _stepping(nominal: Case, q: np.ndarray, h: float, v: np.ndarray | None, iterations: int) -> tuple[Step, State]:
    """A step of one world, and the batch at its start."""
    devices.configure()
    top = interface.topology(nominal)

    def one(case: Case, state: State, reference: jax.Array) -> tuple[State, Record]:
        limits = batching.execution_limits(case, jnp.zeros(()))
        servo = position_mode(case.drive, reference)
        moving, report = step(tree.of(case), case, limits, from_state(state), servo, h, iterations)
        work = h * (jnp.sum(sum(report.power)) + report.outside[0])  # pyright: ignore[reportArgumentType]
        state, before = to_state(moving), report.before
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

    v = np.zeros((len(q), top.model.nv)) if v is None else v
    return one, jax.vmap(lambda q, v: rest(top, q)._replace(v=v))(jnp.asarray(q), jnp.asarray(v, q.dtype))


def _by_xla(one: Step, case: Case, states: State, references: jax.Array) -> Record:
    axes, own = jax.tree.map(lambda x: -1 if np.ndim(x) else None, case), references.ndim == 4
    references = jnp.moveaxis(references, 1, -1) if own else references
    batch = batch_last_vmap(one, (axes, -1, -1 if own else None), devices.reuse_from())
    states = jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1), states)
    # run once, it is not worth the minute or two that optimising it takes
    program = jax.jit(
        lambda *of: jax.lax.scan(lambda s, r: batch(of[0], s, r), *of[1:]),
        compiler_options={"xla_backend_optimization_level": 0},
    )
    _, record = program(case, states, references)
    return jax.tree.map(lambda x: jnp.moveaxis(x, -1, 1), record)


class Running(NamedTuple):
    """A batch in a kernel's memory, and how long the compiler took (s)."""

    tiles: Tiles
    compile_s: float


def _by_kernel(one: Step, case: Case, states: State, references: jax.Array) -> Record:
    running = _begun(one, case, states, references)
    record = running.tiles.advance(0, len(references), np.arange(len(states.q)))
    assert record is not None
    return record


def begun(case: Case, q: np.ndarray, references: np.ndarray, h: float, iterations: int) -> Running:
    """A batch of one case before its first step, in the memory of this package's compiler; see `simulate`."""
    one, states = _stepping(case, q, h, None, iterations)
    return _begun(one, devices.as_arrays(case), states, jnp.asarray(references))


def _begun(one: Step, case: Case, states: State, references: jax.Array) -> Running:
    still = bool(np.all(references == references[0]))  # targets that stay take no memory
    table = references[:1] if still else references
    table = jnp.moveaxis(table, 1, 0) if table.ndim == 4 else table
    last = table.shape[-3] - 1

    def tick(given: tuple[Case, jax.Array], state: State, k: jax.Array) -> tuple[State, Record]:
        case, targets = given
        return one(case, state, targets[jnp.minimum(k, last)])

    def of_one(x: jax.Array, axes: int) -> jax.ShapeDtypeStruct:
        return jax.ShapeDtypeStruct(x.shape[axes:], x.dtype)

    case = jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0) if x.ndim else x, case)
    shapes = jax.tree.map(lambda x: of_one(x, min(x.ndim, 1)), case), of_one(table, table.ndim - 3)
    start = time.perf_counter()
    kernel = Kernel(compiled(tick, shapes, jax.tree.map(lambda x: of_one(x, 1), states)))
    seconds = time.perf_counter() - start
    return Running(kernel.enter((case, table), states, len(states.q)), seconds)
