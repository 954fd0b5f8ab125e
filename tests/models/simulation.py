"""Physics steps without a controller, for a batch of cases under the same joint targets."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sweep.dynamics import interface, tree
from sweep.dynamics.step import from_state, rest, step, to_state
from sweep.engines import batching, devices
from sweep.engines.batch_last import batch_last_vmap
from sweep.models.case import Case
from sweep.models.drive import position_mode


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
) -> History:
    """`case` with swept leaves, its structure in `nominal`, under targets (t, 6, 3).

    It starts from configurations q (b, nq), at velocities v (b, nv) or at rest.
    """
    devices.configure()
    top = interface.topology(nominal)

    def one(case: Case, state, reference):
        limits = batching.execution_limits(case, jnp.zeros(()))
        servo = position_mode(case.drive, reference)
        moving, report = step(tree.of(case), case, limits, from_state(state), servo, h, iterations)
        work = h * (jnp.sum(sum(report.power)) + report.outside[0])
        state, before = to_state(moving), report.before
        return state, (state.q, state.v, report.force.array(), report.normal, before.joints[-1].array(),
                       before.energy[0], report.residual[0], work)  # fmt: skip

    axes = jax.tree.map(lambda x: -1 if np.ndim(x) else None, case)
    batch = batch_last_vmap(one, (axes, -1, None), devices.reuse_from())

    def run(case, states, references):
        return jax.lax.scan(lambda s, r: batch(case, s, r), states, references)

    v = np.zeros((len(q), top.model.nv)) if v is None else v
    states = jax.vmap(lambda q, v: rest(top, q)._replace(v=v))(jnp.asarray(q), jnp.asarray(v, q.dtype))
    args = devices.as_arrays(case), jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1), states), jnp.asarray(references)
    # run once, it is not worth the minute or two that optimising it takes
    _, history = jax.jit(run, compiler_options={"xla_backend_optimization_level": 0})(*args)
    return History(*[np.moveaxis(np.asarray(x, float), -1, 1) for x in history])
