"""Rotations as unit quaternions (w, x, y, z), from body to world axes."""

import jax.numpy as jnp
from jaxtyping import Array, Float

IDENTITY = (1.0, 0.0, 0.0, 0.0)


def rotate(quat: Float[Array, "*b 4"], v: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """Rotate vectors from body to world axes.

    Args:
        quat: Unit quaternions (w, x, y, z), body to world, (..., 4).
        v: Vectors in body axes, (..., 3).

    Returns:
        The vectors in world axes, (..., 3).
    """
    w, u = quat[..., :1], quat[..., 1:]
    t = 2 * jnp.cross(u, v)
    return v + w * t + jnp.cross(u, t)


def conjugate(quat: Float[Array, "*b 4"]) -> Float[Array, "*b 4"]:
    """Return the inverse of rotations given as unit quaternions, (..., 4)."""
    return quat * jnp.array([1, -1, -1, -1], quat.dtype)


def multiply(a: Float[Array, "*b 4"], b: Float[Array, "*b 4"]) -> Float[Array, "*b 4"]:
    """Return the quaternion product a b: the rotation `b` followed by the rotation `a`.

    Args:
        a: Quaternions (w, x, y, z), (..., 4).
        b: Quaternions (w, x, y, z), (..., 4).

    Returns:
        The products, (..., 4).
    """
    w = a[..., :1] * b[..., :1] - jnp.sum(a[..., 1:] * b[..., 1:], axis=-1, keepdims=True)
    v = a[..., :1] * b[..., 1:] + b[..., :1] * a[..., 1:] + jnp.cross(a[..., 1:], b[..., 1:])
    return jnp.concatenate([w, v], axis=-1)


def exponential(turn: Float[Array, "*b 3"]) -> Float[Array, "*b 4"]:
    """Return the unit quaternions (..., 4) of rotation vectors (..., 3) in rad."""
    half = 0.5 * jnp.sqrt(jnp.sum(turn**2, axis=-1, keepdims=True) + 1e-24)
    return jnp.concatenate([jnp.cos(half), 0.5 * turn * jnp.sin(half) / half], axis=-1)


def logarithm(quat: Float[Array, "*b 4"]) -> Float[Array, "*b 3"]:
    """Return the rotation vectors (..., 3) of unit quaternions (..., 4), in rad and at most pi long."""
    sine = jnp.sqrt(jnp.sum(quat[..., 1:] ** 2, axis=-1, keepdims=True) + 1e-24)
    half = jnp.arctan2(sine, jnp.abs(quat[..., :1]))
    return 2 * half / sine * jnp.where(quat[..., :1] < 0, -1.0, 1.0) * quat[..., 1:]


def rotation_about_vertical(angle: Float[Array, ""]) -> Float[Array, " 4"]:
    """Return the unit quaternion (4,) of a rotation by `angle` (rad) about the z axis."""
    zero = jnp.zeros_like(angle)
    return jnp.stack([jnp.cos(angle / 2), zero, zero, jnp.sin(angle / 2)])


def heading(quat: Float[Array, " 4"]) -> Float[Array, ""]:
    """Return the heading of a unit quaternion (4,): its angle about z in rad, by swing-twist decomposition."""
    w, z = quat[0], quat[3]
    return 2 * jnp.arctan2(z * jnp.where(w < 0, -1.0, 1.0), jnp.abs(w))


def matrix(quat: Float[Array, "*b 4"]) -> Float[Array, "*b 3 3"]:
    """Return the rotation matrices (..., 3, 3), body to world, of unit quaternions. Their columns are the body axes."""
    axes = [rotate(quat, jnp.broadcast_to(axis, quat[..., 1:].shape)) for axis in jnp.eye(3, dtype=quat.dtype)]
    return jnp.stack(axes, axis=-1)


def wrap_angle(angle: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """Wrap an angle in rad to the interval from -pi to pi."""
    return jnp.mod(angle + jnp.pi, 2 * jnp.pi) - jnp.pi


def nearest_equivalent_angle(angle: Float[Array, "*b"], to: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """Add whole turns to an angle (rad) so that it is nearest to another angle.

    Args:
        angle: Angles in rad, of any shape.
        to: Angles in rad, of the same shape.

    Returns:
        Angles equivalent to `angle`, at most pi away from `to`, in rad.
    """
    return to + jnp.mod(angle - to + jnp.pi, 2 * jnp.pi) - jnp.pi
