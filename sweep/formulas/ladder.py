"""A ladder leaning on a wall: monograph 2.2."""

from typing import Annotated, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from sweep.formulas.formula import Scalar, formula, positive_input


class LadderStatics(NamedTuple):
    """Result of `ladder`: highest position of a load, over the ladder's length, and whether that is the top."""

    chi_max: Annotated[Float[Array, "..."], ""]
    holds_for_all: Annotated[Bool[Array, "..."], ""]


@formula("monograph", "2.2.1-2.2.4")
def ladder(
    phi: Annotated[Scalar, positive_input("rad", np.deg2rad(75), below=np.pi)],
    f1: Annotated[Scalar, positive_input("", 1.0)],
    f2: Annotated[Scalar, positive_input("", 1.0)],
) -> LadderStatics:
    """Highest position at which a leaning ladder holds a load, and whether it holds one at the top.

    Monograph (2.2.1)-(2.2.4). Both contacts slide at the limit, which gives chi = f1 (tan phi + f2) / (1 + f1 f2); it
    reaches 1 exactly where tan phi >= 1/f1, the theorem of 2.2. An overhanging ladder (phi > pi/2) holds at most what
    the wall's friction carries.

    Args:
        phi: angle of the ladder to the floor (rad).
        f1: coefficient of friction on the floor.
        f2: coefficient of friction on the wall.

    Returns:
        Highest place of the load as a share of the ladder's length, and whether that is the top.
    """
    sin, cos = jnp.sin(phi), jnp.cos(phi)
    upright = jnp.abs(cos) < 1e-6
    slope = jnp.where(upright, 2 / f1, sin / jnp.where(upright, 1.0, cos))
    chi = f1 * (slope + f2) / (1 + f1 * f2)
    return LadderStatics(jnp.clip(chi, 0.0, 1.0), slope * f1 >= 1)


class LadderInclination(NamedTuple):
    """Result of `ladder_lean`: the least angle to the ground at which the ladder stands."""

    phi: Annotated[Float[Array, "..."], "rad"]


@formula("monograph", "2.2.1-2.2.4")
def ladder_lean(
    f1: Annotated[Scalar, positive_input("", 1.0)],
    f2: Annotated[Scalar, positive_input("", 1.0)],
    chi: Annotated[Scalar, positive_input("", 1.0)],
) -> LadderInclination:
    """Least inclination at which a leaning ladder holds a load.

    Least angle phi (rad) with friction f1 on the floor, f2 on the wall, and the load's weight at the share chi of the
    length. `ladder` solved for phi: tan phi = chi (1/f1 + f2) - f2. At chi = 1 that is the theorem of 2.2, cot phi =
    f1; a ladder of its own weight M under a robot of m at its top has chi = (m + M/2)/(m + M).
    """
    slope = chi * (1 / f1 + f2) - f2
    return LadderInclination(jnp.arctan(jnp.maximum(slope, 0.0)))
