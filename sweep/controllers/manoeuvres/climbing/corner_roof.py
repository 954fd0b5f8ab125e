"""From the walls of a corner over its edge on to the roof (monograph 2.4.3), with planned foot forces.

World axes as in `corner`. The roof is a wedge: at a distance d behind its tip it is 2 d tan psi wide.

The printed sequence of events (table 2.1) is replaced by the part `roof` of the plan's file. Its lengths are
`leg_unit`s: measured by the body, robots with legs 2 % short of what their body asks for would be out of reach.
"""

import math
from dataclasses import replace
from typing import ClassVar

import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float

from sweep.controllers.frames import Stance
from sweep.controllers.gaits import TRIPOD
from sweep.controllers.manoeuvres.climbing.corner import OnCorner
from sweep.controllers.manoeuvres.goals import UPRIGHT
from sweep.controllers.moves import part_stages, read_moves
from sweep.controllers.plan import CYCLE_B_SMOOTH, SMOOTH, Stage
from sweep.core.errors import InputError
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.formulas.leg import SIDE
from sweep.models.case import Case
from sweep.models.obstacles.charts import point
from sweep.models.obstacles.corner import Corner
from sweep.models.plan_table import SIZES, tabled
from sweep.models.robot import leg_unit

MOST_RISE = 0.28  # a_r, of a cycle of the gallop; from 0.35 on front and middle legs cross
# when walking on the roof (a_r)
BRINK = 0.05  # of feet behind its edges, along y
NARROWEST = 0.28  # half the distance between a pair's feet


@parameters
class CornerRoof(OnCorner):
    """From the floor on to the corner, up it, and over the edge on to the roof.

    For houses that reach above the front feet where the gallop begins, which goes the rest in `cycles`.
    """

    goal: ClassVar = UPRIGHT
    kind: str = choice("corner_roof", "corner_roof")
    cycles: int = count(2, at_least=1, at_most=100)  # of the gallop, which goes as far as the house is high

    own_plan = "corner_roof"

    def route(self, belief: Case) -> tuple[Stance, list[Stage]]:
        """Climb until the front feet are below the edge, and get over it.

        Raises `InputError` where the house is too low, or too high for the cycles, by plain numbers; rows in which
        it is too low are not a number, hence invalid.
        """
        sizes = tabled(belief, SIZES).get(SIZES, {})
        if "rise" not in sizes:
            raise InputError(f"plan.{SIZES}.rise is missing")
        rise = sizes["rise"]
        if not isinstance(rise, Tracer):
            unit = leg_unit(belief.robot)
            self.validate(belief, float(rise * unit), float(MOST_RISE * belief.robot.body_length))
        known = belief.plan.raised(f"{SIZES}.rise", jnp.where(rise >= 0, 0.0, jnp.nan))
        start, stages, standing = self.climb_stages(replace(belief, plan=known))
        roof, _ = part_stages("roof", self.move_context(belief), standing)
        return start, [*stages, *roof]

    def validate(self, belief: Case, rise: float, most: float) -> None:
        """Raise `InputError` where the gallop cannot go up by `rise` (m), `most` (m) a cycle."""
        top, needed = belief.on(Corner).height, math.ceil(rise / most)
        if rise < 0:
            least = math.ceil(100 * (top - rise)) / 100
            raise InputError(
                f"obstacle.height = {top:g} is not allowed: at least {least:g} m for manoeuvre = {self.kind}"
            )
        if needed > self.cycles:
            raise InputError(
                f"manoeuvre.cycles = {self.cycles} is not allowed: at least {needed} for obstacle.height = {top:g} m"
            )


@parameters
class CornerFull(CornerRoof):
    """From the floor up a corner on to the roof, and some steps on."""

    kind: str = choice("corner_full", "corner_full")
    steps: int = count(10, at_least=0, at_most=100)  # swings by tripod on the roof
    roof_step_ratio: float = quantity(0.1, "a_r", above=0, at_most=0.3)  # way of the base in each, from the third on

    def route(self, belief: Case) -> tuple[Stance, list[Stage]]:
        """On to the roof, and some steps on."""
        start, stages = super().route(belief)
        return start, [*stages, *self.roof_stages(belief)]

    def roof_stages(self, belief: Case) -> list[Stage]:
        """Swings by tripod, from where the base is over the edge.

        Where the roof is narrow, so are the tracks. In the first two the feet go beside their hips and the base rests:
        farther on middle feet would meet the front legs.
        """
        context, stages, length = self.move_context(belief), [], belief.robot.body_length
        way, height = self.roof_step_ratio * length, belief.on(Corner).height + self.height_ratio * context.unit
        *_, last = read_moves(belief, "roof").values()
        base = context.base(last.base, last.path)[0][1]
        for k in range(self.steps):
            advance = way if k >= len(TRIPOD) else 0.0
            base = base - advance
            swing = {}
            for leg in TRIPOD[k % 2]:
                hip = base - advance / 2 + (1 - (leg - 1) // 2) * length / 2
                swing[leg] = roof_foothold(belief, leg, hip, self.floor_track_ratio * context.unit)
            stages.append(Stage(f"on{k + 1}", context.time, swing, CYCLE_B_SMOOTH, context.lift, pace=SMOOTH,
                                position=point(0.0, base, height)))  # fmt: skip
        return stages


def roof_foothold(belief: Case, leg: int, y: Array | float, aside: Array | float) -> Float[Array, " 3"]:
    """A foothold beside a hip at `y`, so far `aside` (m), or as far back as the roof is wide enough."""
    slope, length = jnp.tan(belief.on(Corner).half_angle), belief.robot.body_length
    y = jnp.minimum(y, -BRINK * length - NARROWEST * length / slope)
    aside = jnp.minimum(aside, slope * (-y - BRINK * length))
    return point(float(SIDE[leg - 1]) * aside, y, belief.on(Corner).height)
