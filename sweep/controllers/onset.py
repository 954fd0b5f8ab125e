"""How a stage begins: where its feet are taken to stand, and what of the base's error is to fade."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sweep.controllers.feedforward import Feedforward
from sweep.controllers.observation import Observation
from sweep.controllers.plan import GRIP, KEEP, REGRIP, REZERO, Plan, Stance
from sweep.controllers.posture import feet_in_world
from sweep.core.rotations import conjugate, exponential, heading, logarithm, multiply, rotate
from sweep.formulas.leg import SIDE
from sweep.models.case import Case
from sweep.models.obstacles.surface import poses, under

LEFT = np.array([0.0, 1.0, 0.0], np.float32)  # of the base


class Begun(NamedTuple):
    """What a stage begins with, world axes."""

    feet: Float[Array, "6 3"]  # m, footholds
    error: Float[Array, " 3"]  # m, of the base
    turn: Float[Array, " 3"]  # rad, of its attitude, as a rotation vector


def begun(belief: Case, plan: Plan, following: Int[Array, ""], ended: Stance, seen: Observation) -> Begun:
    """Stage number `following` begins after one that `ended` in a stance (world axes, as planned).

    The feet of that stance are the commanded footholds, not the reached ones: that keeps the pressure on the ground.
    """
    zero = jnp.zeros(3, ended.feet.dtype)
    ways = {
        KEEP: lambda: Begun(ended.feet, zero, zero),
        REGRIP: lambda: Begun(_regripped(belief, ended.feet, seen), zero, zero),
        GRIP: lambda: Begun(_gripped(belief, ended.feet, plan.press[following], seen), zero, zero),
        REZERO: lambda: _with_error(plan, ended, seen),
    }
    first, *others = sorted(set(plan.onset))
    chosen = ways[first]()
    for name in others:
        here = jnp.asarray(np.array(plan.onset) == name)[following]
        chosen = jax.tree.map(lambda new, old, here=here: jnp.where(here, new, old), ways[name](), chosen)
    return chosen


def _measured(belief: Case, seen: Observation) -> tuple[Array, Array, Bool[Array, " 6"]]:
    """Feet where they are measured, the normals there, and which stand on a free body.

    Along the surface also those that have not touched down yet: they are about to, as far off as the base is, which
    would otherwise be handed on from step to step.
    """
    feet = feet_in_world(belief.robot, seen.position, seen.quat, seen.angles)
    surface = under(belief.obstacle, feet, poses(seen.free))
    return feet, surface.normal, surface.body >= 0


def _regripped(belief: Case, commanded: Float[Array, "6 3"], seen: Observation) -> Float[Array, "6 3"]:
    """Feet where they are measured along the surface, and as deep as they were commanded."""
    measured, normal, _ = _measured(belief, seen)
    return measured + jnp.sum((commanded - measured) * normal, axis=-1, keepdims=True) * normal


def _gripped(
    belief: Case, commanded: Float[Array, "6 3"], press: Float[Array, " 2"], seen: Observation
) -> Float[Array, "6 3"]:
    """Feet on free bodies deeper than they are measured, and inward, to the base's middle plane.

    The others are regripped: feet on the ground need not be squeezed. A foot that bears nothing is as deep as it was
    commanded: pressed from where it hangs, it would stay in the air.
    """
    measured, normal, on_body = _measured(belief, seen)
    inward = -SIDE[:, None] * rotate(seen.quat, jnp.asarray(LEFT))
    regripped = _regripped(belief, commanded, seen)
    deep = jnp.where(seen.loaded[:, None], measured - press[0] * normal, regripped)
    return jnp.where(on_body[:, None], deep + press[1] * inward, regripped)


def _with_error(plan: Plan, ended: Stance, seen: Observation) -> Begun:
    """Feet moved with the base's error, which strains nothing, and that error: without it errors add up by stages.

    In a plan that is steered only its parts in the plane count: taken up by the standing feet and not by those that
    land, the others would put the diagonals at different heights.
    """
    error = seen.position - ended.position
    off = multiply(seen.quat, conjugate(ended.quat))
    turn = logarithm(off)
    if plan.steered:
        error, turn = error.at[2].set(0.0), jnp.zeros(3).at[2].set(heading(off))
    moved = ended.position + error + rotate(exponential(turn)[None], ended.feet - ended.position)
    anchored = plan.layer(Feedforward) is not None  # such feet need not be moved
    return Begun(ended.feet if anchored else moved, error, turn)
