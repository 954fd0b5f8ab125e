"""Steady motions of a raft under a constant horizontal pull: monograph 4.2.2 and 4.2.3, small angles.

The bottom's friction h15 = 4 k_lin a b per speed acts at the depth d. The weight acts at the raft's centre.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.formulas.formula import Formula, Input, Scalar, positive
from sweep.formulas.raft_statics import SIZES, WATER, hydro_thick


class Tow(NamedTuple):
    """Speed (m/s), nose-down tilt (rad), the slower pole of the heading (1/s): it is kept where this is negative."""

    speed: Float[Array, "..."]
    tilt: Float[Array, "..."]
    yaw_pole: Float[Array, "..."]


def raft_tow(
    F: Scalar,
    x_s: Scalar,
    z_s: Scalar,
    a: Scalar,
    b: Scalar,
    d: Scalar,
    zeta0: Scalar,
    gamma: Scalar,
    k_lin: Scalar,
    C: Scalar,
) -> Tow:
    """Raft towed by F (N, fixed in the world) at the point (x_s, 0, z_s) (m) of the raft: (4.2.32)-(4.2.35).

    C (kg m^2) is the moment of inertia about the vertical. Pulled at the front (F x_s > 0) the raft keeps its
    heading, pushed from behind it turns away. Nan where the tow overcomes the raft's stiffness.
    """
    friction = 4 * k_lin * a * b
    stiffness = F * x_s + hydro_thick(a, b, d, zeta0, gamma).k_pitch
    tilt = F * (z_s + d) / jnp.where(stiffness > 0, stiffness, jnp.nan)
    b34 = friction * (a**2 + b**2) / 3
    discriminant = b34**2 - 4 * C * F * x_s
    root = jnp.where(discriminant > 0, jnp.sqrt(jnp.where(discriminant > 0, discriminant, 1.0)), 0.0)
    return Tow(jnp.asarray(F / friction), tilt, (-b34 + root) / (2 * C))


class Push(NamedTuple):
    """Speeds along the raft's axes (m/s), rotations about them (rad), rise of the centre (m)."""

    speed_x: Float[Array, "..."]
    speed_y: Float[Array, "..."]
    roll: Float[Array, "..."]
    pitch: Float[Array, "..."]
    rise: Float[Array, "..."]


def raft_push(
    F_x: Scalar,
    F_y: Scalar,
    F_z: Scalar,
    M_x: Scalar,
    M_y: Scalar,
    a: Scalar,
    b: Scalar,
    d: Scalar,
    gamma: Scalar,
    k_lin: Scalar,
) -> Push:
    """Steady motion under a force (N) and moment (N m, none about z) fixed in the raft's axes: (4.2.22)-(4.2.24).

    F_z < 0 holds the weight too; the rise is against the level at which water carries it alone. The heading is free
    (4.2.25). Nan where the level raft is unstable.
    """
    friction = 4 * k_lin * a * b
    stiff = hydro_thick(a, b, d, -F_z / (4 * gamma * a * b) - d, gamma)
    k_roll, k_pitch = (jnp.where(k > 0, k, jnp.nan) for k in stiff)
    arm = friction * d  # b15
    speed_x = (F_x + F_z * M_y / k_pitch) / (friction - F_z * arm / k_pitch)
    speed_y = (F_y - F_z * M_x / k_roll) / (friction - F_z * arm / k_roll)
    roll, pitch = (M_x - speed_y * arm) / k_roll, (M_y + speed_x * arm) / k_pitch
    return Push(speed_x, speed_y, roll, pitch, (F_y * roll - F_x * pitch) / (4 * gamma * a * b))


_FRICTION = positive("k_lin", "N*s/m^3", 20.0)

FORMULAS = (
    Formula(
        "raft_tow",
        "speed, tilt and heading's pole of a raft towed by a force fixed in the world",
        "monograph",
        ("4.2.26-4.2.35",),
        raft_tow,
        (
            positive("F", "N", 50.0),
            Input("x_s", "m", 1.5),
            Input("z_s", "m", 0.1),
            *SIZES,
            Input("zeta0", "m", 0.0),
            WATER,
            _FRICTION,
            positive("C", "kg*m^2", 790.0),
        ),
        {"speed": "m/s", "tilt": "rad", "yaw_pole": "1/s"},
        correction="(4.2.33) has z_s + d/2 for z_s + d; b34 decides the decay of the heading, not b14",
        condition="F x_s must not overcome the stiffness in pitch",
    ),
    Formula(
        "raft_push",
        "steady motion of a raft under a force fixed in its own axes",
        "monograph",
        ("4.2.16-4.2.25",),
        raft_push,
        (
            Input("F_x", "N", 50.0),
            Input("F_y", "N", 0.0),
            Input("F_z", "N", -6489.3, below=0),
            Input("M_x", "N*m", 0.0),
            Input("M_y", "N*m", 0.0),
            *SIZES,
            WATER,
            _FRICTION,
        ),
        {"speed_x": "m/s", "speed_y": "m/s", "roll": "rad", "pitch": "rad", "rise": "m"},
        correction="(4.2.24) has 3 for 12 and misses 4 k a b d in b15",
        condition="the raft must be stable in roll and pitch",
    ),
)
