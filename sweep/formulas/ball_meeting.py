"""Balls that meet: the speed to approach one, its rebound, and the friction that keeps two of them in place.

Monograph 3.2 and 3.5 ask for it and give no equations; these follow from the laws of 3.1 and from statics.
"""

from typing import Annotated, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.core.constants import GRAVITY
from sweep.formulas.ball import ROLLING_INERTIA, BallMass, BallRadius, CentreDistance, RobotMass
from sweep.formulas.formula import Input, Scalar, formula, positive_input


class BallApproach(NamedTuple):
    """Result of `ball_approach`: the speed to command, and the time constant with which the ball reaches it."""

    v: Annotated[Float[Array, "..."], "m/s"]
    tau: Annotated[Float[Array, "..."], "s"]


@formula("monograph", "3.1.8", "3.5.1", correction="not printed: follows from (3.1.8) with rolling friction")
def ball_approach(
    m: RobotMass,
    M: BallMass,
    R: BallRadius,
    rho: CentreDistance,
    delta: Annotated[Scalar, Input("m", 0.5, at_least=0)],
    t: Annotated[Scalar, positive_input("s", 48.0)],
    k_v: Annotated[Scalar, positive_input("s", 0.6)],
    f_s: Annotated[Scalar, Input("m", 4e-4, at_least=0)],
) -> BallApproach:
    """Least speed to command so that a ball covers a distance in a given time.

    By (3.1.8) the mass centre is k_v (v - v_b) ahead of the ball's in the mean, whose speed v_b then goes to
    v - f_s (m + M)/(m k_v), f_s (m) being its rolling friction, with the time constant tau. So it goes `delta` in `t`.
    """
    tau = jnp.asarray((ROLLING_INERTIA * M * R + m * (R + rho)) / (m * GRAVITY * k_v))
    mean = 1 + tau / t * jnp.expm1(-t / tau)
    return BallApproach(delta / (t * mean) + f_s * (m + M) / (m * k_v), tau)


class BallImpact(NamedTuple):
    """Result of `ball_impact`: coefficient of restitution, and rebound speed (m/s) at which landing feet miss by d."""

    e: Annotated[Float[Array, "..."], ""]
    v: Annotated[Float[Array, "..."], "m/s"]


@formula("monograph", "3.2.2", correction="not printed: a spring and a damper in place of the wall")
def ball_impact(
    zeta: Annotated[Scalar, Input("", 1.0, at_least=0)],
    T: Annotated[Scalar, positive_input("s", 1.2)],
    d: Annotated[Scalar, positive_input("m", 0.1)],
) -> BallImpact:
    """Rebound of a ball from a damped wall, and the rebound speed at which landing feet miss by d.

    A spring and a damper of zeta times the critical damping push until they would pull: the ball comes back at e times
    its speed v. Feet land where a ball that rolls on is after half of the step's time T; off by T (1 + e) v/2.
    """
    below, above = jnp.minimum(zeta, 1 - 1e-6), jnp.maximum(zeta, 1 + 1e-6)
    phase = jnp.where(zeta < 1, jnp.arccos(below) / jnp.sqrt(1 - below**2), jnp.arccosh(above) / jnp.sqrt(above**2 - 1))
    e = jnp.exp(-2 * zeta * phase)
    return BallImpact(e, 2 * d / (T * (1 + e)))


class BallContactFriction(NamedTuple):
    """Result of `balls_hold`: coefficient of friction between the two balls."""

    mu: Annotated[Float[Array, "..."], ""]


@formula(
    "monograph",
    "3.5.2",
    correction="not printed: statics and dynamics of two balls that slide on each other",
    condition="T_1 must be above T_2: feet that press the balls together",
)
def balls_hold(
    M: BallMass,
    R: BallRadius,
    T_1: Annotated[Scalar, Input("N m", 40.0)],
    T_2: Annotated[Scalar, Input("N m", -10.0)],
    s: Annotated[Scalar, Input("m", 0.0, at_least=0)],
    t: Annotated[Scalar, positive_input("s", 2.0)],
) -> BallContactFriction:
    """Least friction between two touching balls that keeps them from rolling farther than a limit.

    T_1 and T_2 are the moments of feet about the balls' lowest points, forward. Pressed together by
    N = (T_1 - T_2)/(2 R) they roll as one, and slide on each other: 14/5 M R v' = T_1 + T_2 - mu (T_1 - T_2), so that
    from rest they go s (m) in t (s).
    """
    presses = T_1 - T_2
    left = jnp.abs(T_1 + T_2) - 4 * ROLLING_INERTIA * M * R * s / t**2
    return BallContactFriction(jnp.where(presses > 0, jnp.maximum(left, 0.0) / presses, jnp.nan))
