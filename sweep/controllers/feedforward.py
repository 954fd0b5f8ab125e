"""Holding on with planned forces: what the controller does for them from tick to tick.

The drives are told of a force as an offset of their targets. It acts as planned only where the foothold is the place at
which the foot really stands: 1 mm off is a force as large as the robot's weight.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from sweep.controllers.frames import to_frame
from sweep.controllers.observation import Observation
from sweep.controllers.plan import Feedforward, Plan
from sweep.controllers.posture import feet_in_world
from sweep.models.obstacles.surface import FreeState
from sweep.models.robot import Robot


def anchored(
    robot: Robot,
    plan: Plan,
    feedforward: Feedforward,
    stage: Int[Array, ""],
    feet: Array,
    seen: Observation,
    free: FreeState,
    period: float,
) -> Float[Array, "6 3"]:
    """The footholds `feet` (m, in the stage's frames of the bodies as in `free`) a tick of `period` s later.

    Those of loaded standing feet follow the feet.
    """
    real = to_frame(feet_in_world(robot, seen.position, seen.quat, seen.angles), plan.foot_frame[stage], free)
    share = jnp.where(seen.loaded & ~plan.swing[stage], jnp.minimum(1.0, period / feedforward.anchoring), 0.0)
    return feet + share[:, None] * (real - feet)


def creep(plan: Plan, feedforward: Feedforward, stage: Int[Array, ""], clock: Float[Array, ""]) -> Float[Array, "6 3"]:
    """How far (m) swinging feet go on inwards while the stage waits for their touchdown."""
    late = jnp.maximum(clock - plan.duration[stage], 0.0)
    return jnp.where(plan.swing[stage][:, None], feedforward.creep * late * feedforward.inward[stage], 0.0)


def offset(feedforward: Feedforward, stage: Int[Array, ""], phase: Float[Array, ""]) -> Float[Array, "6 3"]:
    """Planned offset of the targets (rad)."""
    return between(feedforward.offset, stage, phase)


def between(moments: Float[Array, "s k 6 3"], stage: Int[Array, ""], phase: Float[Array, ""]) -> Float[Array, "6 3"]:
    """What is planned for k even moments of every stage, at `phase` (0 to 1) of one: linear between them."""
    last = moments.shape[1] - 1
    before = jnp.minimum((phase * last).astype(jnp.int32), last - 1)
    share = phase * last - before
    return (1 - share) * moments[stage, before] + share * moments[stage, before + 1]
