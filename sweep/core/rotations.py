"""Rotations as quaternions (w, x, y, z), body to world."""

import jax.numpy as jnp
from jaxtyping import Array, Float

IDENTITY = (1.0, 0.0, 0.0, 0.0)


def rotate(quat: Float[Array, "*b 4"], v: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """Rotate a vector `v` from body to world axes."""
    w, u = quat[..., :1], quat[..., 1:]
    t = 2 * jnp.cross(u, v)
    return v + w * t + jnp.cross(u, t)


def conjugate(quat: Float[Array, "*b 4"]) -> Float[Array, "*b 4"]:
    """Return the inverse rotation of a unit quaternion."""
    return quat * jnp.array([1, -1, -1, -1], quat.dtype)


def multiply(a: Float[Array, "*b 4"], b: Float[Array, "*b 4"]) -> Float[Array, "*b 4"]:
    """Return the quaternion product a b: the rotation `b` followed by `a`."""
    w = a[..., :1] * b[..., :1] - jnp.sum(a[..., 1:] * b[..., 1:], axis=-1, keepdims=True)
    v = a[..., :1] * b[..., 1:] + b[..., :1] * a[..., 1:] + jnp.cross(a[..., 1:], b[..., 1:])
    return jnp.concatenate([w, v], axis=-1)


def exponential(turn: Float[Array, "*b 3"]) -> Float[Array, "*b 4"]:
    """Return the quaternion of a rotation vector (rad)."""
    half = 0.5 * jnp.sqrt(jnp.sum(turn**2, axis=-1, keepdims=True) + 1e-24)
    return jnp.concatenate([jnp.cos(half), 0.5 * turn * jnp.sin(half) / half], axis=-1)


def logarithm(quat: Float[Array, "*b 4"]) -> Float[Array, "*b 3"]:
    """Return the rotation vector (rad) of a unit quaternion, at most pi long."""
    sine = jnp.sqrt(jnp.sum(quat[..., 1:] ** 2, axis=-1, keepdims=True) + 1e-24)
    half = jnp.arctan2(sine, jnp.abs(quat[..., :1]))
    return 2 * half / sine * jnp.where(quat[..., :1] < 0, -1.0, 1.0) * quat[..., 1:]


def rotation_about_vertical(angle: Float[Array, ""]) -> Float[Array, " 4"]:
    """Rotation by `angle` (rad) about z."""
    zero = jnp.zeros_like(angle)
    return jnp.stack([jnp.cos(angle / 2), zero, zero, jnp.sin(angle / 2)])


def heading(quat: Float[Array, " 4"]) -> Float[Array, ""]:
    """Return the heading (rad): the angle about z of a rotation, by its swing-twist decomposition."""
    w, z = quat[0], quat[3]
    return 2 * jnp.arctan2(z * jnp.where(w < 0, -1.0, 1.0), jnp.abs(w))


def matrix(quat: Float[Array, "*b 4"]) -> Float[Array, "*b 3 3"]:
    """Return the rotation matrix, body to world; its columns are the body's axes in world coordinates."""
    axes = [rotate(quat, jnp.broadcast_to(axis, quat[..., 1:].shape)) for axis in jnp.eye(3, dtype=quat.dtype)]
    return jnp.stack(axes, axis=-1)


def wrap_angle(angle: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """Wrap an angle (rad) to -pi to pi."""
    return jnp.mod(angle + jnp.pi, 2 * jnp.pi) - jnp.pi


def nearest_equivalent_angle(angle: Float[Array, "*b"], to: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """Add whole turns to an angle (rad) so that it is nearest to the angle `to`."""
    return to + jnp.mod(angle - to + jnp.pi, 2 * jnp.pi) - jnp.pi
