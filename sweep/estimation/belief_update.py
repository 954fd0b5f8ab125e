"""Updates of the robot's belief during a rollout, and the footholds and plan that follow from them."""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from sweep.controllers.layers import ForceFeedforward, JointSpaceLegs
from sweep.controllers.observation import Observation
from sweep.controllers.plan import Plan, stage_end_stances
from sweep.controllers.tracker import TrackerState
from sweep.estimation import touch
from sweep.estimation.calibration import CalibrationResult
from sweep.estimation.touch import TouchState
from sweep.models.case import Case
from sweep.models.frames import body_frame_number
from sweep.models.obstacles.surface import Obstacle, free_start_state, landmarks
from sweep.models.posture import joint_targets


class LearnedState(NamedTuple):
    """Estimates that a robot has made so far in a rollout (body sizes, obstacle sizes), and the newest plan."""

    calibration: CalibrationResult | None = None
    touch: TouchState | None = None
    plan: Plan | None = None  # latest plan, if the robot replans
    # m, by which the rest of that plan is out of the legs' reach; infinite if there is no plan for the learned sizes
    shortfall: Float[Array, ""] | None = None


def updated_belief(belief: Case, learned: LearnedState) -> Case:
    """Return the belief with the estimated sizes of robot and obstacle in place of the assumed ones.

    Args:
        belief: belief at the start.
        learned: what the robot has learned.
    """
    robot = learned.calibration.robot if learned.calibration else belief.robot
    obstacle = touch.cautious_planning_obstacle(learned.touch) if learned.touch else belief.obstacle
    return replace(belief, robot=robot, obstacle=obstacle)


def initial_obstacle(belief: Case, learned: LearnedState) -> Obstacle:
    """Return the obstacle, as first believed, for which the first plan was made.

    Args:
        belief: belief at the start.
        learned: what the robot has learned.
    """
    return learned.touch.first_obstacle if learned.touch else belief.obstacle


def update_belief_from_touch(
    world: Case,
    belief: Case,
    first_plan: Plan,
    state: TrackerState,
    learned: LearnedState,
    obs: Observation,
    period: float,
) -> tuple[TrackerState, Plan, Float[Array, "6 3"] | None, LearnedState]:
    """Update the estimated obstacle sizes from foot contacts in one tick, if the robot learns by touch.

    Args:
        world: simulated parameters, which have the settings of learning (`control`).
        belief: belief at the start.
        first_plan: plan from before the start.
        state: state of the controller.
        learned: what the robot has learned so far, with `touch`.
        obs: measurement of this tick.
        period: control period (s).

    Returns:
        The controller's state with updated footholds of standing feet; the plan to follow; the shift of swinging feet's
        footholds (m, (6, 3), in their frames), or None; what the robot has learned.
    """
    plan = learned.plan or first_plan
    if learned.touch is None or not touch.is_estimated_from_foot_contacts(belief.obstacle):
        return state, plan, None, learned
    ground = touch.planned_foothold_surface(learned.touch, first_plan, state.stage)
    robot = updated_belief(belief, learned).robot
    arguments = world.control, belief.noise, robot, plan, ground
    touched, moves, searches = touch.update_touch_estimate(*arguments, state, learned.touch, obs, period)
    swings = plan.swing[state.stage]
    foothold_offset = jnp.where(swings[:, None], moves, 0.0)
    patience = jnp.where(jnp.any(searches & swings), jnp.inf, plan.patience)
    # With planned forces, footholds of loaded feet follow the measured feet already.
    follows = ~swings if plan.find_layer(ForceFeedforward) is None else ~swings & ~obs.loaded
    state = state._replace(feet=state.feet + jnp.where(follows[:, None], moves, 0.0))
    return state, replace(plan, patience=patience), foothold_offset, learned._replace(touch=touched)


def replan_remaining_stages(belief: Case, plan: Plan, stage: Int[Array, ""], learned: LearnedState) -> LearnedState:
    """Replan the stages after `stage` for the estimated sizes; keep the old plan if none exists for them.

    Planned forces stay as they are: they are expensive, and change by only about as much as the sizes.

    Args:
        belief: belief at the start.
        plan: plan at the start.
        stage: stage number.
        learned: what the robot has learned so far.
    """
    current = learned.plan or plan
    latest = updated_belief(belief, learned)
    fresh = replace(latest.manoeuvre.plan(latest), start=current.start)
    if (forces := current.find_layer(ForceFeedforward)) is not None:
        fresh = fresh.replace_layer(forces)
    is_finite = jnp.all(jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(fresh)]))
    remaining = jnp.arange(plan.duration.shape[0]) > stage
    shortfall = jnp.where(is_finite, jnp.max(jnp.where(remaining, _shortfall(latest, fresh), 0.0)), jnp.inf)
    later = is_finite & remaining

    def select(a: Array, b: Array) -> Array:
        staged = a.ndim and a.shape[0] == later.shape[0]
        return jnp.where(later.reshape(-1, *[1] * (a.ndim - 1)), a, b) if staged else b

    fresh = _shift_in_body_frames(fresh, landmarks(initial_obstacle(belief, learned)) - landmarks(latest.obstacle))
    newer = replace(jax.tree.map(select, fresh, current), start=current.start)
    return learned._replace(plan=newer, shortfall=shortfall)


def _shift_in_body_frames(plan: Plan, shift: Float[Array, "k 3"]) -> Plan:
    """Shift the plan's points in body-fixed frames by `shift` (m)."""

    def shift_in(frame: Array) -> Array:
        return sum(((frame == body_frame_number(k))[..., None] * shift[k] for k in range(shift.shape[0])), jnp.zeros(3))

    feet, base = shift_in(plan.foot_frame), shift_in(plan.base_frame)
    curve = plan.curve._replace(guides=plan.curve.guides + feet[..., None, :])
    path = plan.path._replace(pivot=plan.path.pivot + base)
    return replace(plan, foothold=plan.foothold + feet, curve=curve, position=plan.position + base, path=path)


def _shortfall(belief: Case, plan: Plan) -> Float[Array, " s"]:
    """Distance (m) of the worst foot beyond its reach at the end of each stage, with free bodies where they start."""
    last = stage_end_stances(plan, free_start_state(belief.obstacle))
    out = jax.vmap(lambda stance: joint_targets(belief.robot, stance)[1])(last)
    legs = plan.find_layer(JointSpaceLegs)
    return jnp.max(out if legs is None else jnp.where(legs.held, 0.0, out), axis=1)
