"""A loaded raft at rest: monograph 4.1.1 with its hydrostatic moment corrected.

The raft is a box of half sides a (along x), b (along y), d (up z) in body axes with its centre at the origin. a3 =
(a31, a32, a33) is the upward vertical in body axes, `depth` the centre's depth under the water plane (m), gamma the
specific weight of water (N/m^3). The bottom is wet all over and the deck dry, which nothing here checks.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.formulas.formula import Formula, Input, Scalar, positive
from sweep.formulas.roots import newton


class Hydro(NamedTuple):
    """Buoyant force (N) and its moment about the centre (N m), body axes."""

    F: Float[Array, "... 3"]
    M: Float[Array, "... 3"]


def hydro(a31: Scalar, a32: Scalar, depth: Scalar, a: Scalar, b: Scalar, d: Scalar, gamma: Scalar) -> Hydro:
    """Buoyancy of a tilted raft: monograph (4.1.2), (4.1.3), exact. Nan if the tilt is 90 degrees or more."""
    return buoyancy(upright(a31, a32), depth, a, b, d, gamma)


def upright(a31: Scalar, a32: Scalar) -> Float[Array, "... 3"]:
    """The vertical a3 (unit, body axes) with its positive third component."""
    return jnp.stack(jnp.broadcast_arrays(a31, a32, jnp.sqrt(1 - a31**2 - a32**2)), axis=-1)


def buoyancy(a3: Float[Array, "... 3"], depth: Scalar, a: Scalar, b: Scalar, d: Scalar, gamma: Scalar) -> Hydro:
    """Buoyancy for the vertical `a3`; `depth` over a33 is where the water plane cuts the body's z axis."""
    a31, a32, a33 = jnp.moveaxis(a3, -1, 0)
    cut, slope_x, slope_y = depth / a33, a31 / a33, a32 / a33
    area = a * b
    I_x = -4 / 3 * slope_x * a**2 * area
    I_y = -4 / 3 * slope_y * b**2 * area
    I_z = 2 * area * (cut**2 - d**2) + 2 / 3 * area * ((slope_x * a) ** 2 + (slope_y * b) ** 2)
    force = gamma * 4 * area * (cut + d)
    moment = gamma * jnp.cross(jnp.stack(jnp.broadcast_arrays(I_x, I_y, I_z), axis=-1), a3)
    return Hydro(force[..., None] * a3, moment)


class Stiffness(NamedTuple):
    """Restoring moment over the angle, about x (roll) and y (pitch); negative capsizes."""

    k_roll: Float[Array, "..."]
    k_pitch: Float[Array, "..."]


def hydro_thick(a: Scalar, b: Scalar, d: Scalar, zeta0: Scalar, gamma: Scalar) -> Stiffness:
    """Stiffness of a level raft at depth zeta0 (m), load not counted: monograph (4.1.12), (4.1.16), (4.2.21)."""
    submerged = 2 * (zeta0**2 - d**2)
    weight = jnp.asarray(gamma * a * b)
    return Stiffness(weight * (4 / 3 * b**2 + submerged), weight * (4 / 3 * a**2 + submerged))


class Equilibrium(NamedTuple):
    """The vertical in body axes, and the depth of the centre (m)."""

    a31: Float[Array, "..."]
    a32: Float[Array, "..."]
    a33: Float[Array, "..."]
    depth: Float[Array, "..."]


def raft_equilibrium(
    P: Scalar, r_s: Float[Array, "... 3"], a: Scalar, b: Scalar, d: Scalar, gamma: Scalar
) -> Equilibrium:
    """Raft at rest under the weight P (N, its own included) that acts at r_s (m, body axes): (4.1.21)-(4.1.24).

    The book's fixed point for two slopes needs one number, q = (slope_x a)^2 + (slope_y b)^2, whose equation is
    increasing and concave: Newton from q = 0 cannot miss it. Nan if the level raft is unstable under its load.
    """
    x, y, z = jnp.moveaxis(jnp.asarray(r_s), -1, 0)
    cut = P / (4 * gamma * a * b) - d
    roll, pitch = _load_arms(P, z, a, b, d, gamma)
    growth = 2 / 3 * gamma * a * b / P

    def residual(q: Array) -> Array:
        return q - (x * a / (pitch + growth * q)) ** 2 - (y * b / (roll + growth * q)) ** 2

    q = newton(residual, jnp.zeros_like(roll + x + y), steps=20)
    slope_x, slope_y = -x / (pitch + growth * q), -y / (roll + growth * q)
    a33 = jnp.where((roll > 0) & (pitch > 0), 1 / jnp.sqrt(1 + slope_x**2 + slope_y**2), jnp.nan)
    return Equilibrium(slope_x * a33, slope_y * a33, a33, cut * a33)


class OffsetLimit(NamedTuple):
    """How far the robot may go from the raft's middle, fore and aft and sideways (m)."""

    delta_x: Float[Array, "..."]
    delta_y: Float[Array, "..."]


def raft_offset_limit(
    tilt: Scalar, P: Scalar, P_r: Scalar, z_s: Scalar, a: Scalar, b: Scalar, d: Scalar, gamma: Scalar
) -> OffsetLimit:
    """Offsets of a robot of weight P_r (N) that tilt the raft by `tilt` (rad), small angles: (4.1.25)-(4.1.28).

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


SIZES = (
    positive("a", "m", 1.575),
    positive("b", "m", 1.05),
    positive("d", "m", 0.105),
)
WATER = positive("gamma", "N/m^3", 9810.0)
_QUARTER = "the moment holds 2 (zeta^2 - d^2), printed 1/2; zeta is measured along the body's axis"
_UNSTABLE = "the raft must be stable under its load: a lower load, or a wider raft"

FORMULAS = (
    Formula(
        "hydro",
        "buoyant force and moment on a tilted raft",
        "monograph",
        ("4.1.1-4.1.4",),
        hydro,
        (
            Input("a31", "", 0.01, above=-1, below=1),
            Input("a32", "", 0.01, above=-1, below=1),
            Input("depth", "m", 0.0),
            *SIZES,
            WATER,
        ),
        {"F": "N", "M": "N*m"},
        correction=_QUARTER,
        condition="a31^2 + a32^2 must be less than 1",
    ),
    Formula(
        "hydro_thick",
        "stiffness of a level raft in roll and pitch",
        "monograph",
        ("4.1.12-4.1.16", "4.2.21"),
        hydro_thick,
        (*SIZES, Input("zeta0", "m", 0.0), WATER),
        {"k_roll": "N*m/rad", "k_pitch": "N*m/rad"},
        correction="8 b^2 + 12 (zeta^2 - d^2), printed 3; (4.1.16) exchanges a and b",
    ),
    Formula(
        "raft_equilibrium",
        "tilt and depth of a loaded raft",
        "monograph",
        ("4.1.5-4.1.11", "4.1.20-4.1.24"),
        raft_equilibrium,
        (positive("P", "N", 6500.0), Input("r_s", "m", (0.01, 0.01, 0.05)), *SIZES, WATER),
        {"a31": "", "a32": "", "a33": "", "depth": "m"},
        correction=_QUARTER,
        condition=_UNSTABLE,
    ),
    Formula(
        "raft_offset_limit",
        "how far a robot may walk from the middle of a raft, for a given tilt",
        "monograph",
        ("4.1.25-4.1.28",),
        raft_offset_limit,
        (
            positive("tilt", "rad", 0.03),
            positive("P", "N", 6500.0),
            positive("P_r", "N", 160.0),
            Input("z_s", "m", 0.05),
            *SIZES,
            WATER,
        ),
        {"delta_x": "m", "delta_y": "m"},
        correction=_QUARTER,
        condition=_UNSTABLE,
    ),
)
