"""Time that actuators spend at their force limits."""

from sweep.systems.mujoco_model.tick import Array, ModelTick, make_step_share_metric, sum_share_at_limit


def add_shares_of_actuators(ctx: ModelTick) -> Array:
    """Sum over steps the share of actuators that are at their force limit, (n,)."""
    chosen = ctx.parts.force_limited
    return sum_share_at_limit(ctx.steps["actuator_force"][..., chosen], ctx.limits["actuator_forcerange"][:, chosen])


METRIC = make_step_share_metric(
    add_shares_of_actuators,
    "saturated_share",
    "share of the steps, over all actuators with a limit of force, at that limit",
    needs=("force_limits",),
)
