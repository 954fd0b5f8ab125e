"""Estimates of the obstacle's sizes from touch, and their uncertainty at the end."""

import dataclasses

import jax.numpy as jnp
from jaxtyping import Array

from sweep.core.metric import Metric
from sweep.estimation.touch import TouchState, learnable_sizes
from sweep.metrics.tick import MetricContext, RolloutEnd, RolloutStart
from sweep.models.obstacles import OBSTACLES
from sweep.models.obstacles.surface import Obstacle


def touch_estimate(rollout: RolloutStart | MetricContext) -> TouchState:
    """Return the obstacle sizes that the robot has estimated by touch at the end of a rollout."""
    assert rollout.learned.touch is not None  # since it applies
    return rollout.learned.touch


def compute(state: TouchState, rollout: RolloutEnd) -> dict[str, Array]:
    """Return the obstacle sizes estimated by touch and their standard deviations, by column."""
    parts = ({f"learned_{n}_{u}": jnp.asarray(getattr(state.obstacle, n)),
              f"learned_{n}_sd_{u}": jnp.sqrt(state.covariance[k, k])}
             for k, (n, u) in enumerate(learnable_size_units(rollout.world.obstacle).items()))  # fmt: skip
    return {name: value for part in parts for name, value in part.items()}


def learnable_size_units(obstacle: Obstacle | type[Obstacle]) -> dict[str, str]:
    """Return the units of those sizes of an obstacle that can be learned by touch."""
    fields = {f.name: f for f in dataclasses.fields(obstacle)}  # pyright: ignore[reportArgumentType]
    return {name: fields[name].metadata["unit"] for name in learnable_sizes(obstacle)}


def _columns() -> dict[str, str]:
    """Columns of all obstacles' sizes."""
    sizes = {(n, u) for cls in OBSTACLES.values() for n, u in learnable_size_units(cls).items()}
    told = {}
    for name, unit in sorted(sizes):
        told[f"learned_{name}_{unit}"] = f"the obstacle's {name.replace('_', ' ')}, estimated from touchdowns"
        told[f"learned_{name}_sd_{unit}"] = "standard deviation of this estimate"
    return told


METRIC = Metric(
    touch_estimate,
    lambda state, ctx: touch_estimate(ctx),
    compute,
    _columns(),
    applies=lambda case: case.control.touch == "obstacle",
)
