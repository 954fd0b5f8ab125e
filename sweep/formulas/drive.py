"""The joint servo: monograph (1.2.1)."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.formulas.formula import Formula, Input, Scalar, positive


class Servo(NamedTuple):
    """`torque` at the joint (N m); the closed loop's poles (1/s), the fastest first."""

    chi2: Float[Array, "..."]
    torque: Float[Array, "..."]
    poles_re: Float[Array, "... 2"]
    poles_im: Float[Array, "... 2"]


def servo(
    phi: Scalar, dphi: Scalar, phi0: Scalar, c_e: Scalar, chi1: Scalar, delta: Scalar, umax: Scalar, J: Scalar
) -> Servo:
    """Torque of a drive with clipped control and back-EMF, and its poles about an inertia J: monograph (1.2.1).

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
    return Servo(chi2, torque, poles_re, poles_im)


FORMULAS = (
    Formula(
        "servo",
        "torque of a joint drive and the poles of its closed loop",
        "monograph",
        ("1.2.1",),
        servo,
        (
            Input("phi", "rad", 0.0),
            Input("dphi", "rad/s", 0.0),
            Input("phi0", "rad", 0.001),
            Input("c_e", "N*m*s/rad", 10.0, at_least=0),
            positive("chi1", "N*m/rad", 4.5e4),
            Input("delta", "N*m*s/rad", 100.0, at_least=0),
            positive("umax", "N*m", 150.0),
            positive("J", "kg*m^2", 1.0),
        ),
        {"chi2": "N*m*s/rad", "torque": "N*m", "poles_re": "1/s", "poles_im": "1/s"},
    ),
)
