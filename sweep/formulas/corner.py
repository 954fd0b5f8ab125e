"""Standing on a vertical corner or pole by squeezing it: monograph 2.1.

Four feet stand in two symmetric pairs, one above the other, on walls that make the angle 2 psi (psi = 0 is a pole);
eps is the distance of the mass centre from the line of support over the height between the pairs, called ϰ in (2.1.4)
and ε in (2.1.6). Forces are in units of the weight P. N_u and N_d are the normal forces of an upper and a lower foot,
k_zeta and k_tau the vertical and horizontal friction forces over the normal one.
"""

from typing import Annotated, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.formulas.formula import Input, Scalar, formula, positive_input

_CONDITION = "k must be greater than tan(psi)"
CornerHalfAngle = Annotated[Scalar, Input("rad", np.pi / 4, at_least=0, below=np.pi / 2)]
FootOffset = Annotated[Scalar, positive_input("", 0.4)]
Friction = Annotated[Scalar, positive_input("", 1.1)]


class BalancedCornerForces(NamedTuple):
    """Result of `corner_balanced`: force coefficients k_zeta, k_tau, and normal forces of upper and lower feet (P)."""

    k_zeta: Annotated[Float[Array, "..."], ""]
    k_tau: Annotated[Float[Array, "..."], ""]
    N_u: Annotated[Float[Array, "..."], "P"]
    N_d: Annotated[Float[Array, "..."], "P"]


@formula("monograph", "2.1.1-2.1.6", condition=_CONDITION)
def corner_balanced(psi: CornerHalfAngle, eps: FootOffset, k: Friction) -> BalancedCornerForces:
    """Foot forces on a corner, or a pole (psi = 0), by the balanced scheme, which hold the robot at friction k.

    The balanced scheme where friction k is used up. Nan unless k > tan psi.

    With k_tau = k cos t, k_zeta = k sin t, (2.1.6) becomes cos(2 t + shift) = const, hence no iteration. The normal
    forces follow from k_tau by (2.1.4) in the form that survives psi -> 0.
    """
    c, s = jnp.cos(psi), jnp.sin(psi)
    radius, shift = jnp.hypot(c / 2, eps), jnp.arctan2(eps, c / 2)
    angle = (jnp.arccos((s**2 / (c * k**2) - c / 2) / radius) - shift) / 2
    k_zeta = jnp.where(c * k > s, k * jnp.sin(angle), jnp.nan)
    k_tau = k * jnp.cos(angle)
    lean = k_zeta * eps
    root = jnp.hypot(s, lean)
    N_u = 1 / (2 * k_zeta * (1 + lean / (root + s)))
    N_d = eps / (2 * (lean + root + s))
    return BalancedCornerForces(k_zeta, k_tau, N_u, N_d)


class LeastFrictionCoefficient(NamedTuple):
    """Result of `corner_least_friction`: least coefficient of friction, and its vertical and horizontal components."""

    k: Annotated[Float[Array, "..."], ""]
    k_zeta: Annotated[Float[Array, "..."], ""]
    k_tau: Annotated[Float[Array, "..."], ""]


@formula("monograph", "2.1.7-2.1.8")
def corner_least_friction(
    psi: CornerHalfAngle, eps: FootOffset, squeeze: Annotated[Scalar, positive_input("P", 3.16)]
) -> LeastFrictionCoefficient:
    """Least friction of the balanced scheme under a limit on the normal force.

    No normal force may pass `squeeze` (in P).
    The inverse of `corner_balanced`, whose larger normal force is N_u.
    """
    c, s = jnp.cos(psi), jnp.sin(psi)
    total = 2 * squeeze * (2 * s * squeeze + eps) / (4 * s * squeeze + eps)
    k_zeta = 1 / (2 * total)
    k_tau = (k_zeta * eps + jnp.hypot(s, k_zeta * eps)) / c
    return LeastFrictionCoefficient(jnp.hypot(k_tau, k_zeta), k_zeta, k_tau)


class EqualNormalForces(NamedTuple):
    """Result of `corner_equalN`: force coefficients, and the normal force N of all feet in units of P."""

    k_zeta: Annotated[Float[Array, "..."], ""]
    k_tau_u: Annotated[Float[Array, "..."], ""]
    k_tau_d: Annotated[Float[Array, "..."], ""]
    N: Annotated[Float[Array, "..."], "P"]


@formula("monograph", "2.1", condition=_CONDITION)
def corner_equalN(psi: CornerHalfAngle, eps: FootOffset, k: Friction) -> EqualNormalForces:
    """Foot forces on a corner or pole with equal normal forces, which hold the robot at friction k.

    One normal force for all feet, the upper ones at the limit of friction k: second scheme of monograph 2.1.

    Nan unless k > tan psi.
    """
    c, s = jnp.cos(psi), jnp.sin(psi)
    spare = (c * k) ** 2 - s**2
    k_zeta = spare / (2 * eps * s + jnp.sqrt((2 * eps * s) ** 2 + (4 * eps**2 + c**2) * spare))
    k_zeta = jnp.where(c * k > s, k_zeta, jnp.nan)
    return EqualNormalForces(k_zeta, (-2 * eps * k_zeta - s) / c, (2 * eps * k_zeta - s) / c, 1 / (4 * k_zeta))


class LeastSqueezeForce(NamedTuple):
    """Result of `corner_min_squeeze`: larger normal force of the best force distribution, in units of the load P."""

    Nhat: Annotated[Float[Array, "..."], "P"]


@formula(
    "monograph",
    "2.1.1-2.1.3",
    correction="called optimal in 2.1, the balanced scheme squeezes more than this (3.16 P against 2.83 P)",
    condition=_CONDITION,
)
def corner_min_squeeze(psi: CornerHalfAngle, eps: FootOffset, k: Friction) -> LeastSqueezeForce:
    """Least force with which feet must squeeze a corner or pole so that the robot is in equilibrium.

    Of *all* equilibria of the four feet, in P; less than both schemes of monograph 2.1.
    Averaging an equilibrium with its mirror image squeezes no more, so only symmetric ones matter. There the moment
    fixes the horizontal pull of a pair, +-eps/2 a foot, and what friction is left carries the weight. Both vertical
    forces grow with the normal force if k > tan psi (nan otherwise), so that all feet press alike: either the upper
    feet are just able to pull and the lower ones carry everything, or all use their friction up.
    """
    c, s = jnp.cos(psi), jnp.sin(psi)
    spare = (c * k) ** 2 - s**2
    pull = eps / (2 * (k * c - s))
    lifted = 2 * jnp.sqrt(jnp.maximum(spare * pull**2 + eps * s * pull - eps**2 / 4, 0.0)) / c
    shared_below = c**2 * spare - (2 * eps * s) ** 2
    shared = c * jnp.hypot(c, 2 * eps) / (4 * jnp.sqrt(jnp.where(shared_below > 0, shared_below, 1.0)))
    return LeastSqueezeForce(jnp.where(c * k > s, jnp.where(lifted >= 1, pull, shared), jnp.nan))
