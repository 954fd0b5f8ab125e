"""From the floor up a leaning ladder on to the ledge behind it, and away by tripod (monograph 2.5).

World axes and the ladder's own as in `sweep/models/obstacles/ladder.py`: the robot comes along -y, and the ladder's
axes are turned against the world's about x. Feet on rungs, and the base while it is along the ladder, are planned in
the ladder's own axes: a ladder that leans otherwise than believed is climbed where it is seen.
"""

from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.controllers.forces import PlannedForces
from sweep.controllers.frames import WORLD, fixed, to_frame, to_world
from sweep.controllers.gaits import Step
from sweep.controllers.manoeuvres.climbing.ladder_moves import ALONG, FLOOR, MOVES, PLACES, RUNG, Move
from sweep.controllers.manoeuvres.climbing.pole import STAND
from sweep.controllers.manoeuvres.climbing.walking import EASED, walk_away, walk_up
from sweep.controllers.manoeuvres.goals import UPRIGHT
from sweep.controllers.plan import CYCLE_B, Plan, Stage, assemble
from sweep.controllers.posture import leg_unit
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.formulas import stepping
from sweep.formulas.leg import SIDE
from sweep.models.case import Case
from sweep.models.legs import LEGS
from sweep.models.obstacles.ladder import Ladder
from sweep.models.obstacles.surface import FreeState

OWN = fixed(0)  # the ladder's axes


class LadderSite(NamedTuple):
    """What the stages are made of."""

    ladder: Ladder
    free: FreeState  # the ladder as it starts
    unit: Array | float  # m, in which places are given: `leg_unit`
    deepening: Array | float  # m

    @property
    def foot(self) -> Array:
        """How far the ladder's lower end is from the wall (m)."""
        centre = self.free.position[0, 1]
        return centre + self.ladder.centre * jnp.cos(jnp.asarray(self.ladder.lean))

    def place(self, leg: int, move: Move) -> Float[Array, " 3"]:
        """Where a foot goes (m): on a rung in the ladder's axes, elsewhere in the world's."""
        aside, other = move.place
        x = float(SIDE[leg - 1]) * aside * self.unit
        if move.where == RUNG:
            return _point(x, self.up(move.rung) + self.deepening, other * self.ladder.rung_depth)
        if move.where == FLOOR:
            return _point(x, self.foot + other * self.unit, -self.deepening)
        return _point(x, -other * self.unit, self.ladder.ledge_height - self.deepening)

    def up(self, rungs: Array | float) -> Array | float:
        """The ladder's own y at a height along it, in rungs; whole ones at their tops."""
        return self.ladder.centre - rungs * self.ladder.rung_step

    def base(self, move: Move) -> Float[Array, " 3"]:
        """Where the base goes (m), in the axes of its frame."""
        one, other = move.base
        if move.over == ALONG:
            return _point(0.0, self.up(one), other * self.unit)
        return _point(0.0, -one * self.unit, self.ladder.ledge_height + other * self.unit)

    def guides(self, leg: int, move: Move, start: Array, goal: Array) -> Float[Array, "2 3"]:
        """Control points (m) of a swing, in the axes of its goal."""
        side = float(SIDE[leg - 1])
        axes = np.array([side, -1.0, 1.0] if move.where == RUNG else [side, 1.0, 1.0])
        first, last = (self.unit * axes * jnp.stack([jnp.asarray(x, float) for x in way])
                       for way in (move.first, move.last))  # fmt: skip
        return jnp.stack([start + first, goal + last])


@parameters
class LadderClimb(PlannedForces):
    """By tripod to a leaning ladder, up it and over its top on to the ledge, and away by tripod.

    Stages and their numbers are `MOVES`. Feet hold on by planned forces. Ratios are to a_r."""

    goal: ClassVar = UPRIGHT
    kind: str = choice("ladder_climb", "ladder_climb")
    settle: float = quantity(1.5, "s", above=0, at_most=60)  # that the robot waits for the ladder to come to rest
    steps: int = count(2, at_least=0, at_most=100)  # swings of the approach, 2 x* each
    steps_away: int = count(3, at_least=0, at_most=100)  # swings on the ledge, 2 x* each
    half_step_ratio: float = quantity(0.1, "a_r", above=0, at_most=0.5)  # d_x, half of what a foot moves ahead
    lift_ratio: float = quantity(0.03, "a_r", above=0, at_most=0.5)  # d_y, how high a swinging foot is lifted
    height_ratio: float = quantity(0.5, "a_r", above=0, at_most=2)  # d, of the base above floor and ledge
    spread_ratio: float = quantity(0.262, "a_r", above=0, at_most=1)  # of walking feet from their hips, sideways
    rate: float = quantity(3.0, "rad/s", above=0, at_most=20)  # varpi, of the swings, whose time t* it gives
    deepening: float = quantity(5e-4, "m", at_least=0, at_most=0.05)  # of footholds, inside
    patience: float = quantity(0.5, "s", at_least=0)  # longest wait for a touchdown
    load_time: float = quantity(0.3, "s", above=0, at_most=10)  # for load to go from foot to foot before a swing
    observer: float = quantity(0.1, "s", at_least=0, at_most=10)  # in which the measured ladder is taken over

    needs = (Ladder,)

    @property
    def table(self) -> tuple[Move, ...]:
        """The numbers of the way up."""
        return MOVES

    def obstacle_speed(self, duration: Array) -> Array:
        """The ladder is to stand (m/s)."""
        return jnp.zeros_like(duration)

    def plan(self, belief: Case, table: Sequence[Move] | None = None) -> Plan:
        """Wait, walk up, climb, walk away, halt."""
        plan = self.way(belief, self.table if table is None else table)
        return self.with_feedforward(belief, plan)

    def way(self, belief: Case, moves: Sequence[Move]) -> Plan:
        """The plan but for its forces."""
        ladder, robot = belief.on(Ladder), belief.robot
        length, unit = robot.body_length, leg_unit(robot)
        site = LadderSite(ladder, ladder.start(), unit, self.deepening)
        step = Step(self.half_step_ratio * length, self.lift_ratio * length, stepping.swing_time(self.rate))
        height, spread = self.height_ratio * unit, self.spread_ratio * length
        first, *rest = moves
        arrival = _point(0.0, site.foot + first.base[1] * unit, first.base[0] * unit)
        places = {leg: _point(float(SIDE[leg - 1]) * aside * unit, site.foot + ahead * unit, 0.0)
                  for legs, (aside, ahead) in PLACES.items() for leg in legs}  # fmt: skip
        start, walk = walk_up(belief, step, arrival, spread, places, self.steps)
        last = _point(0.0, -rest[-1].base[0] * unit, ladder.ledge_height + height)
        settle, off = walk_away(belief, step, last, spread, height, self.steps_away)
        climb = stages(site, rest, places, step.time)
        way = [Stage("settle", self.settle), *walk, *self.loading([*climb, *settle]), *off, Stage("halt", STAND)]
        return assemble(start, way, self.patience, free=site.free)


def stages(site: LadderSite, moves: Sequence[Move], places: dict[int, Array], time: Array | float) -> list[Stage]:
    """Stages of `moves`, the feet on the floor at `places` (m) and the base level at first; `time` is t* (s)."""
    at, stand, pitch, out = dict(places), dict.fromkeys(LEGS, WORLD), 0.0, []  # feet in the axes of their frames
    for move in moves:
        frame, swing, guides = OWN if move.where == RUNG else WORLD, {}, {}
        for leg in move.legs:
            start = at[leg]
            if stand[leg] != frame:
                world = to_world(start[None], jnp.array([stand[leg]]), site.free)
                start = to_frame(world, jnp.array([frame]), site.free)[0]
            at[leg] = swing[leg] = site.place(leg, move)
            guides[leg] = site.guides(leg, move, start, swing[leg])
            stand[leg] = frame
        turn = jnp.radians(jnp.asarray(pitch - move.pitch, float))
        out.append(Stage(f"climb.{move.name}", move.time * time, swing, CYCLE_B, position=site.base(move),
                         turn=_point(turn, 0.0, 0.0), rates=EASED, guides=guides,
                         foot_frames=tuple(stand[leg] for leg in LEGS),
                         base_frame=OWN if move.over == ALONG else WORLD))  # fmt: skip
        pitch = move.pitch
    return out


def _point(x: Array | float, y: Array | float, z: Array | float) -> Float[Array, " 3"]:
    return jnp.stack([jnp.asarray(value, float) for value in (x, y, z)])
