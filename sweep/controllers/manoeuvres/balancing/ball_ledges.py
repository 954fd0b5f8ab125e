"""From a ledge on to a ball that leans on it, with the ball to the far ledge, and off (monograph 3.2).

World axes as in `Ledges`: the robot faces x. The way off is the way on backwards in time, seen in a mirror. While a
foot stands on a ledge the ball is meant to rest: feet that followed it as it is seen would let it go where it drifts.
The mass centre stays between the ledge's edge and the ball's centre, so that the ball is pressed to the wall.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sweep.controllers.manoeuvres.balancing.ball import BallDrive, DriveMemory, OnBall, perch
from sweep.controllers.manoeuvres.balancing.beside_ball import refuse
from sweep.controllers.manoeuvres.balancing.by_pairs import LEDGE, OTHER, PAIRS, Move, Place, Stand, Way
from sweep.controllers.manoeuvres.balancing.parts import InParts, has_just_begun
from sweep.controllers.manoeuvres.goals import UPRIGHT
from sweep.controllers.observation import Observation
from sweep.controllers.plan import Plan, assemble
from sweep.controllers.support import RESTS, Support
from sweep.controllers.tracker import Guidance, Guided, TrackerState
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.formulas.leg import SIDE
from sweep.models.case import Case
from sweep.models.frames import WORLD
from sweep.models.obstacles.ledges import Ledges

ROLLS = "roll"


class Table(NamedTuple):
    """The numbers of the way on to the ball."""

    start: Stand
    moves: tuple[Move, ...]


TABLE = Table(
    start=Stand(
        (-1.725, 0.371),
        {
            "rear": Place(LEDGE, -0.8206, 0.5012),
            "middle": Place(LEDGE, -0.3315, 0.4666),
            "front": Place(LEDGE, -0.0558, 0.5051),
        },
    ),
    moves=(
        Move("front", 0.8, (-1.725, 0.2466), "front", Place(0, -0.1666, 0.4698), 0.126, (0.013, 0.072, 1)),
        Move("on", 1.3, (-1.25, 0.3725)),
        Move("middle", 0.8, (-1.3984, 0.4342), "middle", Place(LEDGE, -0.0439, 0.6697), 0.0722, (1.871, -1.429, 2.25)),
        Move("on2", 0.9, (-0.7974, 0.392)),
        Move("rear", 1, (-1.0159, 0.4099), "rear", Place(LEDGE, -0.09, 0.5214), 0.0758, (-0.435, 1.143, 1)),
        Move("middle2", 0.8, (-0.8456, 0.4418), "middle", Place(0, -0.3444, 0.5349), 0.1187, (0.176, -1.012, 1.145)),
        Move("on3", 0.5, (-0.9631, 0.3807)),
        Move("front2", 1, (-0.75, 0.3898), "front", Place(0, 0.429, 0.4375), 0.169, (1.211, 0.771, 1)),
        Move("on4", 1.3, (-0.4, 0.3117)),
        Move("middle3", 0.8, (-0.4, 0.3638), "middle", Place(0, -0.1811, 0.7018), 0.1103, (0.122, -0.509, 2.257)),
        Move("on5", 2.0, (-0.0096, 0.5141)),
        Move("rear2", 1.3, (-0.0139, 0.5106), "rear", Place(0, -0.429, 0.4375), 0.0641, (0.162, 0.236, 1)),
        Move("middle4", 0.8, (-0.0283, 0.4925), "middle", Place(0, 0, 0.6125), 0.1658, (0.5, -0.739, 2.071)),
        Move("lower", 0.8, (0.0, 0.416)),
    ),
)


class Docking(NamedTuple):
    """Steps that roll the ball to the far wall, as many as it needs."""

    drive: BallDrive
    speed: Array | float  # m/s, at the wall
    near: Array | float  # m, that may be left to the wall
    calm: Array | float  # m/s, of a ball that rests there

    def memory(self, belief: Case, plan: Plan) -> DriveMemory:
        """Of the drive."""
        return self.drive.memory(belief, plan)

    def guide(
        self, belief: Case, plan: Plan, state: TrackerState, seen: Observation, begins: Bool[Array, ""], period: float
    ) -> Guidance:
        """By the drive's law, to a place so far behind the wall that its speed is left there."""
        place = belief.on(Ledges).at_far_wall + self.speed / self.drive.brake
        return replace(self.drive, place=place).guide(belief, plan, state, seen, begins, period)

    def ends(self, belief: Case, plan: Plan, state: TrackerState, seen: Observation) -> Bool[Array, ""]:
        """No step is begun where the ball rests at the wall."""
        left = belief.on(Ledges).at_far_wall - seen.free.position[0, 0]
        rests = jnp.linalg.norm(seen.free.velocity[0]) < self.calm
        return has_just_begun(plan, state) & (left < self.near) & rests


@parameters
class BallLedges(OnBall, InParts):
    """From ledge to ledge with a ball. Stages and their numbers are `TABLE`."""

    goal: ClassVar = {
        **UPRIGHT, "docking_gap_max_m": 4e-3, "docking_speed_max_mps": 0.04, "past_centre_max_m": 0.02
    }  # fmt: skip
    kind: str = choice("ball_ledges", "ball_ledges")
    steps: int = count(34, at_least=1, at_most=200)  # that roll the ball, at most
    step_time: float = quantity(1.2, "s", above=0, at_most=20)  # of these steps
    speed: float = quantity(0.1, "m/s", above=0)  # of the ball on its way
    speed_gain: float = quantity(0.3, "s", at_least=0)  # k_v, of `ball_drive`
    brake: float = quantity(0.1, "1/s", above=0)  # wanted speed for each metre that is left, at most
    docking: float = quantity(0.015, "m/s", above=0)  # of the ball as it comes to the far wall
    calm_speed: float = quantity(0.01, "m/s", above=0)  # of a ball that rests there
    near: float = quantity(4e-3, "m", above=0)  # left to the wall by a ball that is there
    height_ratio: float = quantity(0.34, "a_r", above=0, at_most=2)  # of the base over the ball's top
    deepening: float = quantity(1e-3, "m", at_least=0, at_most=0.05)  # footholds inside ball and ledges
    press: float = quantity(1e-3, "m", at_least=0, at_most=0.05)  # feet on the ball deeper than they are measured
    squeeze: float = quantity(1.5e-3, "m", at_least=0, at_most=0.05)  # the same to the middle
    ease: float = quantity(0.15, "s", above=0)  # in which feet go over to where they are measured
    patience: float = quantity(0.1, "s", at_least=0)  # longest wait for a touchdown

    needs = (Ledges,)

    @property
    def table(self) -> Table:
        """The numbers of its plan."""
        return TABLE

    def plan(self, belief: Case, table: Table | None = None) -> Plan:
        """On to the ball, over to the other ledge, off.

        Raises `InputError` where a foot is out of reach at the start, by plain numbers.
        """
        table = table or self.table
        way, centre = BetweenLedges(belief, self), belief.on(Ledges).start().position[0]
        refuse(belief, lambda: way.stance(table.start, belief.on(Ledges).start().position[0]))
        start = way.stance(table.start, centre)
        stages = [way.stage(Move("stand", 0.5, table.start.base))]
        stages += [way.stage(move, "on.") for move in table.moves]
        stages += self.drive.steps_of(perch(belief, self), ROLLS)
        way.far = True
        stages += [way.stage(move, "off.") for move in off(table)]
        return assemble(start, [*stages, way.stage(Move("halt", 1.0, seen_from_far(table.start).base))],
                        self.patience, ease=self.ease)  # fmt: skip

    @property
    def drive(self) -> BallDrive:
        """The steps that roll the ball."""
        return self.driven(steps=self.steps, speed=self.speed, step_time=self.step_time, speed_gain=self.speed_gain,
                           brake=self.brake)  # fmt: skip

    @property
    def parts(self) -> Mapping[str, Guided]:
        """The steps."""
        return {ROLLS: Docking(self.drive, self.docking, self.near, self.calm_speed)}


def seen_from_far(stand: Stand) -> Stand:
    """The same at the far ledge: in the mirror between the ledges."""
    places = {pair: place._replace(ahead=-place.ahead) for pair, place in ((p, stand.feet[OTHER[p]]) for p in PAIRS)}
    return Stand((-stand.base[0], stand.base[1]), places)


def off(table: Table) -> list[Move]:
    """From the ball to the far ledge: the way on to it backwards in time, in the mirror."""
    feet, stands = dict(table.start.feet), [table.start]
    for move in table.moves:
        feet |= {move.pair: move.place} if move.pair else {}
        stands.append(Stand(move.base, dict(feet)))
    back = []
    for move, stand in zip(reversed(table.moves), reversed(stands[:-1]), strict=True):
        there, pair = seen_from_far(stand), OTHER.get(move.pair, "")
        ahead, aside, up = move.plane
        back.append(Move(move.name, move.time, there.base, pair, there.feet[pair] if pair else move.place, move.lift,
                         (-ahead, aside, up)))  # fmt: skip
    return back


class BetweenLedges(Way):
    """From the near ledge, and to the far one."""

    far = False  # which ledge is meant

    def above(self, height: Array | float) -> Array | float:
        """From the mean of ledge and ball's top."""
        return 0.5 * self.ledges.height + height * self.length

    def ashore(self, leg: int, place: Place) -> Float[Array, " 3"]:
        """From the edge."""
        edge = self.ledges.width if self.far else 0.0
        place_ = (
            edge + place.ahead * self.length,
            SIDE[leg - 1] * place.aside * self.length,
            self.ledges.height - self.how.deepening,
        )
        return jnp.stack([jnp.asarray(x, float) for x in place_])

    def supports(self) -> tuple[Support, ...]:
        """The ball is meant to rest while a foot stands on a ledge."""
        return (RESTS if WORLD in self.frames.values() else Support(),)

    @property
    def ledges(self) -> Ledges:
        """The obstacle."""
        assert isinstance(self.obstacle, Ledges)
        return self.obstacle
