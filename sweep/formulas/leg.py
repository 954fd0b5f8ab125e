"""Leg kinematics in closed form: monograph (1.1.1)-(1.1.5), inverse corrected for feet on the inner side.

Legs are numbered 1-2 rear, 3-4 middle, 5-6 front, odd on the right. A foot position is relative to the hip
(the leg's mount), in base axes: x forward, y left, z up.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Real

# (-1)^i of leg i: +1 on the left. 32 bits wide, as 64-bit NumPy constants break JAX once both precisions were used.
SIDE = np.array([-1, 1, -1, 1, -1, 1], np.int32)


def fk(
    side: Real[Array, "*b"] | np.ndarray | int,
    angles: Float[Array, "*b 3"],
    coxa: Array | float,
    thigh: Array | float,
    shin: Array | float,
) -> Float[Array, "*b 3"]:
    """Foot relative to the hip (m) from alpha, beta, gamma (rad): monograph (1.1.1), with a coxa (1.1.4)."""
    alpha, beta, gamma = angles[..., 0], angles[..., 1], angles[..., 2]
    reach = side * (coxa + thigh * jnp.sin(beta)) - shin * jnp.sin(beta + gamma)
    height = -side * thigh * jnp.cos(beta) + shin * jnp.cos(beta + gamma)
    return jnp.stack([-reach * jnp.sin(alpha), reach * jnp.cos(alpha), height], axis=-1)


def ik(
    side: Real[Array, "*b"] | np.ndarray | int,
    foot: Float[Array, "*b 3"],
    coxa: Array | float,
    thigh: Array | float,
    shin: Array | float,
    mirror: Bool[Array, "*b"] | bool = False,
) -> tuple[Float[Array, "*b 3"], Float[Array, "*b"]]:
    """Joint angles (rad) that put the foot there, and by how much (m) it lies out of reach.

    Monograph (1.1.3). The printed branch for a foot on the inner side of its hip misses the foot; this form is exact
    on both sides and for any coxa. The knee stays on the outer side, so that with an inner foot it moves fore and
    aft against the foot, as 2.6.2 wants on a narrow track; `mirror` puts it on the inner side for those feet, where
    it moves with the foot. A target out of reach is clamped to the nearest point on the line from the hip joint.
    """
    x, y, z = foot[..., 0], foot[..., 1], foot[..., 2]
    outer = jnp.where(side * y >= 0, 1.0, -1.0)
    ahead = outer * jnp.hypot(x, y) - coxa
    distance = jnp.hypot(ahead, z)
    safe = jnp.maximum(distance, 1e-9)
    at_hip = _angle((thigh**2 + safe**2 - shin**2) / (2 * thigh * safe))
    at_knee = _angle((thigh**2 + shin**2 - safe**2) / (2 * thigh * shin))
    bend = jnp.where(mirror & (outer < 0), -1.0, 1.0)
    alpha = jnp.arctan2(-outer * side * x, outer * side * y)
    beta = jnp.arctan2(ahead, -side * z) + side * bend * at_hip
    gamma = bend * jnp.where(side > 0, at_knee, jnp.pi - at_knee)
    shortfall = jnp.maximum(jnp.maximum(distance - (thigh + shin), jnp.abs(thigh - shin) - distance), 0.0)
    return jnp.stack([alpha, beta, gamma], axis=-1), shortfall


def _angle(cosine: Array) -> Array:
    """The clamped arccos, f2 of (1.1.3)."""
    clamped = jnp.abs(cosine) >= 1.0  # there it has no slope, and that of arccos is no number
    return jnp.where(clamped, jnp.where(cosine > 0, 0.0, jnp.pi), jnp.arccos(jnp.where(clamped, 0.0, cosine)))


def rectangular_mounts(length: Array | float, width: Array | float) -> Float[Array, "6 3"]:
    """Hips along the sides of the body (m, base axes): monograph 1.1."""
    x = jnp.array([-1, -1, 0, 0, 1, 1]) * length / 2
    return jnp.stack([x, SIDE * width / 2, jnp.zeros(6)], axis=-1)


def circular_mounts(radius: Array | float) -> Float[Array, "6 3"]:
    """Hips on a circle, at the corners of a hexagon (m, base axes): monograph (1.1.5)."""
    angle = jnp.array([np.pi / 6 + i // 2 * np.pi / 3 for i in range(6)])
    return jnp.stack([-radius * jnp.cos(angle), SIDE * radius * jnp.sin(angle), jnp.zeros(6)], axis=-1)
