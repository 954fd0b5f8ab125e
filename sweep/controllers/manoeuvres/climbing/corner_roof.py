"""From the walls of a corner over its edge on to the roof (monograph 2.4.3), with planned foot forces.

World axes as in `corner`. The roof is a wedge: at a distance d behind its tip it is 2 d tan psi wide.

The printed sequence of events (table 2.1) is replaced by `EVENTS`, all of whose numbers were searched for together: for
every stance the friction and the torque that the best foot forces need, the legs' reach, and the distances of links to
the house and to one another.
"""

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from sweep.controllers.gaits import TRIPOD
from sweep.controllers.manoeuvres.climbing.corner import FRONT, MIDDLE, REAR, OnCorner, Site, climb, gallop
from sweep.controllers.manoeuvres.climbing.pole import curves, pair, point
from sweep.controllers.plan import CYCLE_B_SMOOTH, SMOOTH, Plan, Stage, Stance
from sweep.core.errors import InputError
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.formulas.leg import SIDE
from sweep.models.case import Case
from sweep.models.obstacles.corner import Corner


class Wall(NamedTuple):
    """Where a pair stands on the walls (a_r)."""

    aside: float
    above: float  # the roof


class Roof(NamedTuple):
    """Where a pair stands on the roof (a_r)."""

    aside: float
    ahead: float  # of the corner's edge


class Pose(NamedTuple):
    """Of the base: its centre (a_r) and its pitch (deg)."""

    ahead: float  # of the corner's edge
    above: float  # the roof
    pitch: float


class Event(NamedTuple):
    """A swing of a pair, or a move of the base alone."""

    name: str
    base: Pose  # at the end
    legs: tuple[int, int] | None = None
    to: Wall | Roof | None = None
    # control points of the swing's curve, from the place that is left and from the new one: out, ahead, up (a_r)
    leave: tuple[float, float, float] = (0.0, 0.0, 0.0)
    land: tuple[float, float, float] = (0.0, 0.0, 0.0)


EVENTS: tuple[Event, ...] = (
    Event("roof.middle.up", Pose(0.152, -0.568, 90.9), MIDDLE, Wall(0.324, -0.389),
          leave=(0.105, -0.133, 0.0), land=(0.138, -0.1, 0.01)),
    Event("roof.front.on", Pose(0.018, -0.404, 72.4), FRONT, Roof(0.538, 0.587),
          leave=(0.373, -0.079, 0.014), land=(-0.015, 0.008, 0.191)),
    Event("roof.middle.near", Pose(-0.040, -0.316, 70.2), MIDDLE, Wall(0.41, -0.32),
          leave=(0.245, -0.316, 0.335), land=(0.344, -0.054, 0.109)),
    Event("roof.rear.up", Pose(-0.057, -0.179, 56.3), REAR, Wall(0.272, -0.571),
          leave=(0.194, -0.093, 0.012), land=(0.243, -0.142, -0.07)),
    Event("roof.pitch", Pose(-0.113, 0.093, 49.6)),
    Event("roof.middle.higher", Pose(0.001, 0.255, 55.2), MIDDLE, Wall(0.41, -0.111),
          leave=(0.171, -0.105, 0.133), land=(0.235, -0.101, 0.107)),
    Event("roof.middle.on", Pose(0.194, 0.377, 38.8), MIDDLE, Roof(0.284, 0.333),
          leave=(0.495, -0.328, -0.285), land=(0.161, -0.322, 0.474)),
    Event("roof.front.ahead", Pose(0.036, 0.300, 51.0), FRONT, Roof(0.437, 0.667),
          leave=(-0.351, -0.375, 0.687), land=(0.004, -0.482, 0.634)),
    Event("roof.middle.ahead", Pose(0.386, 0.385, 31.4), MIDDLE, Roof(0.429, 0.481),
          leave=(0.179, -0.129, 0.257), land=(-0.008, 0.003, 0.081)),
    Event("roof.over", Pose(0.641, 0.286, 11.9)),
    Event("roof.rear.on", Pose(0.516, 0.495, 0.0), REAR, Roof(0.276, 0.334),
          leave=(0.078, -0.147, -0.057), land=(0.134, -0.346, 0.337)),
)  # fmt: skip
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

    kind: str = choice("corner_roof", "corner_roof")
    cycles: int = count(2, at_least=1, at_most=100)  # of the gallop, which goes as far as the house is high

    def ascend(self, belief: Case) -> tuple[Site, Stance, list[Stage]]:
        """Climb until the front feet are below the edge, and get over it.

        Raises `InputError` where the house is too low, or too high for the cycles, by plain numbers; rows in which
        it is too low are not a number, hence invalid.
        """
        site, top = self.site(belief), belief.on(Corner).height
        start, stages, feet = climb(site)
        rise = below_edge(site, top)[FRONT] - feet[FRONT]
        if not isinstance(rise, Tracer):
            self.refuse(belief, float(rise), float(MOST_RISE * site.length))
        up = gallop(site, feet, jnp.where(rise >= 0, rise, jnp.nan), self.cycles)
        return site, start, [*stages, *up, *over_edge(site, belief)]

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

    def plan(self, belief: Case) -> Plan:
        """Get on to the roof, halt."""
        _, start, stages = self.ascend(belief)
        return self.assembled(belief, start, stages)


@parameters
class CornerFull(CornerRoof):
    """From the floor up a corner on to the roof, and some steps on."""

    kind: str = choice("corner_full", "corner_full")
    steps: int = count(10, at_least=0, at_most=100)  # swings by tripod on the roof
    roof_step_ratio: float = quantity(0.1, "a_r", above=0, at_most=0.3)  # way of the base in each, from the third on

    def plan(self, belief: Case) -> Plan:
        """Get on to the roof, walk on, halt."""
        site, start, stages = self.ascend(belief)
        on = walk_on(site, belief, self.steps, self.roof_step_ratio * site.length)
        return self.assembled(belief, start, [*stages, *on])


def below_edge(site: Site, top: Array | float) -> dict:
    """Heights of the pairs where the gallop ends."""
    front = top - BELOW * site.length
    rear = front - site.span
    return {FRONT: front, MIDDLE: rear + site.near, REAR: rear}


def over_edge(site: Site, belief: Case) -> list[Stage]:
    """2.4.3: the events, from the end of the gallop on."""
    feet = {legs: site.on_wall(legs, height) for legs, height in below_edge(site, belief.on(Corner).height).items()}
    pitch, stages = 90.0, []
    for event in EVENTS:
        swing, guides = {}, {}
        if event.legs is not None and event.to is not None:
            swing = spot(site, belief, event.legs, event.to)
            ahead = site.length * np.array([1.0, -1.0, 1.0])
            leave, land = ahead * np.array(event.leave), ahead * np.array(event.land)
            guides = curves(feet[event.legs], swing, leave, land)
            feet[event.legs] = swing
        centre = point(0.0, -event.base.ahead * site.length, belief.on(Corner).height + event.base.above * site.length)
        turn = point(np.radians(pitch - event.base.pitch), 0.0, 0.0)
        pitch = event.base.pitch
        stages.append(Stage(event.name, TIMES * site.step.time, swing, CYCLE_B_SMOOTH, guides=guides,
                            position=centre, turn=turn, pace=SMOOTH))  # fmt: skip
    return stages


def spot(site: Site, belief: Case, legs: tuple[int, int], to: Wall | Roof) -> dict[int, Array]:
    """Footholds of a pair (m)."""
    top, aside = belief.on(Corner).height, to.aside * site.length
    if isinstance(to, Roof):
        return pair(legs, aside, -to.ahead * site.length, top)
    return pair(legs, aside, -aside / jnp.tan(belief.on(Corner).half_angle), top + to.above * site.length)


def walk_on(site: Site, belief: Case, steps: int, way: Array | float) -> list[Stage]:
    """Swings by tripod, in each of which the base goes `way` (m) on. Where the roof is narrow, so are the tracks.

    In the first two the feet go beside their hips and the base rests: farther on middle feet would meet the front legs.
    """
    top, stages = belief.on(Corner).height, []
    base = -EVENTS[-1].base.ahead * site.length
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


def on_roof(site: Site, belief: Case, leg: int, y: Array | float) -> Float[Array, " 3"]:
    """A foothold beside a hip at `y` (m), or as far back as the roof is wide enough."""
    slope, brink = jnp.tan(belief.on(Corner).half_angle), BRINK * site.length
    y = jnp.minimum(y, -brink - NARROWEST * site.length / slope)
    aside = jnp.minimum(site.floor_track, slope * (-y - brink))
    return point(float(SIDE[leg - 1]) * aside, y, belief.on(Corner).height)
