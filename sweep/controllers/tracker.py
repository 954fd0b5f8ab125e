"""The controller: follows a plan stage by stage, and turns feet and base into joint targets (monograph 1.3, 1.4)."""

from functools import partial
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sweep.controllers.frames import Stance, stance_to_frame, stance_to_world, to_frame
from sweep.controllers.layers import Command, Now
from sweep.controllers.observation import Observation, Observer, behind, followed, untold
from sweep.controllers.plan import GRIP, KEEP, REGRIP, REZERO, Plan, reference
from sweep.controllers.posture import feet_in_world, joint_targets
from sweep.core.rotations import conjugate, exponential, heading, logarithm, multiply, nearest, rotate
from sweep.formulas.leg import SIDE
from sweep.models.case import Case, Riding
from sweep.models.obstacles.surface import FreeState, Surface, free_start, poses, under

LEFT = np.array([0.0, 1.0, 0.0], np.float32)  # of the base


class PoseError(NamedTuple):
    """How far the base is from where a stage wants it when the stage begins. World axes."""

    position: Float[Array, " 3"]  # m
    turn: Float[Array, " 3"]  # rad, as a rotation vector


class TrackerState(NamedTuple):
    """What the controller remembers."""

    stage: Int[Array, ""]
    clock: Float[Array, ""]  # s since the stage began
    feet: Float[Array, "6 3"]  # m, commanded footholds when the stage began, in its frames
    position: Float[Array, " 3"]  # m, planned base when the stage began, in its frame
    error: Float[Array, " 3"]  # m, measured body error when the stage began
    turn: Float[Array, " 3"]  # rad, the same of its attitude, as a rotation vector in world axes
    joints: Float[Array, "6 3"]  # rad, last targets
    finished: Bool[Array, ""]
    goal: Float[Array, "6 3"]  # m, footholds at the end of the stage, in its frames, of a guided manoeuvre
    memory: Any  # of a guided manoeuvre
    observer: Observer | None  # of the obstacle's free bodies, of a manoeuvre on them
    told: Stance | None  # in the last tick, in the stage's frames, of a manoeuvre with events
    layers: tuple[Any, ...]  # states of the plan's layers
    true_error: PoseError | None = None  # what `error` and `turn` would be by exact sensors; None: sensors are exact


class Guidance(NamedTuple):
    """What a guided manoeuvre wants in a tick, in the stage's frames."""

    stance: Stance
    goal: Float[Array, "6 3"]  # m, footholds at the end of the stage
    memory: Any


@runtime_checkable
class Guided(Protocol):
    """A manoeuvre whose stages are re-derived from what is measured."""

    def memory(self, belief: Case, plan: Plan) -> Any:
        """What its feedback remembers, at the start."""
        ...

    def guide(self, belief: Case, now: Now, state: TrackerState) -> Guidance:
        """What its feedback makes of a control tick."""
        ...


@runtime_checkable
class Eventful(Protocol):
    """A manoeuvre whose stages may be over before their time; `duration` is then the longest that they take."""

    def ends(self, belief: Case, plan: Plan, state: TrackerState, seen: Observation) -> Bool[Array, ""]:
        """Whether what the stage waits for has come."""
        ...


def init(belief: Case, plan: Plan, exact: bool = True) -> TrackerState:
    """State of the tracker before the first tick, with the robot standing where the plan starts.

    Args:
        belief: the case that the controller believes in.
        plan: the plan that is followed.
        exact: whether sensors are exact, so that `step` needs no true pose.
    """
    zero = jnp.zeros((), plan.duration.dtype)
    none = jnp.zeros(3, zero.dtype)
    manoeuvre = belief.manoeuvre
    free = free_start(belief.obstacle)
    joints, _ = joint_targets(belief.robot, plan.start)
    memory = manoeuvre.memory(belief, plan) if isinstance(manoeuvre, Guided) else None
    start = stance_to_frame(plan.start, plan.foot_frame[0], plan.base_frame[0], free)
    return TrackerState(
        stage=jnp.int32(0),
        clock=zero,
        feet=start.feet,
        position=start.position,
        error=none,
        turn=none,
        joints=joints,
        finished=jnp.asarray(False),
        goal=start.feet,
        memory=memory,
        observer=Observer(free, free) if isinstance(manoeuvre, Riding) else None,
        told=start if isinstance(manoeuvre, Eventful) else None,
        layers=tuple(layer.begun(start, joints, free) for layer in plan.layers),
        true_error=None if exact else PoseError(none, none),
    )


def step(
    belief: Case,
    plan: Plan,
    state: TrackerState,
    seen: Observation,
    period: float,
    beside: Array | None = None,
    truth: Observation | None = None,
) -> tuple[TrackerState, Command]:
    """Follow the plan for one control tick.

    Args:
        belief: the case that the controller believes in.
        plan: the plan that is followed.
        state: the tracker's state after the last tick.
        seen: what the sensors measure.
        period: length of a tick (s).
        beside: offsets (6, 3) of the stage's footholds from the planned ones (m).
        truth: what exact sensors would measure. It changes no command: `Command.reference` alone follows from it.
            None if sensors are exact.

    Returns:
        The new state, and the command.
    """
    old, manoeuvre = state, belief.manoeuvre
    if isinstance(manoeuvre, Riding) and state.observer is not None:
        observer = followed(state.observer, seen.free, manoeuvre.observer, period)
        state, seen = state._replace(observer=observer), seen._replace(free=observer.second)
    state = _advance(belief, plan, state._replace(clock=state.clock + period), seen, period, beside, truth)
    phase = jnp.clip(state.clock / plan.duration[state.stage], 0.0, 1.0)
    begins = (state.stage != old.stage) | ((old.stage == 0) & (old.clock == 0))
    free, blind = borne(plan, state, seen.free)
    now = Now(belief.robot, plan, old.stage, state.stage, state.clock, phase, begins, seen, free, period, state.joints,
              untold(belief.noise, period), behind(belief.noise, period))  # fmt: skip
    frames = plan.foot_frame[state.stage], plan.base_frame[state.stage]
    for layer in plan.layers:
        state = state._replace(feet=layer.anchored(now, state.feet))
    if isinstance(manoeuvre, Guided):
        wanted, to, memory = manoeuvre.guide(belief, now, state)
        state = state._replace(goal=to, memory=memory)
    else:
        goal = plan.foothold[state.stage]
        if beside is not None:
            goal = goal + jnp.where(state.stage == old.stage, beside, 0.0)
        wanted = reference(plan, state.stage, phase, state.feet, state.position, goal)
    here = stance_to_world(wanted, *frames, free)
    if old.told is not None:
        state = _from_told(now, old.told, state, here)
    # the body error that the stage began with fades out, unless the base's place says nothing of the feet's
    left = jnp.where(blind, 1.0, 1 - phase)
    target, states = _moved_base(here, left, PoseError(state.error, state.turn)), list(state.layers)
    for k, layer in enumerate(plan.layers):
        states[k], target = layer.led(now, states[k], target)
    true_target = None if state.true_error is None else _moved_base(here, left, state.true_error)
    if state.told is not None:
        state = state._replace(told=stance_to_frame(target, *frames, free))
    joints, shortfall = joint_targets(belief.robot, target)
    command = Command(nearest(joints, state.joints), target, phase, shortfall, reference=true_target)
    for k, layer in enumerate(plan.layers):
        states[k], command = layer.commanded(now, states[k], command)
    state = state._replace(joints=command.joints, layers=tuple(states))
    for layer in plan.layers:
        command = command._replace(joints=layer.driven(now, command.joints))
    return state, command


def _moved_base(stance: Stance, left: Array | float, error: PoseError) -> Stance:
    """`stance` with its base moved and turned by the part of an error that is `left`. World axes."""
    quat = multiply(exponential(left * error.turn), stance.quat)
    return Stance(stance.feet, stance.position + left * error.position, quat)


def _advance(
    belief: Case,
    plan: Plan,
    state: TrackerState,
    seen: Observation,
    period: float,
    beside: Array | None,
    truth: Observation | None,
) -> TrackerState:
    """Go on to the next stage when time is up and every swinging foot has touched down, or patience has run out.

    A manoeuvre with events may end it earlier, wherever feet and base have come by then.
    """
    stage, manoeuvre = state.stage, belief.manoeuvre
    over = state.clock - plan.duration[stage]
    landed = jnp.all(seen.loaded | ~plan.swing[stage])
    ends = (over >= 0) & (landed | (over >= plan.patience)) & ~state.finished
    planned = plan.foothold[stage] if beside is None else plan.foothold[stage] + beside
    goal = state.goal if isinstance(manoeuvre, Guided) else planned
    wanted = multiply(exponential(plan.turn[stage]), plan.quat[stage])
    reached = Stance(jnp.where(plan.swing[stage][:, None], goal, state.feet), plan.position[stage], wanted)
    if isinstance(manoeuvre, Eventful) and state.told is not None:
        ends = ends | (manoeuvre.ends(belief, plan, state, seen) & ~state.finished)
        early = (over < 0) & plan.swing[stage][:, None]
        reached = Stance(jnp.where(early, state.told.feet, reached.feet), *state.told[1:])
    last = stage == plan.duration.shape[0] - 1
    following = jnp.where(last, stage, stage + 1)
    meant, blind = borne(plan, state, seen.free)
    ended = stance_to_world(reached, plan.foot_frame[stage], plan.base_frame[stage], meant)
    late = behind(belief.noise, period)
    for layer, own in zip(plan.layers, state.layers, strict=True):
        ended = ended._replace(feet=layer.crept(plan, own, stage, state.clock, ended.feet, late))

    def begin(seen: Observation, before: PoseError) -> Onset:
        begun = onset(belief, plan, following, ended, seen)
        if blind is False:
            return begun
        # it sees nothing of where feet are: the error before holds on
        return jax.tree.map(partial(jnp.where, blind), Onset(ended.feet, before), begun)

    begun, true_error = begin(seen, PoseError(state.error, state.turn)), state.true_error
    if true_error is not None and truth is not None:
        true_error = begin(seen._replace(position=truth.position, quat=truth.quat), true_error).error
    frames, free, states = (plan.foot_frame[following], plan.base_frame[following]), seen.free, list(state.layers)
    feet = to_frame(begun.feet, frames[0], free)
    for k, layer in enumerate(plan.layers):
        states[k], free = layer.entered(following, states[k], meant, free)
    if free.position.shape[0]:  # what is left to the attitude of another frame fades as the error does
        wanted = stance_to_world(ended._replace(quat=plan.quat[following]), *frames, free).quat
        between = multiply(ended.quat, conjugate(wanted))
        stays = plan.base_frame[stage] == plan.base_frame[following]

        def with_rest(error: PoseError) -> PoseError:
            left = logarithm(multiply(exponential(error.turn), between))
            return error._replace(turn=jnp.where(stays, error.turn, left))

        begun = begun._replace(error=with_rest(begun.error))
        true_error = true_error and with_rest(true_error)
    shifted = state._replace(
        stage=following,
        clock=jnp.where(last, state.clock, jnp.minimum(jnp.maximum(over, 0.0), period)),
        feet=feet,
        position=to_frame(ended.position[None], frames[1][None], free)[0],
        error=begun.error.position,
        turn=begun.error.turn,
        finished=last,
        layers=tuple(states),
        true_error=true_error,
    )
    hold = last | ~ends
    kept = state._replace(finished=state.finished | (ends & last))
    return jax.tree.map(partial(jnp.where, hold), kept, shifted)


class Onset(NamedTuple):
    """What a stage begins with, world axes."""

    feet: Float[Array, "6 3"]  # m, footholds
    error: PoseError  # of the base


def onset(belief: Case, plan: Plan, following: Int[Array, ""], ended: Stance, seen: Observation) -> Onset:
    """Stage number `following` begins after one that `ended` in a stance (world axes, as planned).

    The feet of that stance are the commanded footholds, not the reached ones: that keeps the pressure on the ground.
    """
    first, *others = sorted(set(plan.onset))
    chosen = ONSETS[first](belief, plan, following, ended, seen)
    for name in others:
        here = jnp.asarray(np.array(plan.onset) == name)[following]
        chosen = jax.tree.map(partial(jnp.where, here), ONSETS[name](belief, plan, following, ended, seen), chosen)
    return chosen


def _kept(belief: Case, plan: Plan, following: Int[Array, ""], ended: Stance, seen: Observation) -> Onset:
    """Just what was commanded."""
    zero = jnp.zeros(3, ended.feet.dtype)
    return Onset(ended.feet, PoseError(zero, zero))


def _regripped(belief: Case, plan: Plan, following: Int[Array, ""], ended: Stance, seen: Observation) -> Onset:
    """Feet where they are measured along the surface, and as deep as they were commanded.

    Also those that have not touched down yet: they are about to, as far off as the base is, which would otherwise be
    handed on from step to step.
    """
    measured, surface = _measured(belief, seen)
    deep = jnp.sum((ended.feet - measured) * surface.normal, axis=-1, keepdims=True)
    return _kept(belief, plan, following, ended._replace(feet=measured + deep * surface.normal), seen)


def _gripped(belief: Case, plan: Plan, following: Int[Array, ""], ended: Stance, seen: Observation) -> Onset:
    """Feet on free bodies deeper than they are measured, and inward, to the base's middle plane.

    The others are regripped: feet on the ground need not be squeezed. A foot that bears nothing is as deep as it was
    commanded: pressed from where it hangs, it would stay in the air.
    """
    (measured, surface), press = _measured(belief, seen), plan.press[following]
    inward = -SIDE[:, None] * rotate(seen.quat, jnp.asarray(LEFT))
    regripped = _regripped(belief, plan, following, ended, seen)
    deep = jnp.where(seen.loaded[:, None], measured - press[0] * surface.normal, regripped.feet)
    on_body = (surface.body >= 0)[:, None]
    return regripped._replace(feet=jnp.where(on_body, deep + press[1] * inward, regripped.feet))


def _measured(belief: Case, seen: Observation) -> tuple[Float[Array, "6 3"], Surface]:
    """Feet where they are measured (m, world axes), and the believed surface there."""
    feet = feet_in_world(belief.robot, seen.position, seen.quat, seen.angles)
    return feet, under(belief.obstacle, feet, poses(seen.free))


def _rezeroed(belief: Case, plan: Plan, following: Int[Array, ""], ended: Stance, seen: Observation) -> Onset:
    """Feet moved with the base's error, which strains nothing, and that error: without it errors add up by stages.

    In a plan that is steered only its parts in the plane count: taken up by the standing feet and not by those that
    land, the others would put the diagonals at different heights.
    """
    error = seen.position - ended.position
    off = multiply(seen.quat, conjugate(ended.quat))
    turn = logarithm(off)
    if plan.steered:
        error, turn = error.at[2].set(0.0), jnp.zeros(3).at[2].set(heading(off))
    moved = ended.position + error + rotate(exponential(turn)[None], ended.feet - ended.position)
    anchored = any(layer.anchors for layer in plan.layers)
    return Onset(ended.feet if anchored else moved, PoseError(error, turn))


ONSETS = {KEEP: _kept, REGRIP: _regripped, GRIP: _gripped, REZERO: _rezeroed}


def _from_told(now: Now, told: Stance, state: TrackerState, here: Stance) -> TrackerState:
    """The base goes over from where it was told to be to what a stage wants that begins elsewhere, `here` in the world.

    As the error of one that is rezeroed does, which is measured.
    """
    plan, before = now.plan, now.before
    was = stance_to_world(told, plan.foot_frame[before], plan.base_frame[before], now.free)
    takes = now.begins & ~jnp.asarray(np.array(plan.onset) == REZERO)[now.stage]
    jump = PoseError(was.position - here.position, logarithm(multiply(was.quat, conjugate(here.quat))))
    error, turn = jax.tree.map(partial(jnp.where, takes), jump, PoseError(state.error, state.turn))
    true_error = state.true_error and jax.tree.map(partial(jnp.where, takes), jump, state.true_error)
    return state._replace(error=error, turn=turn, true_error=true_error)


def borne(plan: Plan, state: TrackerState, seen: FreeState) -> tuple[FreeState, Bool[Array, ""] | bool]:
    """Free bodies as layers have them in the stage, seen or meant to be; whether the base's place tells no feet's."""
    blind = False
    for layer, own in zip(plan.layers, state.layers, strict=True):
        seen, blind = layer.borne(plan, own, state.stage, state.clock, seen), blind | layer.blind(state.stage)
    return seen, blind
