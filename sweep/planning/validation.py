"""Checks that reject impossible plans before compilation, if parameters are plain numbers."""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.controllers.plan import Plan, stage_end_stances
from sweep.core.errors import InputError
from sweep.fused.numbers import evaluate_with_numpy
from sweep.models.case import Case
from sweep.models.obstacles.surface import FreeBodyState
from sweep.models.posture import Stance, joint_targets


def are_plain_numbers(*parts: Any) -> bool:
    """Return whether all leaves of some trees are plain floats, not traced or batched arrays of JAX."""
    return all(isinstance(x, float) for x in jax.tree.leaves(parts))


def stances_at_stage_ends(plan: Plan, free: FreeBodyState) -> dict[str, Stance]:
    """Return the stances (world axes) at the ends of a plan's stages, by a phrase for messages that names the stage.

    Args:
        plan: the plan.
        free: state of the free bodies at all these moments, world axes.
    """
    last = stage_end_stances(plan, free)
    return {f"at the end of stage {name}": Stance(*(x[k] for x in last)) for k, name in enumerate(plan.names)}


def require_within_reach(belief: Case, stances: Callable[[], Mapping[str, Stance]], prefix: str = "") -> None:
    """Raise an error unless the legs reach all feet in the given stances; skip the check under JAX tracing.

    Args:
        belief: believed parameters.
        stances: makes the stances (world axes), with a phrase for messages as key.
        prefix: start of the message.

    Raises:
        InputError: a foot is out of reach.
    """
    if not are_plain_numbers(belief.robot, belief.obstacle, belief.manoeuvre, belief.plan):
        return
    words = []

    def shortfalls() -> Float[Array, "n 6"]:
        named = stances()
        words[:] = named
        many = jax.tree.map(lambda *leaves: jnp.stack(leaves), *named.values())
        return jax.vmap(lambda stance: joint_targets(belief.robot, stance)[1])(many)

    lacks = evaluate_with_numpy(shortfalls)
    if not lacks.max() <= 0:
        stage, foot = np.unravel_index(lacks.argmax(), lacks.shape)
        raise InputError(f"{prefix}foot {foot + 1} is {lacks.max():.3f} m out of reach {words[stage]}")
