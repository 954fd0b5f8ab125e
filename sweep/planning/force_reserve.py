"""Force reserve of a standing robot: by how much all bounds on its foot forces could be tightened.

Every foot's force must stay within its friction cone, above a least normal force and below the torque limits of its
drives. The reserve is the largest amount by which all these bounds can be tightened at once while the forces stay in
balance. It is negative where the bounds have to be relaxed, so it changes smoothly with the pose. It is the optimum of
a convex program, found by a barrier method; by the envelope theorem its gradient is that of the program's Lagrangian at
the optimal forces and multipliers.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient
from jaxtyping import Array, Float

from sweep.planning.forces import STEP_LENGTHS, ForceBounds, ForcePlanningPose, joint_torque

# weight of the barriers relative to the reserve, for each Newton step
BARRIER_WEIGHTS = np.repeat(np.geomspace(0.1, 1e-4, 16).astype(np.float32), 3)
MIN_SLACK_SHARE = 0.1  # least share of the slack of a bound that a step leaves


class BarrierState(NamedTuple):
    """Iterate of the interior-point search for the force reserve: foot forces, reserve, and Lagrange multipliers."""

    force: Float[Array, "6 3"]  # of the feet, in weights
    reserve: Float[Array, ""]  # in weights
    multipliers: Float[Array, " 6"]  # of the balance of force and moment


def force_reserve(pose: ForcePlanningPose, bounds: ForceBounds) -> Float[Array, ""]:
    """Return by how much, in weights, all bounds on foot forces can be tightened; differentiable in the pose.

    Args:
        pose: The standing robot.
        bounds: Friction, least normal force and torque limits.

    Returns:
        The reserve, as a share of the robot's weight (for torques: weight times 1 m); negative where no forces hold it.
    """
    last = BARRIER_WEIGHTS[-1]
    optimum = stop_gradient(_solve(pose, bounds))
    gain = last * _log_barrier(pose, bounds, optimum) + optimum.multipliers @ _unbalanced(pose, optimum.force)
    return optimum.reserve + gain - stop_gradient(gain)


def _solve(pose: ForcePlanningPose, bounds: ForceBounds) -> BarrierState:
    grasp = jax.jacfwd(lambda f: -_unbalanced(pose, f))(jnp.zeros((6, 3))).reshape(6, 18)
    first = (grasp.T @ jnp.linalg.solve(grasp @ grasp.T, _unbalanced(pose, jnp.zeros((6, 3))))).reshape(6, 3)
    least_slack = jnp.min(_slack(pose, bounds, BarrierState(first, jnp.zeros(()), jnp.zeros(6))))
    swings = jnp.append(jnp.repeat(~pose.stands, 3), False)

    def step(weight: Array, iterate: BarrierState) -> BarrierState:
        def cost(x: Array) -> Array:
            moved = BarrierState(x[:-1].reshape(6, 3), x[-1], iterate.multipliers)
            return -x[-1] - weight * _log_barrier(pose, bounds, moved)

        x = jnp.append(iterate.force.ravel(), iterate.reserve)
        balance = jnp.concatenate([grasp, jnp.zeros((6, 1))], axis=1)
        curvature = jax.hessian(cost)(x) + jnp.diag(jnp.where(swings, 1.0, 0.0))
        matrix = jnp.block([[curvature, balance.T], [balance, jnp.zeros((6, 6))]])
        solution = jnp.linalg.solve(matrix, jnp.append(-jax.grad(cost)(x), _unbalanced(pose, iterate.force)))
        direction, multipliers = solution[:-6], solution[-6:]
        before = _slack(pose, bounds, iterate)

        def advance(length: Array) -> BarrierState:
            x_next = x + length * direction
            return BarrierState(x_next[:-1].reshape(6, 3), x_next[-1], multipliers)

        fits = jax.vmap(lambda length: jnp.all(_slack(pose, bounds, advance(length)) > MIN_SLACK_SHARE * before))
        lengths = jnp.asarray(STEP_LENGTHS)
        return advance(jnp.max(jnp.where(fits(lengths), lengths, 0.0)))

    start = BarrierState(first, least_slack - 1.0, jnp.zeros(6))
    return jax.lax.fori_loop(
        0, len(BARRIER_WEIGHTS), lambda k, iterate: step(jnp.asarray(BARRIER_WEIGHTS)[k], iterate), start
    )


def _unbalanced(pose: ForcePlanningPose, force: Array) -> Float[Array, " 6"]:
    """Unbalanced force and moment about the mass centre (6,), in units of weight and weight times m."""
    force = jnp.where(pose.stands[:, None], force, 0.0)
    moment = jnp.sum(jnp.cross(pose.arm, force), axis=0)
    return jnp.zeros(6).at[2].set(1.0) - jnp.concatenate([jnp.sum(force, axis=0), moment])


def _slack(pose: ForcePlanningPose, bounds: ForceBounds, iterate: BarrierState) -> Float[Array, "6 k"]:
    """Distance (6, k) of foot forces from each bound, less the reserve; positive inside."""
    normal = jnp.sum(iterate.force * pose.normal, axis=-1)
    tangential = jnp.sqrt(jnp.sum((iterate.force - normal[:, None] * pose.normal) ** 2, axis=-1) + 1e-12)
    torque = joint_torque(pose, iterate.force * pose.weight)
    firm = normal - iterate.reserve
    slack = [(bounds.friction * firm - tangential)[:, None], (firm - bounds.least_normal / pose.weight)[:, None],
            (bounds.torque - jnp.abs(torque)) / pose.weight - iterate.reserve]  # fmt: skip
    return jnp.where(pose.stands[:, None], jnp.concatenate(slack, axis=-1), 1.0)


def _log_barrier(pose: ForcePlanningPose, bounds: ForceBounds, iterate: BarrierState) -> Array:
    return jnp.sum(jnp.log(_slack(pose, bounds, iterate)))
