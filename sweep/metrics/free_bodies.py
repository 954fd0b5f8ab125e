"""Motion of the obstacle's free bodies; the first one is the body on which the robot rides."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.core.metric import Cause, Metric
from sweep.core.rotations import conjugate, logarithm, multiply
from sweep.metrics.tick import (
    REST_DURATION_S,
    FinalIntervalStart,
    MetricContext,
    RolloutEnd,
    RolloutStart,
    make_goal_cause,
)

FINAL_INTERVAL_S = 12.0  # s of the plan, its last, over which the speed of a body that is left in motion is taken


class FreeBodyMotion(NamedTuple):
    """Positions (m) of free bodies, such as balls, at the start, after the first stage, and in the last ticks.

    How far they went since both, and turned since the latter (rad); where they were when the plan ended, and since
    when that is (s); the least height.
    """

    start: Float[Array, "k 3"]
    first_stage_end: Float[Array, "k 3"]
    position: Float[Array, "k 3"]
    first_stage_quat: Float[Array, "k 4"]
    final_interval: FinalIntervalStart
    final_state: FinalIntervalStart
    largest_displacement: Float[Array, ""]
    largest_shift: Float[Array, ""]
    largest_turn: Float[Array, ""]
    largest_lateral_offset: Float[Array, ""]
    least_ride_height: Float[Array, ""]


def begin(start: RolloutStart) -> FreeBodyMotion:
    """Return the state of the motion metrics before the free bodies move."""
    place = start.free.position
    zero = jnp.zeros((), place.dtype)
    here, far = FinalIntervalStart(place, zero), jnp.full((), jnp.inf, place.dtype)
    return FreeBodyMotion(place, place, place, start.free.quat, here, here, zero, zero, zero, zero, far)


def update(state: FreeBodyMotion, ctx: MetricContext) -> FreeBodyMotion:
    """Update how far (m) the free bodies, such as balls, have moved from their start."""
    place, quat = ctx.report.actual.free.position, ctx.report.actual.free.quat
    way = place - state.start
    settled = jnp.where(ctx.stage == 0, place, state.first_stage_end)
    upright = jnp.where(ctx.stage == 0, quat, state.first_stage_quat)
    turn = jnp.linalg.norm(logarithm(multiply(quat, conjugate(upright))), axis=-1)
    here, manoeuvre = FinalIntervalStart(place, ctx.time), ctx.world.manoeuvre
    return FreeBodyMotion(
        start=state.start,
        first_stage_end=settled,
        position=place,
        first_stage_quat=upright,
        final_interval=state.final_interval.update(ctx, place, FINAL_INTERVAL_S),
        final_state=jax.tree.map(lambda a, b: jnp.where(ctx.finished, a, b), state.final_state, here),
        largest_displacement=jnp.maximum(state.largest_displacement, jnp.max(jnp.linalg.norm(way, axis=-1))),
        largest_shift=jnp.maximum(state.largest_shift, jnp.max(jnp.linalg.norm(place - settled, axis=-1))),
        largest_turn=jnp.maximum(state.largest_turn, jnp.max(turn)),
        largest_lateral_offset=jnp.maximum(state.largest_lateral_offset, manoeuvre.lateral_offset(way[0])),
        least_ride_height=jnp.minimum(state.least_ride_height, ctx.report.actual.position[2] - place[0, 2]),
    )


def compute(state: FreeBodyMotion, rollout: RolloutEnd) -> dict[str, Array]:
    """Return the displacements of the free bodies, and their mean speeds over the plan's final interval, by column."""
    manoeuvre = rollout.world.manoeuvre
    if manoeuvre.drives_body:
        aim, velocity = (
            manoeuvre.obstacle_speed(jnp.sum(rollout.plan.duration)),
            state.final_interval.mean_velocity(*state.final_state),
        )
    else:
        aim, velocity = 0.0, state.final_state.mean_velocity(state.position, rollout.time)
    speed = jnp.linalg.norm(velocity[0, :2])
    return {
        "obstacle_moved_m": state.largest_displacement,
        "obstacle_shift_m": state.largest_shift,
        "obstacle_turn_max_rad": state.largest_turn,
        "ride_height_min_m": state.least_ride_height,
        "obstacle_x_m": state.position[0, 0],
        "obstacle_y_m": state.position[0, 1],
        "obstacle_aside_max_m": state.largest_lateral_offset,
        "obstacle_speed_mps": speed,
        "obstacle_speed_error_mps": jnp.abs(speed - aim),
    }


METRIC = Metric(
    begin,
    update,
    compute,
    {
        "obstacle_moved_m": "largest distance of a free body of the obstacle from its start",
        "obstacle_shift_m": "largest distance of a free body from its position at the end of the first stage",
        "obstacle_turn_max_rad": "largest rotation of a free body since the end of the first stage",
        "ride_height_min_m": "smallest height of the base over the centre of the body that it rides on",
        "obstacle_x_m": "final x coordinate of the body that the robot rides on, world axes",
        "obstacle_y_m": "final y coordinate of the body that the robot rides on, world axes",
        "obstacle_aside_max_m": "largest lateral distance of the body that the robot rides on from its path",
        "obstacle_speed_mps": f"mean speed of the body that the robot rides on in the {REST_DURATION_S:g} s after "
        "the plan; of a "
        f"body that is left in motion, over the plan's last {FINAL_INTERVAL_S:g} s",
        "obstacle_speed_error_mps": "difference of obstacle_speed_mps from the speed that the manoeuvre aims at",
    },
    (
        Cause(
            "fell_off",
            "the base sank to less than ride_height_min_m over the centre of the body it rides on",
            "ride_height_min_m",
            -1e3,
            below=True,
        ),
        Cause("obstacle_moved", "a free body moved farther than obstacle_moved_max_m", "obstacle_moved_m", 1e3),
        Cause(
            "obstacle_shifted",
            "a free body moved farther than obstacle_shift_max_m from its position at the end of the first stage",
            "obstacle_shift_m",
            None,
        ),
        Cause(
            "obstacle_turned",
            "a free body turned by more than obstacle_turn_max_rad since the end of the first stage",
            "obstacle_turn_max_rad",
            None,
        ),
        make_goal_cause(
            "the final speed of the body that the robot rides on was off by more than obstacle_speed_error_max_mps",
            "obstacle_speed_error_mps",
        ),
        make_goal_cause(
            "the body that the robot rides on drifted sideways by more than obstacle_aside_max_m",
            "obstacle_aside_max_m",
        ),
    ),
    applies=lambda case: bool(case.obstacle.free_bodies),
)
