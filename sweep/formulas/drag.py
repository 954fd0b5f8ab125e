"""Drag of still water on a moving raft: monograph 4.1.2, some sixty printed branches in one form.

The raft is a box |x| <= a, |y| <= b, |z| <= d in body axes with its centre at the origin. An element of its surface
feels k_quad |v_n| v_n against its normal velocity, and the bottom also k_lin v_t against the tangential one (4.1.29).
"""

from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.formulas.formula import Input, Scalar, formula, positive_input
from sweep.formulas.raft_statics import HalfHeight, HalfLength, HalfWidth

# Plain numbers: a float64 array would be cached as such, and fail in a process that uses both precisions.
_NODES, _WEIGHTS = (tuple(map(float, row)) for row in np.polynomial.legendre.leggauss(3))


class DragIntegrals(NamedTuple):
    """Result of `drag_integrals`: integrals over the rectangle of |u|u, x|u|u and y|u|u, u linear in x and y."""

    I: Annotated[Float[Array, "..."], ""]  # noqa: E741 - the book's name
    Ix: Annotated[Float[Array, "..."], ""]
    Iy: Annotated[Float[Array, "..."], ""]


@formula(
    "monograph",
    "4.1.44-4.1.95",
    correction="one form for all branches; (4.1.60), (4.1.71), (4.1.73), (4.1.82), (4.1.84), (4.1.92), (4.1.94) "
    "have wrong signs or copied terms",
)
def drag_integrals(
    c: Annotated[Scalar, Input("", 0.1)],
    al: Annotated[Scalar, Input("", 0.2)],
    be: Annotated[Scalar, Input("", -0.3)],
    A: Annotated[Scalar, positive_input("", 1.0)],
    B: Annotated[Scalar, positive_input("", 1.0)],
) -> DragIntegrals:
    """Integrals of |u|u over a rectangle: drag of a plate in still water.

    I, Ix, Iy = integral of (1, x, y) |u|u, u = c + al x + be y, over |x| <= A, |y| <= B.

    Replaces monograph (4.1.44)-(4.1.95). Exact up to round-off for all slopes, zero included, and so are its
    derivatives: over one side the integral is elementary; it is a polynomial of degree four at most in the other
    coordinate between the lines where u = 0 leaves the rectangle, so that three Gauss nodes are exact on each piece.
    No term cancels against another: a small slope keeps its relative precision.
    """
    p, q = al * A, be * B
    return DragIntegrals(
        A * B * _across(_sum, c, p, q), A**2 * B * _across(_moment, c, p, q), A * B**2 * _across(_moment, c, q, p)
    )


def _across(inner, c: Scalar, p: Scalar, q: Scalar) -> Array:
    """Integral over -1 <= t <= 1 of inner(c + q t, p)."""
    reach = jnp.abs(p)
    breaks = jnp.clip(
        _divide(jnp.stack(jnp.broadcast_arrays(-reach - c, reach - c), -1), jnp.expand_dims(q, -1)), -1, 1
    )
    # The integrand is smooth enough for the moving breaks to add nothing to the derivatives.
    low, high = jax.lax.stop_gradient((breaks.min(-1), breaks.max(-1)))
    ends = jnp.stack([-jnp.ones_like(low), low, high, jnp.ones_like(low)], axis=-1)
    half = jnp.diff(ends) / 2
    t = (ends[..., :-1] + half)[..., None] + half[..., None] * jnp.array(_NODES)
    c, p, q = (jnp.expand_dims(jnp.asarray(value), (-1, -2)) for value in (c, p, q))
    return (inner(c + q * t, p) * half[..., None] * jnp.array(_WEIGHTS)).sum((-1, -2))


def _sum(v: Array, p: Array) -> Array:
    """Integral over -1 <= s <= 1 of |u|u, u = v + p s."""
    ratio, turns = _zero_inside(v, p)
    return jnp.where(turns, 2 * jnp.abs(p) * v * (1 + ratio**2 / 3), 2 * v * jnp.abs(v) + jnp.sign(v) * (2 / 3) * p**2)


def _moment(v: Array, p: Array) -> Array:
    """Integral over -1 <= s <= 1 of s |u|u, u = v + p s."""
    ratio, turns = _zero_inside(v, p)
    square = ratio**2
    return jnp.where(turns, p * jnp.abs(p) * (0.5 + square - square**2 / 6), (4 / 3) * jnp.abs(v) * p)


def _zero_inside(v: Array, p: Array) -> tuple[Array, Array]:
    """v / p where u changes its sign between s = -1 and 1 (else 0), and whether it does."""
    turns = jnp.abs(v) < jnp.abs(p)
    return jnp.where(turns, v, 0.0) / jnp.where(turns, p, 1.0), turns


def _divide(number: Array, by: Array) -> Array:
    """Quotient; a huge number of the same sign where `by` is zero."""
    zero = by == 0
    return jnp.where(zero, jnp.sign(number) * 2, number / jnp.where(zero, 1.0, by))


class RaftDrag(NamedTuple):
    """Result of `raft_drag`: force (N) and moment about the centre (N m), body axes."""

    R: Annotated[Float[Array, "... 3"], "N"]
    N: Annotated[Float[Array, "... 3"], "N*m"]


@formula(
    "monograph",
    "4.1.29-4.1.43",
    correction="signs of e'_3 in (4.1.30) and of d and zeta' in (4.1.42), (4.1.43)",
    condition="zeta0 must be within d of 0",
)
def raft_drag(
    V: Annotated[Float[Array, "... 3"], Input("m/s", (0.2, 0.0, 0.0))],
    w: Annotated[Float[Array, "... 3"], Input("rad/s", (0.0, 0.0, 0.1))],
    a: HalfLength,
    b: HalfWidth,
    d: HalfHeight,
    zeta0: Annotated[Scalar, Input("m", 0.0)],
    k_lin: Annotated[Scalar, Input("N*s/m^3", 20.0, at_least=0)],
    k_quad: Annotated[Scalar, Input("N*s^2/m^4", 500.0, at_least=0)],
) -> RaftDrag:
    """Force and moment of the water on a moving raft.

    Monograph (4.1.38), (4.1.39). The bottom is wet, and so are the sides from -d up to the waterline at rest `zeta0`.

    Args:
        V: velocity of the raft's centre (m/s, body axes).
        w: angular velocity (rad/s, body axes).
        a: half length of the raft (m).
        b: half width (m).
        d: half height (m).
        zeta0: height of the waterline over the centre (m).
        k_lin: linear friction of the bottom (N s/m^3).
        k_quad: quadratic drag (N s^2/m^4).

    Returns:
        Force (N) and moment about the centre (N m), body axes; nan unless |zeta0| <= d.
    """
    Vx, Vy, Vz = jnp.moveaxis(V, -1, 0)
    p, q, r = jnp.moveaxis(w, -1, 0)
    half = jnp.where(jnp.abs(zeta0) <= d, (zeta0 + d) / 2, jnp.nan)  # of the wet part of a side
    middle = half - d
    faces = (
        (Vz, -q, p, a, b),
        (Vy - p * middle, r, -p, a, half),
        (Vx + q * middle, -r, q, b, half),
    )
    integrals = drag_integrals(*(jnp.stack(jnp.broadcast_arrays(*column), -1) for column in zip(*faces, strict=True)))
    bottom, side_y, side_x = (DragIntegrals(*(value[..., i] for value in integrals)) for i in range(3))
    area = 4 * k_lin * a * b
    slide_x, slide_y = area * (Vx - q * d), area * (Vy + p * d)
    force = [-k_quad * side_x.I - slide_x, -k_quad * side_y.I - slide_y, -k_quad * bottom.I]
    moment = [
        k_quad * (side_y.Iy + middle * side_y.I - bottom.Iy) - d * slide_y,
        k_quad * (bottom.Ix - side_x.Iy - middle * side_x.I) + d * slide_x,
        k_quad * (side_x.Ix - side_y.Ix) - area * r * (a**2 + b**2) / 3,
    ]
    return RaftDrag(jnp.stack(jnp.broadcast_arrays(*force), -1), jnp.stack(jnp.broadcast_arrays(*moment), -1))
