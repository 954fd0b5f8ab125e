"""The joint servo: monograph (1.2.1), and how late its own feedback may be."""

from typing import Annotated, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.formulas.formula import Input, Scalar, formula, positive_input


class ServoResponse(NamedTuple):
    """Result of `servo`: `torque` at the joint (N m), and the poles of the closed loop (1/s), the fastest first."""

    chi2: Annotated[Float[Array, "..."], "N*m*s/rad"]
    torque: Annotated[Float[Array, "..."], "N*m"]
    poles_re: Annotated[Float[Array, "... 2"], "1/s"]
    poles_im: Annotated[Float[Array, "... 2"], "1/s"]


@formula("monograph", "1.2.1")
def servo(
    phi: Annotated[Scalar, Input("rad", 0.0)],
    dphi: Annotated[Scalar, Input("rad/s", 0.0)],
    phi0: Annotated[Scalar, Input("rad", 0.001)],
    c_e: Annotated[Scalar, Input("N*m*s/rad", 10.0, at_least=0)],
    chi1: Annotated[Scalar, positive_input("N*m/rad", 45000.0)],
    delta: Annotated[Scalar, Input("N*m*s/rad", 100.0, at_least=0)],
    umax: Annotated[Scalar, positive_input("N*m", 150.0)],
    J: Annotated[Scalar, positive_input("kg*m^2", 1.0)],
) -> ServoResponse:
    """Torque of a joint drive and the poles of its closed loop.

    With clipped control and back-EMF; the poles are those about an inertia J.
    `phi`, `phi0` are the measured and the wanted angle (rad), `dphi` the measured rate (rad/s). The control is
    -chi1 (phi - phi0) + chi2 dphi with chi2 = c_e - 2 sqrt(chi1) - delta, held within +-umax; c_e dphi is lost to
    the back-EMF. Unsaturated: J phi'' = -chi1 (phi - phi0) - (2 sqrt(chi1) + delta) phi'.
    """
    damping = 2 * jnp.sqrt(chi1) + delta
    chi2 = c_e - damping
    torque = jnp.clip(-chi1 * (phi - phi0) + chi2 * dphi, -umax, umax) - c_e * dphi
    discriminant = damping**2 - 4 * J * chi1
    root = jnp.sqrt(jnp.where(discriminant > 0, discriminant, 1.0))
    swing = jnp.sqrt(jnp.where(discriminant < 0, -discriminant, 1.0)) / (2 * J)
    real, centre = discriminant > 0, -damping / (2 * J)
    # The slow pole from the product of the two: the difference would cancel.
    fast = jnp.where(real, -(damping + root) / (2 * J), centre)
    slow = jnp.where(real, -2 * chi1 / (damping + root), centre)
    imaginary = jnp.where(discriminant < 0, swing, 0.0)
    poles_re = jnp.stack(jnp.broadcast_arrays(fast, slow), axis=-1)
    poles_im = jnp.stack(jnp.broadcast_arrays(-imaginary, imaginary), axis=-1)
    return ServoResponse(chi2, torque, poles_re, poles_im)


class ServoDelay(NamedTuple):
    """Result of `servo_delay`: longest feedback delay at which the joint is stable, and the frequency at which it
    oscillates there."""

    delay: Annotated[Float[Array, "..."], "s"]
    omega: Annotated[Float[Array, "..."], "rad/s"]


@formula("monograph", "1.2.1", correction="not printed: the law (1.2.1) with a delay of its feedback")
def servo_delay(
    J: Annotated[Scalar, positive_input("kg*m^2", 0.1187)],
    stiffness: Annotated[Scalar, positive_input("N*m/rad", 45000.0)],
    damping: Annotated[Scalar, Input("N*m*s/rad", 514.26, at_least=0)],
    c_e: Annotated[Scalar, Input("N*m*s/rad", 10.0, at_least=0)],
) -> ServoDelay:
    """Longest feedback delay with which a joint drive is still stable.

    About an inertia J (by default of a shin in the air and its drive), unsaturated; the back-EMF c_e has no delay:
    J phi'' + c_e phi' + damping phi'(t - delay) + stiffness phi(t - delay) = 0. At the limit phi oscillates steadily at
    omega, where J omega^2 - i c_e omega and stiffness + i damping omega have the same magnitude; the delay is the angle
    between them over omega. The oscillation grows with any longer delay.
    """
    net = damping**2 - c_e**2
    omega = jnp.sqrt((net + jnp.sqrt(net**2 + 4 * (J * stiffness) ** 2)) / 2) / J
    angle = jnp.arctan2(damping * omega, stiffness) + jnp.arctan2(c_e, J * omega)
    return ServoDelay(angle / omega, omega)
