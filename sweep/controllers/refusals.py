"""What is refused: plans that cannot be, by plain numbers, before anything compiles."""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.controllers.frames import Stance
from sweep.controllers.plan import Plan, ends
from sweep.controllers.posture import joint_targets
from sweep.core.errors import InputError
from sweep.fused.numbers import worked_out
from sweep.models.case import Case
from sweep.models.obstacles.surface import FreeState


def plain(*parts: Any) -> bool:
    """Whether all numbers of these are plain ones: those of a rollout that is compiled are not, nor those of draws."""
    return all(isinstance(x, float) for x in jax.tree.leaves(parts))


def at_ends(plan: Plan, free: FreeState) -> dict[str, Stance]:
    """Stances at the ends of a plan's stages, bodies as `free`, by words that say when."""
    last = ends(plan, free)
    return {f"at the end of stage {name}": Stance(*(x[k] for x in last)) for k, name in enumerate(plan.names)}


def refuse_reach(belief: Case, stances: Callable[[], Mapping[str, Stance]], said: str = "") -> None:
    """Raise `InputError`, which begins by what is `said`, where a foot is out of reach, by plain numbers.

    `stances` has those of the plan (world axes) by words that say when.
    """
    if not plain(belief.robot, belief.obstacle, belief.manoeuvre):
        return
    words = []

    def shortfalls() -> Float[Array, "n 6"]:
        found = stances()
        words[:] = found
        many = jax.tree.map(lambda *leaves: jnp.stack(leaves), *found.values())
        return jax.vmap(lambda stance: joint_targets(belief.robot, stance)[1])(many)

    lacks = worked_out(shortfalls)
    if not lacks.max() <= 0:
        stage, foot = np.unravel_index(lacks.argmax(), lacks.shape)
        raise InputError(f"{said}foot {foot + 1} is {lacks.max():.3f} m out of reach {words[stage]}")
