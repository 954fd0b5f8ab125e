"""Leg kinematics in closed form: monograph (1.1.1)-(1.1.5), inverse corrected for feet on the inner side.

Legs are numbered 1-2 rear, 3-4 middle, 5-6 front, odd on the right. A foot position is relative to the hip
(the leg's mount), in base axes: x forward, y left, z up.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Real

# (-1)^i of leg i: +1 on the left. 32 bits wide, as 64-bit NumPy constants break JAX in a process of both precisions.
SIDE_BY_LEG = np.array([-1, 1, -1, 1, -1, 1], np.int32)


def forward_kinematics(
    side: Real[Array, "*b"] | np.ndarray | int,
    angles: Float[Array, "*b 3"],
    coxa: Array | float,
    thigh: Array | float,
    shin: Array | float,
) -> Float[Array, "*b 3"]:
    """Forward kinematics of a leg: monograph (1.1.1), with a coxa (1.1.4).

    Args:
        side: +1 for legs on the left, -1 on the right; as `SIDE_BY_LEG`.
        angles: alpha, beta, gamma (rad).
        coxa: Length of the coxa (m); 0 where the leg has none.
        thigh: Length of the thigh (m).
        shin: Length of the shin (m).

    Returns:
        The foot relative to the hip (m, base axes).
    """
    alpha, beta, gamma = angles[..., 0], angles[..., 1], angles[..., 2]
    reach = side * (coxa + thigh * jnp.sin(beta)) - shin * jnp.sin(beta + gamma)
    height = -side * thigh * jnp.cos(beta) + shin * jnp.cos(beta + gamma)
    return jnp.stack([-reach * jnp.sin(alpha), reach * jnp.cos(alpha), height], axis=-1)


def inverse_kinematics(
    side: Real[Array, "*b"] | np.ndarray | int,
    foot: Float[Array, "*b 3"],
    coxa: Array | float,
    thigh: Array | float,
    shin: Array | float,
    mirror: Bool[Array, "*b"] | bool = False,
) -> tuple[Float[Array, "*b 3"], Float[Array, "*b"]]:
    """Inverse kinematics of a leg: monograph (1.1.3), corrected.

    The printed branch for a foot on the inner side of its hip misses the foot; this form is exact on both sides and for
    any coxa. The knee stays on the outer side, so that with an inner foot it moves fore and aft against the foot, as
    2.6.2 wants on a narrow track. A target out of reach is clamped to the nearest point on the line from the hip joint.

    Args:
        side: +1 for legs on the left, -1 on the right; as `SIDE_BY_LEG`.
        foot: The foot relative to the hip (m, base axes).
        coxa: Length of the coxa (m); 0 where the leg has none.
        thigh: Length of the thigh (m).
        shin: Length of the shin (m).
        mirror: Whether the knee of a foot on the inner side is on that side, too, where it moves with the foot.

    Returns:
        alpha, beta, gamma (rad), and the distance of the foot beyond the leg's reach (m).
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
    """Clamped arccos, f2 of (1.1.3), with zero derivative where it is clamped: that of arccos is infinite there."""
    clamped = jnp.abs(cosine) >= 1.0
    return jnp.where(clamped, jnp.where(cosine > 0, 0.0, jnp.pi), jnp.arccos(jnp.where(clamped, 0.0, cosine)))


def rectangular_hip_positions(length: Array | float, width: Array | float) -> Float[Array, "6 3"]:
    """Hip positions in two rows along the sides of a rectangular base: monograph 1.1.

    Args:
        length: Distance between the front and the rear hips (m).
        width: Distance between the rows (m).

    Returns:
        Hips of legs 1 to 6 (m, base axes).
    """
    x = jnp.array([-1, -1, 0, 0, 1, 1]) * length / 2
    return jnp.stack([x, SIDE_BY_LEG * width / 2, jnp.zeros(6)], axis=-1)


def circular_hip_positions(radius: Array | float) -> Float[Array, "6 3"]:
    """Hip positions of legs 1 to 6 (m, base axes) at the corners of a hexagon of `radius` (m): monograph (1.1.5)."""
    angle = jnp.array([np.pi / 6 + i // 2 * np.pi / 3 for i in range(6)])
    return jnp.stack([-radius * jnp.cos(angle), SIDE_BY_LEG * radius * jnp.sin(angle), jnp.zeros(6)], axis=-1)
