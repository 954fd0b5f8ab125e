"""Load of the drives: torques, time in saturation, work; angles, rates and power of the joints."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.core.metric import Cause, Metric
from sweep.core.shared_metrics import joint_speed, joint_torque, work
from sweep.metrics.tick import BRIEF, MetricTick, Rollout, RolloutStart
from sweep.models.legs import KINDS


class Drives(NamedTuple):
    """For each kind of joint the largest torque (N m) and the time in saturation (s); the positive work (J).

    The largest turn of a leg (rad), rate (rad/s) and power (W) of a joint. By kind of joint the torque over its limit
    that legs take in the mean, lately; and the least that it was away from 1.
    """

    torque: Float[Array, " 3"]
    saturated: Float[Array, " 3"]
    effort: Float[Array, ""]
    turn: Float[Array, ""]
    rate: tuple[Float[Array, ""]]
    power: Float[Array, ""]
    use: Float[Array, " 3"]
    reserve: Float[Array, ""]


def begin(start: RolloutStart) -> Drives:
    """Initial state, before the first tick."""
    torque, effort, speed = (part.METRIC.begin(start) for part in (joint_torque, work, joint_speed))
    zero, kinds = start.constant(0.0), start.constant(np.zeros(3))
    return Drives(torque, kinds, effort, zero, speed, zero, kinds, start.constant(1.0))


def update(state: Drives, ctx: MetricTick) -> Drives:
    """Update peaks over the legs, and times averaged over them. Power is a tick's mean, angles are those at its end."""
    tick, world = ctx.tick, ctx.world
    limit = world.execution.torque_scale * world.drive.torque_limit
    use = jnp.mean(tick.torque_peak, axis=0) / jnp.maximum(limit, 1e-9)
    use = state.use + min(1.0, ctx.period / BRIEF) * (use - state.use)
    return Drives(
        joint_torque.METRIC.update(state.torque, ctx),
        state.saturated + ctx.period * jnp.mean(tick.saturated, axis=0),
        work.METRIC.update(state.effort, ctx),
        jnp.maximum(state.turn, jnp.max(jnp.abs(tick.truth.angles[:, 0]))),
        joint_speed.METRIC.update(state.rate, ctx),
        jnp.maximum(state.power, jnp.max(jnp.abs(tick.power))),
        use,
        jnp.minimum(state.reserve, 1 - jnp.max(use)),
    )


def compute(state: Drives, rollout: Rollout) -> dict[str, Array]:
    """Torque peaks, shares of time in saturation, and positive work."""
    share = state.saturated / jnp.maximum(rollout.time, 1e-9)
    speed = joint_speed.METRIC.compute(state.rate, rollout)
    drive = rollout.world.drive
    return {
        **work.METRIC.compute(state.effort, rollout),
        **{f"torque_peak_{joint}_nm": state.torque[k] for k, joint in enumerate(KINDS)},
        **joint_torque.METRIC.compute(state.torque, rollout),
        **{f"saturation_share_{joint}": share[k] for k, joint in enumerate(KINDS)},
        "saturation_share_max": jnp.max(share),
        "torque_reserve_min": state.reserve,
        "turn_over_limit": state.turn / drive.turn_limit,
        **speed,
        "joint_speed_over_limit": speed["joint_speed_max_radps"] / drive.speed_limit,
        "joint_power_max_w": state.power,
        "joint_power_over_limit": state.power / drive.power_limit,
    }


METRIC = Metric(
    begin,
    update,
    compute,
    {
        **work.METRIC.columns,
        **{f"torque_peak_{joint}_nm": f"largest torque of a {joint} joint" for joint in KINDS},
        **joint_torque.METRIC.columns,
        **{f"saturation_share_{joint}": f"share of time at the torque limit of {joint} joints" for joint in KINDS},
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
