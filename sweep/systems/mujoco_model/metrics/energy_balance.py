"""Growth of energy that neither actuators nor pushes caused."""

from typing import NamedTuple

from sweep.core.metric import Metric, initial_state
from sweep.systems.mujoco_model.tick import Array, ModelRollout, ModelTick


class Work(NamedTuple):
    """Power of the actuators, added up over steps (W), and work of pushes (J)."""

    power: Array
    pushes: Array


def update(state: Work, ctx: ModelTick) -> Work:
    """Add the work of a report."""
    return Work(state.power + ctx.power.sum(axis=(1, 2)), state.pushes + ctx.steps.get("push_work", 0.0))


def compute(state: Work, rollout: ModelRollout) -> dict[str, Array]:
    """Growth of energy less the work."""
    return {"energy_gained_j": rollout.gained - rollout.integral(state.power) - state.pushes}


METRIC = Metric(
    initial_state(Work, 0.0, 0.0),
    update,
    compute,
    {"energy_gained_j": "growth of mechanical energy beyond the work of actuators and pushes"},
)
