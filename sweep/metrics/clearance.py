"""Signed distances: base and links to the obstacle, legs to each other and to the base."""

from collections.abc import Iterator

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.core.metric import Cause, make_extremes_metric
from sweep.core.rotations import matrix
from sweep.metrics.tick import MetricContext
from sweep.models.geometry import gap_between_legs, leg_base_gap, link_capsules, thigh_shin_gap
from sweep.models.robot import base_half_size
from sweep.models.solids import distance_to_box


def least_clearances(ctx: MetricContext) -> Iterator[Float[Array, ""]]:
    """Return the least distances (m) in this tick: base and links to the obstacle, legs to each other and to the base.

    Links are `link_capsules`. Towards base and thigh they begin with a round end beyond the joint.
    """
    tick, robot = ctx.report, ctx.world.robot
    base = tick.actual.position, matrix(tick.actual.quat)
    solids = ctx.world.obstacle.solids(tick.bodies)
    links = link_capsules(tick.joints, robot).distance_to(solids)
    yield jnp.minimum(jnp.min(links), distance_to_box(solids, *base, base_half_size(robot)))
    yield gap_between_legs(tick.joints[:, -3:]) - 2 * robot.link_radius
    yield leg_base_gap(tick.joints, *base, robot)
    yield thigh_shin_gap(tick.joints, robot.fork_ratio * robot.shin + robot.link_radius) - 2 * robot.link_radius


METRIC = make_extremes_metric(
    least_clearances,
    {
        "clearance_min_m": "least distance of base and links to the obstacle, negative inside; links collide only "
        "with `engine=native engine.solid=true`",
        "leg_gap_min_m": "least distance between two legs",
        "base_gap_min_m": "least distance of a leg to the base between the hips, farther from its hip than "
        "robot.hip_clearance",
        "fold_gap_min_m": "least distance of a leg's thigh to its shin, farther from the knee than its fork is deep",
    },
    tuple(
        Cause(name, f"{what} than {figure}", figure, -5e-3, below=True, scale=0.02)
        for figure, name, what in (
            ("clearance_min_m", "link_collision", "a link or the base came closer to the obstacle"),
            ("leg_gap_min_m", "leg_crossing", "two legs came closer to each other"),
            ("base_gap_min_m", "base_hit", "a leg came closer to the base"),
            ("fold_gap_min_m", "folded", "a leg's shin came closer to its thigh"),
        )
    ),
    interval=0.02,
)
