"""Slip: distance of loaded feet from where they took hold."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from sweep.dynamics.contacts import to_body, to_world
from sweep.metrics.metric import Cause, LeadingMetric, Metric, MetricTick, RolloutStart
from sweep.models.case import Case
from sweep.models.obstacles.ball import Ball
from sweep.models.obstacles.raft import Raft
from sweep.models.obstacles.surface import surface_at


class FootHold(NamedTuple):
    """Where feet took hold (m), in the axes of the body under them, which body that is, and which feet hold.

    A foot that slides from one body to another without a swing keeps the point on the first one.
    """

    place: Float[Array, "6 3"]
    body: Int[Array, " 6"] | None  # -1 is fixed ground; None where there is nothing else
    holds: Bool[Array, " 6"]

    @classmethod
    def at_start(cls, start: RolloutStart) -> "FootHold":
        """State of feet that have not been loaded yet."""
        body = jnp.full(6, -1, jnp.int32) if len(start.free.position) else None
        return cls(jnp.zeros_like(start.feet), body, jnp.zeros(6, bool))

    def update(self, ctx: MetricTick) -> tuple["FootHold", Float[Array, " 6"]]:
        """Update after a tick, and return the distance of each loaded foot from where it took hold (m).

        A foot takes hold at its actual position when it is first loaded: after the start, or in the second half of a
        swing. A standing foot that is unloaded for a moment keeps its point, so that chattering does not hide a slip.
        """
        tick = ctx.tick
        feet = tick.joints[:, -1]
        swings = ctx.plan.swing[ctx.stage] & ~ctx.finished
        holds = jnp.where(swings, tick.truth.loaded & (ctx.phase > 0.5), self.holds | tick.truth.loaded)
        held = holds & self.holds
        here = surface_at(ctx.world.obstacle, feet, tick.bodies).body.astype(jnp.int32)
        body = here if self.body is None else jnp.where(held, self.body, here)
        place = jnp.where(held[:, None], self.place, to_body(feet, body, tick.bodies))
        way = jnp.linalg.norm(feet - to_world(place, body, tick.bodies), axis=-1)
        return FootHold(place, None if self.body is None else body, holds), jnp.where(
            holds & tick.truth.loaded, way, 0.0
        )


class Slip(NamedTuple):
    """Where feet hold, and the largest slip so far (m)."""

    hold: FootHold
    largest: Float[Array, ""]


def begin(start: RolloutStart) -> Slip:
    """Initial state; no foot is loaded yet."""
    return Slip(FootHold.at_start(start), jnp.zeros((), start.feet.dtype))


def update(state: Slip, ctx: MetricTick) -> Slip:
    """Update the largest slip with this tick."""
    hold, way = state.hold.update(ctx)
    return Slip(hold, jnp.maximum(state.largest, jnp.max(way)))


def slip_threshold(case: Case) -> float:
    """Default threshold of slip (m) on an obstacle: half the distance after which a foot would lose its hold.

    Rungs are 40 mm wide. On a ball plans have footholds at up to 37.8 degrees, and friction 1 holds up to 45 degrees,
    106 mm farther. Footholds keep 105 mm from the edges of raft and banks.
    """
    return 0.05 if isinstance(case.obstacle, Ball | Raft) else 0.02


METRIC = Metric(
    begin,
    update,
    lambda state, rollout: {"slip_max_m": state.largest},
    {"slip_max_m": "largest slip of a loaded stance foot from its touchdown"},
    (
        Cause(
            "slipped",
            "a standing foot slipped by more than slip_max_m",
            "slip_max_m",
            None,
            lead=LeadingMetric("edge_reserve_min_m", 0.02),
            default_for=slip_threshold,
        ),
    ),
)
