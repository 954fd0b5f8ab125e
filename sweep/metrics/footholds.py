"""Error of the final footholds against the plan."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.controllers.frames import points_to_world
from sweep.core.metric import Metric, SmoothMarginMetric
from sweep.metrics.tick import MetricContext, RolloutEnd, RolloutStart, make_goal_cause
from sweep.models.obstacles.surface import FreeBodyState, body_poses, surface_at

# m, within which a foot that may hover, since others carry, is at a face: what a base off by 2 degrees makes of the
# feet beside it, and half the height of a swing
FACE_TOLERANCE_M = 0.02

FinalPositions = tuple[Float[Array, "6 3"], FreeBodyState]  # feet (m) and free bodies


def begin(start: RolloutStart) -> FinalPositions:
    """Return the metric's state: positions of the feet and poses of the free bodies at the start."""
    return start.feet, start.free


def update(state: FinalPositions, ctx: MetricContext) -> FinalPositions:
    """Replace the stored foot positions and free-body poses by those at the end of this tick."""
    return ctx.report.joints[:, -1], ctx.report.actual.free


def compute(state: FinalPositions, rollout: RolloutEnd) -> dict[str, Array]:
    """Return by column how many feet end on their planned faces, and the largest distance (m) from these faces."""
    feet, free = state
    target = points_to_world(rollout.plan.foothold[-1], rollout.plan.foot_frame[-1], free)
    here, there = (surface_at(rollout.world.obstacle, p, body_poses(free)) for p in (feet, target))
    same = (here.face == there.face) & (here.body == there.body)
    hit = same & (here.depth > -FACE_TOLERANCE_M)
    away = jnp.maximum(jnp.linalg.norm(feet - target, axis=-1), 1.001 * FACE_TOLERANCE_M)
    gap = jnp.where(same, -here.depth, away)
    return {"feet_on_target": jnp.sum(hit).astype(jnp.int32), "foot_gap_max_m": jnp.max(gap)}


METRIC = Metric(
    begin,
    update,
    compute,
    {
        "feet_on_target": "number of feet that end on their planned face, or within 20 mm of it",
        "foot_gap_max_m": "largest final distance of a foot from its planned face, negative inside; on another face "
        "the distance from its foothold, at least 20 mm",
    },
    (
        make_goal_cause(
            "fewer feet than feet_on_target_min ended on their planned faces",
            "feet_on_target",
            below=True,
            is_count=True,
            twin=SmoothMarginMetric("foot_gap_max_m", FACE_TOLERANCE_M, FACE_TOLERANCE_M),
        ),
    ),
)
