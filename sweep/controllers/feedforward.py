"""Holding on with planned forces: what the controller does for them from tick to tick.

The drives are told of a force as an offset of their targets. It acts as planned only where the foothold is the place at
which the foot really stands: 1 mm off is a force as large as the robot's weight.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from sweep.controllers.frames import to_frame
from sweep.controllers.layers import Layer, Now
from sweep.controllers.plan import Plan
from sweep.controllers.posture import feet_in_world


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Feedforward(Layer):
    """Planned foot forces as the drives are told of them, over S stages and K even moments of each."""

    offset: Float[Array, "s k 6 3"]  # rad, that the drives turn into the joint torques wanted
    imbalance: Float[Array, " s"]  # what the forces leave of the weight; more than a little where none hold it
    inward: Float[Array, "s 6 3"]  # unit vectors into the surface at the footholds
    creep: Float[Array, ""]  # m/s, of a foot that has not touched down at the end of its swing
    anchoring: Float[Array, ""]  # s, in which the foothold of a loaded foot follows the place where it really is

    def anchored(self, now: Now, feet: Float[Array, "6 3"]) -> Float[Array, "6 3"]:
        """Those of loaded standing feet follow the feet."""
        stage, seen = now.stage, now.seen
        places = feet_in_world(now.robot, seen.position, seen.quat, seen.angles)
        real = to_frame(places, now.plan.foot_frame[stage], now.free)
        share = jnp.where(seen.loaded & ~now.plan.swing[stage], jnp.minimum(1.0, now.period / self.anchoring), 0.0)
        return feet + share[:, None] * (real - feet)

    def crept(
        self, plan: Plan, stage: Int[Array, ""], clock: Float[Array, ""], feet: Float[Array, "6 3"]
    ) -> Float[Array, "6 3"]:
        """Swinging feet go on inwards while the stage waits for their touchdown."""
        late = jnp.maximum(clock - plan.duration[stage], 0.0)
        return feet + jnp.where(plan.swing[stage][:, None], self.creep * late * self.inward[stage], 0.0)

    def driven(self, now: Now, joints: Float[Array, "6 3"]) -> Float[Array, "6 3"]:
        """With the planned offset."""
        return joints + between(self.offset, now.stage, now.phase)


def between(moments: Float[Array, "s k 6 3"], stage: Int[Array, ""], phase: Float[Array, ""]) -> Float[Array, "6 3"]:
    """What is planned for k even moments of every stage, at `phase` (0 to 1) of one: linear between them."""
    last = moments.shape[1] - 1
    before = jnp.minimum((phase * last).astype(jnp.int32), last - 1)
    share = phase * last - before
    return (1 - share) * moments[stage, before] + share * moments[stage, before + 1]
