"""Motion of a raft under its robot: freeboard, speeds at departure and arrival, slip on its deck."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.controllers.plan import is_under_law
from sweep.core.metric import Cause, Metric
from sweep.core.rotations import heading, rotate
from sweep.manoeuvres.afloat.raft_cross import PUSH, WAIT
from sweep.metrics.tick import FootHold, MetricTick, Rollout, RolloutStart
from sweep.models.obstacles.raft import CORNERS, Raft


class Afloat(NamedTuple):
    """Least freeboard and draught of the raft's corners (m), tilt (rad), motion, and where feet took hold."""

    freeboard: Float[Array, ""]
    draught: Float[Array, ""]
    tilt: Float[Array, ""]
    pushed: Float[Array, ""]  # m/s
    arrived: Float[Array, ""]  # m/s
    turned: Float[Array, ""]  # rad
    hold: FootHold
    slip: Float[Array, ""]  # m


def begin(start: RolloutStart) -> Afloat:
    """Initial state; no foot is loaded yet."""
    far, zero = jnp.full((), jnp.inf, start.feet.dtype), jnp.zeros((), start.feet.dtype)
    return Afloat(far, far, zero, zero, zero, zero, FootHold.at_start(start), zero)


def update(state: Afloat, ctx: MetricTick) -> Afloat:
    """Update extremes, and the slip of feet that took hold on the deck."""
    raft, tick = ctx.world.obstacle, ctx.tick
    assert isinstance(raft, Raft)
    free = tick.truth.free
    half = raft.half_size * jnp.array([[x, y, 1.0] for x, y in CORNERS])
    quat = jnp.broadcast_to(free.quat[0], (4, 4))
    deck, bottom = (
        free.position[0, 2] + rotate(quat, half * jnp.array([1.0, 1.0, side]))[:, 2] + raft.bank_height
        for side in (1.0, -1.0)
    )
    up = rotate(free.quat[0], jnp.array([0.0, 0.0, 1.0], free.quat.dtype))
    pushes, arrives = (is_under_law(ctx.plan, ctx.stage, law) for law in (PUSH, WAIT))
    speed = free.velocity[0, 0]
    hold, way = state.hold.update(ctx)
    return Afloat(
        freeboard=jnp.minimum(state.freeboard, jnp.min(deck)),
        draught=jnp.minimum(state.draught, -jnp.max(bottom)),
        tilt=jnp.maximum(state.tilt, jnp.arccos(jnp.clip(up[2], -1.0, 1.0))),
        pushed=jnp.where(pushes, speed, state.pushed),
        arrived=jnp.where(arrives, speed, state.arrived),
        turned=jnp.where(arrives, heading(free.quat[0]), state.turned),
        hold=hold,
        slip=jnp.maximum(state.slip, jnp.max(jnp.where(hold.body == 0, way, 0.0))),
    )


def compute(state: Afloat, rollout: Rollout) -> dict[str, Array]:
    """Extremes so far, and the raft's speed at departure, speed and heading at arrival."""
    return {
        "freeboard_min_m": state.freeboard,
        "draught_min_m": state.draught,
        "raft_tilt_max_rad": state.tilt,
        "push_speed_mps": state.pushed,
        "arrival_speed_mps": state.arrived,
        "arrival_turn_rad": state.turned,
        "deck_slip_max_m": state.slip,
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
