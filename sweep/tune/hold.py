"""How well foot forces hold a standing robot, also where none do: a number that follows the pose without a break.

Every foot's force has to stay within its friction cone, over a least normal force and under its drives' limit. The
`reserve` is the most by which all of these may be tightened at once, negative where they have to give way for forces to
be in balance: the optimum of a convex program, found by the method of barriers. By the envelope theorem its slopes are
those of the program's Lagrangian, at the forces and multipliers that were found.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient
from jaxtyping import Array, Float

from sweep.controllers.forces import STEP_LENGTHS, Bounds, StaticPose, joint_torque

# what the barriers of all bounds weigh against the reserve, in each Newton step
WEIGHTS = np.repeat(np.geomspace(0.1, 1e-4, 16).astype(np.float32), 3)
KEPT = 0.1  # of the room to a bound, by a step


class Centre(NamedTuple):
    """Forces, and what they leave."""

    force: Float[Array, "6 3"]  # weights
    reserve: Float[Array, ""]  # weights
    price: Float[Array, " 6"]  # of force and moment that feet have to balance


def reserve(pose: StaticPose, bounds: Bounds) -> Float[Array, ""]:
    """By how much of the weight every foot's force could be nearer to all its bounds (of torques, weights times m)."""
    last = WEIGHTS[-1]
    held = stop_gradient(_centre(pose, bounds))
    gain = last * _logs(pose, bounds, held) + held.price @ _left(pose, held.force)
    return held.reserve + gain - stop_gradient(gain)


def _centre(pose: StaticPose, bounds: Bounds) -> Centre:
    grasp = jax.jacfwd(lambda f: -_left(pose, f))(jnp.zeros((6, 3))).reshape(6, 18)
    first = (grasp.T @ jnp.linalg.solve(grasp @ grasp.T, _left(pose, jnp.zeros((6, 3))))).reshape(6, 3)
    room = jnp.min(_room(pose, bounds, Centre(first, jnp.zeros(()), jnp.zeros(6))))
    swings = jnp.append(jnp.repeat(~pose.stands, 3), False)

    def step(weight: Array, now: Centre) -> Centre:
        def cost(x: Array) -> Array:
            return -x[-1] - weight * _logs(pose, bounds, Centre(x[:-1].reshape(6, 3), x[-1], now.price))

        x = jnp.append(now.force.ravel(), now.reserve)
        balance = jnp.concatenate([grasp, jnp.zeros((6, 1))], axis=1)
        curvature = jax.hessian(cost)(x) + jnp.diag(jnp.where(swings, 1.0, 0.0))
        matrix = jnp.block([[curvature, balance.T], [balance, jnp.zeros((6, 6))]])
        found = jnp.linalg.solve(matrix, jnp.append(-jax.grad(cost)(x), _left(pose, now.force)))
        way, price = found[:-6], found[-6:]
        before = _room(pose, bounds, now)

        def at(length: Array) -> Centre:
            to = x + length * way
            return Centre(to[:-1].reshape(6, 3), to[-1], price)

        fits = jax.vmap(lambda length: jnp.all(_room(pose, bounds, at(length)) > KEPT * before))
        lengths = jnp.asarray(STEP_LENGTHS)
        return at(jnp.max(jnp.where(fits(lengths), lengths, 0.0)))

    begin = Centre(first, room - 1.0, jnp.zeros(6))
    return jax.lax.fori_loop(0, len(WEIGHTS), lambda k, so_far: step(jnp.asarray(WEIGHTS)[k], so_far), begin)


def _left(pose: StaticPose, force: Array) -> Float[Array, " 6"]:
    """Weight that is not held, and its moment about the mass centre (m)."""
    force = jnp.where(pose.stands[:, None], force, 0.0)
    moment = jnp.sum(jnp.cross(pose.arm, force), axis=0)
    return jnp.zeros(6).at[2].set(1.0) - jnp.concatenate([jnp.sum(force, axis=0), moment])


def _room(pose: StaticPose, bounds: Bounds, at: Centre) -> Float[Array, "6 k"]:
    """What is left to each bound over the reserve; positive within."""
    normal = jnp.sum(at.force * pose.normal, axis=-1)
    tangential = jnp.sqrt(jnp.sum((at.force - normal[:, None] * pose.normal) ** 2, axis=-1) + 1e-12)
    torque = joint_torque(pose, at.force * pose.weight)
    firm = normal - at.reserve
    room = [(bounds.friction * firm - tangential)[:, None], (firm - bounds.least_normal / pose.weight)[:, None],
            (bounds.torque - jnp.abs(torque)) / pose.weight - at.reserve]  # fmt: skip
    return jnp.where(pose.stands[:, None], jnp.concatenate(room, axis=-1), 1.0)


def _logs(pose: StaticPose, bounds: Bounds, at: Centre) -> Array:
    return jnp.sum(jnp.log(_room(pose, bounds, at)))
