"""What the obstacle's free bodies do; the first one is that on which the robot rides."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.core.rotations import conjugate, logarithm, multiply
from sweep.metrics.metric import REST, Begin, Cause, Elapsed, Metric, Moment, Tail, missed
from sweep.models.case import Driving

TAIL = 12.0  # s of the plan, its last, over which the speed of a body that is left in motion is taken


class BodiesMotion(NamedTuple):
    """Where they were at the start, when the first stage ended, are, and were before (m).

    How far they went since both, and turned since the latter (rad); where they were when the plan ended, and since
    when that is (s); the least height.
    """

    start: Float[Array, "k 3"]
    settled: Float[Array, "k 3"]
    place: Float[Array, "k 3"]
    quat: Float[Array, "k 4"]
    tail: Tail
    ended: Tail
    moved: Float[Array, ""]
    shifted: Float[Array, ""]
    turned: Float[Array, ""]
    aside: Float[Array, ""]
    ride_height: Float[Array, ""]


def begin(start: Begin) -> BodiesMotion:
    """The metric before anything has moved."""
    place = start.free.position
    zero = jnp.zeros((), place.dtype)
    here, far = Tail(place, zero), jnp.full((), jnp.inf, place.dtype)
    return BodiesMotion(place, place, place, start.free.quat, here, here, zero, zero, zero, zero, far)


def update(so_far: BodiesMotion, now: Moment) -> BodiesMotion:
    """Their ways from the start."""
    place, quat = now.tick.truth.free.position, now.tick.truth.free.quat
    way = place - so_far.start
    settled = jnp.where(now.stage == 0, place, so_far.settled)
    upright = jnp.where(now.stage == 0, quat, so_far.quat)
    turn = jnp.linalg.norm(logarithm(multiply(quat, conjugate(upright))), axis=-1)
    here, manoeuvre = Tail(place, now.time), now.world.manoeuvre
    aside = manoeuvre.lateral_offset if isinstance(manoeuvre, Driving) else lambda way: jnp.abs(way[1])
    return BodiesMotion(
        start=so_far.start,
        settled=settled,
        place=place,
        quat=upright,
        tail=so_far.tail.later(now, place, TAIL),
        ended=jax.tree.map(lambda a, b: jnp.where(now.finished, a, b), so_far.ended, here),
        moved=jnp.maximum(so_far.moved, jnp.max(jnp.linalg.norm(way, axis=-1))),
        shifted=jnp.maximum(so_far.shifted, jnp.max(jnp.linalg.norm(place - settled, axis=-1))),
        turned=jnp.maximum(so_far.turned, jnp.max(turn)),
        aside=jnp.maximum(so_far.aside, aside(way[0])),
        ride_height=jnp.minimum(so_far.ride_height, now.tick.truth.position[2] - place[0, 2]),
    )


def figures(found: BodiesMotion, at: Elapsed) -> dict[str, Array]:
    """Ways so far, and speeds over the last part of the plan."""
    manoeuvre = at.world.manoeuvre
    if isinstance(manoeuvre, Driving):
        aim, velocity = manoeuvre.obstacle_speed(jnp.sum(at.plan.duration)), found.tail.velocity(*found.ended)
    else:
        aim, velocity = 0.0, found.ended.velocity(found.place, at.time)
    speed = jnp.linalg.norm(velocity[0, :2])
    return {
        "obstacle_moved_m": found.moved,
        "obstacle_shift_m": found.shifted,
        "obstacle_turn_max_rad": found.turned,
        "ride_height_min_m": found.ride_height,
        "obstacle_x_m": found.place[0, 0],
        "obstacle_y_m": found.place[0, 1],
        "obstacle_aside_max_m": found.aside,
        "obstacle_speed_mps": speed,
        "obstacle_speed_error_mps": jnp.abs(speed - aim),
    }


METRIC = Metric(
    begin,
    update,
    figures,
    {
        "obstacle_moved_m": "farthest that a free body of the obstacle was from its start",
        "obstacle_shift_m": "the same from where it was when the plan's first stage ended",
        "obstacle_turn_max_rad": "farthest that it had turned from then",
        "ride_height_min_m": "least height of the base over the centre of the body that it rides on",
        "obstacle_x_m": "where that body ended, along the world's x axis",
        "obstacle_y_m": "the same along y",
        "obstacle_aside_max_m": "the farthest that it was sideways of the x axis, or of the way that it is driven",
        "obstacle_speed_mps": f"its mean speed in the {REST:g} s after the plan; of one that is left in motion, over "
        f"the plan's last {TAIL:g} s",
        "obstacle_speed_error_mps": "difference of that from the speed that the manoeuvre aims at, if not at rest",
    },
    (
        Cause(
            "fell_off",
            "the base sank to less than ride_height_min_m over the centre of the body it rides on",
            "ride_height_min_m",
            -1e3,
            below=True,
        ),
        Cause("obstacle_moved", "a free body went farther than obstacle_moved_max_m", "obstacle_moved_m", 1e3),
        Cause(
            "obstacle_shifted",
            "a free body went farther than obstacle_shift_max_m from where it was when the plan's first stage ended",
            "obstacle_shift_m",
            None,
        ),
        Cause(
            "obstacle_turned",
            "a free body turned by more than obstacle_turn_max_rad from how it was when the plan's first stage ended",
            "obstacle_turn_max_rad",
            None,
        ),
        missed(
            "the body that the robot rides on ended off its speed by more than obstacle_speed_error_max_mps",
            "obstacle_speed_error_mps",
        ),
        missed("the body that the robot rides on went aside by more than obstacle_aside_max_m", "obstacle_aside_max_m"),
    ),
    applies=lambda case: bool(case.obstacle.free_bodies),
)
