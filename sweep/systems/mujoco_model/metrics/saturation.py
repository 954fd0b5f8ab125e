"""Time that actuators spend at their limits of force."""

from sweep.core.metric import Metric, initial_state
from sweep.systems.mujoco_model.tick import Array, ModelTick, share_at_limit


def update(state: Array, ctx: ModelTick) -> Array:
    """Add the shares of actuators at their limit, by step."""
    chosen = ctx.parts.force_limited
    return state + share_at_limit(
        ctx.steps["actuator_force"][..., chosen], ctx.limits["actuator_forcerange"][:, chosen]
    )


METRIC = Metric(
    initial_state(lambda count: count, 0.0),
    update,
    lambda state, rollout: {"saturated_share": rollout.share(state)},
    {"saturated_share": "share of the steps, over all actuators with a limit of force, at that limit"},
    needs=("force_limits",),
)
