"""The leg of the thesis: kinematics by Denavit-Hartenberg, workspace, largest step.

Angles phi (about the vertical), psi (thigh above the horizontal), gam (shin against the thigh, negative with the knee
up), rad; links l1, l2, l3 in any one unit of length. The kinematics are in the frame of (9)-(11), x outward for
phi = 0; workspace and step in the leg's frame, where the mount makes +y outward: x = -rho sin phi, y = rho cos phi.
"""

from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.formulas.formula import Input, Scalar, formula, positive_input

_WIDEST = 2 * np.pi / 3  # what the hexagon leaves to a leg


Coxa = Annotated[Scalar, positive_input("", 1.0)]
Thigh = Annotated[Scalar, positive_input("", 1.0)]
Shin = Annotated[Scalar, positive_input("", 2.0)]


class ThesisFootKinematics(NamedTuple):
    """Result of `thesis_fk`: foot position, its Jacobian by the angles (phi, psi, gam), and the determinant."""

    foot: Annotated[Float[Array, "... 3"], "length"]
    J: Annotated[Float[Array, "... 3 3"], "length/rad"]
    det: Annotated[Float[Array, "..."], "length^3"]


@formula("thesis", "1-14", correction="(14) has the wrong sign")
def thesis_fk(
    phi: Annotated[Scalar, Input("rad", 0.0)],
    psi: Annotated[Scalar, Input("rad", np.pi / 4)],
    gam: Annotated[Scalar, Input("rad", -3 * np.pi / 4)],
    l1: Coxa,
    l2: Thigh,
    l3: Shin,
) -> ThesisFootKinematics:
    """Foot, Jacobian and determinant of the thesis' leg.

    Args:
        phi: angle about the vertical (rad).
        psi: angle of the thigh above the horizontal (rad).
        gam: angle of the shin against the thigh (rad), negative with the knee up.
        l1: length of the coxa.
        l2: length of the thigh.
        l3: length of the shin.

    Returns:
        The foot in the frame of (9)-(11), its derivatives by (phi, psi, gam), and their determinant.
    """
    phi, psi, gam, l1, l2, l3 = jnp.broadcast_arrays(*map(jnp.asarray, (phi, psi, gam, l1, l2, l3)))
    c, s = jnp.cos(phi), jnp.sin(phi)
    shin = l3 * jnp.cos(psi + gam), l3 * jnp.sin(psi + gam)
    leg = l2 * jnp.cos(psi) + shin[0], l2 * jnp.sin(psi) + shin[1]
    reach = l1 + leg[0]
    foot = jnp.stack([reach * c, reach * s, leg[1]], axis=-1)
    columns = [
        jnp.stack([-reach * s, reach * c, jnp.zeros_like(reach)], axis=-1),
        jnp.stack([-leg[1] * c, -leg[1] * s, leg[0]], axis=-1),
        jnp.stack([-shin[1] * c, -shin[1] * s, shin[0]], axis=-1),
    ]
    return ThesisFootKinematics(foot, jnp.stack(columns, axis=-1), -l2 * l3 * reach * jnp.sin(gam))


def thesis_ik(foot: Float[Array, "... 3"], l1: Scalar, l2: Scalar, l3: Scalar) -> Float[Array, "... 3"]:
    """Inverse kinematics of the thesis' leg in closed form, knee up.

    Args:
        foot: The foot in the frame of the thesis (9)-(11), in the unit of the links.
        l1: Length of the coxa.
        l2: Length of the thigh.
        l3: Length of the shin.

    Returns:
        Angles (phi, psi, gam) (rad); nan out of reach.
    """
    x, y, z = jnp.moveaxis(foot, -1, 0)
    ahead = jnp.hypot(x, y) - l1
    gam = -jnp.arccos((ahead**2 + z**2 - l2**2 - l3**2) / (2 * l2 * l3))
    psi = jnp.arctan2(z, ahead) - jnp.arctan2(l3 * jnp.sin(gam), l2 + l3 * jnp.cos(gam))
    return jnp.stack([jnp.arctan2(y, x), psi, gam], axis=-1)


def thesis_ik_euler(
    start: Float[Array, " 3"], path: Float[Array, "n 3"], l1: Scalar, l2: Scalar, l3: Scalar
) -> Float[Array, "n 3"]:
    """Inverse kinematics along a path of the foot by Euler steps with the inverse Jacobian: thesis (13).

    The error grows with the length of a step; `thesis_ik` has none.

    Args:
        start: Angles (phi, psi, gam) (rad) at the path's first point.
        path: Points of the foot, in the unit of the links.
        l1: Length of the coxa.
        l2: Length of the thigh.
        l3: Length of the shin.

    Returns:
        Angles (rad) at each point.
    """

    def step(angles: Array, move: Array) -> tuple[Array, Array]:
        phi, psi, gam = angles
        angles = angles + jnp.linalg.solve(thesis_fk(phi, psi, gam, l1, l2, l3).J, move)
        return angles, angles

    start = jnp.asarray(start)
    return jnp.concatenate([start[None], jax.lax.scan(step, start, jnp.diff(path, axis=0))[1]])


class Workspace(NamedTuple):
    """Result of `thesis_workspace`: inner and outer radius from the leg's mount, and half angle of the sector (rad)."""

    OA: Annotated[Float[Array, "..."], "length"]
    OB: Annotated[Float[Array, "..."], "length"]
    phimax: Annotated[Float[Array, "..."], "rad"]


@formula(
    "thesis",
    "1.3",
    "19-20",
    correction="(19), third piece: valid up to z = sqrt(l3^2 - l2^2), not l3",
    condition="z must be within l2 + l3, and l3 greater than l2",
)
def thesis_workspace(
    z: Annotated[Scalar, Input("", -1.2928932188134525)],
    l1: Coxa,
    l2: Thigh,
    l3: Shin,
    R: Annotated[Scalar, positive_input("", 2.0)],
) -> Workspace:
    """Inner and outer radius and half angle of a leg's workspace at a height.

    Args:
        z: height of the foot over the mount.
        l1: length of the coxa.
        l2: length of the thigh.
        l3: length of the shin.
        R: distance between the mounts.

    Returns:
        The radii from the mount, and the half angle of the sector (rad); nan if z is out of reach or l3 <= l2, for
        which the section has another shape.
    """
    z, l1, l2, l3, R = jnp.broadcast_arrays(*map(jnp.asarray, (z, l1, l2, l3, R)))
    reach = jnp.where((jnp.abs(z) <= l2 + l3) & (l3 > l2), l2 + l3, jnp.nan)
    folded = jnp.where((l2 - l3 <= z) & (z < 0), _leg_of_triangle(l3 - l2, z), 0.0)
    raised = jnp.where((z >= 0) & (z**2 < l3**2 - l2**2), _leg_of_triangle(l3, z) - l2, 0.0)
    span = 2 * (l1 + reach)
    meets = span > R
    overlap = jnp.where(meets, jnp.arccos(jnp.where(meets, R / span, 0.0)), 0.0)
    return Workspace(l1 + folded + raised + 0 * reach, l1 + _leg_of_triangle(reach, z), _WIDEST - overlap)


def _leg_of_triangle(hypotenuse: Array, other: Array) -> Array:
    """sqrt(hypotenuse^2 - other^2), 0 where that is negative."""
    square = (hypotenuse - other) * (hypotenuse + other)
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), square * 0)


class LargestThesisStep(NamedTuple):
    """Result of `thesis_step`: the longest moves of a foot in support and in transfer."""

    support: Annotated[Float[Array, "..."], "length"]
    transfer: Annotated[Float[Array, "..."], "length"]


@formula(
    "thesis",
    "2.3",
    "18",
    "21",
    correction="2.3: sign of the cut by the sector, both its edges, root of the radii; (21): cos > cos(phi_max)",
    condition="r0 must lie in the sector, and p not be zero",
)
def thesis_step(
    r0: Annotated[Float[Array, "... 2"], Input("length", (0.0, 1.7071067811865475))],
    p: Annotated[Float[Array, "... 2"], Input("", (1.0, 0.0))],
    OA: Annotated[Scalar, positive_input("length", 1.0)],
    OB: Annotated[Scalar, positive_input("length", 3.7071067811865475)],
    phimax: Annotated[Scalar, positive_input("rad", 0.7762790307403773, below=np.pi)],
) -> LargestThesisStep:
    """Largest step of a foot, in support and in transfer.

    The foot goes from r0 along p in the sector OA <= r <= OB, at most phimax from +y.

    Args:
        r0: start of the step, in the leg's frame.
        p: direction of the step.
        OA: inner radius of the sector.
        OB: outer radius.
        phimax: half angle of the sector (rad).

    Returns:
        `support`, the longest step that stays inside, and `transfer`, the longest one that ends inside: a swing may
        pass over the inner circle. Nan if r0 is outside.
    """
    r0, p = jnp.asarray(r0), jnp.asarray(p)
    p = p / jnp.linalg.norm(p, axis=-1, keepdims=True)
    nearest = -_dot(r0, p)  # how far along p the line is closest to the origin
    passing = jnp.abs(r0[..., 0] * p[..., 1] - r0[..., 1] * p[..., 0])

    def inside_sector(length: Array) -> Array:
        x, y = jnp.moveaxis(r0 + length[..., None] * p, -1, 0)
        return jnp.abs(jnp.arctan2(x, y)) <= phimax

    outer = nearest + _leg_of_triangle(jnp.asarray(OB), passing)
    inner = nearest - _leg_of_triangle(jnp.asarray(OA), passing)
    exits = [
        (outer, inside_sector(outer)),
        (inner, (nearest > 0) & (passing < OA) & inside_sector(inner)),
    ]
    for side in (1, -1):
        edge = jnp.stack(jnp.broadcast_arrays(side * jnp.sin(phimax), jnp.cos(phimax)), axis=-1)
        outward = jnp.stack([side * edge[..., 1], -side * edge[..., 0]], axis=-1)
        leaving = _dot(p, outward) > 0
        length = jnp.where(leaving, -_dot(r0, outward) / jnp.where(leaving, _dot(p, outward), 1.0), 0.0)
        along = _dot(r0 + length[..., None] * p, edge)
        ahead = length > -1e-6 * OB  # a sector wider than a half-plane has a border behind the foot, too
        exits.append((length, leaving & ahead & (along >= OA) & (along <= OB)))
    radius, angle = jnp.linalg.norm(r0, axis=-1), jnp.arctan2(r0[..., 0], r0[..., 1])
    started = (radius >= OA) & (radius <= OB) & (jnp.abs(angle) <= phimax)
    lengths = jnp.stack(jnp.broadcast_arrays(*(length for length, _ in exits)), axis=-1)
    valid = jnp.stack(jnp.broadcast_arrays(*(valid for _, valid in exits)), axis=-1)
    first = jnp.where(valid, lengths, jnp.inf).min(-1)
    last = jnp.where(valid, lengths, -jnp.inf).max(-1)
    return LargestThesisStep(jnp.where(started, first, jnp.nan), jnp.where(started, last, jnp.nan))


def _dot(u: Array, v: Array) -> Array:
    return (u * v).sum(-1)
