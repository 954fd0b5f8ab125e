"""Physics steps without a controller, for a batch of cases under the same joint targets."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sweep.dynamics import interface as dynamics
from sweep.dynamics import mjx as mjx_dynamics
from sweep.dynamics.step import rest, step
from sweep.engines import batching, devices
from sweep.models.case import Case
from sweep.models.drive import position_mode


class History(NamedTuple):
    """Everything after each step: first axis time, second the batch."""

    q: np.ndarray
    v: np.ndarray
    force: np.ndarray  # (t, b, n, 3) N, on the contact points
    normal: np.ndarray  # (t, b, n) N
    point: np.ndarray  # (t, b, n, 3) m, before the step
    residual: np.ndarray  # (t, b) N
    power: np.ndarray  # (t, b) W, of the drives


def simulate(
    case: Case, nominal: Case, q: np.ndarray, references: np.ndarray, h: float = 2e-3, v: np.ndarray | None = None
) -> History:
    """`case` with swept leaves, its structure in `nominal`, under targets (t, 6, 3).

    It starts from configurations q (b, nq), at velocities v (b, nv) or at rest.
    """
    devices.configure()
    top = dynamics.topology(nominal)
    smooth = mjx_dynamics.of(top)

    def one(case: Case, state, reference):
        limits = batching.execution_limits(case, jnp.zeros(()))
        state, report = step(top, smooth(case), case, limits, state, position_mode(case.drive, reference), h, 2)
        forces = report.forces
        return state, (state.q, state.v, forces.force, forces.normal, report.smooth.point, report.residual,
                       jnp.sum(report.power))  # fmt: skip

    batch = jax.vmap(one, in_axes=(devices.axes(case), 0, None))

    @jax.jit
    def run(case, states, references):
        return jax.lax.scan(lambda s, r: batch(case, s, r), states, references)

    v = np.zeros((len(q), top.model.nv)) if v is None else v
    states = jax.vmap(lambda q, v: rest(top, q)._replace(v=v))(jnp.asarray(q), jnp.asarray(v, q.dtype))
    _, history = run(devices.as_arrays(case), states, jnp.asarray(references))
    return History(*[np.asarray(x, float) for x in history])
