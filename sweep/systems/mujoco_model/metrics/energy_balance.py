"""Growth of mechanical energy beyond the work of actuators and pushes."""

from typing import NamedTuple

from sweep.core.metric import Metric, make_begin_with_constants
from sweep.systems.mujoco_model.tick import Array, ModelRollout, ModelTick


class AppliedWork(NamedTuple):
    """Power of the actuators summed over steps (W), and work of the pushes (J)."""

    actuator_power_sum: Array
    push_work: Array


def update(state: AppliedWork, ctx: ModelTick) -> AppliedWork:
    """Add the actuator power and the work of pushes since the previous report."""
    return AppliedWork(
        state.actuator_power_sum + ctx.power.sum(axis=(1, 2)), state.push_work + ctx.steps.get("push_work", 0.0)
    )


def compute(state: AppliedWork, rollout: ModelRollout) -> dict[str, Array]:
    """Return the growth of mechanical energy beyond the work of actuators and pushes (J), by column."""
    return {"energy_gained_j": rollout.energy_gain - rollout.integrate_sum(state.actuator_power_sum) - state.push_work}


METRIC = Metric(
    make_begin_with_constants(AppliedWork, 0.0, 0.0),
    update,
    compute,
    {"energy_gained_j": "growth of mechanical energy beyond the work of actuators and pushes"},
)
