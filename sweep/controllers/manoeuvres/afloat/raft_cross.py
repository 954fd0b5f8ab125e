"""Across water on a raft (monograph 4.3): board, push off, walk over the deck, pull the raft in, go ashore.

World axes as in `Raft`. Feet on a bank and on the raft at once would let it go where it drifts, had the deck's feet to
follow it as it is seen: while the robot touches a bank the raft is meant to go somewhere, and is moored, pushed and
pulled there (`Stage.support`). In between base and feet live in the raft's own frame.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sweep.controllers.gaits import GALLOP, TRIPOD
from sweep.controllers.manoeuvres.afloat.statics import refuse
from sweep.controllers.manoeuvres.goals import ON_ITS_FEET
from sweep.controllers.observation import Observation
from sweep.controllers.plan import CYCLE_B_SMOOTH, REGRIP, Plan, Stage, Stance, assemble, named, reference
from sweep.controllers.support import ALONGSIDE, STAYS, TO_VELOCITY, Support
from sweep.controllers.tracker import Guidance, TrackerState
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.core.rotations import IDENTITY, rotate
from sweep.formulas.crossing import Crossing, crossing
from sweep.formulas.leg import SIDE
from sweep.models.case import Case
from sweep.models.frames import WORLD, fixed
from sweep.models.legs import LEGS
from sweep.models.obstacles.raft import Raft
from sweep.models.obstacles.surface import FreeState
from sweep.models.robot import total_mass

FRONT, _, REAR = GALLOP
A, B = TRIPOD
NEAR, DECK, FAR = "n", "d", "f"
BOARDING = "board."  # how the names of stages begin in which the rear feet come to where they push
HIPS = (-0.5, -0.5, 0.0, 0.0, 0.5, 0.5)  # a_r, ahead of the base's centre


class Move(NamedTuple):
    """A stage: the base goes ahead, and some feet, or none, to places.

    In units of a_r; of the near table from the near edge of the water or of the raft, of the far one from the far edge.
    """

    name: str
    base: float  # of the base's centre
    legs: tuple[int, ...] = ()
    places: tuple[float, ...] = ()  # of each leg's foot
    on: str = ""  # near bank, deck or far bank: a letter for each of them


BOARD = (
    Move("a1", -0.5, A, (-0.875, -0.375, 0.125), "nnd"),
    Move("b1", -0.25, B, (-0.625, -0.125, 0.375), "nnd"),
    Move("a2", 0.0, A, (-0.375, 0.125, 0.625), "ndd"),
    Move("b2", 0.25, B, (-0.125, 0.375, 0.875), "ndd"),
    Move("a3", 0.4, A, (-0.125, 0.375, 0.875), "ndd"),
    Move("ready", 0.42),
    Move("push", 0.46),
    Move("rear", 0.55, REAR, (0.12, 0.12), "dd"),
    Move("a4", 0.6, A, (0.12, 0.6, 1.1), "ddd"),
    Move("b3", 0.6, B, (0.1, 0.6, 1.1), "ddd"),
)
REACH = (Move("wait", -0.62), Move("squat", -0.72), Move("reach", -0.7, FRONT, (0.125, 0.125), "ff"))
LAND = (
    Move("rise", -0.62),
    Move("a1", -0.5, (1, 4), (-0.875, -0.375), "dd"),
    Move("b1", -0.25, B, (-0.625, -0.125, 0.375), "ddf"),
    Move("a2", 0.0, A, (-0.375, 0.125, 0.625), "dff"),
    Move("b2", 0.25, B, (-0.125, 0.375, 0.875), "dff"),
    Move("a3", 0.5, A, (0.125, 0.625, 1.125), "fff"),
    Move("b3", 0.75, B, (0.375, 0.875, 1.375), "fff"),
    Move("a4", 0.875, A, (0.375, 0.875, 1.375), "fff"),
)
MARGIN = 0.1  # a_r, on both sides of an edge, that footholds leave out
PATIENCE = 3.0  # times that of coasting, for which a raft that was pushed too little is waited for
FIRST = -0.75  # of the base, before it boards


class Tables(NamedTuple):
    """The numbers of the plan."""

    board: tuple[Move, ...] = BOARD
    reach: tuple[Move, ...] = REACH
    land: tuple[Move, ...] = LAND


@parameters
class RaftCross:
    """From one bank to the other, and on. Stages and their numbers are `Tables`; ratios are to the body length a_r."""

    goal: ClassVar = ON_ITS_FEET
    kind: str = choice("raft_cross", "raft_cross")
    approach: int = count(2, at_least=0, at_most=20)  # swings of a tripod to the near bank
    steps: int = count(10, at_least=1, at_most=40)  # over the deck
    leave: int = count(2, at_least=0, at_most=20)  # on the far bank
    stride_ratio: float = quantity(0.2, "a_r", above=0, at_most=0.5)  # way of the base in a swing ashore
    height_ratio: float = quantity(0.5, "a_r", above=0, at_most=2)  # d, hips above the ground
    squat_ratio: float = quantity(0.4, "a_r", above=0, at_most=2)  # the same while the raft is pulled in
    spread_ratio: float = quantity(0.3, "a_r", at_least=0, at_most=2)  # feet out from the hips
    lift_ratio: float = quantity(0.06, "a_r", above=0, at_most=0.5)  # of a swing, between bank and raft
    swing: float = quantity(0.8, "s", above=0, at_most=10)  # a swing's time
    landing: float = quantity(0.1, "m/s", above=0)  # v_eps, with which the raft is to meet the far bank
    force: float = quantity(15.0, "N", above=0)  # of the push, at least
    push_ratio: float = quantity(0.3, "a_r", above=0, at_most=1)  # way on which the raft gains its speed, at most
    push: float = quantity(1.0, "-", above=0, at_most=3)  # speed after the push, over that of (4.3)
    offset: float = quantity(0.0, "m")  # h, of the robot's way to the left of the raft's middle
    near: float = quantity(0.01, "m", above=0)  # gap to the far bank at which the wait is over
    close: float = quantity(0.02, "m", above=0)  # largest gap that the robot steps over
    slow: float = quantity(0.02, "m/s", above=0)  # a raft that is slower is still
    pulls: int = count(5, at_least=1, at_most=10)  # of the raft to the bank, at most
    pull: float = quantity(4.0, "s", above=0)  # time of one
    deepening: float = quantity(1e-3, "m", at_least=0, at_most=0.05)  # footholds below the surface
    bracing: float = quantity(3e-3, "m", at_least=0, at_most=0.05)  # the same of the feet that push, beyond this
    observer: float = quantity(0.0, "s", at_least=0)  # time constant in which the raft's measured pose is taken over
    ease: float = quantity(0.15, "s", above=0)  # in which feet go over to where they are measured
    patience: float = quantity(0.1, "s", at_least=0)  # longest wait for a touchdown

    needs = (Raft,)

    @property
    def table(self) -> Tables:
        """The numbers of its plan."""
        return Tables()

    def plan(self, belief: Case, table: Tables | None = None) -> Plan:
        """The whole way.

        Raises `InputError` where the raft would capsize or sink under the robot, by plain numbers.
        """
        raft, tables = belief.on(Raft), self.table if table is None else table
        length = belief.robot.body_length
        refuse(belief, (raft.length / 2 - MARGIN * length, self.offset))
        way = Way(belief, self)
        first = FIRST - self.approach * self.stride_ratio
        start = Stance(
            jnp.stack([way.foot(NEAR, leg, first + HIPS[leg - 1], 0.0) for leg in LEGS]),
            way.base(NEAR, first),
            jnp.array(IDENTITY),
        )
        names = [move.name for move in tables.board]
        cast_off = names.index("push")
        ashore = tables.board[-1].base  # from the raft's near edge
        over = (raft.length / length + tables.reach[0].base - ashore) / self.steps
        end = tables.land[-1].base
        stages = [
            Stage("stand", 0.5, onset=REGRIP),
            *way.stages(tripods(first, self.approach, self.stride_ratio, NEAR), "approach.", 0),
            *way.stages(tables.board[:cast_off], BOARDING, 0),
            way.pushing(tables.board[cast_off]),
            *way.stages(tables.board[cast_off + 1 :], "aboard."),
            *way.stages(tripods(ashore, self.steps, over, DECK), "walk."),
            *way.reaching(tables.reach),
            *way.stages(tables.land, "land.", 1),
            *way.stages(tripods(end, self.leave, self.stride_ratio, FAR), "leave.", 1),
            Stage("halt", 1.0, onset=REGRIP),
        ]
        return assemble(start, stages, self.patience, ease=self.ease, free=raft.start(), afloat=True)

    def push_off(self, belief: Case) -> Crossing:
        """Of (4.3) and (4.3.1)."""
        raft, load = belief.on(Raft), total_mass(belief.robot)
        a, b, _ = raft.half
        mass, al2 = raft.mass + load, raft.drag * raft.width * raft.draught(load)
        inertia = mass * (a**2 + b**2) / 3
        return crossing(raft.water_width, raft.length, self.landing, mass, al2, inertia, inertia, self.offset)

    def memory(self, belief: Case, plan: Plan) -> Float[Array, " 3"]:
        """Where the robot goes ashore, m from where it was to.

        Beside it, by how far the raft has come along the bank; and before it, where the raft met a bank before that.
        """
        return jnp.zeros(3)

    def guide(
        self, belief: Case, plan: Plan, state: TrackerState, seen: Observation, begins: Bool[Array, ""], period: float
    ) -> Guidance:
        """As planned, but ashore at the place where the raft has come to."""
        stage = state.stage
        lies = named(plan, stage, "reach", "land.rise")
        gap = jnp.min(far_gaps(belief.on(Raft), seen.free))
        short = jnp.where((gap > self.near) & (gap < MARGIN * belief.robot.body_length), gap, 0.0)
        come = jnp.stack([-short, seen.free.position[0, 1], jnp.zeros_like(short)])
        along = jnp.where(begins & lies, come, state.memory)
        frames = jnp.append(plan.foot_frame[stage], plan.base_frame[stage])
        ashore = named(plan, stage, "reach", "pull", "land", "leave", "halt") & (frames == WORLD)
        shifts = jnp.where(ashore[:, None], along, 0.0)
        goal, position = plan.foothold[stage] + shifts[:6], plan.position.at[stage].add(shifts[6])
        phase = jnp.clip(state.clock / plan.duration[stage], 0.0, 1.0)
        shifted = replace(plan, foothold=plan.foothold.at[stage].set(goal), position=position)
        return Guidance(reference(shifted, stage, phase, state.feet, state.position), goal, along)

    def ends(self, belief: Case, plan: Plan, state: TrackerState, seen: Observation) -> Bool[Array, ""]:
        """The wait, as soon as the raft is there, or still before the bank; a pull, when it lies along the bank."""
        gaps = far_gaps(belief.on(Raft), seen.free) + state.memory[0]
        waits, pulls = named(plan, state.stage, "wait"), named(plan, state.stage, "pull")
        still = jnp.abs(seen.free.velocity[0, 0]) < self.slow
        met = (jnp.min(gaps) < self.near) | (still & (jnp.min(gaps) < MARGIN * belief.robot.body_length))
        return (waits & met) | (pulls & (jnp.max(gaps) < self.close) & still)


def far_gaps(raft: Raft, free: FreeState) -> Float[Array, " 2"]:
    """From the corners of the raft's far side to the far bank (m)."""
    corners = jnp.stack([raft.half * jnp.array([1.0, side, 0.0]) for side in (-1.0, 1.0)])
    return raft.water_width - (free.position[0] + rotate(free.quat[0], corners))[:, 0]


def tripods(base: Array | float, count: int, stride: Array | float, on: str) -> list[Move]:
    """Swings of tripods in turn, the base at `base` (a_r) at first; they begin and end with the feet under their hips.

    It goes on by `stride` a swing; a foot lands half a stride ahead of its hip, the last ones under theirs.
    """
    moves = []
    for k in range(count + (count > 0)):
        base = base + stride if k < count else base
        legs, ahead = TRIPOD[k % 2], stride / 2 if k < count - 1 else 0.0
        places = tuple(base + HIPS[leg - 1] + ahead for leg in legs)
        moves.append(Move(f"{k + 1}", base, legs, places, 3 * on))  # pyright: ignore
    return moves


class Way:
    """Places and stages of a crossing; where feet stand is kept while stages are made."""

    def __init__(self, belief: Case, how: RaftCross):
        self.raft, self.how, self.length = belief.on(Raft), how, belief.robot.body_length
        self.aside = belief.robot.body_width / 2 + how.spread_ratio * self.length
        self.push = how.push_off(belief)
        self.mass = self.raft.mass + total_mass(belief.robot)
        self.frames = dict.fromkeys(LEGS, WORLD)
        self.far = False  # places are from the far edge

    def along(self, where: str, x: Array | float) -> Array:
        """From a place (a_r) to x (m) in the world, or in the raft's frame."""
        edge = {NEAR: 0.0, FAR: self.raft.water_width, DECK: (1 if self.far else -1) * self.raft.length / 2}[where]
        return jnp.asarray(edge + x * self.length, float)

    def base(self, where: str, x: Array | float, ratio: Array | float | None = None) -> Float[Array, " 3"]:
        """The base's centre (m)."""
        height = (self.how.height_ratio if ratio is None else ratio) * self.length
        deck = self.raft.thickness / 2 if where == DECK else 0.0
        return jnp.stack([self.along(where, x), jnp.asarray(self.how.offset, float), jnp.asarray(height + deck, float)])

    def foot(self, where: str, leg: int, x: Array | float, deepening: Array | float) -> Float[Array, " 3"]:
        """A foothold (m)."""
        deck = self.raft.thickness / 2 if where == DECK else 0.0
        y, z = self.how.offset + SIDE[leg - 1] * self.aside, deck - deepening
        return jnp.stack([self.along(where, x), jnp.asarray(y, float), jnp.asarray(z, float)])

    def stages(self, moves: Sequence[Move], prefix: str, moored: int | None = None) -> list[Stage]:
        """Of moves; the raft is held at the near bank (0), at the far one (1), where it has come to, or left alone."""
        stages = [self.stage(move, prefix, moored) for move in moves]
        if moored is not None:  # once it is there it is kept: a hold that is taken anew at every step gives way
            kept = slice(1 - moored, None)
            stages[kept] = [replace(stage, support=(STAYS,)) for stage in stages[kept]]
        return stages

    def stage(
        self, move: Move, prefix: str = "", moored: int | None = None, time: Array | float | None = None,
        ratio: Array | float | None = None, support: Support | None = None,
    ) -> Stage:  # fmt: skip
        """Of a move."""
        swing = {}
        for leg, x, on in zip(move.legs, move.places, move.on, strict=True):
            brace = self.how.bracing if prefix == BOARDING and leg in REAR else 0.0
            swing[leg] = self.foot(on, leg, x, self.how.deepening + brace)
            self.frames[leg] = fixed(0) if on == DECK else WORLD
        where = DECK if moored is None and any(self.frames.values()) else (FAR if self.far else NEAR)
        if support is None:
            support = Support() if moored is None else Support(ALONGSIDE, position=self.berth(moored))
        return Stage(
            prefix + move.name, self.how.swing if time is None else time, swing, CYCLE_B_SMOOTH,
            self.how.lift_ratio * self.length, position=self.base(where, move.base, ratio), rates=(0.0, 0.0),
            onset=REGRIP, foot_frames=tuple(self.frames.values()),
            base_frame=fixed(0) if where == DECK else WORLD, support=(support,),
        )  # fmt: skip

    def berth(self, bank: int) -> Float[Array, " 3"]:
        """The raft's place along a bank, 0 the near one (m), wherever along it."""
        x = (1 - bank) * self.raft.length / 2 + bank * (self.raft.water_width - self.raft.length / 2)
        return jnp.array([1.0, 0.0, 0.0]) * x

    def pushing(self, move: Move) -> Stage:
        """Raft and robot gain speed at a constant force, with the turn that a push beside the middle gives.

        Heavy or fast ones are pushed harder: the rear feet stay on the bank meanwhile.
        """
        speed, turn = self.how.push * self.push.v0, self.how.push * self.push.w0
        force = jnp.maximum(self.how.force, self.mass * speed**2 / (2 * self.how.push_ratio * self.length))
        to = Support(TO_VELOCITY, jnp.array([1.0, 0.0, 0.0]) * speed, jnp.array([0.0, 0.0, -1.0]) * turn)
        return self.stage(move, time=self.mass * speed / force, support=to)

    def reaching(self, moves: Sequence[Move]) -> list[Stage]:
        """Wait for the far bank, squat, front feet ashore, pull; the raft lies as it comes until then."""
        self.far, squat = True, self.how.squat_ratio
        wait, down, reach = moves
        out = [
            self.stage(wait, time=PATIENCE * self.push.time),
            self.stage(down, time=1.0, ratio=squat),
            self.stage(reach, ratio=squat),
        ]
        for k in range(self.how.pulls):
            berth = Support(ALONGSIDE, position=self.berth(1))
            out.append(self.stage(Move(f"pull{k + 1}", reach.base), time=self.how.pull, ratio=squat, support=berth))
        return out
