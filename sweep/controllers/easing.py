"""Feet that go over to where a stage takes them to stand: a jump would have the drives kick."""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.controllers.frames import to_world
from sweep.controllers.layers import Layer, Now
from sweep.controllers.plan import Stance
from sweep.models.obstacles.surface import FreeState


class Slack(NamedTuple):
    """Where feet are on that way. World axes."""

    command: Float[Array, "6 3"]  # m, in the last tick, from the origins of their frames
    left: Float[Array, "6 3"]  # m, from where they stand to where they were commanded before the stage


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Ease(Layer):
    """The time in which feet go over."""

    time: Float[Array, ""]  # s

    def begun(self, start: Stance, joints: Float[Array, "6 3"], free: FreeState) -> Slack:
        """Feet that stand where they were commanded."""
        return Slack(start.feet, jnp.zeros_like(start.feet))

    def led(self, now: Now, own: Slack, target: Stance) -> tuple[Slack, Stance]:
        """The feet on their way, evenly within `time`."""
        frame, nowhere = now.plan.foot_frame, jnp.zeros((6, 3))
        was, here = (to_world(nowhere, frame[stage], now.free) for stage in (now.before, now.stage))
        left = jnp.where(now.begins, own.command + was - target.feet, own.left)
        feet = target.feet + jnp.clip(1 - now.clock / self.time, 0.0, 1.0) * left
        return Slack(feet - here, left), target._replace(feet=feet)
