"""How the robot's mass centre follows its body while the feet stand: monograph (3.1.1), (3.1.9)."""

from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Real

from sweep.formulas import leg
from sweep.formulas.formula import Scalar, formula, positive_input


def leg_mass_centre(
    side: Real[Array, "*b"],
    angles: Float[Array, "*b 3"],
    thigh: Scalar,
    shin: Scalar,
    thigh_mass: Scalar,
    shin_mass: Scalar,
) -> Float[Array, "*b 3"]:
    """Mass centre of a leg that consists of two uniform links: monograph (3.1.9).

    Args:
        side: +1 for legs on the left, -1 on the right.
        angles: alpha, beta, gamma (rad).
        thigh: Length of the thigh (m).
        shin: Length of the shin (m).
        thigh_mass: Mass of the thigh (kg).
        shin_mass: Mass of the shin (kg).

    Returns:
        The mass centre relative to the hip (m, base axes).
    """
    knee = leg.forward_kinematics(side, angles, 0.0, thigh, 0.0)
    foot = leg.forward_kinematics(side, angles, 0.0, thigh, shin)
    return (thigh_mass * knee / 2 + shin_mass * (knee + foot) / 2) / (thigh_mass + shin_mass)


class MassCentreJacobian(NamedTuple):
    """Result of `ball_jacobian`: derivative of the robot's mass centre by the position of its base."""

    D: Annotated[Float[Array, "3 3"], ""]


@formula("monograph", "3.1.1", "3.1.9", condition="d2 <= d1 <= R, and the feet in reach of the legs")
def ball_jacobian(
    R: Annotated[Scalar, positive_input("m", 0.84)],
    d1: Annotated[Scalar, positive_input("m", 0.5)],
    d2: Annotated[Scalar, positive_input("m", 0.3)],
    height: Annotated[Scalar, positive_input("m", 1.0)],
    a_r: Annotated[Scalar, positive_input("m", 1.05)],
    b_r: Annotated[Scalar, positive_input("m", 0.5)],
    l1: Annotated[Scalar, positive_input("m", 0.52)],
    l2: Annotated[Scalar, positive_input("m", 0.335)],
    m_b: Annotated[Scalar, positive_input("kg", 10.0)],
    m1: Annotated[Scalar, positive_input("kg", 0.5)],
    m2: Annotated[Scalar, positive_input("kg", 0.5)],
) -> MassCentreJacobian:
    """Motion of the mass centre per motion of the body, for a robot on a ball.

    D of (3.1.1) for a robot that stands on a ball: what the mass centre moves by if the body moves by 1.

    The feet stand on a circle of radius d1 round the top of the ball of radius R, front and rear ones d2 from its
    middle line (before 3.1.3); the level body's centre is `height` over the ball's centre. Body of length a_r and
    width b_r, links l1, l2 (m), masses of the body and of the links of a leg m_b, m1, m2 (kg). Axes: x forward, y
    left, z up. Nan where a foot is out of reach.
    """
    fore = jnp.array([-1.0, -1.0, 0.0, 0.0, 1.0, 1.0]) * d2
    feet = jnp.stack([fore, leg.SIDE_BY_LEG * jnp.sqrt(d1**2 - fore**2), jnp.full(6, jnp.sqrt(R**2 - d1**2))], axis=-1)
    mounts = leg.rectangular_hip_positions(a_r, b_r)
    leg_mass = m1 + m2
    side = jnp.asarray(leg.SIDE_BY_LEG)

    def mass_centre(body: Float[Array, " 3"]) -> Float[Array, " 3"]:
        angles, miss = leg.inverse_kinematics(side, feet - body - mounts, 0.0, l1, l2)
        legs = mounts + leg_mass_centre(side, angles, l1, l2, m1, m2)
        reached = jnp.where(jnp.any(miss > 0), jnp.nan, 1.0)
        return reached * (body + leg_mass * legs.sum(0) / (m_b + 6 * leg_mass))

    return MassCentreJacobian(jax.jacfwd(mass_centre)(jnp.stack([0.0 * height, 0.0 * height, height])))
