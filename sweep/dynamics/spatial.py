"""Poses, motions and masses of the robot and of the obstacle's free bodies, by components.

Root bodies are those with six degrees of freedom: the robot's base first, then the free bodies. Legs couple through
the base alone. Every scalar is an array over the legs, or of one number for a root body; see `vectors`.
"""

from collections.abc import Callable
from itertools import chain
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.core.vectors import Matrix, Vector, rotation_from_quaternion, sum_last_axis
from sweep.models.legs import N_LEGS

JointTriple = tuple[Array, Array, Array]  # (l,) of alpha, beta, gamma


def split_leg_joints(values: Float[Array, "l 3"]) -> JointTriple:
    """Split joint values (l, 3) of all legs into three arrays alpha, beta, gamma (l,)."""
    return values[:, 0], values[:, 1], values[:, 2]


def map_leg_joints(f: Callable[..., Array], *values: tuple[Any, Any, Any]) -> JointTriple:
    """Apply `f` to the three joint values alpha, beta and gamma in turn, taking each from all arguments."""
    alpha, beta, gamma = (f(*parts) for parts in zip(*values, strict=True))
    return alpha, beta, gamma


class SpatialVector(NamedTuple):
    """Motion, momentum or force of a body: its linear part, and its angular part about the body's origin."""

    linear: Vector
    angular: Vector

    def dot(self, other: "SpatialVector") -> Array:
        """Return the power: the scalar product of a body's velocity and force."""
        return self.linear.dot(other.linear) + self.angular.dot(other.angular)

    def rotate(self, rotation: Matrix) -> "SpatialVector":
        """Return the vector with both parts rotated to other axes."""
        return SpatialVector(rotation @ self.linear, rotation @ self.angular)


class RootPose(NamedTuple):
    """Position and orientation of a root body: the robot's base or a free body."""

    position: Vector  # (1,) m, of its origin, world axes
    quat: tuple[Array, Array, Array, Array]  # (1,) body to world

    def rotation(self) -> Matrix:
        """Rotation from body to world axes."""
        return rotation_from_quaternion(*self.quat)

    def integrate(self, velocity: Vector, spin: Vector, h: float) -> "RootPose":
        """Integrate over h seconds at `velocity` (m/s, world axes) and `spin` (rad/s, body axes)."""
        rate = jnp.sqrt(spin.dot(spin) + 1e-24)
        half = 0.5 * h * rate
        c, s = jnp.cos(half), jnp.sin(half) / rate
        x, y, z = s * spin.x, s * spin.y, s * spin.z
        w0, x0, y0, z0 = self.quat
        out = (
            w0 * c - x0 * x - y0 * y - z0 * z,
            w0 * x + x0 * c + y0 * z - z0 * y,
            w0 * y - x0 * z + y0 * c + z0 * x,
            w0 * z + x0 * y - y0 * x + z0 * c,
        )
        scale = jax.lax.rsqrt(sum(part * part for part in out))
        return RootPose(self.position + h * velocity, tuple(part * scale for part in out))  # pyright: ignore


class SystemPose(NamedTuple):
    """Poses of all root bodies (base and free bodies), and joint angles of the legs."""

    root: tuple[RootPose, ...]
    angle: JointTriple  # (l,) rad: alpha, beta, gamma


class GeneralizedVector(NamedTuple):
    """Velocities of base, free bodies and joints, or momenta or forces of that form; each use names the axes."""

    root: tuple[SpatialVector, ...]
    leg: JointTriple

    def dot(self, other: "GeneralizedVector") -> Array:
        """Return the power (1,): the scalar product of velocities and forces."""
        bodies = sum(a.dot(b) for a, b in zip(self.root, other.root, strict=True))
        return bodies + sum_last_axis(sum(a * b for a, b in zip(self.leg, other.leg, strict=True)))  # pyright: ignore


class Inertia(NamedTuple):
    """Spatial inertia of a body about its origin: mass, first moment and moments of inertia."""

    mass: Array  # (1,) kg
    moment: Vector | None  # (1,) kg m, mass times mass centre; None where that is the origin
    inertia: Matrix  # (1,) kg m^2

    def momentum(self, v: SpatialVector) -> SpatialVector:
        """Return the momentum of the body that moves at velocity `v`."""
        linear, angular = self.mass * v.linear, self.inertia @ v.angular
        if self.moment is None:
            return SpatialVector(linear, angular)
        return SpatialVector(linear - self.moment.cross(v.angular), self.moment.cross(v.linear) + angular)


class MassMatrix(NamedTuple):
    """Mass matrix of the robot and the obstacle's free bodies, in blocks."""

    root: tuple[Inertia, ...]  # the robot's as if its joints were locked, then the free bodies'
    cross: tuple[SpatialVector, SpatialVector, SpatialVector]  # (l,) momentum of the leg per rate of a joint
    leg: Matrix  # (l,)

    def momentum(self, v: GeneralizedVector) -> GeneralizedVector:
        """Return the momentum of all bodies that move at velocities `v`."""
        base, *free = [inertia.momentum(motion) for inertia, motion in zip(self.root, v.root, strict=True)]
        linear, angular = base
        own = self.leg @ Vector(*v.leg)
        legs = tuple(c.dot(v.root[0]) + p for c, p in zip(self.cross, own, strict=True))
        for column, rate in zip(self.cross, v.leg, strict=True):
            linear, angular = (
                linear + (rate * column.linear).sum_last_axis(),
                angular + (rate * column.angular).sum_last_axis(),
            )
        return GeneralizedVector((SpatialVector(linear, angular), *free), legs)  # pyright: ignore


def tree_add_scaled(a, share: Array | float, b):
    """Return a + share * b for each pair of leaves of two trees with the same structure."""
    return jax.tree.map(lambda x, y: x + share * y, a, b)


def unpack_state(q: Array, v: Array) -> tuple[SystemPose, GeneralizedVector]:
    """Split MuJoCo's qpos and qvel into poses and motions of base, legs and free bodies; motions are in body axes."""
    joints = 3 * N_LEGS
    angle, rate = q[7 : 7 + joints].reshape(N_LEGS, 3), v[6 : 6 + joints].reshape(N_LEGS, 3)
    places, motions = [], []
    for k in range((q.shape[0] - joints) // 7):
        at, of = 7 * k + joints * (k > 0), 6 * k + joints * (k > 0)
        x, y, z, *quat = (q[at + i : at + i + 1] for i in range(7))
        moving = [v[of + i : of + i + 1] for i in range(6)]
        place = RootPose(Vector(x, y, z), tuple(quat))  # pyright: ignore
        places.append(place)
        motions.append(SpatialVector(place.rotation().transpose @ Vector(*moving[:3]), Vector(*moving[3:])))
    return SystemPose(tuple(places), split_leg_joints(angle)), GeneralizedVector(tuple(motions), split_leg_joints(rate))


def pack_state(pose: SystemPose, v: GeneralizedVector) -> tuple[Array, Array]:
    """Join poses and motions to MuJoCo's qpos and qvel, the inverse of `unpack_state`."""
    angle, rate = (jnp.stack(parts, axis=-1).reshape(-1) for parts in (pose.angle, v.leg))
    places = [[*place.position, *place.quat] for place in pose.root]
    motions = [[*(place.rotation() @ own.linear), *own.angular] for place, own in zip(pose.root, v.root, strict=True)]
    parts = ((places, angle), (motions, rate))
    whole = [jnp.concatenate([*base, legs, *chain(*free)]) for (base, *free), legs in parts]
    return whole[0], whole[1]
