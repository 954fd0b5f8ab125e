"""From the floor on to a pole and up it (monograph 2.3.1 and 2.3.2 of section 2.3.2, "Construction of the motion").

World axes: the pole stands along z at the origin and the robot comes along -y. The book's xi, eta, zeta are x, y, z.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.controllers.assembly import assemble
from sweep.controllers.forces import PlannedForces
from sweep.controllers.frames import Stance
from sweep.controllers.gaits import FRONT, GALLOP, MIDDLE, REAR, Step
from sweep.controllers.manoeuvres.climbing.walking import walk_up
from sweep.controllers.manoeuvres.goals import ON_ITS_FEET
from sweep.controllers.moves import numbers_of
from sweep.controllers.plan import CYCLE_A, CYCLE_B, STAND, Plan, Stage
from sweep.controllers.posture import leg_unit
from sweep.controllers.symmetry import gone
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.formulas.leg import SIDE
from sweep.models.case import Case
from sweep.models.obstacles.charts import point
from sweep.models.obstacles.pole_ledge import PoleLedge

OUTWARD = SIDE[:, None] * np.array([1, 0, 0])  # (6, 3), e_n of (2.3.2)
UP = np.array([0, 0, 1])


class PoleEntry(NamedTuple):
    """Numbers of 2.3.1 and 2.3.2, from the floor on to the pole, as the plan's file has and explains them."""

    pitch: tuple[float, float, float, float]
    away: float
    lower: float
    floor: tuple[float, float]
    nearer: float
    middle: tuple[float, float]
    rear: tuple[float, float]
    below: tuple[float, float, float]


class PoleSite(NamedTuple):
    """What the stages are made of (m)."""

    length: Array | float  # a_r, of the body
    unit: Array | float  # `leg_unit`, nominally a_r, in which all is measured that legs have to reach
    radius: Array | float  # r
    top: Array | float  # h, of the pole
    foot_radius: Array | float  # x_f, the feet's distance from the pole's axis: r less the deepening
    track: Array | float  # of a foot on the floor from the plane x = 0
    clearance: Array | float  # d, of the base above the floor
    standoff: Array | float  # d_c, of the vertical base from the pole's axis
    front_ahead: tuple[Array | float, Array | float]  # arguments of `ahead` for the front feet
    step: Step
    entry: PoleEntry

    @property
    def crossing(self) -> Float[Array, " 3"]:
        """Where the lines cross along which the base's front and rear edges go while it pitches up."""
        away, lower = self.entry.away * self.unit, self.entry.lower * self.unit
        return point(0.0, self.standoff + away, self.clearance - lower)

    def ahead(self, share: Array | float, more: Array | float) -> Array | float:
        """How far in front of the pole's axis feet first touch it (m): `share` of r, and `more` the thicker it is."""
        return (share + more * (self.radius / self.unit - 0.4)) * self.radius

    @property
    def upright(self) -> Array | float:
        """Height of the base's centre (m) when it has become vertical."""
        return self.clearance + self.length / 2

    def on_floor(self, legs: tuple[int, int]) -> dict[int, Array]:
        """Places of a pair before the pole, (2.3.1)."""
        front, middle = (x * self.step.landing for x in self.entry.floor)
        behind = {FRONT: front, MIDDLE: self.length / 2 - middle, REAR: self.length}[legs]
        return pair(legs, self.track, self.crossing[1] + behind, 0.0)

    def on_pole(self, legs: tuple[int, int], ahead: Array | float, height: Array | float) -> dict[int, Array]:
        """Footholds of a pair, `ahead` (m) of the pole's axis, for a base's centre at `height` (m).

        Where a cycle of the gallop starts, the front, middle and rear feet stand at A, B and C of their step cycles.
        """
        reach = self.length / 2 - self.step.landing
        offset = {FRONT: reach, MIDDLE: 0.0, REAR: -reach}[legs]
        return pair(legs, jnp.sqrt(self.foot_radius**2 - jnp.asarray(ahead) ** 2), ahead, height + offset)


@parameters
class OnPole(PlannedForces):
    """What manoeuvres on a pole have in common: by tripod to it, on to it, and up it by gallop. Ratios are to a_r.

    The feet are pressed on to the pole by footholds inside it, as printed, or by planned forces.

    For robots with legs along their sides, and poles from 0.32 to 0.52 a_r. What differs from the printed plan, and
    why: `PoleEntry` and `front_ahead`; d_c, printed 0.47 a_r, where the base touches poles thicker than 0.45 a_r; feet
    on the floor stay as far from the hips whatever the pole, printed at its radius, where knees meet before thin poles;
    and in `get_on` the rear feet's step on the floor, when the front feet go up, and how feet leave the floor.
    """

    steps: int = count(4, at_least=0, at_most=100)  # swings of the approach, 2 x* each
    cycles: int = count(3, at_least=0, at_most=100)  # of the gallop, 3 x* each
    # d_x, half of what a foot moves ahead in a swing
    half_step_ratio: float = quantity(0.1, "a_r", above=0, at_most=0.5)
    lift_ratio: float = quantity(0.03, "a_r", above=0, at_most=0.5)  # d_y, how high a swinging foot is lifted
    height_ratio: float = quantity(0.5, "a_r", above=0, at_most=2)  # d, of the base above the floor
    gap_ratio: float = quantity(0.07, "a_r", at_least=0, at_most=2)  # d_c - r
    spread_ratio: float = quantity(0.175, "a_r", above=0, at_most=1)  # of feet on the floor from their hips, sideways
    # How far in front of the pole's axis the front feet first touch it, and how much more for every a_r by which r
    # passes 0.4 a_r. With the printed 0, and the printed pitch, their shins are 34 mm inside the pole. A foot that
    # touches it at the angle psi in front of its side needs a friction of tan(psi) to stay there (2.1): farther ahead
    # than shins need is no better.
    front_ahead: float = quantity(0.47, "r", at_least=0, at_most=1)
    # by how much more for each a_r that the pole's radius is above 0.4 a_r
    front_ahead_slope: float = quantity(1.5, "r/a_r", at_least=0, at_most=10)
    rate: float = quantity(3.0, "rad/s", above=0, at_most=20)  # varpi, of the swings, whose time t* it gives
    deepening: float = quantity(5e-3, "m", at_least=0, at_most=0.05)  # epsilon, footholds inside the pole
    patience: float = quantity(0.1, "s", at_least=0)  # longest wait for a touchdown
    # what presses feet on: footholds inside the pole, or forces planned for every stance
    forces: str = choice("deepening", "deepening", "planned")

    needs = (PoleLedge,)
    own_plan = "pole"

    def site(self, belief: Case) -> PoleSite:
        """What is believed of the robot and of the pole."""
        unit, pole = leg_unit(belief.robot), belief.on(PoleLedge)
        step = Step.of(unit, self.half_step_ratio, self.lift_ratio, self.rate)
        track = belief.robot.body_width / 2 + self.spread_ratio * unit
        return PoleSite(
            belief.robot.body_length,
            unit,
            pole.radius,
            pole.height,
            pole.radius - self.deepening,
            track,
            self.height_ratio * unit,
            pole.radius + self.gap_ratio * unit,
            (self.front_ahead, self.front_ahead_slope),
            step,
            numbers_of(PoleEntry, belief, "entry"),
        )

    def climb(
        self, site: PoleSite, belief: Case, rise: Array | float, gap: Array | float = 0.0
    ) -> tuple[Stance, list[Stage]]:
        """Stand, go to the places of (2.3.1), get on, shift the feet up, gallop by `rise` (m) a swing.

        `gap` is as in `walk_up`.
        """
        arrival = site.crossing + point(0.0, site.length / 2, 0.0)
        places = {leg: place for legs in GALLOP for leg, place in site.on_floor(legs).items()}
        spread = site.track - belief.robot.body_width / 2
        start, walk = walk_up(belief, site.step, arrival, spread, places, self.steps, gap)
        climb = [*get_on(site), *shift_up(site), *gallop(site, self.cycles, rise)]
        return start, [Stage("stand", STAND), *walk, *self.rested(climb)]

    def rested(self, stages: list[Stage]) -> list[Stage]:
        """With planned forces, `stages` with a rest before each of them for the load to go over."""
        return self.loading(stages) if self.forces == "planned" else stages


@parameters
class PoleClimb(OnPole):
    """By tripod to the pole, on to it, and up it by gallop."""

    goal: ClassVar = ON_ITS_FEET
    two_way: ClassVar = True
    kind: str = choice("pole_climb", "pole_climb")

    def plan(self, belief: Case) -> Plan:
        """The way and a halt, with its forces if they are planned."""
        start, stages = self.way(belief)
        plan = gone(belief, assemble(start, [*stages, Stage("halt", STAND)], self.patience))
        return self.with_feedforward(belief, plan) if self.forces == "planned" else plan

    def way(self, belief: Case) -> tuple[Stance, list[Stage]]:
        """The climb to the end of the gallop."""
        site = self.site(belief)
        return self.climb(site, belief, site.step.landing)


def get_on(site: PoleSite) -> list[Stage]:
    """2.3.2: front feet to the pole, rear feet nearer to it, middle feet to the pole, front feet up, rear feet to it.

    The base's front edge goes up a vertical line, its rear edge along a horizontal one, as printed: its centre turns
    about their crossing by the angle by which the base pitches up. The lines are farther from the pole than the printed
    d_c, and lower than d (`PoleEntry`).

    Printed with the front feet going up last. Ahead of the axis the pole's normal pushes the robot away from it, which
    costs a friction of 0.93 once the rear feet are in the air; with the front feet up and at the pole's sides, 0.3.
    """
    step, time, entry = site.step, site.step.time, site.entry
    # Printed as a step of -2 x* along xi, which would take both feet to one side.
    nearer = {leg: place - point(0.0, entry.nearer * step.landing, 0.0) for leg, place in site.on_floor(REAR).items()}
    ahead = site.front_ahead, entry.middle, entry.rear
    first = {legs: site.on_pole(legs, site.ahead(*where), site.upright - below * step.landing)
             for legs, where, below in zip(GALLOP, ahead, entry.below, strict=True)}  # fmt: skip
    swings = (
        Stage("on.front", time, first[FRONT], CYCLE_B, 3 * step.height, OUTWARD + UP),
        Stage("on.nearer", time, nearer, CYCLE_A, step.height),
        Stage("on.middle", time, first[MIDDLE], CYCLE_B, guides=off_floor(site, site.on_floor(MIDDLE), first[MIDDLE])),
        Stage("up.front", time, site.on_pole(FRONT, 0.0, site.upright), CYCLE_A, step.height, OUTWARD),
        Stage("on.rear", time, first[REAR], CYCLE_B, guides=off_floor(site, nearer, first[REAR])),
    )
    crossing, half = site.crossing, site.length / 2
    pitches, rates = pitch_path(entry.pitch)
    stages = []
    for k, swing in enumerate(swings):
        angle, pitch = pitches[k + 1] - pitches[k], pitches[k + 1]
        centre = crossing + half * point(0.0, jnp.cos(pitch), jnp.sin(pitch))
        stages.append(replace(swing, position=centre, pivot=crossing, arc=angle, turn=point(-angle, 0.0, 0.0),
                              rates=tuple(rates[k : k + 2] / angle)))  # fmt: skip
    return stages


def pitch_path(between: Sequence[float]) -> tuple[Float[Array, " 6"], Float[Array, " 6"]]:
    """Pitch (rad) before and after the swings on to the pole, and its rates (rad per swing) there.

    The rates are those of the monotone cubic through it that starts and ends at rest: harmonic means.
    """
    pitch = jnp.radians(jnp.array([0.0, *between, 90.0]))
    rise = jnp.diff(pitch)
    means = 2 * rise[:-1] * rise[1:] / (rise[:-1] + rise[1:])
    return pitch, jnp.array([0.0, *means, 0.0])


def off_floor(site: PoleSite, start: dict[int, Array], end: dict[int, Array]) -> dict[int, Array]:
    """Guides of swings from the floor to the pole: straight up from the floor, from the side on to the pole.

    The printed flat cycle drags a foot along the floor where the base hangs lower than planned.
    """
    up, out = 0.3 * site.unit, 0.1 * site.unit
    up = point(0.0, 0.0, up)
    return {leg: jnp.stack([start[leg] + up, goal + out * OUTWARD[leg - 1]]) for leg, goal in end.items()}


def shift_up(site: PoleSite) -> list[Stage]:
    """2.3.2 from t_5: middle and rear feet go up to where the gallop starts, the base comes to d_c from the pole."""
    base = point(0.0, site.standoff, site.upright)
    middle, rear = (
        Stage(name, site.step.time, site.on_pole(legs, 0.0, site.upright), CYCLE_A, site.step.height, OUTWARD)
        for name, legs in (("up.middle", MIDDLE), ("up.rear", REAR))
    )
    return [replace(middle, position=base, rates=(0.0, 0.0)), rear]


def gallop(site: PoleSite, cycles: int, rise: Array | float) -> list[Stage]:
    """2.3.1: front, middle and rear feet go up in their turns by three times what the base goes up in each swing."""
    stages = []
    for k in range(3 * cycles):
        goal = site.upright + 3 * rise * (k // 3 + 1)
        centre = point(0.0, site.standoff, site.upright + rise * (k + 1))
        name = f"gallop{k // 3 + 1}.{('front', 'middle', 'rear')[k % 3]}"
        stages.append(Stage(name, site.step.time, site.on_pole(GALLOP[k % 3], 0.0, goal), CYCLE_A, site.step.height,
                            OUTWARD, carry=1 / 3, position=centre))  # fmt: skip
    return stages


def pair(legs: Sequence[int], x: Array | float, y: Array | float, z: Array | float) -> dict[int, Array]:
    """Points (m) of legs by number, each on its own side of the plane x = 0."""
    return {leg: point(float(SIDE[leg - 1]) * x, y, z) for leg in legs}
