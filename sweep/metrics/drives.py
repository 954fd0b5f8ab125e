"""Load of the drives: torques, time in saturation, work; angles, rates and power of the joints."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.core.metric import Cause, Metric
from sweep.core.shared_metrics import joint_speed, joint_torque, work
from sweep.metrics.tick import FORCE_FILTER_TIME_S, MetricContext, RolloutEnd, RolloutStart
from sweep.models.legs import JOINT_KINDS


class DriveLoads(NamedTuple):
    """State of the drive metrics: peak torques (N m), times at the torque limit (s) by joint, positive work (J).

    The largest turn of a leg (rad), rate (rad/s) and power (W) of a joint. By kind of joint the torque over its limit
    that legs take in the mean, lately; and the least that it was away from 1.
    """

    peak_torque: Float[Array, " 3"]
    saturated_time: Float[Array, " 3"]
    positive_work: Float[Array, ""]
    peak_alpha: Float[Array, ""]
    peak_rate: tuple[Float[Array, ""]]
    peak_power: Float[Array, ""]
    filtered_torque_use: Float[Array, " 3"]
    least_torque_reserve: Float[Array, ""]


def begin(start: RolloutStart) -> DriveLoads:
    """Return the state of the drive metrics before the first tick: no torque, no work."""
    torque, effort, speed = (part.METRIC.begin(start) for part in (joint_torque, work, joint_speed))
    zero, kinds = start.constant_state(0.0), start.constant_state(np.zeros(3))
    return DriveLoads(torque, kinds, effort, zero, speed, zero, kinds, start.constant_state(1.0))


def update(state: DriveLoads, ctx: MetricContext) -> DriveLoads:
    """Update peak joint torques, time at the torque limit averaged over legs, and positive work of the drives."""
    tick, world = ctx.report, ctx.world
    limit = world.execution.torque_scale * world.drive.torque_limit
    use = jnp.mean(tick.torque_peak, axis=0) / jnp.maximum(limit, 1e-9)
    use = state.filtered_torque_use + min(1.0, ctx.period / FORCE_FILTER_TIME_S) * (use - state.filtered_torque_use)
    return DriveLoads(
        joint_torque.METRIC.update(state.peak_torque, ctx),
        state.saturated_time + ctx.period * jnp.mean(tick.saturated, axis=0),
        work.METRIC.update(state.positive_work, ctx),
        jnp.maximum(state.peak_alpha, jnp.max(jnp.abs(tick.actual.angles[:, 0]))),
        joint_speed.METRIC.update(state.peak_rate, ctx),
        jnp.maximum(state.peak_power, jnp.max(jnp.abs(tick.power))),
        use,
        jnp.minimum(state.least_torque_reserve, 1 - jnp.max(use)),
    )


def compute(state: DriveLoads, rollout: RolloutEnd) -> dict[str, Array]:
    """Return peak joint torques, shares of time at the torque limit, and the drives' positive work, by column."""
    share = state.saturated_time / jnp.maximum(rollout.time, 1e-9)
    speed = joint_speed.METRIC.compute(state.peak_rate, rollout)
    drive = rollout.world.drive
    return {
        **work.METRIC.compute(state.positive_work, rollout),
        **{f"torque_peak_{joint}_nm": state.peak_torque[k] for k, joint in enumerate(JOINT_KINDS)},
        **joint_torque.METRIC.compute(state.peak_torque, rollout),
        **{f"saturation_share_{joint}": share[k] for k, joint in enumerate(JOINT_KINDS)},
        "saturation_share_max": jnp.max(share),
        "torque_reserve_min": state.least_torque_reserve,
        "turn_over_limit": state.peak_alpha / drive.turn_limit,
        **speed,
        "joint_speed_over_limit": speed["joint_speed_max_radps"] / drive.speed_limit,
        "joint_power_max_w": state.peak_power,
        "joint_power_over_limit": state.peak_power / drive.power_limit,
    }


METRIC = Metric(
    begin,
    update,
    compute,
    {
        **work.METRIC.columns,
        **{f"torque_peak_{joint}_nm": f"largest torque of a {joint} joint" for joint in JOINT_KINDS},
        **joint_torque.METRIC.columns,
        **{
            f"saturation_share_{joint}": f"share of time at the torque limit of {joint} joints" for joint in JOINT_KINDS
        },
        "saturation_share_max": "largest of the saturation shares of alpha, beta and gamma joints",
        "torque_reserve_min": "smallest value of 1 minus torque over limit, averaged over all legs and 50 ms, among "
        "alpha, beta and gamma joints",
        "turn_over_limit": "largest absolute alpha angle over drive.turn_limit",
        **joint_speed.METRIC.columns,
        "joint_speed_over_limit": "largest rate of a joint over drive.speed_limit",
        "joint_power_max_w": "largest absolute mechanical power of a joint, tick mean",
        "joint_power_over_limit": "largest absolute mechanical power of a joint over drive.power_limit",
    },
    (
        Cause(
            "overload",
            "a kind of joint was saturated for more than saturation_share_max of the time",
            "saturation_share_max",
            0.5,
            known_at="end",
        ),
        *(
            Cause(name, f"{what} {figure}_max times drive.{size}", figure, 1.0)
            for figure, size, name, what in (
                ("turn_over_limit", "turn_limit", "overturned_leg", "an alpha angle exceeded"),
                ("joint_speed_over_limit", "speed_limit", "overspeed", "a joint rate exceeded"),
                ("joint_power_over_limit", "power_limit", "overpower", "the power of a joint exceeded"),
            )
        ),
    ),
)
