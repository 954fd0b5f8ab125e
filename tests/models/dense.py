"""The blocks of the smooth dynamics as full matrices, in MuJoCo's coordinates."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from sweep.dynamics.interface import SmoothDynamics
from sweep.dynamics.spatial import pack_state, unpack_state


class Dense(NamedTuple):
    """Of a robot on ground that does not move."""

    mass: Array  # (nv, nv)
    bias: Array  # (nv,)
    foot: Array  # (6, 3) m, world axes
    jacobian: Array  # (nv, 6, 3) of the feet
    links: Array  # (6, l, 3) m
    centre_of_mass: Array  # (3,) m


def dense(smooth_dynamics: SmoothDynamics, q: Array, v: Array) -> Dense:
    """At configuration q (nq,) and velocity v (nv,)."""
    pose, motion = unpack_state(q, v)
    robot, base, turned = smooth_dynamics(pose, motion), pose.root[0].position, pose.root[0].rotation()
    whole, end = robot.mass.root[0], robot.joints[-1]

    def momentum(velocity: Array) -> Array:
        return pack_state(pose, robot.mass.momentum(unpack_state(q, velocity)[1]))[1]

    def of_feet(velocity: Array) -> Array:
        (body,), rates = unpack_state(q, velocity)[1]
        own = body.linear + body.angular.cross(end)
        for column, rate in zip(robot.foot, rates, strict=True):
            own = own + rate * column
        return (turned @ own).array()

    each = jnp.eye(len(v), dtype=v.dtype)
    joints = [(base + turned @ joint).array() for joint in robot.joints]
    centre = base + turned @ ((1 / whole.mass) * whole.moment)
    return Dense(jax.vmap(momentum)(each), pack_state(pose, robot.bias)[1], joints[-1], jax.vmap(of_feet)(each),
                 jnp.stack(joints[:-1], axis=1), centre.array()[0])  # fmt: skip
