"""Legs that follow joint angles instead of footholds."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sweep.controllers.layers import Command, Layer, Now
from sweep.controllers.plan import Stance
from sweep.controllers.posture import feet_in_world
from sweep.core.rotations import nearest
from sweep.formulas import stepping
from sweep.models.obstacles.surface import FreeState


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class HeldLegs(Layer):
    """Which legs do, and where they go, over S stages. The state is where the joints (rad) were as the stage began."""

    held: Bool[Array, "s 6"]
    joints: Float[Array, "s 6 3"]  # rad, at the end of the stage

    def begun(self, start: Stance, joints: Float[Array, "6 3"], free: FreeState) -> Float[Array, "6 3"]:
        """The joint angles (rad) at the start."""
        return joints

    def commanded(self, now: Now, own: Float[Array, "6 3"], command: Command) -> tuple[Float[Array, "6 3"], Command]:
        """These legs on their straight way in joint space, spent by lambda_1; their reach counts for nothing."""
        origin, held = jnp.where(now.begins, now.joints, own), self.held[now.stage]
        goal = nearest(self.joints[now.stage], origin)
        posed = origin + stepping.lambda_1(now.phase, 0.0, 1.0)[0] * (goal - origin)
        joints, target = jnp.where(held[:, None], posed, command.joints), command.target
        feet = feet_in_world(now.robot, target.position, target.quat, joints)
        target = target._replace(feet=jnp.where(held[:, None], feet, target.feet))
        shortfall = jnp.where(held, 0.0, command.shortfall)
        return origin, command._replace(joints=joints, target=target, shortfall=shortfall)
