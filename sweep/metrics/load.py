"""Contact forces of the feet: used friction, and normal forces."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.core.constants import GRAVITY, LOADED
from sweep.core.metric import Metric, initial_state
from sweep.metrics.tick import BRIEF, MetricTick, Rollout
from sweep.models.obstacles.surface import surface_at
from sweep.models.robot import total_mass


class Load(NamedTuple):
    """Largest tangential over normal force, its integral over time (s), largest normal force over the weight.

    Sums over the feet of tangential force and of what friction allows (N), lately, and the least reserve they left.
    """

    friction: Float[Array, ""]
    use: Float[Array, ""]
    normal: Float[Array, ""]
    taken: Float[Array, ""]
    allowed: Float[Array, ""]
    reserve: Float[Array, ""]


def update(state: Load, ctx: MetricTick) -> Load:
    """Update peaks and integrals with a tick's mean forces."""
    tick, weight = ctx.tick, GRAVITY * total_mass(ctx.world.robot)
    demand = jnp.where(tick.normal > LOADED, tick.tangential / jnp.maximum(tick.normal, LOADED), 0.0)
    use = jnp.sum(tick.tangential) / jnp.maximum(jnp.sum(tick.normal), LOADED)
    feet = tick.joints[:, -1]
    friction = ctx.world.contact.friction * surface_at(ctx.world.obstacle, feet, tick.bodies).friction_scale
    lately = min(1.0, ctx.period / BRIEF)
    taken = state.taken + lately * (jnp.sum(tick.tangential) - state.taken)
    allowed = state.allowed + lately * (jnp.sum(friction * tick.normal) - state.allowed)
    return Load(
        jnp.maximum(state.friction, jnp.max(demand)),
        state.use + ctx.period * use,
        jnp.maximum(state.normal, jnp.max(tick.normal) / weight),
        taken,
        allowed,
        jnp.minimum(state.reserve, 1 - taken / jnp.maximum(allowed, LOADED)),
    )


def compute(state: Load, rollout: Rollout) -> dict[str, Array]:
    """Peaks and means of the used friction, and the reserve."""
    return {
        "friction_demand_max": state.friction,
        "friction_demand_mean": state.use / jnp.maximum(rollout.time, 1e-9),
        "normal_max_over_weight": state.normal,
        "friction_reserve_min": state.reserve,
    }


METRIC = Metric(
    initial_state(Load, 0.0, 0.0, 0.0, 0.0, LOADED, 1.0),
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
