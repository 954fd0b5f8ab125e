"""Free bodies as they are meant to be during a stage.

What stands on the ground and on a body at once would let the body go wherever it drifts, had it to follow it; and what
is to push a body must go ahead of it. The frames of such a stage are those of the body as it is meant to be.
"""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from sweep.controllers.frames import Stance
from sweep.controllers.layers import Layer
from sweep.controllers.plan import ALONGSIDE, KEPT, TO_POSE, Plan, Support
from sweep.core.rotations import about_vertical, conjugate, exponential, heading, logarithm, multiply
from sweep.formulas import stepping
from sweep.models.obstacles.surface import FreeState

LOWEST = (-np.inf, -np.inf, 0.0)  # m/s, least velocity of what stands on a floor


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Programme(Layer):
    """How they move, over S stages, where a stage says anything of it. The state is how they were as it began."""

    support: Support  # leading axes (s, k), of every body
    # whether water carries them: height and tilt are then as they are seen, whatever a stage means
    afloat: bool = field(metadata={"static": True})

    def begun(self, start: Stance, joints: Float[Array, "6 3"], free: FreeState) -> FreeState:
        """The state: bodies as they start."""
        return free

    def borne(
        self, plan: Plan, own: FreeState, stage: Int[Array, ""], clock: Float[Array, ""], free: FreeState
    ) -> FreeState:
        """Bodies as the stage means them to be."""
        here = jax.tree.map(lambda x: x[stage], self.support)
        return (floating if self.afloat else meant)(here, own, free, clock, plan.duration[stage])

    def entered(
        self, stage: Int[Array, ""], own: FreeState, was: FreeState, free: FreeState
    ) -> tuple[FreeState, FreeState]:
        """The stage begins with them as they are seen, or were meant to be."""
        kept = jnp.asarray(self.support.mode)[stage] == KEPT
        began = FreeState(*[jnp.where(kept[:, None], a, b) for a, b in zip(was, free, strict=True)])
        return began, began


def meant(support: Support, start: FreeState, seen: FreeState, clock: Array, duration: Array) -> FreeState:
    """Free bodies `clock` s into a stage that began with `start`, as its `support` (k,) means them to be.

    Once the stage's time is over, they keep the pose that they were to have.
    """
    time = jnp.minimum(clock, duration)
    share = time / duration
    first = jnp.maximum(start.velocity, jnp.asarray(LOWEST))
    goes, turns = (then - now for then, now in ((support.velocity, first), (support.turn, start.turn)))
    to_velocity = FreeState(
        start.position + time * (first + 0.5 * share * goes),
        multiply(exponential(time * (start.turn + 0.5 * share * turns)), start.quat),
        first + share * goes,
        start.turn + share * turns,
    )
    done, rate = stepping.trapezoidal_transfer(share, 0.0, 1.0)
    way, turn = support.position - start.position, logarithm(multiply(jnp.asarray(support.quat), conjugate(start.quat)))
    to_pose = FreeState(
        start.position + done * way,
        multiply(exponential(done * turn), start.quat),
        rate / duration * way,
        rate / duration * turn,
    )
    moved, turned = seen.position - start.position, logarithm(multiply(seen.quat, conjugate(start.quat)))
    together = FreeState(
        start.position + jnp.mean(moved, axis=0),
        multiply(exponential(jnp.broadcast_to(jnp.mean(turned, axis=0), turned.shape)), start.quat),
        jnp.broadcast_to(jnp.mean(seen.velocity, axis=0), seen.velocity.shape),
        jnp.broadcast_to(jnp.mean(seen.turn, axis=0), seen.turn.shape),
    )

    kept = start._replace(velocity=jnp.zeros_like(start.velocity), turn=jnp.zeros_like(start.turn))

    def chosen(*parts: Array) -> Array:
        mode = jnp.broadcast_to(jnp.asarray(support.mode)[..., None], parts[0].shape)
        return jnp.select([mode == k for k in range(KEPT)], parts[:KEPT], parts[KEPT])

    return FreeState(*[chosen(*parts) for parts in zip(seen, to_velocity, to_pose, together, kept, strict=True)])


def floating(support: Support, start: FreeState, seen: FreeState, clock: Array, duration: Array) -> FreeState:
    """Free bodies as they are `meant` to be in the plane; water carries them: height and tilt are as they are seen.

    Those that go alongside go to a pose that is found at the `start` of the stage.
    """
    alongside = jnp.asarray(support.mode) == ALONGSIDE
    kept = alongside[..., None] & (np.arange(3) > 0)
    position = jnp.where(kept, start.position, support.position)
    support = support._replace(mode=jnp.where(alongside, TO_POSE, support.mode), position=position)
    plane = meant(support, start, seen, clock, duration)
    ahead = jax.vmap(heading)(multiply(plane.quat, conjugate(seen.quat)))
    upright = np.array([False, False, True])
    return FreeState(
        jnp.where(upright, seen.position, plane.position),
        multiply(jax.vmap(about_vertical)(ahead), seen.quat),
        jnp.where(upright, seen.velocity, plane.velocity),
        jnp.where(upright, plane.turn, seen.turn),
    )
