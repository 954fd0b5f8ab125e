"""How far standing feet slide from where they took hold."""

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
    """Where feet took hold (m), in the axes of what they did on; which free body that is, if any, and who has yet.

    A foot that passes on to another body without a swing has gone as far as it is from there.
    """

    place: Float[Array, "6 3"]
    body: Int[Array, " 6"] | None  # -1 is fixed ground; None where there is nothing else
    holds: Bool[Array, " 6"]

    @classmethod
    def at_start(cls, start: RolloutStart) -> "FootHold":
        """Of feet that have not been loaded yet."""
        body = jnp.full(6, -1, jnp.int32) if len(start.free.position) else None
        return cls(jnp.zeros_like(start.feet), body, jnp.zeros(6, bool))

    def update(self, ctx: MetricTick) -> tuple["FootHold", Float[Array, " 6"]]:
        """A tick on, and how far each loaded foot is from where it took hold (m).

        It does where it really is when it is first loaded: after the start, or in the second half of a swing. A
        standing foot that is unloaded for a moment keeps its place, so that chattering along does not hide a slip.
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
    """No foot has been loaded yet."""
    return Slip(FootHold.at_start(start), jnp.zeros((), start.feet.dtype))


def update(state: Slip, ctx: MetricTick) -> Slip:
    """The largest slip a tick on."""
    hold, way = state.hold.update(ctx)
    return Slip(hold, jnp.maximum(state.largest, jnp.max(way)))


def slip_threshold(case: Case) -> float:
    """The slip (m) that what is stood on leaves room for: half of the way to where a foot holds on no more.

    Rungs are 40 mm wide. On a ball plans have feet where it is as steep as 37.8 degrees, and friction 1 holds up to 45:
    106 mm on. From the edges of raft and banks they keep 105 mm away.
    """
    return 0.05 if isinstance(case.obstacle, Ball | Raft) else 0.02


METRIC = Metric(
    begin,
    update,
    lambda state, rollout: {"slip_max_m": state.largest},
    {"slip_max_m": "largest distance of a loaded standing foot from where it took hold"},
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
