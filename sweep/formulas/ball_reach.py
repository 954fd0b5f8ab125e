"""What the legs allow at a ball: the largest ball that can be climbed, and turning the body in front of it.

Monograph 3.1.5 and 3.3.1.
"""

from typing import Annotated, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.formulas.formula import Input, Scalar, formula, positive_input
from sweep.formulas.roots import newton_root


class LargestBall(NamedTuple):
    """Result of `max_ball`: largest radius of a ball (m) that can be climbed."""

    R: Annotated[Float[Array, "..."], "m"]


@formula(
    "monograph",
    "3.1.18-3.1.22",
    correction="(3.1.22) has (1 - k_f)^2 + 4 for (1 - k_f)^4 + 4 below, and lacks a square for k_f = 1",
    condition="hhat must be in reach of the ball's footholds and b less than its diameter",
)
def max_ball(
    l1: Annotated[Scalar, positive_input("m", 0.52)],
    l2: Annotated[Scalar, positive_input("m", 0.335)],
    hhat: Annotated[Scalar, positive_input("m", 1.71)],
    b: Annotated[Scalar, Input("m", 0.5, at_least=0)],
    k_f: Annotated[Scalar, Input("", 1.0, at_least=0)],
) -> LargestBall:
    """Radius of the largest ball that can be climbed.

    The front feet reach its region of safe footholds: the largest root of (3.1.19). The shin only touches the ball, and
    the hip stands over its rim. Newton's method starts from (3.1.22), exact for b = 0.

    Args:
        l1: length of the thigh (m).
        l2: length of the shin (m).
        hhat: height of the front hips (m).
        b: distance between the front hips (m).
        k_f: coefficient of friction.

    Returns:
        The radius (m); nan if no ball can be climbed.
    """
    l1, l2, hhat, b, k_f = jnp.broadcast_arrays(*map(jnp.asarray, (l1, l2, hhat, b, k_f)))
    steepness = 1 + k_f**2

    def residual(R: Array) -> Array:
        section = jnp.sqrt(R**2 - b**2 / 4)  # radius of the circle on which both feet of a side stand
        above = (R + jnp.sqrt(R**2 - steepness * b**2 / 4)) / steepness  # height of the foothold over the ground
        beside, up = k_f * above, above - R  # from the ball's centre: eta and zeta of the foothold
        return (beside + up * l2 / section - R) ** 2 + (above - beside * l2 / section - hhat) ** 2 - l1**2

    slack = (1 - k_f) ** 4 + 4
    d1 = (((1 - k_f) ** 2 * (1 - k_f**2) + 4 * k_f) * l2 + 2 * steepness * hhat) / slack
    d2 = steepness * ((hhat**2 + l2**2 - l1**2) * steepness + 4 * k_f * l2 * hhat) / slack
    return LargestBall(newton_root(residual, d1 + jnp.sqrt(d1**2 - d2), steps=12))


class BodyTurnDisplacements(NamedTuple):
    """Result of `body_turn`: displacements (eta, zeta) (m) of three points of the body's axis."""

    d_mid: Annotated[Float[Array, "... 2"], "m"]
    d_rear: Annotated[Float[Array, "... 2"], "m"]
    d_front: Annotated[Float[Array, "... 2"], "m"]


@formula(
    "monograph", "3.3.1-3.3.2", condition="ds must be so small that the body still bridges the circle and the line"
)
def body_turn(
    ds: Annotated[Scalar, Input("rad", 0.3)],
    s0: Annotated[Scalar, Input("rad", -0.3)],
    Rp: Annotated[Scalar, positive_input("m", 0.9)],
    a_r: Annotated[Scalar, positive_input("m", 1.05)],
    eps: Annotated[Scalar, Input("rad", 0.1, above=-1.5, below=1.5)],
) -> BodyTurnDisplacements:
    """Displacement of the body as it turns up to a ball.

    Body, level at first, as its front end goes by the angle ds (rad) up a circle of radius Rp (m) from s0.

    Its middle slides down a line that falls by eps (rad) towards the rear. Monograph (3.3.1), (3.3.2); eta points
    away from the ball, zeta up, a_r is the length of the body. Nan where the body is too short.
    """
    half = a_r / 2
    chord = 2 * Rp * jnp.sin(ds / 2)
    eta, zeta = -chord * jnp.sin(s0 + ds / 2), chord * jnp.cos(s0 + ds / 2)
    slope = jnp.tan(eps)
    # The length of the half body, |(half - eta - run, zeta - slope run)| = half, is quadratic in the run.
    middle = half - eta + zeta * slope
    rest = eta**2 - 2 * half * eta + zeta**2
    run = rest / (middle + jnp.sqrt(middle**2 - rest * (1 + slope**2)))
    front = jnp.stack(jnp.broadcast_arrays(eta, zeta), axis=-1)
    mid = jnp.stack(jnp.broadcast_arrays(-run, slope * run), axis=-1)
    return BodyTurnDisplacements(mid, 2 * mid - front, front + jnp.zeros_like(mid))
