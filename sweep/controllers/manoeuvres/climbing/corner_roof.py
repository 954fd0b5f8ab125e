"""From the walls of a corner over its edge on to the roof (monograph 2.4.3), with planned foot forces.

World axes as in `corner`. The roof is a wedge: at a distance d behind its tip it is 2 d tan psi wide.

The printed sequence of events (table 2.1) is replaced by `EVENTS`, all of whose numbers were searched for together: for
every stance the friction and the torque that the best foot forces need, the legs' reach, and the distances of links to
the house and to one another, all of them true ones. Until its centre is above the roof the base keeps away from the
house: farther over the edge it would need less friction, and be cut by it. Lengths are `leg_unit`s: measured by the
body, robots with legs 2 % short of what their body asks for would be out of reach.
"""

import math
from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float

from sweep.controllers.gaits import TRIPOD
from sweep.controllers.manoeuvres.climbing import corner
from sweep.controllers.manoeuvres.climbing.corner import FRONT, MIDDLE, REAR, CornerSite, OnCorner, climb, gallop
from sweep.controllers.manoeuvres.climbing.pole import curves, pair, point
from sweep.controllers.manoeuvres.goals import UPRIGHT
from sweep.controllers.plan import CYCLE_B_SMOOTH, SMOOTH, Plan, Stage, Stance
from sweep.controllers.posture import leg_unit
from sweep.core.errors import InputError
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.formulas.leg import SIDE
from sweep.models.case import Case
from sweep.models.obstacles.corner import Corner


class Wall(NamedTuple):
    """Where a pair stands on the walls, in `leg_unit`s, nominally a_r."""

    aside: float
    above: float  # the roof


class Roof(NamedTuple):
    """Where a pair stands on the roof, in the same unit."""

    aside: float
    ahead: float  # of the corner's edge


class BasePose(NamedTuple):
    """Of the base: its centre, in the same unit, and its pitch (deg)."""

    ahead: float  # of the corner's edge
    above: float  # the roof
    pitch: float


class Event(NamedTuple):
    """A swing of a pair, or a move of the base alone."""

    name: str
    base: BasePose  # at the end
    legs: tuple[int, int] | None = None
    to: Wall | Roof | None = None
    # control points of the swing's curve, from the place that is left and from the new one: out, ahead, up
    leave: tuple[float, float, float] = (0.0, 0.0, 0.0)
    land: tuple[float, float, float] = (0.0, 0.0, 0.0)


class Way(NamedTuple):
    """On to the corner, and over its edge."""

    entry: corner.Entry
    events: tuple[Event, ...]


EVENTS: tuple[Event, ...] = (
    Event("roof.middle.up", BasePose(-0.2071, -0.7058, 89.99), MIDDLE, Wall(0.2809, -0.5545),
          leave=(0.0378, -0.1634, 0.0672), land=(0.2330, -0.1864, 0.1207)),
    Event("roof.front.on", BasePose(-0.1731, -0.6335, 84.28), FRONT, Roof(0.4436, 0.4695),
          leave=(0.1607, -0.0544, 0.1179), land=(-0.0012, 0.0098, 0.1530)),
    Event("roof.middle.near", BasePose(-0.2090, -0.4740, 73.87), MIDDLE, Wall(0.4096, -0.4067),
          leave=(0.1250, -0.1452, 0.0305), land=(0.1782, -0.2103, 0.1374)),
    Event("roof.rear.up", BasePose(-0.2387, -0.3106, 68.82), REAR, Wall(0.3006, -0.4746),
          leave=(0.1443, -0.0995, 0.1076), land=(0.1758, -0.0928, 0.1389)),
    Event("roof.pitch", BasePose(-0.1467, 0.0545, 48.80)),
    Event("roof.middle.higher", BasePose(-0.0584, 0.2997, 49.22), MIDDLE, Wall(0.3000, -0.1242),
          leave=(0.1685, -0.1182, 0.1383), land=(0.1284, -0.0878, 0.1407)),
    Event("roof.middle.on", BasePose(-0.0176, 0.3644, 49.40), MIDDLE, Roof(0.3762, 0.4100),
          leave=(0.1607, -0.0741, 0.1658), land=(0.1773, -0.1716, 0.1473)),
    Event("roof.front.ahead", BasePose(0.0092, 0.3327, 48.96), FRONT, Roof(0.3842, 0.6512),
          leave=(0.0712, -0.0122, 0.1840), land=(0.1740, -0.1702, 0.1413)),
    Event("roof.middle.ahead", BasePose(0.5726, 0.4494, 28.76), MIDDLE, Roof(0.4177, 0.4536),
          leave=(0.0894, -0.0580, 0.1706), land=(0.2114, -0.1819, 0.1686)),
    Event("roof.over", BasePose(0.6773, 0.3456, 14.62)),
    Event("roof.rear.on", BasePose(0.5160, 0.4950, 0.00), REAR, Roof(0.2677, 0.3093),
          leave=(0.7280, 0.4303, 0.0318), land=(-0.0062, -0.6438, 0.2593)),
)  # fmt: skip
WAY = Way(corner.ENTRY, EVENTS)
BELOW = 0.029  # a_r, of the front feet under the edge when the first event begins
MOST_RISE = 0.28  # a_r, of a cycle of the gallop; from 0.35 on front and middle legs cross
TIMES = 2.0  # t*, of an event
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

    @property
    def table(self) -> Way:
        """The numbers of the whole way."""
        return WAY

    def ascend(self, belief: Case, way: Way = WAY) -> tuple[CornerSite, Stance, list[Stage]]:
        """Climb until the front feet are below the edge, and get over it.

        Raises `InputError` where the house is too low, or too high for the cycles, by plain numbers; rows in which
        it is too low are not a number, hence invalid.
        """
        site, top = self.site(belief), belief.on(Corner).height
        start, stages, feet = climb(site, way.entry)
        rise = below_edge(site, top)[FRONT] - feet[FRONT]
        if not isinstance(rise, Tracer):
            self.refuse(belief, float(rise), float(MOST_RISE * site.length))
        up = gallop(site, feet, jnp.where(rise >= 0, rise, jnp.nan), self.cycles)
        return site, start, [*stages, *up, *over_edge(site, belief, way.events)]

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

    def plan(self, belief: Case, table: Way = WAY) -> Plan:
        """Get on to the roof, halt."""
        _, start, stages = self.ascend(belief, table)
        return self.assembled(belief, start, stages)


@parameters
class CornerFull(CornerRoof):
    """From the floor up a corner on to the roof, and some steps on."""

    kind: str = choice("corner_full", "corner_full")
    steps: int = count(10, at_least=0, at_most=100)  # swings by tripod on the roof
    roof_step_ratio: float = quantity(0.1, "a_r", above=0, at_most=0.3)  # way of the base in each, from the third on

    def plan(self, belief: Case, table: Way = WAY) -> Plan:
        """Get on to the roof, walk on, halt."""
        site, start, stages = self.ascend(belief, table)
        on = walk_on(site, belief, self.steps, self.roof_step_ratio * site.length, table.events[-1].base.ahead)
        return self.assembled(belief, start, [*stages, *on])


def below_edge(site: CornerSite, top: Array | float) -> dict:
    """Heights of the pairs where the gallop ends."""
    front = top - BELOW * site.length
    rear = front - site.span
    return {FRONT: front, MIDDLE: rear + site.near, REAR: rear}


def over_edge(site: CornerSite, belief: Case, events: Sequence[Event]) -> list[Stage]:
    """2.4.3: the events, from the end of the gallop on."""
    feet = {legs: site.on_wall(legs, height) for legs, height in below_edge(site, belief.on(Corner).height).items()}
    unit, pitch, stages = leg_unit(belief.robot), 90.0, []
    for event in events:
        swing, guides = {}, {}
        if event.legs is not None and event.to is not None:
            swing = spot(belief, event.legs, event.to)
            ahead = unit * jnp.array([1.0, -1.0, 1.0])
            leave, land = ahead * jnp.array(event.leave), ahead * jnp.array(event.land)
            guides = curves(feet[event.legs], swing, leave, land)
            feet[event.legs] = swing
        centre = point(0.0, -event.base.ahead * unit, belief.on(Corner).height + event.base.above * unit)
        turn = point(jnp.radians(pitch - event.base.pitch), 0.0, 0.0)
        pitch = event.base.pitch
        stages.append(Stage(event.name, TIMES * site.step.time, swing, CYCLE_B_SMOOTH, guides=guides,
                            position=centre, turn=turn, pace=SMOOTH))  # fmt: skip
    return stages


def spot(belief: Case, legs: tuple[int, int], to: Wall | Roof) -> dict[int, Array]:
    """Footholds of a pair (m)."""
    top, unit = belief.on(Corner).height, leg_unit(belief.robot)
    aside = to.aside * unit
    if isinstance(to, Roof):
        return pair(legs, aside, -to.ahead * unit, top)
    return pair(legs, aside, -aside / jnp.tan(belief.on(Corner).half_angle), top + to.above * unit)


def walk_on(site: CornerSite, belief: Case, steps: int, way: Array | float, ahead: Array | float) -> list[Stage]:
    """Swings by tripod, in each of which the base goes `way` (m) on, from `ahead` of the corner's edge.

    Where the roof is narrow, so are the tracks. In the first two the feet go beside their hips and the base rests:
    farther on middle feet would meet the front legs.
    """
    top, stages = belief.on(Corner).height, []
    base = -ahead * leg_unit(belief.robot)
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
