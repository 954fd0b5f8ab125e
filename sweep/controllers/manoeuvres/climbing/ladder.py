"""From the floor up a leaning ladder on to the ledge behind it, and away by tripod (monograph 2.5).

World axes and the ladder's own as in `sweep/models/obstacles/ladder.py`: the robot comes along -y, and the ladder's
axes are turned against the world's about x. Feet on rungs, and the base while it is along the ladder, are planned in
the ladder's own axes: a ladder that leans otherwise than believed is climbed where it is seen.
"""

from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.controllers.forces import LAST, PlannedForces
from sweep.controllers.frames import WORLD, fixed, to_frame, to_world
from sweep.controllers.gaits import Step
from sweep.controllers.manoeuvres.climbing.ladder_moves import ALONG, FLOOR, MOVES, PLACES, RUNG, Move
from sweep.controllers.manoeuvres.climbing.walking import EASED, walk_away, walk_up
from sweep.controllers.manoeuvres.goals import UPRIGHT
from sweep.controllers.plan import CYCLE_B, Plan, Stage, assemble
from sweep.controllers.posture import leg_unit
from sweep.core.errors import InputError
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.formulas import stepping
from sweep.formulas.ladder import ladder as statics
from sweep.formulas.leg import SIDE
from sweep.models.case import Case
from sweep.models.legs import LEGS
from sweep.models.obstacles.ladder import Ladder, point
from sweep.models.obstacles.surface import FreeState
from sweep.models.robot import total_mass
from sweep.models.scene import mounts

OWN = fixed(0)  # the ladder's axes
TOP = 6.47  # rungs, of the ledge along the nominal ladder
GAP = 0.15  # leg units, that the base still has to go when the feet take their places before the ladder
AWAY = 0.72  # leg units beyond the ledge's edge, of the base when it begins to walk away


class LadderSite(NamedTuple):
    """What the stages are made of."""

    ladder: Ladder
    free: FreeState  # the ladder as it starts
    unit: Array | float  # m, in which places are given: `leg_unit`
    deepening: Array | float  # m

    @classmethod
    def of(cls, belief: Case, deepening: Array | float) -> "LadderSite":
        """As it is believed."""
        ladder = belief.on(Ladder)
        return cls(ladder, ladder.start(), leg_unit(belief.robot), deepening)

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
            return point(x, self.up(move.rung) + self.deepening, other * self.ladder.rung_depth)
        if move.where == FLOOR:
            return point(x, self.foot + other * self.unit, -self.deepening)
        return point(x, -other * self.unit, self.ladder.ledge_height - self.deepening)

    def up(self, rungs: Array | float) -> Array | float:
        """The ladder's own y at a height along it, in rungs; whole ones at their tops."""
        return self.ladder.centre - rungs * self.ladder.rung_step

    @property
    def excess(self) -> Array | float:
        """By how much (m, along the ladder) the ledge is farther up than `TOP` rungs."""
        return self.ladder.ledge_height / jnp.sin(jnp.asarray(self.ladder.lean)) - TOP * self.ladder.rung_step

    def pitch(self, move: Move) -> Array | float:
        """Of the base (rad), nose up."""
        return (move.pitch + move.follow[2] * self.excess / self.unit) * self.ladder.lean

    def base(self, move: Move) -> Float[Array, " 3"]:
        """Where the base goes (m), in the axes of its frame."""
        one, other = move.base
        ahead, out = (share * self.excess for share in move.follow[:2])
        if move.over == ALONG:
            return point(0.0, self.up(one) - ahead, other * self.unit + out)
        pitch = jnp.asarray(self.pitch(move))
        back, sin, cos = self.excess - ahead, jnp.sin(pitch), jnp.cos(pitch)
        y, z = back * cos + out * sin - one * self.unit, out * cos - back * sin + other * self.unit
        return point(0.0, y, self.ladder.ledge_height + z)

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

    goal: ClassVar = {**UPRIGHT, "obstacle_shift_max_m": 1e-3, "obstacle_turn_max_rad": 1e-3}
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
    slack: float = quantity(0.2, "-", at_least=LAST, at_most=2)  # of planned forces, see `PlannedForces`
    least_normal: float = quantity(12.0, "N", at_least=0)  # force of a standing foot
    load_time: float = quantity(0.3, "s", above=0, at_most=10)  # for load to go from foot to foot before a swing
    observer: float = quantity(0.1, "s", at_least=0, at_most=10)  # in which the measured ladder is taken over

    needs = (Ladder,)

    @property
    def table(self) -> tuple[Move, ...]:
        """The numbers of the way up."""
        return MOVES

    def plan(self, belief: Case, table: Sequence[Move] | None = None) -> Plan:
        """Wait, walk up, climb, walk away, halt.

        Raises `InputError` where the ladder cannot be climbed, by plain numbers.
        """
        return self.with_feedforward(belief, self.way(belief, self.table if table is None else table))

    def way(self, belief: Case, moves: Sequence[Move]) -> Plan:
        """The plan but for its forces."""
        refuse(belief, self.deepening, moves)
        ladder, robot = belief.on(Ladder), belief.robot
        length, unit = robot.body_length, leg_unit(robot)
        site = LadderSite.of(belief, self.deepening)
        step = Step(self.half_step_ratio * length, self.lift_ratio * length, stepping.swing_time(self.rate))
        height, spread = self.height_ratio * unit, self.spread_ratio * length
        first, *rest = moves
        arrival = point(0.0, site.foot + first.base[1] * unit, first.base[0] * unit)
        places = {leg: point(float(SIDE[leg - 1]) * aside * unit, site.foot + ahead * unit, 0.0)
                  for legs, (aside, ahead) in PLACES.items() for leg in legs}  # fmt: skip
        start, walk = walk_up(belief, step, arrival, spread, places, self.steps, GAP * unit)
        last = point(0.0, -AWAY * unit, ladder.ledge_height + height)
        settle, off = walk_away(belief, step, last, spread, height, self.steps_away)
        climb = stages(site, rest, places, step.time)
        way = [Stage("settle", self.settle), *walk, *self.loading([*climb, *settle]), *off, Stage("halt", self.settle)]
        return assemble(start, way, self.patience, free=site.free)


def refuse(belief: Case, deepening: Array | float, moves: Sequence[Move]) -> None:
    """Raise `InputError`, by plain numbers, where the ladder slides, lacks rungs or is out of the legs' reach."""
    ladder, robot, contact = belief.on(Ladder), belief.robot, belief.contact
    if not all(isinstance(x, float) for x in jax.tree.leaves((robot, ladder, contact, deepening))):
        return
    ladder.check()
    needs = max(move.rung for move in moves)
    if ladder.rungs < needs:
        raise InputError(f"obstacle.rungs = {ladder.rungs} is not allowed: the way up needs {needs}")
    with jax.ensure_compile_time_eval():
        grips = [contact.friction * grip for grip in (ladder.floor_grip, ladder.wall_grip)]
        bears = float(statics(jnp.asarray(ladder.lean), *map(jnp.asarray, grips)).chi_max)
        mass = float(total_mass(robot))
        load = (mass + ladder.mass * ladder.centre / ladder.length) / (mass + ladder.mass)
        if not bears >= load:
            raise InputError(
                f"obstacle.lean = {ladder.lean:g} is not allowed: with friction {grips[0]:g} on the floor and "
                f"{grips[1]:g} on the wall the ladder slides under the robot at its top"
            )
        name, leg, lack = _worst_reach(belief, LadderSite.of(belief, deepening), moves)
    if lack > 0:
        raise InputError(
            f"obstacle.ledge_height = {ladder.ledge_height:g} is not allowed with obstacle.length = {ladder.length:g} "
            f"and obstacle.rung_step = {ladder.rung_step:g}: foot {leg} is {lack:.3f} m out of reach in climb.{name}"
        )


def _worst_reach(belief: Case, site: LadderSite, moves: Sequence[Move]) -> tuple[str, int, float]:
    """The stage at whose end a foot is farthest out of reach, that foot, and how far (m), by plain numbers."""
    robot, hips = belief.robot, np.asarray(mounts(belief.robot))
    origin, turn = (np.asarray(x[0]) for x in site.ladder.leaning())
    feet, worst = {}, ("", 0, -np.inf)
    for move in moves[1:]:
        base, pitch = np.asarray(site.base(move)), np.asarray(site.pitch(move))
        base = origin + turn @ base if move.over == ALONG else base
        ahead = np.array([[0.0, -np.cos(pitch), np.sin(pitch)], [1.0, 0.0, 0.0], [0.0, np.sin(pitch), np.cos(pitch)]])
        for leg in move.legs:
            foot = np.asarray(site.place(leg, move))
            feet[leg] = origin + turn @ foot if move.where == RUNG else foot
        for leg, foot in feet.items():
            lack = np.linalg.norm(foot - base - hips[leg - 1] @ ahead) - robot.thigh - robot.shin
            worst = max(worst, (move.name, leg, float(lack)), key=lambda found: found[2])
    return worst


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
        turn, pitch = jnp.asarray(pitch - site.pitch(move), float), site.pitch(move)
        out.append(Stage(f"climb.{move.name}", move.time * time, swing, CYCLE_B, position=site.base(move),
                         turn=point(turn, 0.0, 0.0), rates=EASED, guides=guides,
                         foot_frames=tuple(stand[leg] for leg in LEGS),
                         base_frame=OWN if move.over == ALONG else WORLD))  # fmt: skip
    return out
