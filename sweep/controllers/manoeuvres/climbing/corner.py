"""Up the corner of a house (monograph 2.4.2), with planned foot forces.

World axes: the corner's edge stands along z at the origin and the robot comes along -y. The book's xi and zeta are x
and z; its eta counts from the middle between the tracks on the walls.
"""

from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from sweep.controllers.assembly import assemble
from sweep.controllers.forces import PlannedForces
from sweep.controllers.frames import Stance
from sweep.controllers.gaits import FRONT, MIDDLE, REAR, Step
from sweep.controllers.manoeuvres.climbing.pole import OUTWARD, UP, pair
from sweep.controllers.manoeuvres.climbing.walking import TOWARDS
from sweep.controllers.manoeuvres.goals import ON_ITS_FEET
from sweep.controllers.moves import numbers_of
from sweep.controllers.plan import CYCLE_B_SMOOTH, SMOOTH, STAND, Plan, Stage
from sweep.controllers.posture import leg_unit
from sweep.controllers.symmetry import gone
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.models.case import Case
from sweep.models.legs import LEGS
from sweep.models.obstacles.charts import point
from sweep.models.obstacles.corner import Corner

# e of stages 2.4.3 and 2.4.5
RISING = OUTWARD + UP
SLANTED = (OUTWARD + 0.9 * UP).tolist()


class CornerSite(NamedTuple):
    """What the stages are made of (m)."""

    length: Array | float  # a_r, of the body
    unit: Array | float  # `leg_unit`, nominally a_r, in which all is measured that legs have to reach
    track: Array | float  # x_f, half the distance between the tracks on the walls
    floor_track: Array | float  # half the distance between the feet on the floor
    edge: Array | float  # eta of the corner's edge
    clearance: Array | float  # zeta_f, of the base above the floor
    standoff: Array | float  # eta_f, of the vertical base
    span: Array | float  # from the rear to the front feet on the wall
    near: Array | float  # of the middle feet to the pair that swings next, at least
    step: Step

    def at(self, x: Array | float, eta: Array | float, z: Array | float) -> Array:
        """A point by the book's eta."""
        return point(x, eta - self.edge, z)

    def on_wall(self, legs: tuple[int, int], height: Array | float, wider: float = 1.0) -> dict[int, Array]:
        """Footholds of a pair, `wider` times the track apart."""
        return pair(legs, wider * self.track, -wider * self.edge, height)

    def on_floor(self, legs: tuple[int, int], eta: Array | float) -> dict[int, Array]:
        """Footholds of a pair on the floor (m)."""
        return pair(legs, self.floor_track, eta - self.edge, 0.0)

    def between(self, feet: dict) -> Array:
        """The upright base's centre half-way from the rear to the front feet."""
        return self.at(0.0, self.standoff, (feet[FRONT] + feet[REAR]) / 2)

    def swing(
        self,
        name: str,
        goals: dict[int, Array],
        times: float = 1.0,
        plane: np.ndarray | Sequence[Sequence[float]] = OUTWARD,
        **body,
    ) -> Stage:
        """A swing that takes `times` t*, with what the base does in it."""
        return Stage(name, times * self.step.time, goals, CYCLE_B_SMOOTH, self.step.height, plane, pace=SMOOTH, **body)


class CornerEntry(NamedTuple):
    """Numbers of 2.4.1 to 2.4.5, as the plan's file has and explains them."""

    pitch: tuple[float, float]
    track: float
    front: float
    higher: float
    middle_floor: float
    middle: float
    rear_floor: float
    rear: float


@parameters
class OnCorner(PlannedForces):
    """What manoeuvres on a corner have in common. Ratios are to a_r.

    That is `leg_unit` where legs have to reach, and the body's length for the rise of a gallop and steps on a roof. The
    book measures all by the body: legs shorter than its body's then do not reach where feet stand.
    """

    cycles: int = count(1, at_least=0, at_most=100)  # of the gallop up the corner
    anchoring: float = quantity(0.03, "s", above=0)  # in which footholds follow the feet
    # x_f, half the distance between the tracks on the walls
    track_ratio: float = quantity(1 / 3, "a_r", above=0, at_most=1)
    # eta_f, of the vertical base from the middle between the tracks
    standoff_ratio: float = quantity(0.39, "a_r", above=0, at_most=2)
    # of the vertical base from the corner's edge, at least; it goes farther from a sharper one
    edge_gap: float = quantity(8e-3, "m", at_least=0, at_most=1)
    # half the distance between the feet on the floor
    floor_track_ratio: float = quantity(0.44, "a_r", above=0, at_most=1)
    span_ratio: float = quantity(1.3, "a_r", above=0, at_most=3)  # from the rear to the front feet on the wall
    # from the middle feet to the pair that swings next, along the wall
    near_ratio: float = quantity(0.24, "a_r", above=0, at_most=1)
    height_ratio: float = quantity(0.5, "a_r", above=0, at_most=2)  # zeta_f, of the base above the floor
    # d_x, half of what a foot moves ahead in a swing
    half_step_ratio: float = quantity(0.1, "a_r", above=0, at_most=0.5)
    lift_ratio: float = quantity(0.05, "a_r", above=0, at_most=0.5)  # d_y, how high a swinging foot is lifted
    rate: float = quantity(3.0, "rad/s", above=0, at_most=20)  # varpi, of the swings, whose time t* it gives
    patience: float = quantity(0.5, "s", at_least=0)  # longest wait for a touchdown

    needs = (Corner,)
    two_way: ClassVar = True
    own_plan = "corner"

    def site(self, belief: Case) -> CornerSite:
        """What is believed of the robot and of the corner."""
        unit = leg_unit(belief.robot)
        track = self.track_ratio * unit
        edge = track / jnp.tan(belief.on(Corner).half_angle)
        return CornerSite(
            length=belief.robot.body_length,
            unit=unit,
            track=track,
            floor_track=self.floor_track_ratio * unit,
            edge=edge,
            clearance=self.height_ratio * unit,
            standoff=jnp.maximum(self.standoff_ratio * unit, edge + belief.robot.body_height / 2 + self.edge_gap),
            span=self.span_ratio * unit,
            near=self.near_ratio * unit,
            step=Step.of(unit, self.half_step_ratio, self.lift_ratio, self.rate),
        )

    def plan(self, belief: Case) -> Plan:
        """Stand, the way, halt, and the forces."""
        start, way = self.way(belief)
        stages = [Stage("stand", STAND), *self.loading(way), Stage("halt", STAND)]
        return self.with_feedforward(belief, gone(belief, assemble(start, stages, self.patience)))

    @abstractmethod
    def way(self, belief: Case) -> tuple[Stance, list[Stage]]:
        """Where the robot stands at the start, and the stages from there on."""


@parameters
class CornerClimb(OnCorner):
    """On to the corner and up it by the modified gallop.

    Forces are planned (`PlannedForces`) where the book presses the feet into the walls by a fixed depth: before every
    swing load goes off the feet that are to swing, and standing feet are commanded to where they are. What else differs
    from the printed plan: x_f is a_r/3 and eta_f 0.39 a_r, which need less friction than the book's 0.374 a_r; feet on
    the floor stand wider than on the walls, and the front ones x* farther ahead, else front and middle legs cross; the
    middle feet stand 0.6 x* nearer to the corner, and the base pitches up a little less in 2.4.2, or the middle legs do
    not reach the floor, and in 2.4.3 they leave it upwards, or are out of reach; the front feet touch the wall x*
    higher and farther apart (`CornerEntry`), where their shins clear it, and go up as much less in 2.4.4, whose way is
    along zeta; swings with a moving base take 2 to 2.6 t*; 2.4.7 is left out, and the feet are spread from the start,
    since the longer the lever from the lower to the upper feet, the less friction is needed.
    """

    goal: ClassVar = ON_ITS_FEET
    kind: str = choice("corner_climb", "corner_climb")
    rise_ratio: float = quantity(0.14, "a_r", at_least=0, at_most=100)  # of the whole gallop

    def way(self, belief: Case) -> tuple[Stance, list[Stage]]:
        """Get on, spread the feet, gallop."""
        site = self.site(belief)
        start, stages, feet = get_on(belief, site)
        return start, [*stages, *gallop(site, feet, self.rise_ratio * site.length, self.cycles)]


def get_on(belief: Case, site: CornerSite) -> tuple[Stance, list[Stage], dict]:
    """2.4.1 to 2.4.8: the base pitches up, its front edge on a vertical line, its rear edge on a level one.

    Then the rear feet go up, the middle ones out of their way first. The feet's heights on the wall, where the gallop
    starts, are returned beside the stages, by pair.
    """
    entry = numbers_of(CornerEntry, belief, "entry")
    a_r, x = site.length, site.step.landing
    pivot = site.at(0.0, site.standoff, site.clearance)
    behind = {FRONT: 0.0, MIDDLE: a_r / 2 - entry.middle_floor * x, REAR: a_r}
    floor = {leg: place for legs, eta in behind.items()
             for leg, place in site.on_floor(legs, site.standoff + eta).items()}  # fmt: skip
    start = Stance(jnp.stack([floor[leg] for leg in LEGS]), pivot + point(0.0, a_r / 2, 0.0), jnp.array(TOWARDS))

    pitches = [0.0, *(jnp.arcsin(sine) for sine in entry.pitch), np.pi / 2]

    def pitched(k: int) -> dict:
        angle, pitch = pitches[k + 1] - pitches[k], pitches[k + 1]
        centre = pivot + a_r / 2 * point(0.0, jnp.cos(pitch), jnp.sin(pitch))
        return {"position": centre, "pivot": pivot, "arc": angle, "turn": point(-angle, 0.0, 0.0)}

    front = site.clearance + a_r - entry.front * x
    middle = front - 0.7 * a_r + entry.middle * x
    rear, nearer = site.clearance - entry.rear * x, site.standoff + site.unit - entry.rear_floor * x
    higher = front + entry.higher * x
    feet = {FRONT: higher, MIDDLE: higher - site.span + site.near, REAR: higher - site.span}
    upright = np.tile(UP, (6, 1))
    stages = [
        site.swing("2.4.1", site.on_wall(FRONT, front, entry.track), 2.0, **pitched(0)),
        site.swing("2.4.2", site.on_floor(REAR, nearer), 2.0, upright, **pitched(1)),
        site.swing("2.4.3", site.on_wall(MIDDLE, middle), 2.6, RISING, **pitched(2)),
        site.swing("2.4.4", site.on_wall(FRONT, higher)),
        site.swing("2.4.5", site.on_wall(REAR, rear), plane=SLANTED),
        site.swing("2.4.6", site.on_wall(MIDDLE, feet[MIDDLE]), 2.0, position=site.between(feet)),
        site.swing("2.4.8", site.on_wall(REAR, feet[REAR])),
    ]
    return start, stages, feet


def gallop(site: CornerSite, feet: dict, rise: Array | float, cycles: int) -> list[Stage]:
    """2.4.2, end: the middle feet go near the pair that swings next, up with the base and down again.

    The feet's heights are `rise` (m) more after all cycles, and the middle ones' those of the rear ones and `near`.
    """
    stages, feet, way = [], dict(feet), rise / max(cycles, 1)
    for k in range(cycles):
        low = feet[FRONT] - site.near
        feet[FRONT] = feet[FRONT] + way
        stages.append(site.swing(f"gallop{k + 1}.up", site.on_wall(MIDDLE, low), 1.5, position=site.between(feet)))
        stages.append(site.swing(f"gallop{k + 1}.front", site.on_wall(FRONT, feet[FRONT])))
        feet[REAR] = feet[REAR] + way
        stages.append(site.swing(f"gallop{k + 1}.down", site.on_wall(MIDDLE, feet[REAR] + site.near)))
        stages.append(site.swing(f"gallop{k + 1}.rear", site.on_wall(REAR, feet[REAR])))
    return stages
