"""Torques of the joints."""

from sweep.core.metric import Array, CommonRollout, CommonStart, CommonTick, Metric, array_namespace


def begin(start: CommonStart) -> Array:
    """Return the initial state: zero peak torque for each group of joints."""
    return start.constant_state([0.0] * start.torque_groups)


def update(state: Array, ctx: CommonTick) -> Array:
    """Update the largest torque of each group of joints (N m)."""
    torques = ctx.joint_torques
    xp = array_namespace(torques)
    return xp.maximum(state, xp.max(torques, axis=-2))


def compute(state: Array, rollout: CommonRollout) -> dict[str, Array]:
    """Return the largest torque (N m) of all joints, by column."""
    return {"torque_max_nm": array_namespace(state).max(state, axis=-1)}


METRIC = Metric(
    begin,
    update,
    compute,
    {"torque_max_nm": "largest torque of a drive at a hinge joint"},
    needs=("hinge_drives",),
)
