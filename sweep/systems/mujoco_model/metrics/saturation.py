"""Time that actuators spend at their force limits."""

from sweep.systems.mujoco_model.tick import Array, ModelTick, make_step_share_metric, sum_share_at_limit


def sum_actuator_share_at_limit(ctx: ModelTick) -> Array:
    """Yield the share of actuators (n,) at their force limit, summed over physics steps."""
    chosen = ctx.parts.force_limited
    return sum_share_at_limit(ctx.steps["actuator_force"][..., chosen], ctx.limits["actuator_forcerange"][:, chosen])


METRIC = make_step_share_metric(
    sum_actuator_share_at_limit,
    "saturated_share",
    "share of the steps, over all actuators with a limit of force, at that limit",
    needs=("force_limits",),
)
