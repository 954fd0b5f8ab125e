"""How far the robot gets along its plan, and how fast."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sweep.controllers.plan import path_length
from sweep.metrics.metric import GRACE, Begin, Cause, Elapsed, Metric, Moment, Twin, missed, time_left
from sweep.models.frames import WORLD


class Progress(NamedTuple):
    """Where the base was and is (m), its way (m) in the time (s) in which the plan moves it, its largest error (m).

    Whether the plan has ended, and how much of the time that it is given it took, with what it still lacks.
    """

    start: Float[Array, " 3"]
    position: Float[Array, " 3"]
    travel: Float[Array, ""]
    travel_time: Float[Array, ""]
    error: Float[Array, ""]
    finished: Bool[Array, ""]
    use: Float[Array, ""]


def begin(start: Begin) -> Progress:
    """The metric before the first step."""
    zero = jnp.zeros((), start.position.dtype)
    return Progress(start.position, start.position, zero, zero, zero, jnp.asarray(False), zero + 2)


def update(so_far: Progress, now: Moment) -> Progress:
    """The way along the planned direction counts."""
    way = now.plan.position[now.stage] - now.stage_start
    length = jnp.linalg.norm(way)
    moving = (length > 1e-6) & ~now.finished
    step = (now.tick.truth.position - so_far.position) @ (way / jnp.maximum(length, 1e-6))
    given = GRACE * jnp.sum(now.plan.duration)
    ended = jnp.where(so_far.finished, so_far.use, jnp.minimum(now.time / given, 1.0))
    lacks = 1 + jnp.maximum(time_left(now) / given, 1e-6)
    return so_far._replace(
        position=now.tick.truth.position,
        travel=so_far.travel + jnp.where(moving, step, 0.0),
        travel_time=so_far.travel_time + jnp.where(moving, now.period, 0.0),
        error=jnp.maximum(so_far.error, jnp.linalg.norm(now.tick.truth.position - now.reference.position)),
        finished=now.finished,
        use=jnp.where(now.finished, ended, lacks),
    )


def figures(found: Progress, at: Elapsed) -> dict[str, Array]:
    """How far the way is done, and how fast."""
    length = path_length(at.plan)
    left = jnp.linalg.norm(found.position - at.plan.position[-1])
    goes = (length > 1e-6) & (at.plan.base_frame[-1] == WORLD)  # on a free body the goal is a motion, not a place
    return {
        "finished": found.finished,
        "time_use": found.use,
        "end_stage": at.stage,
        "duration_s": at.time,
        "progress": jnp.where(goes, 1 - left / jnp.maximum(length, 1e-6), 1.0),
        "distance_m": jnp.linalg.norm((found.position - found.start)[:2]),
        "speed_mps": found.travel / jnp.maximum(found.travel_time, 1e-9),
        "position_error_max_m": found.error,
    }


METRIC = Metric(
    begin,
    update,
    figures,
    {
        "finished": "whether the plan came to its end",
        "time_use": f"time to the plan's end over {GRACE:g} of its duration, all it is given; beyond 1 what it lacked",
        "end_stage": "number of its last stage that began",
        "duration_s": "simulated time",
        "progress": "1 minus the distance left to the goal over the length of the planned way",
        "distance_m": "between the base's first place and its last, seen from above",
        "speed_mps": "along the planned direction, while the plan moves the base",
        "position_error_max_m": "largest distance of the base from where it was told to be",
    },
    (
        Cause(
            "stalled",
            "the plan was not finished",
            "finished",
            1.0,
            key="",
            below=True,
            known="end",
            whole=True,
            twin=Twin("time_use", 1.0, 1 - 1 / GRACE),
        ),
        missed("progress to the goal stayed below progress_min", "progress", below=True, scale=0.1),
    ),
)
