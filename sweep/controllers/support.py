"""Programmed support: how free bodies are meant to move during a stage, where feet do not just follow them as seen.

What stands on the ground and on a body at once would let the body go wherever it drifts, had it to follow it; and what
is to push a body must go ahead of it. The frames of such a stage are those of the body as it is meant to be.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from sweep.core.rotations import about_vertical, conjugate, exponential, heading, logarithm, multiply
from sweep.formulas import stepping
from sweep.models.obstacles.surface import FreeState

# a body is: where it is seen; going over to a velocity; going to a pose; rolling along with the others; held where it
# was meant to be when the stage before ended; one that floats: going to a pose, but along the world's y axis and in
# height where it is
MEASURED, TO_VELOCITY, TO_POSE, TOGETHER, KEPT, ALONGSIDE = range(6)
STILL, LEVEL = np.zeros(3, np.float32), np.array([1, 0, 0, 0], np.float32)
LOWEST = np.array([-np.inf, -np.inf, 0], np.float32)  # m/s, least velocity of what stands on a floor


class Support(NamedTuple):
    """How a free body is meant to move from where it is seen when a stage begins; of a plan, over S stages, k bodies.

    To the velocity (with its rate of turning) that it has at the stage's end, at constant acceleration: monograph
    (3.3.5), also to rest. Not from one into the floor: a body that chatters on it falls for a step now and then, and
    would be meant to go on and sink by millimetres. To a pose, spent by lambda_1. Together: as the mean of all bodies
    has moved and turned. Kept: not from where it is seen, so that it is pulled back there.
    """

    mode: Int[Array, "*b"] | int = MEASURED
    velocity: Float[Array, "*b 3"] | np.ndarray = STILL  # m/s
    turn: Float[Array, "*b 3"] | np.ndarray = STILL  # rad/s
    position: Float[Array, "*b 3"] | np.ndarray = STILL  # m
    quat: Float[Array, "*b 4"] | np.ndarray = LEVEL


RESTS, STAYS = Support(TO_VELOCITY), Support(KEPT)


def meant(support: Support, start: FreeState, seen: FreeState, clock: Array, duration: Array) -> FreeState:
    """Free bodies `clock` s into a stage that began with `start`, as its `support` (k,) means them to be.

    Once the stage's time is over, they keep the pose that they were to have.
    """
    time = jnp.minimum(clock, duration)
    share = time / duration
    first = jnp.maximum(start.velocity, LOWEST)
    goes, turns = (then - now for then, now in ((support.velocity, first), (support.turn, start.turn)))
    to_velocity = FreeState(
        start.position + time * (first + 0.5 * share * goes),
        multiply(exponential(time * (start.turn + 0.5 * share * turns)), start.quat),
        first + share * goes,
        start.turn + share * turns,
    )
    done, rate = stepping.lambda_1(share, 0.0, 1.0)
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


def placed(support: Support, start: FreeState) -> Support:
    """`support` with bodies that go alongside as ones that go to a pose, which is found at the `start` of the stage."""
    alongside = jnp.asarray(support.mode) == ALONGSIDE
    kept = alongside[..., None] & (np.arange(3) > 0)
    return support._replace(
        mode=jnp.where(alongside, TO_POSE, support.mode), position=jnp.where(kept, start.position, support.position)
    )


def floating(meant: FreeState, seen: FreeState) -> FreeState:
    """Free bodies as they are `meant` to be in the plane; water carries them: height and tilt are as they are seen."""
    ahead = jax.vmap(heading)(multiply(meant.quat, conjugate(seen.quat)))
    upright = np.array([0.0, 0.0, 1.0], np.float32)
    return FreeState(
        jnp.where(upright > 0, seen.position, meant.position),
        multiply(jax.vmap(about_vertical)(ahead), seen.quat),
        jnp.where(upright > 0, seen.velocity, meant.velocity),
        jnp.where(upright > 0, meant.turn, seen.turn),
    )


def begun(support: Support, meant: FreeState, seen: FreeState) -> FreeState:
    """Free bodies with which a stage of `support` (k,) begins, after one that has meant them to be as in `meant`."""
    kept = jnp.asarray(support.mode) == KEPT
    return FreeState(*[jnp.where(kept[:, None], a, b) for a, b in zip(meant, seen, strict=True)])
