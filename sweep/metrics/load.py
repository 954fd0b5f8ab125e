"""Contact forces of the feet: used friction, and normal forces."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.core.constants import FOOT_LOAD_THRESHOLD_N, GRAVITY
from sweep.core.metric import Metric, make_begin_with_constants
from sweep.metrics.tick import FORCE_FILTER_TIME_S, MetricContext, RolloutEnd
from sweep.models.obstacles.surface import surface_at
from sweep.models.robot import total_mass


class FootLoads(NamedTuple):
    """State of the foot load metrics: peak friction ratio and its time integral (s), peak normal force over weight.

    Sums over the feet of tangential force and of what friction allows (N), lately, and the least reserve they left.
    """

    largest_friction: Float[Array, ""]
    friction_use_integral: Float[Array, ""]
    largest_normal: Float[Array, ""]
    filtered_tangential: Float[Array, ""]
    filtered_friction_limit: Float[Array, ""]
    least_reserve: Float[Array, ""]


def update(state: FootLoads, ctx: MetricContext) -> FootLoads:
    """Update the peaks and time integrals of the foot loads with the mean foot forces of this tick."""
    tick, weight = ctx.report, GRAVITY * total_mass(ctx.world.robot)
    demand = jnp.where(
        tick.normal > FOOT_LOAD_THRESHOLD_N, tick.tangential / jnp.maximum(tick.normal, FOOT_LOAD_THRESHOLD_N), 0.0
    )
    use = jnp.sum(tick.tangential) / jnp.maximum(jnp.sum(tick.normal), FOOT_LOAD_THRESHOLD_N)
    feet = tick.joints[:, -1]
    friction = ctx.world.contact.friction * surface_at(ctx.world.obstacle, feet, tick.bodies).friction_scale
    lately = min(1.0, ctx.period / FORCE_FILTER_TIME_S)
    taken = state.filtered_tangential + lately * (jnp.sum(tick.tangential) - state.filtered_tangential)
    allowed = state.filtered_friction_limit + lately * (jnp.sum(friction * tick.normal) - state.filtered_friction_limit)
    return FootLoads(
        jnp.maximum(state.largest_friction, jnp.max(demand)),
        state.friction_use_integral + ctx.period * use,
        jnp.maximum(state.largest_normal, jnp.max(tick.normal) / weight),
        taken,
        allowed,
        jnp.minimum(state.least_reserve, 1 - taken / jnp.maximum(allowed, FOOT_LOAD_THRESHOLD_N)),
    )


def compute(state: FootLoads, rollout: RolloutEnd) -> dict[str, Array]:
    """Return friction ratios (peak, mean), peak normal force over weight, and friction reserve, by column."""
    return {
        "friction_demand_max": state.largest_friction,
        "friction_demand_mean": state.friction_use_integral / jnp.maximum(rollout.time, 1e-9),
        "normal_max_over_weight": state.largest_normal,
        "friction_reserve_min": state.least_reserve,
    }


METRIC = Metric(
    make_begin_with_constants(FootLoads, 0.0, 0.0, 0.0, 0.0, FOOT_LOAD_THRESHOLD_N, 1.0),
    update,
    compute,
    {
        "friction_demand_max": "largest ratio of tangential to normal force of a loaded foot, tick means; equals the "
        "friction coefficient when a foot slides",
        "friction_demand_mean": "ratio of tangential to normal force, each summed over the feet, averaged over time",
        "normal_max_over_weight": "largest normal force of a foot over the robot's weight",
        "friction_reserve_min": "least of 1 minus tangential force over what friction allows, each summed over the "
        "feet, over 50 ms",
    },
)
