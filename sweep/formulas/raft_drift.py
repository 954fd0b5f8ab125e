"""Steady motions of a raft under a constant horizontal pull: monograph 4.2.2 and 4.2.3, small angles.

The bottom's friction h15 = 4 k_lin a b per speed acts at the depth d. The weight acts at the raft's centre.
"""

from typing import Annotated, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.formulas.formula import Input, Scalar, formula, positive_input
from sweep.formulas.raft_statics import HalfHeight, HalfLength, HalfWidth, WaterWeight, hydro_thick

WaterDragCoefficient = Annotated[Scalar, positive_input("N*s/m^3", 20.0)]


class TowedRaftMotion(NamedTuple):
    """Result of `raft_tow`: speed (m/s), nose-down tilt (rad), and the slower pole of the heading (1/s), stable if
    negative."""

    speed: Annotated[Float[Array, "..."], "m/s"]
    tilt: Annotated[Float[Array, "..."], "rad"]
    yaw_pole: Annotated[Float[Array, "..."], "1/s"]


@formula(
    "monograph",
    "4.2.26-4.2.35",
    correction="(4.2.33) has z_s + d/2 for z_s + d; b34 decides the decay of the heading, not b14",
    condition="F x_s must not overcome the stiffness in pitch",
)
def raft_tow(
    F: Annotated[Scalar, positive_input("N", 50.0)],
    x_s: Annotated[Scalar, Input("m", 1.5)],
    z_s: Annotated[Scalar, Input("m", 0.1)],
    a: HalfLength,
    b: HalfWidth,
    d: HalfHeight,
    zeta0: Annotated[Scalar, Input("m", 0.0)],
    gamma: WaterWeight,
    k_lin: WaterDragCoefficient,
    C: Annotated[Scalar, positive_input("kg*m^2", 790.0)],
) -> TowedRaftMotion:
    """Speed, tilt and pole of the heading of a raft towed by a force fixed in world axes.

    Raft towed by F (N, fixed in the world) at the point (x_s, 0, z_s) (m) of the raft.

    C (kg m^2) is the moment of inertia about the vertical. Pulled at the front (F x_s > 0) the raft keeps its
    heading, pushed from behind it turns away. Nan where the tow overcomes the raft's stiffness.
    """
    friction = 4 * k_lin * a * b
    stiffness = F * x_s + hydro_thick(a, b, d, zeta0, gamma).k_pitch
    tilt = F * (z_s + d) / jnp.where(stiffness > 0, stiffness, jnp.nan)
    b34 = friction * (a**2 + b**2) / 3
    discriminant = b34**2 - 4 * C * F * x_s
    root = jnp.where(discriminant > 0, jnp.sqrt(jnp.where(discriminant > 0, discriminant, 1.0)), 0.0)
    return TowedRaftMotion(jnp.asarray(F / friction), tilt, (-b34 + root) / (2 * C))


class PushedRaftMotion(NamedTuple):
    """Result of `raft_push`: speeds along the raft's axes (m/s), rotations about them (rad), rise of the centre (m)."""

    speed_x: Annotated[Float[Array, "..."], "m/s"]
    speed_y: Annotated[Float[Array, "..."], "m/s"]
    roll: Annotated[Float[Array, "..."], "rad"]
    pitch: Annotated[Float[Array, "..."], "rad"]
    rise: Annotated[Float[Array, "..."], "m"]


@formula(
    "monograph",
    "4.2.16-4.2.25",
    correction="(4.2.24) has 3 for 12 and misses 4 k a b d in b15",
    condition="the raft must be stable in roll and pitch",
)
def raft_push(
    F_x: Annotated[Scalar, Input("N", 50.0)],
    F_y: Annotated[Scalar, Input("N", 0.0)],
    F_z: Annotated[Scalar, Input("N", -6489.3, below=0)],
    M_x: Annotated[Scalar, Input("N*m", 0.0)],
    M_y: Annotated[Scalar, Input("N*m", 0.0)],
    a: HalfLength,
    b: HalfWidth,
    d: HalfHeight,
    gamma: WaterWeight,
    k_lin: WaterDragCoefficient,
) -> PushedRaftMotion:
    """Steady motion of a raft under a force fixed in the raft's axes.

    The force (N) comes with a moment (N m, none about z).

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
    return PushedRaftMotion(speed_x, speed_y, roll, pitch, (F_y * roll - F_x * pitch) / (4 * gamma * a * b))
