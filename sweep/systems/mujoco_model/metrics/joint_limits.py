"""Time that joints spend at the ends of their ranges."""

from sweep.systems.mujoco_model.tick import Array, ModelTick, make_step_share_metric, sum_share_at_limit


def sum_joint_share_at_limit(ctx: ModelTick) -> Array:
    """Yield the share of joints (n,) at an end of their range, summed over physics steps."""
    positions = ctx.steps["qpos"][..., ctx.parts.limited_positions]
    return sum_share_at_limit(positions, ctx.limits["jnt_range"][:, ctx.parts.limited_joints])


METRIC = make_step_share_metric(
    sum_joint_share_at_limit,
    "joint_limit_share",
    "share of the steps, over all joints with a range, at an end of it",
    needs=("joint_limits",),
)
