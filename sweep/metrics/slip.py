"""How far standing feet slide from where they took hold."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sweep.dynamics.contacts import to_body, to_world
from sweep.metrics.metric import Begin, Cause, Elapsed, Lead, Metric, Moment
from sweep.models.case import Case
from sweep.models.obstacles.ball import Ball
from sweep.models.obstacles.ledges import Ledges
from sweep.models.obstacles.raft import Raft
from sweep.models.obstacles.surface import poses, under
from sweep.models.obstacles.two_balls import TwoBalls


class Slip(NamedTuple):
    """Where each foot took hold (m), in the axes of what it stands on, whether it has yet, and the largest slip (m)."""

    place: Float[Array, "6 3"]
    holds: Bool[Array, " 6"]
    most: Float[Array, ""]


def begin(start: Begin) -> Slip:
    """No foot has been loaded yet."""
    bodies = poses(start.free)
    body = under(start.world.obstacle, start.feet, bodies).body
    return Slip(to_body(start.feet, body, bodies), jnp.zeros(6, bool), jnp.zeros((), start.feet.dtype))


def update(so_far: Slip, now: Moment) -> Slip:
    """A foot takes hold where it really is when it is first loaded: after the start, or in the second half of a swing.

    A standing foot that is unloaded for a moment keeps its place, so that chattering along does not hide a slip.
    """
    tick = now.tick
    feet = tick.joints[:, -1]
    body = under(now.world.obstacle, feet, tick.bodies).body
    swings = now.plan.swing[now.stage] & ~now.finished
    holds = jnp.where(swings, tick.loaded & (now.phase > 0.5), so_far.holds | tick.loaded)
    here = to_body(feet, body, tick.bodies)
    place = jnp.where((holds & so_far.holds)[:, None], so_far.place, here)
    slip = jnp.linalg.norm(feet - to_world(place, body, tick.bodies), axis=-1)
    slip = jnp.where(holds & tick.loaded, slip, 0.0)
    return Slip(place, holds, jnp.maximum(so_far.most, jnp.max(slip)))


def figures(found: Slip, at: Elapsed) -> dict[str, Array]:
    """See `METRIC`."""
    return {"slip_max_m": found.most}


def allowed(case: Case) -> float:
    """The slip (m) that what is stood on leaves room for: half of the way to where a foot holds on no more.

    Rungs are 40 mm wide. On a ball plans have feet where it is as steep as 37.8 degrees, and friction 1 holds up to 45:
    106 mm on. From the edges of raft and banks they keep 105 mm away.
    """
    return 0.05 if isinstance(case.obstacle, Ball | Ledges | TwoBalls | Raft) else 0.02


METRIC = Metric(
    begin,
    update,
    figures,
    {"slip_max_m": "largest distance of a loaded standing foot from where it took hold"},
    (
        Cause(
            "slipped",
            "a standing foot slipped beyond slip_max_m",
            "slip_max_m",
            None,
            lead=Lead("edge_reserve_min_m", 0.02),
            otherwise=allowed,
        ),
    ),
)
