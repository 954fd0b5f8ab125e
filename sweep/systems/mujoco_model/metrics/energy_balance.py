"""Growth of mechanical energy beyond the work of actuators and pushes."""

from typing import NamedTuple

from sweep.core.metric import Metric, initial_state
from sweep.systems.mujoco_model.tick import Array, ModelRollout, ModelTick


class Work(NamedTuple):
    """Power of the actuators summed over steps (W), and work of the pushes (J)."""

    power: Array
    pushes: Array


def update(state: Work, ctx: ModelTick) -> Work:
    """Add the actuator power and the work of pushes since the previous report."""
    return Work(state.power + ctx.power.sum(axis=(1, 2)), state.pushes + ctx.steps.get("push_work", 0.0))


def compute(state: Work, rollout: ModelRollout) -> dict[str, Array]:
    """Return the growth of mechanical energy beyond the work of actuators and pushes (J), by column."""
    return {"energy_gained_j": rollout.gained - rollout.integral(state.power) - state.pushes}


METRIC = Metric(
    initial_state(Work, 0.0, 0.0),
    update,
    compute,
    {"energy_gained_j": "growth of mechanical energy beyond the work of actuators and pushes"},
)
