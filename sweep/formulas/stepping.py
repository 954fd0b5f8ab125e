"""Step cycles and swing timing: monograph 1.3, and the half-ellipse of the thesis.

Phases are normalised: u = 0 at lift-off, u = 1 at touchdown, whatever the duration of the swing.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

PHI_0 = -float(np.arcsin(0.25))  # phase of point A of cycle a, since y_s = d_y / 4
LANDING_RATIO = float(np.cos(PHI_0))  # x* / d_x = sqrt(15) / 4


def swing_time(rate: Array | float) -> Array | float:
    """Duration t* (s) of the swing of a step cycle with angular rate varpi (rad/s): (pi - 2 phi_0) / varpi."""
    return (np.pi - 2 * PHI_0) / rate


def swing_cycle_a(u: Float[Array, "*b"]) -> tuple[Float[Array, "*b"], Float[Array, "*b"]]:
    """Swing of step cycle a, along the arc of an ellipse with a soft landing, at phase u: (1.3.1) a.

    Returns: x'/d_x and (y' + y_s)/d_y.
    """
    phi = PHI_0 + u * (np.pi - 2 * PHI_0)
    return -jnp.cos(phi), jnp.sin(phi) + 0.25


def swing_cycle_b(u: Float[Array, "*b"]) -> tuple[Float[Array, "*b"], Float[Array, "*b"]]:
    """Swing of step cycle b, along half an ellipse, for a foot that must not move back first, at phase u: (1.3.1) b.

    The angular rate is pi/t*; the printed one, that of cycle a, overshoots point B.

    Returns: x'/d_x and (y' + y_s)/d_y.
    """
    phi = np.pi * u
    return -LANDING_RATIO * jnp.cos(phi), 1.25 * jnp.sin(phi)


def step_cycle(
    kind: str, t: Array | float, t_star: Array | float, d_x: Array | float, d_y: Array | float, k_prime: Array | float
) -> Float[Array, "*b 2"]:
    """Foot position in a step cycle of swing and stance: monograph (1.3.1), and (1.3.2) for the stance, from time t*.

    Args:
        kind: "a", the arc of an ellipse, or "b", half an ellipse.
        t: Time since lift-off (s).
        t_star: Duration of the swing (s).
        d_x: Half length of the cycle's ellipse (m).
        d_y: Half height of the cycle's ellipse (m).
        k_prime: 2 for a stance of t* (tripod), 1 for one of 2 t* (gallop); printed the other way round.

    Returns:
        (x', y') (m) in the cycle's axes.
    """
    x_swing, y_swing = (swing_cycle_a if kind == "a" else swing_cycle_b)(jnp.clip(t / t_star, 0, 1))
    x_stance = LANDING_RATIO * (1 - k_prime * (t - t_star) / t_star)
    swinging = t < t_star
    x = d_x * jnp.where(swinging, x_swing, x_stance)
    y = d_y * jnp.where(swinging, y_swing - 0.25, -0.25)
    return jnp.stack([x, y], axis=-1)


def trapezoidal_transfer_timing(
    t: Array | float, t_0: Array | float, t_star: Array | float, sigma_2: Array | float = 1.0
) -> tuple[Array, Array]:
    """Timing lambda_1 of an irregular transfer, whose rate is a trapezoid over time: monograph (1.3.3).

    w = 1/[sigma (sigma_2 t* - sigma)] is printed for sigma_2 = 1 only.

    Args:
        t: Time (s).
        t_0: Start of the transfer (s).
        t_star: Duration of a swing (s).
        sigma_2: Share of t* after which the transfer ends, 1/2 to 1.

    Returns:
        Share of the transfer that is done, 0 to 1, and its rate (1/s).
    """
    sigma = t_star / 4
    end = sigma_2 * t_star
    w = 1 / (sigma * (end - sigma))
    s = jnp.clip(t - t_0, 0, end)
    last = jnp.maximum(s - end + sigma, 0)
    ramp = jnp.minimum(s, sigma)
    share = w * (ramp**2 / 2 + sigma * (s - ramp) - last**2 / 2)
    inside = (t >= t_0) & (t < t_0 + end)
    return share, jnp.where(inside, w * (ramp - last), 0.0)


def half_ellipse_swing(u: Float[Array, "*b"]) -> tuple[Float[Array, "*b"], Float[Array, "*b"]]:
    """Swing that lands without impact, at phase u: thesis (16), tau = -pi/2 (1 + cos pi u).

    Returns: share of the step's length that is done, and height over the largest height.
    """
    tau = -np.pi / 2 * (1 + jnp.cos(np.pi * u))
    return (1 + jnp.cos(tau)) / 2, -jnp.sin(tau)


def lift_direction(step: Float[Array, "*b 3"], plane: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """Direction in which a swing lifts the foot: monograph (1.3.3).

    Args:
        step: From lift-off to touchdown (m).
        plane: A vector that spans the swing's plane together with `step`.

    Returns:
        The unit vector normal to `step` in that plane; along `plane` for a step of no length.
    """
    across = jnp.cross(step, jnp.cross(plane, step))
    size = jnp.sqrt(jnp.sum(across**2, axis=-1, keepdims=True) + 1e-24)  # keeps the gradient finite at zero length
    straight = plane / jnp.linalg.norm(plane, axis=-1, keepdims=True)
    return jnp.where(size > 1e-9, across / jnp.maximum(size, 1e-9), straight)
