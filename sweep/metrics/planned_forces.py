"""Whether foot forces within the believed friction and torque limits can hold the planned stances."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.controllers.layers import ForceFeedforward
from sweep.controllers.plan import Plan
from sweep.core.metric import Cause, Metric
from sweep.metrics.tick import RolloutEnd


def compute(state: None, rollout: RolloutEnd) -> dict[str, Array]:
    """Return by column the largest share of weight that planned forces leave unsupported, and the stage of it."""
    left = unsupported_weight(rollout.plan)
    return {"imbalance_max": jnp.max(left), "infeasible_stage": jnp.argmax(left).astype(jnp.int32)}


def unsupported_weight(plan: Plan) -> Float[Array, " s"]:
    """Return the share of the robot's weight that planned forces leave unsupported in each stage; 0 without them."""
    forces = plan.find_layer(ForceFeedforward)
    return jnp.zeros_like(plan.duration) if forces is None else forces.imbalance


METRIC = Metric(
    lambda start: None,
    lambda state, ctx: None,
    compute,
    {
        "imbalance_max": "largest part of the weight that planned forces leave unheld",
        "infeasible_stage": "number of the stage with the largest imbalance of planned forces",
    },
    (
        Cause(
            "infeasible",
            "no forces within the believed friction and torque limit hold a planned stance",
            "imbalance_max",
            0.01,
            known_at="start",
        ),
    ),
)
