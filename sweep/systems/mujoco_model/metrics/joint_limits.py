"""Time that joints spend at the ends of their ranges."""

from sweep.core.metric import Metric, initial_state
from sweep.systems.mujoco_model.tick import Array, ModelTick, share_at_limit


def update(state: Array, ctx: ModelTick) -> Array:
    """Add the shares of joints at an end of their range, by step."""
    positions = ctx.steps["qpos"][..., ctx.parts.limited_positions]
    return state + share_at_limit(positions, ctx.limits["jnt_range"][:, ctx.parts.limited_joints])


METRIC = Metric(
    initial_state(lambda count: count, 0.0),
    update,
    lambda state, rollout: {"joint_limit_share": rollout.share(state)},
    {"joint_limit_share": "share of the steps, over all joints with a range, at an end of it"},
    needs=("joint_limits",),
)
