"""From the walls of a corner over its edge on to the roof (monograph 2.4.3), with planned foot forces.

World axes as in `corner`. The roof is a wedge: at a distance d behind its tip it is 2 d tan psi wide.

The printed sequence of events (table 2.1) is replaced by the part `roof` of the plan's file. Its lengths are
`leg_unit`s: measured by the body, robots with legs 2 % short of what their body asks for would be out of reach.
"""

import math
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from sweep.controllers.frames import Stance
from sweep.controllers.gaits import TRIPOD
from sweep.controllers.manoeuvres.climbing.corner import FRONT, MIDDLE, REAR, CornerSite, OnCorner, gallop, get_on
from sweep.controllers.manoeuvres.goals import UPRIGHT
from sweep.controllers.moves import Terms, moves, stages_of, standing
from sweep.controllers.plan import CYCLE_B_SMOOTH, SMOOTH, Stage
from sweep.core.errors import InputError
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.formulas.leg import SIDE
from sweep.models.case import Case
from sweep.models.obstacles.charts import point
from sweep.models.obstacles.corner import Corner

BELOW = 0.029  # a_r, of the front feet under the edge when the first event begins
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

    def ascend(self, belief: Case) -> tuple[CornerSite, Stance, list[Stage]]:
        """Climb until the front feet are below the edge, and get over it.

        Raises `InputError` where the house is too low, or too high for the cycles, by plain numbers; rows in which
        it is too low are not a number, hence invalid.
        """
        site, top = self.site(belief), belief.on(Corner).height
        start, stages, feet = get_on(belief, site)
        front = top - BELOW * site.length
        rear = front - site.span
        edge = {FRONT: front, MIDDLE: rear + site.near, REAR: rear}  # heights of the pairs where the gallop ends
        rise = front - feet[FRONT]
        if not isinstance(rise, Tracer):
            self.refuse(belief, float(rise), float(MOST_RISE * site.length))
        up = gallop(site, feet, jnp.where(rise >= 0, rise, jnp.nan), self.cycles)
        below = {leg: foot for legs, height in edge.items() for leg, foot in site.on_wall(legs, height).items()}
        over, _ = stages_of("roof", on_house(site, belief), standing(below, np.pi / 2))
        return site, start, [*stages, *up, *over]

    def refuse(self, belief: Case, rise: float, most: float) -> None:
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

    def way(self, belief: Case) -> tuple[Stance, list[Stage]]:
        """Up to the edge and over it on to the roof."""
        return self.ascend(belief)[1:]


@parameters
class CornerFull(CornerRoof):
    """From the floor up a corner on to the roof, and some steps on."""

    kind: str = choice("corner_full", "corner_full")
    steps: int = count(10, at_least=0, at_most=100)  # swings by tripod on the roof
    roof_step_ratio: float = quantity(0.1, "a_r", above=0, at_most=0.3)  # way of the base in each, from the third on

    def way(self, belief: Case) -> tuple[Stance, list[Stage]]:
        """On to the roof, and some steps on."""
        site, start, stages = self.ascend(belief)
        on = walk_on(site, belief, self.steps, self.roof_step_ratio * site.length)
        return start, [*stages, *on]


def on_house(site: CornerSite, belief: Case) -> Terms:
    """What the words of the moves over the edge mean, lengths in `leg_unit`s."""
    return Terms(belief, site.unit, site.step.time, site.step.height)


def walk_on(site: CornerSite, belief: Case, steps: int, way: Array | float) -> list[Stage]:
    """Swings by tripod, in each of which the base goes `way` (m) on, from where it is over the edge.

    Where the roof is narrow, so are the tracks. In the first two the feet go beside their hips and the base rests:
    farther on middle feet would meet the front legs.
    """
    top, stages = belief.on(Corner).height, []
    *_, last = moves(belief, "roof").values()
    base = on_house(site, belief).base(last.base, last.path)[0][1]
    for k in range(steps):
        on = way if k >= len(TRIPOD) else 0.0
        base = base - on
        swing = {}
        for leg in TRIPOD[k % 2]:
            hip = base - on / 2 + (1 - (leg - 1) // 2) * site.length / 2
            swing[leg] = on_roof(site, belief, leg, hip)
        stages.append(Stage(f"on{k + 1}", site.step.time, swing, CYCLE_B_SMOOTH, site.step.height, pace=SMOOTH,
                            position=point(0.0, base, top + site.clearance)))  # fmt: skip
    return stages


def on_roof(site: CornerSite, belief: Case, leg: int, y: Array | float) -> Float[Array, " 3"]:
    """A foothold beside a hip at `y` (m), or as far back as the roof is wide enough."""
    slope, brink = jnp.tan(belief.on(Corner).half_angle), BRINK * site.length
    y = jnp.minimum(y, -brink - NARROWEST * site.length / slope)
    aside = jnp.minimum(site.floor_track, slope * (-y - brink))
    return point(float(SIDE[leg - 1]) * aside, y, belief.on(Corner).height)
