"""The controller: follows a plan stage by stage and turns feet and base into joint targets (monograph 1.3, 1.4)."""

from functools import partial
from typing import Any, ClassVar, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sweep.controllers.frames import points_to_frame, stance_to_frame, stance_to_world
from sweep.controllers.layers import Command, TickContext
from sweep.controllers.observation import (
    FreeBodyFilterState,
    Observation,
    foot_load_delay_s,
    update_free_body_filter,
)
from sweep.controllers.plan import GRIP, KEEP, REGRIP, REZERO, Plan, reference_stance
from sweep.core.rotations import conjugate, exponential, heading, logarithm, multiply, nearest_equivalent_angle, rotate
from sweep.formulas.leg import SIDE_BY_LEG
from sweep.models.case import Case
from sweep.models.obstacles.surface import FreeBodyState, Surface, body_poses, free_start_state, surface_at
from sweep.models.posture import Stance, feet_in_world, joint_targets

LEFT = np.array([0.0, 1.0, 0.0], np.float32)  # left of the base, base axes


class PoseError(NamedTuple):
    """Deviation of the measured base pose from its reference when a stage starts, world axes."""

    position: Float[Array, " 3"]  # m
    turn: Float[Array, " 3"]  # rad, rotation vector


class TrackerState(NamedTuple):
    """State of the controller between ticks, made by `init` and advanced by `step`."""

    stage: Int[Array, ""]  # stage number
    clock: Float[Array, ""]  # s since the stage started
    feet: Float[Array, "6 3"]  # m, commanded footholds at the start of the stage, in its frames
    position: Float[Array, " 3"]  # m, planned base at the start of the stage, in its frame
    error: PoseError  # measured base error at the start of the stage
    joints: Float[Array, "6 3"]  # rad, joint targets of the last tick
    finished: Bool[Array, ""]  # whether the last stage has ended
    goal: Float[Array, "6 3"]  # m, footholds at the end of the stage, in its frames; used by guided manoeuvres
    memory: Any  # state of a guided manoeuvre's feedback, else None
    observer: FreeBodyFilterState | None  # filter of the free bodies, for manoeuvres on them, else None
    last_target: Stance | None  # last commanded stance in the stage's frames, for manoeuvres that end stages, else None
    layer_states: tuple[Any, ...]  # one for each layer of the plan
    true_error: PoseError | None = None  # `error` by exact sensors; None: sensors are exact


class Guidance(NamedTuple):
    """Output of a feedback law in one tick: the stance to command, the footholds, and the law's new state."""

    stance: Stance
    goal: Float[Array, "6 3"]  # m, footholds at the end of the stage
    memory: Any  # new state of the feedback


class FeedbackLaw(Protocol):
    """Law that computes the commanded stance in each tick from measurements, for a manoeuvre or some of its stages."""

    ends_stages: ClassVar[bool]  # whether it may end a stage early; `duration` of a stage is then its longest time

    def init_memory(self, belief: Case, plan: Plan) -> Any:
        """Return the feedback law's state before the first tick."""
        ...

    def guide(self, belief: Case, ctx: TickContext, state: TrackerState) -> Guidance:
        """Return the stance to command in this tick, the footholds, and the law's new state.

        Args:
            belief: believed parameters.
            ctx: the control tick.
            state: state of the controller; its `memory` is the state of the feedback.
        """
        ...

    def is_stage_over(self, belief: Case, plan: Plan, state: TrackerState, obs: Observation) -> Bool[Array, ""]:
        """Return whether the event that ends the current stage has occurred, for laws with `ends_stages`."""
        ...


def init(belief: Case, plan: Plan, exact: bool = True) -> TrackerState:
    """Return the controller's state before the first tick, with the robot in the stance in which the plan starts.

    Args:
        belief: believed parameters.
        plan: the plan to follow.
        exact: whether sensors are exact, so that `step` needs no true state.
    """
    zero = jnp.zeros((), plan.duration.dtype)
    zeros = jnp.zeros(3, zero.dtype)
    manoeuvre = belief.manoeuvre
    free = free_start_state(belief.obstacle)
    joints, _ = joint_targets(belief.robot, plan.start)
    start = stance_to_frame(plan.start, plan.foot_frame[0], plan.base_frame[0], free)
    return TrackerState(
        stage=jnp.int32(0),
        clock=zero,
        feet=start.feet,
        position=start.position,
        error=PoseError(zeros, zeros),
        joints=joints,
        finished=jnp.asarray(False),
        goal=start.feet,
        memory=manoeuvre.init_memory(belief, plan),
        observer=None if manoeuvre.observer is None else FreeBodyFilterState(free, free),
        last_target=start if manoeuvre.ends_stages else None,
        layer_states=tuple(layer.init_state(start, joints, free) for layer in plan.layers),
        true_error=None if exact else PoseError(zeros, zeros),
    )


def step(
    belief: Case,
    plan: Plan,
    state: TrackerState,
    obs: Observation,
    period: float,
    foothold_offset: Array | None = None,
    truth: Observation | None = None,
) -> tuple[TrackerState, Command]:
    """Run one control tick: advance the stage if it is over, and compute the joint targets.

    Args:
        belief: believed parameters.
        plan: the plan to follow.
        state: state of the controller.
        obs: measurement of this tick.
        period: control period (s).
        foothold_offset: shift (m) of the planned footholds of the current stage, (6, 3), in its frames; None: no shift.
        truth: measurement by exact sensors, from which `Command.reference` follows but no command; None: sensors are
            exact.

    Returns:
        The new state and the command for the drives.
    """
    manoeuvre, has_bodies = belief.manoeuvre, obs.free.position.shape[0] > 0
    last_stage, last_target, starts = state.stage, state.last_target, (state.stage == 0) & (state.clock == 0)
    if manoeuvre.observer is not None and state.observer is not None:
        observer = update_free_body_filter(state.observer, obs.free, manoeuvre.observer, period)
        state, obs = state._replace(observer=observer), obs._replace(free=observer.second)
    state = _advance(belief, plan, state._replace(clock=state.clock + period), obs, period, foothold_offset, truth)
    phase = jnp.clip(state.clock / plan.duration[state.stage], 0.0, 1.0)
    is_first_tick = (state.stage != last_stage) | starts
    free, ignores_pose = stage_free_body_reference(plan, state, obs.free)
    ctx = TickContext(
        belief.robot, plan, last_stage, state.stage, state.clock, phase, is_first_tick, obs, free, period, state.joints,
        belief.noise,
    )  # fmt: skip
    frames = plan.foot_frame[state.stage], plan.base_frame[state.stage]
    for layer in plan.layers:
        state = state._replace(feet=layer.update_footholds(ctx, state.feet))
    if manoeuvre.is_guided:
        stance, goal, memory = manoeuvre.guide(belief, ctx, state)
        state = state._replace(goal=goal, memory=memory)
    else:
        goal = plan.foothold[state.stage]
        if foothold_offset is not None:
            goal = goal + jnp.where(state.stage == last_stage, foothold_offset, 0.0)
        stance = reference_stance(plan, state.stage, phase, state.feet, state.position, goal)
    if has_bodies:
        stance = stance_to_world(stance, *frames, free)
    if last_target is not None:
        state = _blend_from_last_target(ctx, last_target, state, stance)
    # The base error at the start of the stage fades out, unless the base pose says nothing about the feet.
    remaining = jnp.where(ignores_pose, 1.0, 1 - phase)
    target, *references = [
        Stance(
            stance.feet,
            stance.position + remaining * error.position,
            multiply(exponential(remaining * error.turn), stance.quat),
        )
        for error in (state.error, state.true_error)
        if error is not None
    ]
    states = list(state.layer_states)
    for k, layer in enumerate(plan.layers):
        states[k], target = layer.modify_stance(ctx, states[k], target)
    if state.last_target is not None:
        state = state._replace(last_target=stance_to_frame(target, *frames, free))
    joints, shortfall = joint_targets(belief.robot, target)
    joints = nearest_equivalent_angle(joints, state.joints)
    command = Command(joints, target, phase, shortfall, reference=references[0] if references else None)
    for k, layer in enumerate(plan.layers):
        states[k], command = layer.modify_command(ctx, states[k], command)
    state = state._replace(joints=command.joints, layer_states=tuple(states))
    for layer in plan.layers:
        command = command._replace(joints=layer.modify_joint_targets(ctx, command.joints))
    return state, command


def _advance(
    belief: Case,
    plan: Plan,
    state: TrackerState,
    obs: Observation,
    period: float,
    foothold_offset: Array | None,
    truth: Observation | None,
) -> TrackerState:
    """Go to the next stage when its time is over and all swinging feet have touched down, or patience has run out.

    A manoeuvre that `ends_stages` may end a stage earlier, with feet and base wherever they are by then.
    """
    stage, manoeuvre, has_bodies = state.stage, belief.manoeuvre, obs.free.position.shape[0] > 0
    overtime = state.clock - plan.duration[stage]
    landed = jnp.all(obs.loaded | ~plan.swing[stage])
    ends = (overtime >= 0) & (landed | (overtime >= plan.patience)) & ~state.finished
    goal = plan.foothold[stage] if foothold_offset is None else plan.foothold[stage] + foothold_offset
    goal = state.goal if manoeuvre.is_guided else goal
    end_quat = multiply(exponential(plan.turn[stage]), plan.quat[stage])
    end = Stance(jnp.where(plan.swing[stage][:, None], goal, state.feet), plan.position[stage], end_quat)
    if state.last_target is not None:
        ends = ends | (manoeuvre.is_stage_over(belief, plan, state, obs) & ~state.finished)
        early = (overtime < 0) & plan.swing[stage][:, None]
        end = Stance(jnp.where(early, state.last_target.feet, end.feet), *state.last_target[1:])
    last = stage == plan.duration.shape[0] - 1
    next_stage = jnp.where(last, stage, stage + 1)
    last_free, ignores_pose = stage_free_body_reference(plan, state, obs.free)
    if has_bodies:
        end = stance_to_world(end, plan.foot_frame[stage], plan.base_frame[stage], last_free)
    for layer, layer_state in zip(plan.layers, state.layer_states, strict=True):
        load_delay = foot_load_delay_s(belief.noise, period)
        end = end._replace(feet=layer.extend_late_feet(plan, layer_state, stage, state.clock, end.feet, load_delay))

    def start_next_stage(obs: Observation, earlier: PoseError) -> StageStart:
        first, *others = sorted(set(plan.onset))
        start = STAGE_STARTS[first](belief, plan, next_stage, end, obs)
        for name in others:
            uses, other = np.array(plan.onset) == name, STAGE_STARTS[name](belief, plan, next_stage, end, obs)
            start = jax.tree.map(partial(jnp.where, jnp.asarray(uses)[next_stage]), other, start)
        if ignores_pose is False:
            return start
        # the base pose says nothing about the feet: keep the earlier error
        return jax.tree.map(partial(jnp.where, ignores_pose), StageStart(end.feet, earlier), start)

    start, true_error = start_next_stage(obs, state.error), state.true_error
    if true_error is not None and truth is not None:
        true_error = start_next_stage(obs._replace(position=truth.position, quat=truth.quat), true_error).error
    free, states = obs.free, list(state.layer_states)
    feet, position = start.feet, end.position
    for k, layer in enumerate(plan.layers):
        states[k], free = layer.on_stage_enter(next_stage, states[k], last_free, free)
    if has_bodies:
        frames = plan.foot_frame[next_stage], plan.base_frame[next_stage]
        feet, position = (
            points_to_frame(feet, frames[0], obs.free),
            points_to_frame(position[None], frames[1][None], free)[0],
        )
        # the difference to the attitude in another frame fades like the error
        quat_in_next_frame = stance_to_world(end._replace(quat=plan.quat[next_stage]), *frames, free).quat
        turn_between = multiply(end.quat, conjugate(quat_in_next_frame))
        stays = plan.base_frame[stage] == plan.base_frame[next_stage]

        def with_frame_turn(error: PoseError) -> PoseError:
            turn = logarithm(multiply(exponential(error.turn), turn_between))
            return error._replace(turn=jnp.where(stays, error.turn, turn))

        start = start._replace(error=with_frame_turn(start.error))
        true_error = true_error and with_frame_turn(true_error)
    advanced = state._replace(
        stage=next_stage,
        clock=jnp.where(last, state.clock, jnp.minimum(jnp.maximum(overtime, 0.0), period)),
        feet=feet,
        position=position,
        error=start.error,
        finished=last,
        layer_states=tuple(states),
        true_error=true_error,
    )
    stays_in_stage = last | ~ends
    unchanged = state._replace(finished=state.finished | (ends & last))
    return jax.tree.map(partial(jnp.where, stays_in_stage), unchanged, advanced)


class StageStart(NamedTuple):
    """Footholds and base pose error with which the tracker starts a stage, world axes."""

    feet: Float[Array, "6 3"]  # m, footholds
    error: PoseError  # of the base


def _keep_commanded(belief: Case, plan: Plan, next_stage: Int[Array, ""], end: Stance, obs: Observation) -> StageStart:
    """Start a stage from the commanded feet, without base error."""
    zero = jnp.zeros(3, end.feet.dtype)
    return StageStart(end.feet, PoseError(zero, zero))


def _regrip(belief: Case, plan: Plan, next_stage: Int[Array, ""], end: Stance, obs: Observation) -> StageStart:
    """Start a stage with the feet at their measured positions along the surface, at the commanded depth.

    This includes feet that have not touched down yet: their foothold would be off by the base error, and each step
    would hand that error on to the next.
    """
    measured, surface = _measured_feet(belief, obs)
    deep = jnp.sum((end.feet - measured) * surface.normal, axis=-1, keepdims=True)
    return _keep_commanded(belief, plan, next_stage, end._replace(feet=measured + deep * surface.normal), obs)


def _grip(belief: Case, plan: Plan, next_stage: Int[Array, ""], end: Stance, obs: Observation) -> StageStart:
    """Start a stage with feet on free bodies pressed deeper and inward; regrip all other feet.

    A foot without load keeps its commanded depth: pressed from where it hangs, it would stay in the air.
    """
    (measured, surface), press = _measured_feet(belief, obs), plan.press[next_stage]
    inward = -SIDE_BY_LEG[:, None] * rotate(obs.quat, jnp.asarray(LEFT))
    regripped = _regrip(belief, plan, next_stage, end, obs)
    deep = jnp.where(obs.loaded[:, None], measured - press[0] * surface.normal, regripped.feet)
    on_body = (surface.body >= 0)[:, None]
    return regripped._replace(feet=jnp.where(on_body, deep + press[1] * inward, regripped.feet))


def _measured_feet(belief: Case, obs: Observation) -> tuple[Float[Array, "6 3"], Surface]:
    """Measured feet (m, world axes) and the believed surface there."""
    feet = feet_in_world(belief.robot, obs.position, obs.quat, obs.angles)
    return feet, surface_at(belief.obstacle, feet, body_poses(obs.free))


def _rezero(belief: Case, plan: Plan, next_stage: Int[Array, ""], end: Stance, obs: Observation) -> StageStart:
    """Start a stage with the feet shifted by the base error, which avoids internal forces; the error then fades.

    If the plan is steered, only position in the plane and heading count: standing feet would correct the rest of the
    error while landing feet do not, which would put the diagonals at different heights.
    """
    error = obs.position - end.position
    off = multiply(obs.quat, conjugate(end.quat))
    turn = logarithm(off)
    if plan.steered:
        error, turn = error.at[2].set(0.0), jnp.zeros(3).at[2].set(heading(off))
    moved = end.position + error + rotate(exponential(turn)[None], end.feet - end.position)
    anchored = any(layer.anchors_feet for layer in plan.layers)
    return StageStart(end.feet if anchored else moved, PoseError(error, turn))


# Rules of how a stage starts, by the name in `Plan.onset`: from its number, from the stance (world axes) at which the
# stage before should have ended, and from the measurement. No rule uses measured feet as they are: footholds come from
# the commanded feet, or lie at a depth below the surface at the measured feet, so that feet go on pressing.
STAGE_STARTS = {KEEP: _keep_commanded, REGRIP: _regrip, GRIP: _grip, REZERO: _rezero}


def _blend_from_last_target(ctx: TickContext, last_target: Stance, state: TrackerState, stance: Stance) -> TrackerState:
    """Blend the base from its last target into a stage that starts elsewhere, at `stance` (world axes).

    The difference fades during the stage, like a measured error under `REZERO`.
    """
    plan, before = ctx.plan, ctx.last_stage
    last_in_world = stance_to_world(last_target, plan.foot_frame[before], plan.base_frame[before], ctx.free)
    blends = ctx.is_first_tick & ~jnp.asarray(np.array(plan.onset) == REZERO)[ctx.stage]
    jump = PoseError(
        last_in_world.position - stance.position, logarithm(multiply(last_in_world.quat, conjugate(stance.quat)))
    )
    error = jax.tree.map(partial(jnp.where, blends), jump, state.error)
    true_error = state.true_error and jax.tree.map(partial(jnp.where, blends), jump, state.true_error)
    return state._replace(error=error, true_error=true_error)


def stage_free_body_reference(
    plan: Plan, state: TrackerState, free: FreeBodyState
) -> tuple[FreeBodyState, Bool[Array, ""] | bool]:
    """Return the reference state of free bodies in the current stage, and whether the measured base pose is ignored.

    Args:
        plan: the plan to follow.
        state: state of the controller.
        free: measured state of the free bodies, world axes.

    Returns:
        The reference state of the free bodies after all layers (see `Layer.free_body_reference`), and whether some
        layer considers the base pose to say nothing about the feet.
    """
    ignores_pose = False
    for layer, layer_state in zip(plan.layers, state.layer_states, strict=True):
        free, ignores_pose = (
            layer.free_body_reference(plan, layer_state, state.stage, state.clock, free),
            ignores_pose | layer.ignores_base_pose(state.stage),
        )
    return free, ignores_pose
