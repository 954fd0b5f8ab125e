"""Across water on a raft (monograph 4.3): board, push off, walk over the deck, pull the raft in, go ashore.

World axes as in `Raft`. If feet stood on a bank and on the measured raft at once, the raft would drift anywhere.
Therefore the raft has a reference motion while the robot touches a bank: it is moored, pushed and pulled
(`Stage.support`). In between, base and feet are planned in the raft's own frame.
"""

from dataclasses import replace
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from sweep.controllers.layers import TickContext
from sweep.controllers.observation import Observation
from sweep.controllers.plan import (
    ALONGSIDE,
    REGRIP,
    STAYS,
    TO_VELOCITY,
    Plan,
    Stage,
    SupportMotion,
    is_guided_by_law,
    reference_stance,
)
from sweep.controllers.tracker import Guidance, TrackerState
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.core.rotations import IDENTITY, rotate
from sweep.formulas.crossing import RaftCrossing, crossing
from sweep.manoeuvres.afloat.statics import require_floating
from sweep.manoeuvres.goals import ON_ITS_FEET
from sweep.models.case import Case, Manoeuvre
from sweep.models.frames import WORLD_FRAME, body_frame_number
from sweep.models.legs import LEG_NAMES, LEGS
from sweep.models.obstacles.charts import Chart, Number, stack_components
from sweep.models.obstacles.raft import Raft
from sweep.models.obstacles.surface import FreeBodyState
from sweep.models.posture import Stance
from sweep.models.robot import total_mass
from sweep.planning.compile_plan import compile_plan
from sweep.planning.gaits import TRIPOD
from sweep.planning.moves import Move, MoveContext, make_standing_state, move_stages, plan_part_stages, read_moves

HIPS = (-0.5, -0.5, 0.0, 0.0, 0.5, 0.5)  # a_r, ahead of the base's centre
MARGIN = 0.1  # a_r, on both sides of an edge, without footholds
WAIT_FACTOR = 3.0  # over the coasting time, longest wait for a raft that was pushed too little
START_POSITION = -0.75  # a_r, of the base before it boards
# Laws: pushing off; coasting until the raft is at the other bank; standing where it has arrived; pulling it in; and
# going on as planned from there.
PUSH, WAIT, REACH, PULL, ASHORE = "push", "wait", "reach", "pull", "ashore"


@parameters
class RaftCross(Manoeuvre):
    """Cross the water from one bank to the other on a raft, and walk on.
    Ratios are to the body length a_r."""

    goal: ClassVar = ON_ITS_FEET
    kind: str = choice("raft_cross", "raft_cross")
    approach: int = count(2, at_least=0, at_most=20)  # number of swings of a tripod to the near bank
    steps: int = count(10, at_least=1, at_most=40)  # number of swings over the deck
    leave: int = count(2, at_least=0, at_most=20)  # number of swings on the far bank
    stride_ratio: float = quantity(0.2, "a_r", above=0, at_most=0.5)  # motion of the base in a swing ashore
    height_ratio: float = quantity(0.5, "a_r", above=0, at_most=2)  # d, height of the hips above the ground
    squat_ratio: float = quantity(0.4, "a_r", above=0, at_most=2)  # the same while the raft is pulled in
    spread_ratio: float = quantity(0.3, "a_r", at_least=0, at_most=2)  # distance of feet outward from their hips
    lift_ratio: float = quantity(0.06, "a_r", above=0, at_most=0.5)  # height of a swing between bank and raft
    swing: float = quantity(0.8, "s", above=0, at_most=10)  # time of a swing
    landing: float = quantity(0.1, "m/s", above=0)  # v_eps, planned speed of the raft at the far bank
    force: float = quantity(15.0, "N", above=0)  # least force of the push
    push_ratio: float = quantity(0.3, "a_r", above=0, at_most=1)  # longest distance over which the raft gains its speed
    push: float = quantity(1.0, "-", above=0, at_most=3)  # speed after the push, over that of (4.3)
    offset: float = quantity(0.0, "m")  # h, distance of the robot's path to the left of the raft's middle
    near: float = quantity(0.01, "m", above=0)  # gap to the far bank at which the wait ends
    close: float = quantity(0.02, "m", above=0)  # largest gap that the robot steps over
    slow: float = quantity(0.02, "m/s", above=0)  # speed below which the raft counts as still
    pulls: int = count(5, at_least=1, at_most=10)  # largest number of pulls of the raft to the bank
    # time of a pull; in 4 s, feet slip on a raft that lies turned by 15 degrees
    pull: float = quantity(7.0, "s", above=0)
    deepening: float = quantity(1e-3, "m", at_least=0, at_most=0.05)  # depth of footholds below the surface
    bracing: float = quantity(3e-3, "m", at_least=0, at_most=0.05)  # additional depth of the feet that push
    observer: float = quantity(0.0, "s", at_least=0)  # time constant of the filter of the raft's measured pose
    ease: float = quantity(0.15, "s", above=0)  # time in which feet move over to new footholds
    patience: float = quantity(0.1, "s", at_least=0)  # longest wait for a touchdown

    needs = (Raft,)
    default_plan_name = "raft_cross"  # in a_r

    def plan(self, belief: Case) -> Plan:
        """Return the plan from the near bank over the raft to the far bank.

        Raises:
            InputError: the raft would capsize or sink under the robot, all plain numbers.
        """
        raft, length, push = belief.obstacle_of_type(Raft), belief.robot.body_length, self.push_motion(belief)
        require_floating(belief, (raft.length / 2 - MARGIN * length, self.offset))
        context, first = self.move_context(belief), START_POSITION - self.approach * self.stride_ratio
        feet = {leg: context.foothold_at(leg, {"near": [first + HIPS[leg - 1]]}, "", 0.0).point for leg in LEGS}
        position, _, _ = context.base_pose_at({"by_near": [first]}, "")
        start = Stance(jnp.stack([feet[leg] for leg in LEGS]), position, jnp.array(IDENTITY))
        aboard, reached, landed = (list(read_moves(belief, part).values()) for part in ("aboard", "reach", "land"))
        ashore, reached_at, end = (move.base[chart][0] for move, chart in (
            (aboard[-1], "on_deck"), (reached[0], "on_deck_far"), (landed[-1], "by_far")))  # fmt: skip
        stride = (raft.length / length + reached_at - ashore) / self.steps
        pull = replace(reached[-1], feet={}, seconds=self.pull, support="pulled", law=PULL)
        standing = make_standing_state(feet, 0.0)
        approach, standing = move_stages(
            tripod_moves(first, self.approach, self.stride_ratio, "by_near", "near"), context, standing, "approach."
        )
        board, standing = plan_part_stages("board", context, standing)
        push_off, standing = plan_part_stages("push", context, standing, "")
        walk_on, standing = plan_part_stages("aboard", context, standing)
        walk, standing = move_stages(
            tripod_moves(ashore, self.steps, stride, "on_deck", "deck"), context, standing, "walk."
        )
        (wait, *reach), standing = plan_part_stages("reach", context, standing, "")
        pulls, standing = move_stages({f"pull{k + 1}": pull for k in range(self.pulls)}, context, standing, "")
        land, standing = plan_part_stages("land", context, standing)
        leave = tripod_moves(end, self.leave, self.stride_ratio, "by_far", "far")
        walk_off, _ = move_stages(
            {name: replace(move, law=ASHORE) for name, move in leave.items()}, context, standing, "leave."
        )
        stages = [
            Stage("stand", 0.5, onset=REGRIP),
            *approach,
            *board,
            *(self.push_stage(belief, stage, push) for stage in push_off),
            *walk_on,
            *walk,
            replace(wait, duration=WAIT_FACTOR * push.time),
            *reach,
            *pulls,
            *land,
            *walk_off,
            Stage("halt", 1.0, law=ASHORE, onset=REGRIP),
        ]
        return compile_plan(start, stages, self.patience, ease=self.ease, free=raft.start(), afloat=True)

    def move_context(self, belief: Case) -> MoveContext:
        """Return the coordinate systems and directions for moves in the plan file, between banks and raft.

        A moored raft stays at its reference: measured anew at every step, it would be let go step by step.
        """
        raft, length = belief.obstacle_of_type(Raft), belief.robot.body_length
        aside, deck = belief.robot.body_width / 2 + self.spread_ratio * length, raft.thickness / 2
        hips, squat = self.height_ratio * length, self.squat_ratio * length
        half, width, raft_frame = raft.length / 2, raft.water_width, body_frame_number(0)
        feet = {"near": (0.0, 0.0, WORLD_FRAME), "brace": (0.0, 0.0, WORLD_FRAME), "deck": (-half, deck, raft_frame),
                "deck_far": (half, deck, raft_frame), "far": (width, 0.0, WORLD_FRAME)}  # fmt: skip
        bases = {"by_near": (0.0, hips, WORLD_FRAME), "on_deck": (-half, hips + deck, raft_frame),
                 "on_deck_far": (half, hips + deck, raft_frame), "squat": (half, squat + deck, raft_frame),
                 "by_far": (width, hips, WORLD_FRAME)}  # fmt: skip
        charts = {
            name: make_chart_beyond_edge(edge, self.offset, aside, up, frame)
            for name, (edge, up, frame) in feet.items()
        }
        charts |= {
            name: make_chart_beyond_edge(edge, self.offset, 0.0, up, frame) for name, (edge, up, frame) in bases.items()
        }
        depths = {**dict.fromkeys(feet, self.deepening), "brace": self.deepening + self.bracing}
        berths = {"moored": half, "pulled": width - half}  # wherever along the banks
        along = jnp.array([1.0, 0.0, 0.0])
        supports = {"free": (SupportMotion(),), "stays": (STAYS,),
                    **{name: (SupportMotion(ALONGSIDE, position=x * along),)
                       for name, x in berths.items()}}  # fmt: skip
        return MoveContext(belief, length, self.swing, self.lift_ratio * length, depths, charts, supports,
                     (PUSH, WAIT, REACH, PULL, ASHORE), {"onset": REGRIP})  # fmt: skip

    def push_stage(self, belief: Case, stage: Stage, push: RaftCrossing) -> Stage:
        """Return the stage that accelerates raft and robot at constant force, with a turn if the push is off-centre.

        Heavy or fast rafts are pushed harder, so that the rear feet can stay on the bank meanwhile.

        Args:
            belief: believed parameters.
            stage: the stage of the push.
            push: speed and turn to gain.
        """
        mass = belief.obstacle_of_type(Raft).mass + total_mass(belief.robot)
        speed, turn = self.push * push.v0, self.push * push.w0
        force = jnp.maximum(self.force, mass * speed**2 / (2 * self.push_ratio * belief.robot.body_length))
        to = SupportMotion(TO_VELOCITY, jnp.array([1.0, 0.0, 0.0]) * speed, jnp.array([0.0, 0.0, -1.0]) * turn)
        return replace(stage, duration=mass * speed / force, support=(to,))

    def push_motion(self, belief: Case) -> RaftCrossing:
        """Return speed, turn and travel time of the raft after the robot's push-off: monograph (4.3) and (4.3.1)."""
        raft, load = belief.obstacle_of_type(Raft), total_mass(belief.robot)
        a, b, _ = raft.half_size
        mass, al2 = raft.mass + load, raft.drag * raft.width * raft.draught(load)
        inertia = mass * (a**2 + b**2) / 3
        return crossing(raft.water_width, raft.length, self.landing, mass, al2, inertia, inertia, self.offset)

    def init_memory(self, belief: Case, plan: Plan) -> Float[Array, " 3"]:
        """Return the feedback state before the first tick: no shift (m) of the landing place yet.

        Its y component is the drift of the raft along the bank, its x component the gap at which the raft stopped
        early.
        """
        return jnp.zeros(3)

    def guide(self, belief: Case, ctx: TickContext, state: TrackerState) -> Guidance:
        """Return the planned stance, shifted so that the robot lands where the raft has actually arrived."""
        plan, stage, free = ctx.plan, ctx.stage, ctx.obs.free
        gap = jnp.min(far_bank_gaps(belief.obstacle_of_type(Raft), free))
        short = jnp.where((gap > self.near) & (gap < MARGIN * belief.robot.body_length), gap, 0.0)
        drift = jnp.stack([-short, self.drift_along_bank(plan, stage, free), jnp.zeros_like(short)])
        memory = jnp.where(ctx.is_first_tick & is_guided_by_law(plan, stage, REACH), drift, state.memory)
        frames = jnp.append(plan.foot_frame[stage], plan.base_frame[stage])
        ashore = is_guided_by_law(plan, stage, REACH, PULL, ASHORE) & (frames == WORLD_FRAME)
        shifts = jnp.where(ashore[:, None], memory, 0.0)
        goal, position = plan.foothold[stage] + shifts[:6], plan.position.at[stage].add(shifts[6])
        stance = reference_stance(replace(plan, position=position), stage, ctx.phase, state.feet, state.position, goal)
        return Guidance(stance, goal, memory)

    def drift_along_bank(self, plan: Plan, stage: Int[Array, ""], free: FreeBodyState) -> Float[Array, ""]:
        """Return how far (m) along the bank the base's target has shifted from the planned landing place.

        On a raft that lies turned, a base ahead of its middle is also beside it.

        Args:
            plan: the plan.
            stage: stage number.
            free: measured state of the raft.
        """
        place = jnp.where(
            plan.base_frame[stage] == body_frame_number(0), plan.position[stage], self.offset * jnp.eye(3)[1]
        )
        return (free.position[0] + rotate(free.quat[0], place))[1] - self.offset

    def is_stage_over(self, belief: Case, plan: Plan, state: TrackerState, obs: Observation) -> Bool[Array, ""]:
        """Return whether the stage ends: the raft has arrived (or rests near the bank), or lies alongside."""
        gaps = far_bank_gaps(belief.obstacle_of_type(Raft), obs.free) + state.memory[0]
        waits, pulls = is_guided_by_law(plan, state.stage, WAIT), is_guided_by_law(plan, state.stage, PULL)
        still = jnp.abs(obs.free.velocity[0, 0]) < self.slow
        met = (jnp.min(gaps) < self.near) | (still & (jnp.min(gaps) < MARGIN * belief.robot.body_length))
        return (waits & met) | (pulls & (jnp.max(gaps) < self.close) & still)


def far_bank_gaps(raft: Raft, free: FreeBodyState) -> Float[Array, " 2"]:
    """Return the distances from the corners of the raft's far side to the far bank (m)."""
    corners = jnp.stack([raft.half_size * jnp.array([1.0, side, 0.0]) for side in (-1.0, 1.0)])
    return raft.water_width - (free.position[0] + rotate(free.quat[0], corners))[:, 0]


def make_chart_beyond_edge(
    edge: Array | float, middle: Array | float, aside: Array | float, up: Array | float, frame: int
) -> Chart:
    """Return a chart, a coordinate system for footholds, for the ground beyond an edge.

    Args:
        edge: x of the edge (m).
        middle: y of the robot's path (m).
        aside: distance of left and right feet from that path (m).
        up: height of the surface (m).
        frame: frame of the chart.
    """

    def place(raft: Raft, side: float, unit: Number, depth: Number, ahead: Number) -> Float[Array, " 3"]:
        return stack_components(edge + ahead * unit, middle + side * aside, up - depth)

    return Chart(("ahead",), place, frame)


def tripod_moves(base: Number, count: int, stride: Number, chart: str, on: str) -> dict[str, Move]:
    """Return moves of a tripod gait, which starts and ends with all feet under their hips.

    A foot lands half a stride ahead of its hip, the last ones under theirs.

    Args:
        base: position of the base at first (a_r).
        count: number of swings.
        stride: motion of the base in a swing (a_r).
        chart: chart of the base.
        on: chart of the feet.
    """
    result = {}
    for k in range(count + (count > 0)):
        base = base + stride if k < count else base
        ahead = stride / 2 if k < count - 1 else 0.0
        feet = {LEG_NAMES[leg]: {on: [base + HIPS[leg - 1] + ahead]} for leg in TRIPOD[k % 2]}
        support = "free" if on == "deck" else "moored" if on == "near" and k == 0 else "stays"
        result[f"{k + 1}"] = Move(f"tripod {k + 1}", feet, base={chart: [base]}, pace="eased", swing="b_smooth",
                                 lift=1.0, support=support)  # fmt: skip
    return result
