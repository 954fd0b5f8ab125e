"""A loaded raft at rest: monograph 4.1.1 with its hydrostatic moment corrected.

The raft is a box of half sides a (along x), b (along y), d (up z) in body axes with its centre at the origin. a3 =
(a31, a32, a33) is the upward vertical in body axes, `depth` the centre's depth under the water plane (m), gamma the
specific weight of water (N/m^3). The bottom is wet all over and the deck dry, which nothing here checks.
"""

from typing import Annotated, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.formulas.formula import Input, Scalar, formula, positive_input
from sweep.formulas.roots import newton_root

_QUARTER = "the moment holds 2 (zeta^2 - d^2), printed 1/2; zeta is measured along the body's axis"
_UNSTABLE = "the raft must be stable under its load: a lower load, or a wider raft"
HalfLength = Annotated[Scalar, positive_input("m", 1.575)]
HalfWidth = Annotated[Scalar, positive_input("m", 1.05)]
HalfHeight = Annotated[Scalar, positive_input("m", 0.105)]
WaterWeight = Annotated[Scalar, positive_input("N/m^3", 9810.0)]


class HydrostaticForce(NamedTuple):
    """Result of `hydro`: buoyant force (N) and its moment about the centre (N m), body axes."""

    F: Annotated[Float[Array, "... 3"], "N"]
    M: Annotated[Float[Array, "... 3"], "N*m"]


@formula("monograph", "4.1.1-4.1.4", correction=_QUARTER, condition="a31^2 + a32^2 must be less than 1")
def hydro(
    a31: Annotated[Scalar, Input("", 0.01, above=-1, below=1)],
    a32: Annotated[Scalar, Input("", 0.01, above=-1, below=1)],
    depth: Annotated[Scalar, Input("m", 0.0)],
    a: HalfLength,
    b: HalfWidth,
    d: HalfHeight,
    gamma: WaterWeight,
) -> HydrostaticForce:
    """Buoyant force and moment on a raft, tilted so that the vertical has components a31 and a32 in its axes.

    Exact. Nan if the tilt is 90 degrees or more.
    """
    return buoyancy(vertical_in_body_axes(a31, a32), depth, a, b, d, gamma)


def vertical_in_body_axes(a31: Scalar, a32: Scalar) -> Float[Array, "... 3"]:
    """Upward unit vector in body axes from its first two components; the third is positive."""
    return jnp.stack(jnp.broadcast_arrays(a31, a32, jnp.sqrt(1 - a31**2 - a32**2)), axis=-1)


def buoyancy(
    a3: Float[Array, "... 3"], depth: Scalar, a: Scalar, b: Scalar, d: Scalar, gamma: Scalar
) -> HydrostaticForce:
    """Buoyant force and moment on a raft of any tilt below 90 degrees: monograph (4.1.1)-(4.1.4), corrected.

    Args:
        a3: Upward unit vector (body axes).
        depth: Depth of the centre under the water plane (m).
        a: Half length of the raft (m).
        b: Half width (m).
        d: Half height (m).
        gamma: Specific weight of water (N/m^3).

    Returns:
        Force (N) and moment about the centre (N m), body axes.
    """
    # the water plane cuts the body's z axis at depth / a33
    a31, a32, a33 = jnp.moveaxis(a3, -1, 0)
    cut, slope_x, slope_y = depth / a33, a31 / a33, a32 / a33
    area = a * b
    I_x = -4 / 3 * slope_x * a**2 * area
    I_y = -4 / 3 * slope_y * b**2 * area
    I_z = 2 * area * (cut**2 - d**2) + 2 / 3 * area * ((slope_x * a) ** 2 + (slope_y * b) ** 2)
    force = gamma * 4 * area * (cut + d)
    moment = gamma * jnp.cross(jnp.stack(jnp.broadcast_arrays(I_x, I_y, I_z), axis=-1), a3)
    return HydrostaticForce(force[..., None] * a3, moment)


class RaftStiffness(NamedTuple):
    """Result of `hydro_thick`: restoring moment per angle about x (roll) and y (pitch); a raft with a negative one
    capsizes."""

    k_roll: Annotated[Float[Array, "..."], "N*m/rad"]
    k_pitch: Annotated[Float[Array, "..."], "N*m/rad"]


@formula(
    "monograph",
    "4.1.12-4.1.16",
    "4.2.21",
    correction="8 b^2 + 12 (zeta^2 - d^2), printed 3; (4.1.16) exchanges a and b",
)
def hydro_thick(
    a: HalfLength, b: HalfWidth, d: HalfHeight, zeta0: Annotated[Scalar, Input("m", 0.0)], gamma: WaterWeight
) -> RaftStiffness:
    """Stiffness of a level raft in roll and pitch.

    At depth zeta0 (m), load not counted.
    """
    submerged = 2 * (zeta0**2 - d**2)
    weight = jnp.asarray(gamma * a * b)
    return RaftStiffness(weight * (4 / 3 * b**2 + submerged), weight * (4 / 3 * a**2 + submerged))


class RaftEquilibrium(NamedTuple):
    """Result of `raft_equilibrium`: the upward vertical in axes of the tilted raft, and the depth of its centre (m)."""

    a31: Annotated[Float[Array, "..."], ""]
    a32: Annotated[Float[Array, "..."], ""]
    a33: Annotated[Float[Array, "..."], ""]
    depth: Annotated[Float[Array, "..."], "m"]


@formula("monograph", "4.1.5-4.1.11", "4.1.20-4.1.24", correction=_QUARTER, condition=_UNSTABLE)
def raft_equilibrium(
    P: Annotated[Scalar, positive_input("N", 6500.0)],
    r_s: Annotated[Float[Array, "... 3"], Input("m", (0.01, 0.01, 0.05))],
    a: HalfLength,
    b: HalfWidth,
    d: HalfHeight,
    gamma: WaterWeight,
) -> RaftEquilibrium:
    """Tilt and depth of a loaded raft.

    The book's fixed point for two slopes needs one number, q = (slope_x a)^2 + (slope_y b)^2, whose equation is
    increasing and concave, so that Newton's method from q = 0 converges.

    Args:
        P: weight of raft and load (N).
        r_s: point at which it acts (m, body axes).
        a: half length of the raft (m).
        b: half width (m).
        d: half height (m).
        gamma: specific weight of water (N/m^3).

    Returns:
        The upward vertical in body axes, and the depth of the centre (m); nan if the level raft is unstable.
    """
    x, y, z = jnp.moveaxis(jnp.asarray(r_s), -1, 0)
    cut = P / (4 * gamma * a * b) - d
    roll, pitch = _load_arms(P, z, a, b, d, gamma)
    growth = 2 / 3 * gamma * a * b / P

    def residual(q: Array) -> Array:
        return q - (x * a / (pitch + growth * q)) ** 2 - (y * b / (roll + growth * q)) ** 2

    q = newton_root(residual, jnp.zeros_like(roll + x + y), steps=20)
    slope_x, slope_y = -x / (pitch + growth * q), -y / (roll + growth * q)
    a33 = jnp.where((roll > 0) & (pitch > 0), 1 / jnp.sqrt(1 + slope_x**2 + slope_y**2), jnp.nan)
    return RaftEquilibrium(slope_x * a33, slope_y * a33, a33, cut * a33)


class OffsetLimit(NamedTuple):
    """Result of `raft_offset_limit`: largest distance of the robot from the raft's middle, lengthwise and sideways
    (m)."""

    delta_x: Annotated[Float[Array, "..."], "m"]
    delta_y: Annotated[Float[Array, "..."], "m"]


@formula("monograph", "4.1.25-4.1.28", correction=_QUARTER, condition=_UNSTABLE)
def raft_offset_limit(
    tilt: Annotated[Scalar, positive_input("rad", 0.03)],
    P: Annotated[Scalar, positive_input("N", 6500.0)],
    P_r: Annotated[Scalar, positive_input("N", 160.0)],
    z_s: Annotated[Scalar, Input("m", 0.05)],
    a: HalfLength,
    b: HalfWidth,
    d: HalfHeight,
    gamma: WaterWeight,
) -> OffsetLimit:
    """Largest distance of a robot from the middle of a raft, for a given tilt.

    Offsets of a robot of weight P_r (N) that tilt the raft by `tilt` (rad), small angles.

    P (N) is the whole weight, z_s (m) the height at which it acts. Nan if the level raft is unstable.
    """
    roll, pitch = (jnp.where(arm > 0, arm, jnp.nan) for arm in _load_arms(P, z_s, a, b, d, gamma))
    return OffsetLimit(tilt * pitch * P / P_r, tilt * roll * P / P_r)


def _load_arms(
    P: Scalar, z_s: Scalar, a: Scalar, b: Scalar, d: Scalar, gamma: Scalar
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Offset of the load over the angle it causes (m), in roll and in pitch: the hatted alphas of (4.1.23)."""
    stiffness = hydro_thick(a, b, d, P / (4 * gamma * a * b) - d, gamma)
    return stiffness.k_roll / P - z_s, stiffness.k_pitch / P - z_s
