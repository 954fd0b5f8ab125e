"""The controller: follows a plan stage by stage, and turns feet and base into joint targets (monograph 1.3, 1.4)."""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sweep.controllers import feedforward, flywheel
from sweep.controllers.frames import to_frame, to_world
from sweep.controllers.observation import Observation
from sweep.controllers.observer import Observer, followed
from sweep.controllers.plan import BALANCE, Plan, Posture, Stance, reference
from sweep.controllers.posture import feet_in_world
from sweep.core.rotations import conjugate, exponential, heading, logarithm, multiply, rotate
from sweep.formulas import leg, stepping
from sweep.models.case import Case
from sweep.models.drive import Servo
from sweep.models.obstacles.surface import FreeState, free_start, poses
from sweep.models.robot import Robot
from sweep.models.scene import mount_yaw, mounts


class TrackerState(NamedTuple):
    """What the controller remembers."""

    stage: Int[Array, ""]
    clock: Float[Array, ""]  # s since the stage began
    feet: Float[Array, "6 3"]  # m, commanded footholds when the stage began, in its frames
    position: Float[Array, " 3"]  # m, planned base when the stage began, in its frame
    error: Float[Array, " 3"]  # m, measured body error when the stage began
    turn: Float[Array, " 3"]  # rad, the same of its attitude, as a rotation vector in world axes
    joints: Float[Array, "6 3"]  # rad, last targets
    origin: Float[Array, "6 3"]  # rad, targets when the stage began
    finished: Bool[Array, ""]
    goal: Float[Array, "6 3"]  # m, footholds at the end of the stage, in its frames, of a guided manoeuvre
    memory: Any  # of a guided manoeuvre
    observer: Observer | None  # of the obstacle's free bodies, of such a manoeuvre


class Guidance(NamedTuple):
    """What a guided manoeuvre wants in a tick, in the stage's frames."""

    stance: Stance
    goal: Float[Array, "6 3"]  # m, footholds at the end of the stage
    memory: Any


class Command(NamedTuple):
    """What the controller asks for at the end of a tick."""

    joints: Float[Array, "6 3"]  # rad
    target: Stance
    phase: Float[Array, ""]  # of the stage, 0 to 1
    shortfall: Float[Array, ""]  # m, by how much the worst foot target is out of reach
    own: tuple[Bool[Array, "6 3"], Servo] | None = None  # which joints do otherwise than go to `joints`, and what


def joint_targets(robot: Robot, stance: Stance) -> tuple[Float[Array, "6 3"], Float[Array, " 6"]]:
    """Joint angles (rad) of the believed robot in a stance, and how far each foot is out of reach (m)."""
    to_base = jnp.broadcast_to(conjugate(stance.quat), (6, 4))
    foot = rotate(to_base, stance.feet - stance.position) - mounts(robot)
    yaw = np.zeros((6, 3))
    yaw[:, 2] = -mount_yaw(robot)
    foot = rotate(exponential(jnp.asarray(yaw, foot.dtype)), foot)
    return leg.ik(leg.SIDE, foot, robot.coxa, robot.thigh, robot.shin, robot.knees == "mirror")


@runtime_checkable
class Guided(Protocol):
    """A manoeuvre whose stages are re-derived from what is measured."""

    observer: Array | float  # s, time constant in which the free bodies' measured poses are taken over

    def memory(self, belief: Case, plan: Plan) -> Any:
        """What its feedback remembers, at the start."""
        ...

    def guide(
        self, belief: Case, plan: Plan, state: TrackerState, seen: Observation, begins: Bool[Array, ""], period: float
    ) -> Guidance:
        """One tick; `begins` in the first of a stage."""
        ...


def init(belief: Case, plan: Plan) -> TrackerState:
    """At the plan's start, standing as it wants."""
    zero = jnp.zeros((), plan.duration.dtype)
    manoeuvre = belief.manoeuvre
    free = free_start(belief.obstacle)
    joints, _ = joint_targets(belief.robot, plan.start)
    memory = manoeuvre.memory(belief, plan) if isinstance(manoeuvre, Guided) else None
    feet = to_frame(plan.start.feet, plan.foot_frame[0], free)
    return TrackerState(
        stage=jnp.int32(0),
        clock=zero,
        feet=feet,
        position=_place(to_frame, plan.start.position, plan.base_frame[0], free),
        error=jnp.zeros(3, zero.dtype),
        turn=jnp.zeros(3, zero.dtype),
        joints=joints,
        origin=joints,
        finished=jnp.asarray(False),
        goal=feet,
        memory=memory,
        observer=None if memory is None else Observer(free, free),
    )


def step(
    belief: Case, plan: Plan, state: TrackerState, seen: Observation, period: float
) -> tuple[TrackerState, Command]:
    """One control tick of `period` seconds."""
    old, manoeuvre = state, belief.manoeuvre
    if isinstance(manoeuvre, Guided) and state.observer is not None:
        observer = followed(state.observer, seen.free, manoeuvre.observer, period)
        state, seen = state._replace(observer=observer), seen._replace(free=observer.second)
    state = _advance(belief, plan, state._replace(clock=state.clock + period), seen, period)
    if plan.feedforward is not None:
        state = state._replace(
            feet=feedforward.anchored(belief.robot, plan, plan.feedforward, state.stage, state.feet, seen, period)
        )
    phase = jnp.clip(state.clock / plan.duration[state.stage], 0.0, 1.0)
    if isinstance(manoeuvre, Guided):
        begins = (state.stage != old.stage) | ((old.stage == 0) & (old.clock == 0))
        wanted, goal, memory = manoeuvre.guide(belief, plan, state, seen, begins, period)
        state = state._replace(goal=goal, memory=memory)
    else:
        wanted = reference(plan, state.stage, phase, state.feet, state.position)
    target = _in_world(plan, state, wanted, phase, seen.free)
    if plan.feedforward is not None:
        target = target._replace(feet=target.feet + feedforward.creep(plan, plan.feedforward, state.stage, state.clock))
    joints, shortfall = joint_targets(belief.robot, target)
    joints = _nearest(joints, state.joints)
    if plan.posture is not None:
        held = plan.posture.held[state.stage]
        joints = jnp.where(held[:, None], _posed(plan.posture, state, phase), joints)
        shortfall = jnp.where(held, 0.0, shortfall)
        feet = feet_in_world(belief.robot, target.position, target.quat, joints)
        target = target._replace(feet=jnp.where(held[:, None], feet, target.feet))
    command = Command(joints, target, phase, jnp.max(shortfall))
    if plan.feedforward is not None:
        command = command._replace(joints=joints + feedforward.offset(plan.feedforward, state.stage, phase))
    if plan.flywheel is not None:
        turning, servo = flywheel.order(belief.robot, plan, plan.flywheel, state.stage, seen)
        joints = jnp.where(turning, seen.angles, joints)  # where position mode takes over from
        command = command._replace(joints=joints, own=(turning, servo))
    return state._replace(joints=joints), command


def _nearest(joints: Array, to: Array) -> Array:
    """The same joint angles without a jump by a full turn."""
    return to + jnp.mod(joints - to + jnp.pi, 2 * jnp.pi) - jnp.pi


def _posed(posture: Posture, state: TrackerState, phase: Array) -> Float[Array, "6 3"]:
    """Joint angles of legs on their straight way in joint space, spent by lambda_1."""
    goal = _nearest(posture.joints[state.stage], state.origin)
    return state.origin + stepping.lambda_1(phase, 0.0, 1.0)[0] * (goal - state.origin)


def _in_world(plan: Plan, state: TrackerState, wanted: Stance, phase: Array, free: FreeState) -> Stance:
    """What the stage wants, with the free body where it is seen.

    The body error that the stage began with fades out, unless two feet carry.
    """
    stage = state.stage
    left = jnp.where(_balancing(plan, stage), 1.0, 1 - phase)
    feet = to_world(wanted.feet, plan.foot_frame[stage], free)
    position = _place(to_world, wanted.position, plan.base_frame[stage], free) + left * state.error
    return Stance(feet, position, multiply(exponential(left * state.turn), wanted.quat))


def _place(convert: Callable, point: Array, frame: Array, free: FreeState) -> Float[Array, " 3"]:
    return convert(point[None], frame[None], free)[0]


def _balancing(plan: Plan, stage: Int[Array, ""]) -> Bool[Array, ""] | bool:
    """Whether the robot stands on two feet, about which it tilts: its place then says nothing of the feet's."""
    return plan.flywheel is not None and plan.flywheel.mode[stage] == BALANCE


def _advance(belief: Case, plan: Plan, state: TrackerState, seen: Observation, period: float) -> TrackerState:
    """Go on to the next stage when time is up and every swinging foot has touched down, or patience has run out.

    The next stage starts from the commanded footholds, not the reached ones: that keeps the pressure on the ground.
    With the onset `rezero` feet and body are shifted and turned together by the measured error of the body's place and
    attitude, which strains nothing, and the body's part of it then fades: without this, errors add up from stage to
    stage.
    """
    stage = state.stage
    over = state.clock - plan.duration[stage]
    landed = jnp.all(seen.loaded | ~plan.swing[stage])
    ends = (over >= 0) & (landed | (over >= plan.patience)) & ~state.finished
    last = stage == plan.duration.shape[0] - 1
    following = jnp.where(last, stage, stage + 1)
    planned = _place(to_world, plan.position[stage], plan.base_frame[stage], seen.free)
    goal = state.goal if isinstance(belief.manoeuvre, Guided) else plan.foothold[stage]
    feet = to_world(jnp.where(plan.swing[stage][:, None], goal, state.feet), plan.foot_frame[stage], seen.free)
    if plan.feedforward is not None:
        feet = feet + feedforward.creep(plan, plan.feedforward, stage, state.clock)
    error, turn = jnp.zeros_like(planned), state.turn
    if plan.onset == "rezero":
        feet, error, turn = _with_error(plan, state, seen, feet, planned)
    elif plan.onset == "regrip":
        feet = _regripped(belief, feet, seen)
    shifted = state._replace(
        stage=following,
        clock=jnp.where(last, state.clock, jnp.minimum(over, period)),
        feet=to_frame(feet, plan.foot_frame[following], seen.free),
        position=_place(to_frame, planned, plan.base_frame[following], seen.free),
        error=error,
        turn=turn,
        origin=state.joints,
        finished=last,
    )
    hold = last | ~ends
    kept = state._replace(finished=state.finished | (ends & last))
    return jax.tree.map(lambda a, b: jnp.where(hold, a, b), kept, shifted)


def _regripped(belief: Case, commanded: Float[Array, "6 3"], seen: Observation) -> Float[Array, "6 3"]:
    """Feet where they are measured along the surface, and as deep as they were commanded.

    Also those that have not touched down yet: they are about to, as far off as the base is, which would otherwise be
    handed on from step to step.
    """
    measured = feet_in_world(belief.robot, seen.position, seen.quat, seen.angles)
    normal = belief.obstacle.surface(measured, (-1,) * 6, poses(seen.free)).normal
    return measured + jnp.sum((commanded - measured) * normal, axis=-1, keepdims=True) * normal


def _with_error(
    plan: Plan, state: TrackerState, seen: Observation, feet: Array, planned: Array
) -> tuple[Array, Array, Array]:
    """Feet moved with the body's error at the end of the stage, and that error of its place (m) and attitude (rad).

    In a plan that is steered only its parts in the plane count: taken up by the standing feet and not by those that
    land, the others would put the diagonals at different heights. A robot that balanced on two feet has tilted about
    them: what it sees says nothing of where they are, and the error that it knew before holds on.
    """
    error = seen.position - planned
    wanted = multiply(exponential(plan.turn[state.stage]), plan.quat[state.stage])
    off = multiply(seen.quat, conjugate(wanted))
    turn = logarithm(off)
    if plan.steered:
        error, turn = error.at[2].set(0.0), jnp.zeros(3).at[2].set(heading(off))
    moved = planned + error + rotate(exponential(turn)[None], feet - planned)
    if plan.feedforward is not None:  # feet that are anchored where they are need not be moved
        moved = feet
    known = _balancing(plan, state.stage)
    return jnp.where(known, feet, moved), jnp.where(known, state.error, error), jnp.where(known, state.turn, turn)
