"""A robot on a rolling ball: timing of the body's moves, climbing, descending, turning, the largest ball.

Monograph ch. 3. The ball is homogeneous (moment of inertia 2/5 M R^2 about its centre), rolls without slipping and
the robot's mass centre keeps the distance rho from the ball's centre; phi is its elevation seen from there
(pi/2 on top), and a positive rate dphi climbs.
"""

from typing import Annotated, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.core.constants import GRAVITY
from sweep.formulas.formula import Input, Scalar, formula, positive_input

ROLLING_INERTIA = 7 / 5  # ball's moment of inertia about the point of contact, in M R^2
SPINNING_INERTIA = 2 / 5  # the same about its centre


_TWICE = "the ball's M R^2 is counted twice by J_b + (m + M) R^2 with J_b = 7/5 M R^2"
RobotMass = Annotated[Scalar, positive_input("kg", 16.0)]
BallMass = Annotated[Scalar, positive_input("kg", 40.0)]
BallRadius = Annotated[Scalar, positive_input("m", 0.84)]
CentreDistance = Annotated[Scalar, positive_input("m", 1.1)]


class StabilisingMotion(NamedTuple):
    """Result of `stabilise_delta`: the shapes at time tau, and the constants of delta (times in s, `ubar` in 1/s^2)."""

    ubar: Annotated[Float[Array, "..."], "1/s^2"]
    tau1: Annotated[Float[Array, "..."], "s"]
    tau2: Annotated[Float[Array, "..."], "s"]
    delta: Annotated[Float[Array, "..."], ""]
    pulse: Annotated[Float[Array, "..."], ""]
    pulse_integral_T: Annotated[Float[Array, "..."], ""]


@formula(
    "monograph",
    "3.1.3-3.1.7",
    correction="(3.1.7) gives the pulse the integral T - Delta, not T: pulse_integral_T is scaled",
    condition="Delta must be less than T",
)
def stabilise_delta(
    T: Annotated[Scalar, positive_input("s", 2.0)],
    Delta: Annotated[Scalar, Input("s", 0.0, at_least=0)],
    tau: Annotated[Scalar, Input("s", 1.0, at_least=0)],
) -> StabilisingMotion:
    """Body motion that stops a rolling ball: the shape delta, which grows from 0 to 1, and the pulse delta'.

    The ball ends at rest with no angular momentum gained. `delta` goes from 0 to 1 in T - Delta with an overshoot
    (golden ratio) such that its integral over T is T. The body then rests. `pulse` (delta') leaves and returns to 0,
    its peak is 2 and its integral T - Delta; `pulse_integral_T` is scaled so that the integral is T, as the law of
    conservation before (3.1.7) wants and (3.1.7) misses unless Delta = 0.

    Args:
        T: duration of the move (s).
        Delta: rest of the body at its end (s).
        tau: time since its start (s).

    Returns:
        The shapes at time tau, and the constants of delta.
    """
    length = jnp.where(Delta < T, T - Delta, jnp.nan)
    s = jnp.clip(tau / length, 0.0, 1.0)
    ubar = 2 / (np.sqrt(5) / 2 - 1)
    early, late = (np.sqrt(5) - 1) / 4, (np.sqrt(5) + 1) / 4
    pulse = _bell(s)
    return StabilisingMotion(
        ubar / length**2, early * length, late * length, _spline(s, ubar, early, late), pulse, pulse * T / length
    )


class LateralMotion(NamedTuple):
    """Result of `lateral_mu`: the value at time tau of the pulse mu, which scales the body's sideways motion."""

    mu: Annotated[Float[Array, "..."], ""]


@formula("monograph", "3.3.7")
def lateral_mu(
    T: Annotated[Scalar, positive_input("s", 2.0)], tau: Annotated[Scalar, Input("s", 1.0, at_least=0)]
) -> LateralMotion:
    """Shape mu of the sideways body motion that pushes a ball: a pulse with a plateau.

    The peak is 2, the plateau lasts d = T/4. The integral is 3/2 T, so that the gain of (3.1.8) must be multiplied by
    2/3 where this shape replaces the pulse.

    Args:
        T: duration of the push (s).
        tau: time since its start (s).

    Returns:
        Value of the pulse at time tau.
    """
    share = tau / T
    without_plateau = jnp.clip(share, 0.0, 0.25) + jnp.clip(share - 0.75, 0.0, 0.25)
    return LateralMotion(_bell(2 * without_plateau))


def _spline(s: Array, ubar: float, early: float, late: float) -> Array:
    """Twice integrated acceleration: +ubar, from `early` -ubar, from `late` +ubar."""
    return ubar * (s**2 / 2 - jnp.maximum(s - early, 0) ** 2 + jnp.maximum(s - late, 0) ** 2)


def _bell(s: Array) -> Array:
    """Up to 2 and back over 0 <= s <= 1."""
    return _spline(s, 32.0, 0.25, 0.75)


class BallClimbRates(NamedTuple):
    """Result of `ball_climb`: least starting speed of the ball (m/s) with its best climbing rate, and the rate at 1.3
    times that speed."""

    v0_min: Annotated[Float[Array, "..."], "m/s"]
    dphi_opt: Annotated[Float[Array, "..."], "rad/s"]
    omega0: Annotated[Float[Array, "..."], "rad/s"]
    dphi: Annotated[Float[Array, "..."], "rad/s"]


@formula("monograph", "3.1.14-3.1.16", correction=_TWICE)
def ball_climb(
    m: RobotMass,
    M: BallMass,
    R: BallRadius,
    rho: CentreDistance,
    phi0: Annotated[Scalar, Input("rad", 0.4, above=-np.pi / 2, below=np.pi / 2)],
) -> BallClimbRates:
    """Least speed of a ball that can be climbed, and the rate of climbing.

    Push that the ball needs so that the robot reaches its top as it stops.

    Robot of mass m (kg) starting at elevation phi0 (rad), ball of mass M and radius R (m). `omega0` (rad/s) is the
    start at 1.3 times the least speed and `dphi` (rad/s) the lower of the two climbing rates that suit it.
    """
    p = _ratio(m, M, R, rho)
    effort = jnp.log1p(p * (1 - jnp.sin(phi0)) / (1 + p * jnp.sin(phi0)))
    v0_min = 2 * effort * jnp.sqrt(GRAVITY * R)
    omega0 = 1.3 * v0_min / R
    return BallClimbRates(v0_min, jnp.sqrt(GRAVITY / jnp.asarray(R)), omega0, climbing_rate(omega0, effort, R))


def climbing_rate(omega0: Scalar, effort: Scalar, R: Scalar) -> Array:
    """Climbing rate of a robot that reaches the top of a ball as the ball stops: lower root of monograph (3.1.14).

    Args:
        omega0: Rate of the ball at the start (rad/s).
        effort: The book's cursive P, dimensionless.
        R: Radius of the ball (m).

    Returns:
        dphi (rad/s) of (3.1.16); nan where the equation has no root.
    """
    speed = omega0 * R
    # This form of the root does not cancel for a fast ball.
    return 2 * effort * GRAVITY / (speed + jnp.sqrt(speed**2 - 4 * effort**2 * R * GRAVITY))


class BallAngularRate(NamedTuple):
    """Result of `ball_omega`: the angular rate of the ball (rad/s)."""

    omega: Annotated[Float[Array, "..."], "rad/s"]


@formula("monograph", "3.1.11-3.1.13", correction=_TWICE, condition="dphi must not be 0")
def ball_omega(
    m: RobotMass,
    M: BallMass,
    R: BallRadius,
    rho: CentreDistance,
    phi0: Annotated[Scalar, Input("rad", 0.4, at_least=-np.pi, at_most=np.pi)],
    phi1: Annotated[Scalar, Input("rad", np.pi / 2, at_least=-np.pi, at_most=np.pi)],
    dphi: Annotated[Scalar, Input("rad/s", 1.0)],
    omega0: Annotated[Scalar, Input("rad/s", 1.0)],
) -> BallAngularRate:
    """Angular rate of a ball after the robot moved on it at a constant rate.

    Args:
        m: mass of the robot (kg).
        M: mass of the ball (kg).
        R: radius of the ball (m).
        rho: distance of the robot's mass centre from the ball's centre (m).
        phi0: elevation of the mass centre at the start, seen from the ball's centre (rad).
        phi1: elevation at the end (rad).
        dphi: rate of the elevation (rad/s), not 0; positive rates climb.
        omega0: rate of the ball at the start (rad/s).

    Returns:
        Rate of the ball at the end (rad/s).
    """
    p = _ratio(m, M, R, rho)
    growth = jnp.log1p(p * (jnp.sin(phi1) - jnp.sin(phi0)) / (1 + p * jnp.sin(phi0)))
    return BallAngularRate(omega0 - (GRAVITY + dphi**2 * R) / (dphi * R) * growth)


class BallDescentRates(NamedTuple):
    """Result of `ball_descent`: the robot's best rate of descent and the rate that the ball gains by it (rad/s)."""

    dphi_opt: Annotated[Float[Array, "..."], "rad/s"]
    gain: Annotated[Float[Array, "..."], "rad/s"]


@formula("monograph", "3.1.17", correction=f"the bound after (3.1.17) lacks the factor 2; {_TWICE}")
def ball_descent(
    m: RobotMass,
    M: BallMass,
    R: BallRadius,
    rho: CentreDistance,
    phi: Annotated[Scalar, Input("rad", 0.4, at_least=0, at_most=np.pi / 2)],
) -> BallDescentRates:
    """Least angular rate that a ball gains while the robot comes down from its top.

    A ball at rest ends with `gain`; a ball that shall be at rest in the end must start with as much the other way.
    """
    p = _ratio(m, M, R, rho)
    share = p / (1 + p)  # epsilon of (3.1.17)
    rate = jnp.sqrt(GRAVITY / jnp.asarray(R))
    return BallDescentRates(rate, -2 * rate * jnp.log1p(-share * (1 - jnp.sin(phi))))


def _ratio(m: Scalar, M: Scalar, R: Scalar, rho: Scalar) -> Scalar:
    """p of (3.1.14), with J_b + m R^2 below: J_b about the contact already holds the M R^2 that is printed twice."""
    return m * rho / (R * (ROLLING_INERTIA * M + m))


class BallTurnRadius(NamedTuple):
    """Result of `ball_turn`: the radius (m) of the circle on which the ball rolls."""

    rho_exact: Annotated[Float[Array, "..."], "m"]
    rho_approx: Annotated[Float[Array, "..."], "m"]


@formula(
    "monograph",
    "3.1.23-3.1.25",
    "3.1.32-3.1.33",
    correction="(3.1.24) leaves the turn out of the mass centre's speed; rho_exact keeps it",
    condition="phi must not be 0, and v so high that a steady turn exists",
)
def ball_turn(
    m: RobotMass,
    M: BallMass,
    R: BallRadius,
    h: Annotated[Scalar, positive_input("m", 0.3)],
    phi: Annotated[Scalar, Input("rad", 0.2, above=-np.pi / 2, below=np.pi / 2)],
    v: Annotated[Scalar, positive_input("m/s", 0.5)],
) -> BallTurnRadius:
    """Radius of the steady turn of a ball, exact and as printed.

    The ball's speed is v (m/s), the robot leans by phi (rad) to the inside.
    `h` (m) is the height of the mass centre over the ball. Monograph (3.1.33) is `rho_approx`: it takes the mass
    centre to be as fast as the ball. Without that, D rho^2 - v^2 (A + B) rho + v^2 B S = 0 and the outer root is
    `rho_exact`; nan where there is no steady turn. The sign is that of phi.
    """
    height = h / R + 1
    A, B = ROLLING_INERTIA * M / m, 1 + height * jnp.cos(phi)
    D, S = GRAVITY * height * jnp.sin(phi), (h + R) * jnp.sin(phi)
    approx = v**2 * (A + B) / D
    return BallTurnRadius(approx * (1 + jnp.sqrt(1 - 4 * D * B * S / (v * (A + B)) ** 2)) / 2, approx)


class BallSwerve(NamedTuple):
    """Result of `ball_swerve`: radius of the path, spin, and gain in speed of the ball."""

    rho_phi: Annotated[Float[Array, "..."], "m"]
    omega_zeta: Annotated[Float[Array, "..."], "rad/s"]
    gain: Annotated[Float[Array, "..."], "m/s/rad"]


@formula(
    "monograph",
    "3.1.26-3.1.31",
    correction="v_A x Q has the sign + in (3.1.26), by which C_4 = 0: rho_phi is not 2 R c_2/((h + 1)(C_1 + 4 c_2) "
    "sin phi), and the ball does not slow down by (3.1.30); about the vertical its moment of inertia is 2/5 M R^2",
    condition="phi must not be 0",
)
def ball_swerve(
    m: RobotMass,
    M: BallMass,
    R: BallRadius,
    h: Annotated[Scalar, positive_input("m", 0.3)],
    phi: Annotated[Scalar, Input("rad", 0.2, above=-np.pi / 2, below=np.pi / 2)],
    dphi: Annotated[Scalar, Input("rad/s", 0.5)],
    v: Annotated[Scalar, positive_input("m/s", 0.5)],
    J_r: Annotated[Scalar, Input("kg m^2", 1.0, at_least=0)],
    J_zeta: Annotated[Scalar, Input("kg m^2", 1.5, at_least=0)],
) -> BallSwerve:
    """Turn of a rolling ball while its robot leans sideways at a steady rate: radius, spin, gain in speed.

    The robot leans by phi (rad) to the inside, more by dphi (rad/s), and turns with the ball's path. The ball's speed
    is v (m/s), `h` (m) the height of the robot's mass centre over the ball; `J_r` and `J_zeta` (kg m^2) are its moments
    of inertia along the ball's path and about the vertical. `rho_phi` (m) is the radius of that path, (3.1.33) with g +
    dphi^2 R for g. `omega_zeta` (rad/s) is the spin that the robot's turning leaves to a ball that had none, to first
    order in phi and without friction against it. `gain` (m/s for each rad of phi) is how the ball's speed grows.
    """
    height, unit = h / R + 1, m * R**2
    C_1 = ROLLING_INERTIA * M / m + 1 + height * jnp.cos(phi)
    c_2 = J_r / unit + height * jnp.cos(phi) + height**2
    turning = height * (GRAVITY + dphi**2 * R) * jnp.sin(phi) / (v * C_1)
    return BallSwerve(v / turning, -J_zeta * turning / (SPINNING_INERTIA * M * R**2), R * c_2 * turning / C_1)
