"""Unwanted contacts: contacts of parts that are listed in `model.collisions`."""

from typing import NamedTuple

from sweep.core.metric import Metric, make_begin_with_constants
from sweep.systems.mujoco_model.tick import Array, ModelRollout, ModelTick


class CollisionTotals(NamedTuple):
    """Number of physics steps with an unwanted contact, and the sum of the contact loads (N) over these steps."""

    steps_with_touch: Array
    load: Array


def update(state: CollisionTotals, ctx: ModelTick) -> CollisionTotals:
    """Add the unwanted contacts in the physics steps since the previous report."""
    touch = ctx.steps["sensordata"][..., ctx.parts.collision_sensors].sum(axis=2)
    return CollisionTotals(state.steps_with_touch + (touch > 0).sum(axis=1), state.load + touch.sum(axis=1))


def compute(state: CollisionTotals, rollout: ModelRollout) -> dict[str, Array]:
    """Return the share of physics steps with an unwanted contact, and the impulse (N s) of these, by column."""
    return {
        "collision_share": rollout.share_of_steps(state.steps_with_touch),
        "collision_impulse_ns": rollout.integrate_sum(state.load),
    }


METRIC = Metric(
    make_begin_with_constants(CollisionTotals, 0.0, 0.0),
    update,
    compute,
    {
        "collision_share": "share of the steps in which a sensor of `collisions` touched",
        "collision_impulse_ns": "load of the sensors of `collisions`, added up over time",
    },
    needs=("collisions",),
)
