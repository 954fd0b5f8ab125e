"""Motion of a raft under its robot: freeboard, speeds at departure and arrival, slip on its deck."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.controllers.plan import is_guided_by_law
from sweep.core.metric import Cause, Metric
from sweep.core.rotations import heading, rotate
from sweep.manoeuvres.afloat.raft_cross import PUSH, WAIT
from sweep.metrics.tick import BodyTouchdownPoints, MetricContext, RolloutEnd, RolloutStart
from sweep.models.obstacles.raft import CORNER_SIGNS, Raft


class RaftMotionExtremes(NamedTuple):
    """Extremes of the raft's motion: least freeboard and draught of corners (m), tilt (rad), slip on the deck (m)."""

    least_freeboard: Float[Array, ""]
    least_draught: Float[Array, ""]
    largest_tilt: Float[Array, ""]
    departure_speed: Float[Array, ""]  # m/s
    arrival_speed: Float[Array, ""]  # m/s
    arrival_heading: Float[Array, ""]  # rad
    touchdown_points: BodyTouchdownPoints
    largest_slip: Float[Array, ""]  # m


def begin(start: RolloutStart) -> RaftMotionExtremes:
    """Return the state of the raft metrics before any foot is loaded."""
    far, zero = jnp.full((), jnp.inf, start.feet.dtype), jnp.zeros((), start.feet.dtype)
    return RaftMotionExtremes(far, far, zero, zero, zero, zero, BodyTouchdownPoints.from_rollout_start(start), zero)


def update(state: RaftMotionExtremes, ctx: MetricContext) -> RaftMotionExtremes:
    """Update the extremes of the raft's motion, and the slip of feet on its deck."""
    raft, tick = ctx.world.obstacle, ctx.report
    assert isinstance(raft, Raft)
    free = tick.actual.free
    half = raft.half_size * jnp.array([[x, y, 1.0] for x, y in CORNER_SIGNS])
    quat = jnp.broadcast_to(free.quat[0], (4, 4))
    deck, bottom = (
        free.position[0, 2] + rotate(quat, half * jnp.array([1.0, 1.0, side]))[:, 2] + raft.bank_height
        for side in (1.0, -1.0)
    )
    up = rotate(free.quat[0], jnp.array([0.0, 0.0, 1.0], free.quat.dtype))
    pushes, arrives = (is_guided_by_law(ctx.plan, ctx.stage, law) for law in (PUSH, WAIT))
    speed = free.velocity[0, 0]
    hold, way = state.touchdown_points.update(ctx)
    return RaftMotionExtremes(
        least_freeboard=jnp.minimum(state.least_freeboard, jnp.min(deck)),
        least_draught=jnp.minimum(state.least_draught, -jnp.max(bottom)),
        largest_tilt=jnp.maximum(state.largest_tilt, jnp.arccos(jnp.clip(up[2], -1.0, 1.0))),
        departure_speed=jnp.where(pushes, speed, state.departure_speed),
        arrival_speed=jnp.where(arrives, speed, state.arrival_speed),
        arrival_heading=jnp.where(arrives, heading(free.quat[0]), state.arrival_heading),
        touchdown_points=hold,
        largest_slip=jnp.maximum(state.largest_slip, jnp.max(jnp.where(hold.body == 0, way, 0.0))),
    )


def compute(state: RaftMotionExtremes, rollout: RolloutEnd) -> dict[str, Array]:
    """Return extremes of the raft's motion, its speed at departure, and speed and heading at arrival, by column."""
    return {
        "freeboard_min_m": state.least_freeboard,
        "draught_min_m": state.least_draught,
        "raft_tilt_max_rad": state.largest_tilt,
        "push_speed_mps": state.departure_speed,
        "arrival_speed_mps": state.arrival_speed,
        "arrival_turn_rad": state.arrival_heading,
        "deck_slip_max_m": state.largest_slip,
    }


METRIC = Metric(
    begin,
    update,
    compute,
    {
        "freeboard_min_m": "smallest height of a corner of the raft's deck over the water",
        "draught_min_m": "smallest depth of a corner of the raft's bottom",
        "raft_tilt_max_rad": "largest tilt of the raft's deck",
        "push_speed_mps": "speed of the raft across the water at the end of the push",
        "arrival_speed_mps": "speed of the raft across the water when it reached the other bank",
        "arrival_turn_rad": "rotation of the raft about the vertical when it reached the other bank",
        "deck_slip_max_m": "largest slip of a loaded foot on the raft's deck",
    },
    (
        Cause(
            "awash",
            "a corner of the raft's deck was less than freeboard_min_m above the water",
            "freeboard_min_m",
            0.0,
            below=True,
            scale=0.02,
        ),
        Cause(
            "lifted",
            "a corner of the raft's bottom was less than draught_min_m below the water",
            "draught_min_m",
            0.0,
            below=True,
            scale=0.02,
        ),
        Cause(
            "slipped_on_deck", "a foot slipped on the raft's deck by more than deck_slip_max_m", "deck_slip_max_m", 0.05
        ),
    ),
    applies=lambda case: isinstance(case.obstacle, Raft),
)
