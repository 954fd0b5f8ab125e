"""The smooth dynamics of `dynamics` from the structure of the robot, see `star`, beside the obstacle's free bodies."""

from collections.abc import Callable
from functools import partial

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.core.rotations import matrix
from sweep.dynamics import tree
from sweep.dynamics.interface import N_LEGS, Smooth, SmoothDynamics, Topology
from sweep.models.case import Case
from sweep.models.obstacles.surface import Bodies
from sweep.models.scene import GRAVITY


def of(top: Topology) -> Callable[[Case], SmoothDynamics]:
    """The smooth dynamics of a world, for every world of the topology."""
    return lambda world: partial(smooth_dynamics, top, world)


def smooth_dynamics(top: Topology, case: Case, q: Float[Array, " nq"], v: Float[Array, " nv"]) -> Smooth:
    """Blocks at configuration q and velocity v; a free body's frame is at its mass centre, along its principal axes."""
    pose, motion = tree.unpack(q[: 7 + 3 * N_LEGS], v[: 6 + 3 * N_LEGS])
    robot = tree.star(case.robot, case.drive.armature, pose, motion)
    mass, turned, base = robot.mass, robot.rotation, pose.position.array()
    rotation = _array(turned)[0]
    linear, moment = mass.mass * jnp.eye(3, dtype=q.dtype), mass.moment.array()[0]
    coupling = -rotation @ _cross(moment)
    blocks = [jnp.block([[linear, coupling], [coupling.T, _array(mass.inertia)[0]]])]
    bias = [(turned @ robot.bias.linear).array()[0], robot.bias.angular.array()[0]]
    columns = [jnp.concatenate([(turned @ c.linear).array(), c.angular.array()], axis=1) for c in mass.cross]
    joints = [base + (turned @ joint).array() for joint in robot.joints]
    points, own = [joints[-1]], [_point_jacobian(rotation, joints[-1] - base)]
    potential = tree.potential(mass, turned, pose.position)[0]
    position, quat = (jnp.stack([q[7 * k + 25 :][part] for k in range(len(top.free))]) if top.free else
                      jnp.zeros((0, size), q.dtype) for part, size in ((slice(3), 3), (slice(3, 7), 4)))  # fmt: skip
    bodies = Bodies(position, matrix(quat))
    leaves = case.obstacle.leaves()
    for k, name in enumerate(case.obstacle.free_bodies):
        heavy, inertia = leaves["body_mass"][name], leaves["body_inertia"][name]
        spin = v[6 * k + 27 : 6 * k + 30]
        blocks.append(jnp.diag(jnp.concatenate([jnp.broadcast_to(heavy, 3), inertia])))
        bias += [heavy * jnp.array([0.0, 0.0, GRAVITY]), jnp.cross(spin, inertia * spin)]
        potential = potential + GRAVITY * heavy * position[k, 2]
    for name, k in case.obstacle.contact_sites:
        place = leaves.get("site_pos", {}).get(name, jnp.zeros(3))
        points.append((position[k] + bodies.rotation[k] @ place)[None])
    point = jnp.concatenate(points)
    under = [_point_jacobian(r, point - x) for x, r in zip(position, bodies.rotation, strict=True)]
    rows = [jnp.pad(own[0], ((0, 0), (0, 0), (0, 6 * len(under))))]
    for i, (_, k) in enumerate(case.obstacle.contact_sites):
        before, after = 6 * (k + 1), 6 * (len(under) - k - 1)
        rows.append(jnp.pad(under[k][N_LEGS + i][None], ((0, 0), (0, 0), (before, after))))
    cross = jnp.pad(jnp.stack(columns, axis=2), ((0, 0), (0, 6 * len(under)), (0, 0)))
    return Smooth(
        m_root=_block_diagonal(blocks), m_cross=cross, m_leg=_array(mass.leg), bias_root=jnp.concatenate(bias),
        bias_leg=jnp.stack(robot.bias.leg, axis=1), point=point, j_root=jnp.concatenate(rows),
        j_leg=jnp.stack([(turned @ j).array() for j in robot.foot], axis=2), bodies=bodies,
        j_body=jnp.stack(under) if under else jnp.zeros((0, point.shape[0], 3, 6), q.dtype), potential=potential,
        links=jnp.stack(joints[:-1], axis=1).reshape(-1, 3), centre_of_mass=base[0] + rotation @ moment / mass.mass,
    )  # fmt: skip


def _array(m: tree.Matrix) -> Float[Array, "n 3 3"]:
    return jnp.stack([row.array() for row in m], axis=-2)


def _cross(v: Float[Array, "*n 3"]) -> Float[Array, "*n 3 3"]:
    """The matrix of `v` cross."""
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    zero = jnp.zeros_like(x)
    rows = ((zero, -z, y), (z, zero, -x), (-y, x, zero))
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


def _point_jacobian(rotation: Float[Array, "3 3"], offset: Float[Array, "n 3"]) -> Float[Array, "n 3 6"]:
    """World velocity of a body's points by its world linear and own angular velocity."""
    straight = jnp.broadcast_to(jnp.eye(3, dtype=offset.dtype), (offset.shape[0], 3, 3))
    return jnp.concatenate([straight, -_cross(offset) @ rotation], axis=2)


def _block_diagonal(blocks: list[Array]) -> Array:
    rows = [jnp.pad(block, ((0, 0), (6 * k, 6 * (len(blocks) - 1 - k)))) for k, block in enumerate(blocks)]
    return jnp.concatenate(rows)
