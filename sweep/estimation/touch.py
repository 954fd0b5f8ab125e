"""Learning from touch: estimates the obstacle's sizes from touchdowns, and moves feet to the real surface.

A foot that has just landed is at the surface. Its distance from the believed surface is one equation for the obstacle's
sizes; recursive least squares takes in one equation after the other.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from sweep.controllers import frames
from sweep.controllers.frames import points_to_frame, points_to_world
from sweep.controllers.layers import JointSpaceLegs
from sweep.controllers.observation import Observation, touchdown_detection_delay_s
from sweep.controllers.plan import Plan
from sweep.controllers.tracker import TrackerState
from sweep.models.control import Control
from sweep.models.legs import N_LEGS
from sweep.models.noise import Noise
from sweep.models.obstacles.surface import (
    BodyPoses,
    Obstacle,
    Surface,
    body_poses,
    free_start_state,
    landmark_state,
    state_from_landmarks,
    surface_at,
)
from sweep.models.posture import Stance, feet_in_world
from sweep.models.robot import Robot

MAX_SEARCH = 0.04  # m, how far a foot moves on beyond its planned place in search of the surface
LANDING_PHASE = 0.5  # phase of a swing after which a loaded foot counts as landed
MAX_OVERSHOOT = 0.002  # m, that a searching foot may move on before its load is measured
YIELD_SHARE = 0.5  # share of the excess pressure of a landing foot that it gives way to in one tick
# m, by which a foot may land outside the planned surface; further out it is lifted, by as much above it
CLEARANCE = 0.005


class TouchState(NamedTuple):
    """State of estimating obstacle sizes from touch: the obstacle as believed, covariance, and corrections of feet."""

    obstacle: Obstacle  # obstacle as believed now
    first_obstacle: Obstacle  # obstacle for which the first plan was made
    covariance: Float[Array, "n n"]  # of the sizes in `learnable_sizes`, in their units
    has_landed: Bool[Array, " 6"]  # feet that have landed since their swing
    # m, outward shift of each foot's command that is still to be made; negative: it has moved on inward
    pending: Float[Array, " 6"]
    caution: Float[Array, ""]  # standard deviations, see `cautious_planning_obstacle`


def learnable_sizes(obstacle: Obstacle | type[Obstacle]) -> tuple[str, ...]:
    """Return the names of the obstacle's sizes that foot contacts can determine.

    If its free bodies move, these are the sizes that show when they lie on the floor, or when feet stand on them.
    """
    if obstacle.free_bodies:  # pyright: ignore[reportAttributeAccessIssue]
        return obstacle.sizes_learnable_from_height or obstacle.sizes_learnable_from_feet  # pyright: ignore[reportAttributeAccessIssue]
    fields = dataclasses.fields(obstacle)  # pyright: ignore[reportArgumentType]
    return tuple(f.name for f in fields if f.metadata.get("role") == "quantity")


def is_estimated_from_foot_contacts(obstacle: Obstacle) -> bool:
    """Return whether the obstacle's sizes are estimated from foot contacts; else from where free bodies lie."""
    return not obstacle.free_bodies or bool(obstacle.sizes_learnable_from_feet)


def init_touch_state(control: Control, obstacle: Obstacle) -> TouchState:
    """Return the state of estimation from touch before any contact: sizes as believed, all feet standing.

    Args:
        control: has the prior deviation of sizes.
        obstacle: the believed obstacle.
    """
    sizes = _sizes(obstacle)
    covariance = jnp.diag((control.obstacle_error * sizes) ** 2)
    caution = jnp.asarray(control.caution, float)
    known = _with_sizes(obstacle, sizes)
    return TouchState(known, known, covariance, jnp.ones(N_LEGS, bool), jnp.zeros(N_LEGS), caution)


def update_from_stance(
    control: Control,
    noise: Noise,
    robot: Robot,
    start: Stance,
    touch_state: TouchState,
    position: Float[Array, "3"],
    quat: Float[Array, "4"],
    angles: Float[Array, "6 3"],
) -> TouchState:
    """Update the obstacle's estimated sizes from a measurement of all feet standing at the start.

    Args:
        control: settings of learning.
        noise: believed sensor errors.
        robot: the robot, as believed.
        start: planned stance, world axes.
        touch_state: state of learning.
        position: measured base position (m).
        quat: measured base attitude.
        angles: measured joint angles (rad).
    """
    places = feet_in_world(robot, position, quat, angles)
    ground = surface_at(touch_state.obstacle, start.feet, _start_poses(touch_state.first_obstacle))
    outside = jnp.sum((places - start.feet) * ground.normal, axis=1)
    variance = _variance(control, noise, touch_state.obstacle)
    known, _ = _update_sizes(touch_state, places, outside, ground.normal, variance, jnp.ones(N_LEGS, bool))
    return known._replace(first_obstacle=cautious_planning_obstacle(known))


def update_from_resting_bodies(
    control: Control, noise: Noise, touch_state: TouchState, places: Float[Array, "k 3"]
) -> TouchState:
    """Update the obstacle's estimated sizes from where its free bodies lie on the floor.

    Args:
        control: settings of learning.
        noise: believed sensor errors.
        touch_state: state of learning.
        places: measured centres of the bodies (m), world axes.
    """
    bodies = _start_poses(touch_state.obstacle)._replace(position=places)
    owner = tuple(range(len(touch_state.obstacle.free_bodies)))

    def inside(x: Array) -> Array:
        return _with_sizes(touch_state.obstacle, x).surface(places, owner, bodies).depth

    variance = control.touch_error**2 + noise.body_position_noise**2 + noise.body_position_bias**2
    return _update_sizes_from_depths(touch_state, inside, variance, jnp.ones(len(owner), bool))[0]


def cautious_planning_obstacle(touched: TouchState) -> Obstacle:
    """Return the obstacle to plan for: uncertain heights are raised by `caution` standard deviations.

    A foot over a surface lower than planned moves on in search of it. If the surface is higher, links hit its edge
    before any foot can sense it.
    """
    known = learnable_sizes(touched.obstacle)
    deviation = jnp.sqrt(jnp.maximum(jnp.diagonal(touched.covariance), 0.0))
    more = jnp.array([name in touched.obstacle.heights for name in known]) * touched.caution * deviation
    return _with_sizes(touched.obstacle, _sizes(touched.obstacle) + more)


def planned_foothold_surface(touch_state: TouchState, plan: Plan, stage: Int[Array, ""]) -> Surface:
    """Return the believed obstacle surface under a stage's footholds, for which the first plan was made.

    Args:
        touch_state: state of learning.
        plan: the first plan.
        stage: stage number.
    """
    return frames.surface_under_feet(touch_state.first_obstacle, plan.foothold[stage], plan.foot_frame[stage])


def update_touch_estimate(
    control: Control,
    noise: Noise,
    robot: Robot,
    plan: Plan,
    ground: Surface,
    state: TrackerState,
    touch_state: TouchState,
    obs: Observation,
    period: float,
) -> tuple[TouchState, Float[Array, "6 3"], Bool[Array, " 6"]]:
    """Run one tick of estimation from touch: update the obstacle's sizes, and move feet to the real surface.

    If sizes are uncertain:

    - A foot that lands updates the sizes, and its command moves along the surface normal to the commanded depth inside
      the real surface.
    - A foot that lands before the end of its swing gives way to the excess pressure. If it is far outside its planned
      place, it is lifted over the surface that it met.
    - A foot in the air after its swing moves on inward, once a load would be measured, and no faster than the delay of
      the load allows.

    Along the surface, commands stay where they are. Legs held by joint angles are left out. On free bodies, everything
    is computed as if the body were where it starts.

    Args:
        control: settings of learning.
        noise: believed sensor errors.
        robot: the robot, as believed.
        plan: plan that is followed.
        ground: `planned_foothold_surface` of the stage; each foot is taken to be on its face, as deep inside
            as planned.
        state: state of the controller.
        touch_state: state of learning.
        obs: measurement of this tick.
        period: control period (s).

    Returns:
        The new state of learning; the shift of footholds (m, (6, 3), in their frames), from the plan for swinging feet
        and from the last command for standing ones; and which feet search for the surface.
    """
    stage, normal = state.stage, ground.normal
    frame, rest = plan.foot_frame[stage], free_start_state(touch_state.first_obstacle)
    free = obs.free if state.observer is None else state.observer.second

    def feet(angles: Array) -> Array:
        places = feet_in_world(robot, obs.position, obs.quat, angles)
        return points_to_world(points_to_frame(places, frame, free), frame, rest)

    places, commanded, swing_start = feet(obs.angles), feet(state.joints), points_to_world(state.feet, frame, rest)
    outside = jnp.sum((places - points_to_world(plan.foothold[stage], frame, rest)) * normal, axis=1)
    legs = plan.find_layer(JointSpaceLegs)
    follows_footholds = jnp.ones(N_LEGS, bool) if legs is None else ~legs.held[stage]
    stands = follows_footholds & ~plan.swing[stage]
    lands = stands & obs.loaded & ~touch_state.has_landed
    known, uncertain = _update_sizes(
        touch_state, places, outside, normal, _variance(control, noise, touch_state.obstacle), lands
    )
    outwards = jnp.sum((places - swing_start) * normal, axis=1) - ground.depth
    may_land = follows_footholds & plan.swing[stage] & (state.clock >= LANDING_PHASE * plan.duration[stage])
    pending = jnp.where(stands | may_land, jnp.where(lands & uncertain, outwards, touch_state.pending), 0.0)
    landed = stands & (touch_state.has_landed | lands)
    step = control.touch_speed * period
    tracking = jnp.where(landed & obs.loaded, jnp.clip(pending, -step, step), 0.0)
    is_late = may_land & (state.clock >= plan.duration[stage])
    is_searching = ((stands & ~landed) | (is_late & ~obs.loaded)) & uncertain & (pending > -MAX_SEARCH)
    detection_delay = touchdown_detection_delay_s(noise, period)
    goes_on = is_searching & (stands | (state.clock >= plan.duration[stage] + detection_delay))
    onwards = jnp.where(goes_on, jnp.minimum(step, MAX_OVERSHOOT * period / jnp.maximum(detection_delay, period)), 0.0)
    strain = jnp.sum((places - commanded) * normal, axis=1)  # m
    pressed = YIELD_SHARE / (1 + noise.delay) * (strain - ground.depth)
    give_way = jnp.maximum(pressed, -jnp.maximum(pending, 0.0))
    lift = jnp.where(strain > 0, jnp.maximum(outside + CLEARANCE - pending, 0.0), 0.0)
    lands_early = may_land & ~is_late & obs.loaded & uncertain
    yields = jnp.where(lands_early, jnp.where(outside > ground.depth + CLEARANCE, lift, give_way), 0.0)
    standing_move = tracking - onwards
    pending = jnp.where(is_searching, pending - onwards, pending - tracking + yields)
    axes = rest._replace(position=jnp.zeros_like(rest.position))
    moves = points_to_frame(jnp.where(stands, standing_move, pending)[:, None] * normal, frame, axes)
    return known._replace(has_landed=landed, pending=pending), moves, is_searching


def _variance(control: Control, noise: Noise, obstacle: Obstacle) -> Array | float:
    """Variance of a touched point's measured distance from the surface (m^2)."""
    variance = control.touch_error**2 + noise.position_noise**2 + noise.position_bias**2
    return variance + noise.body_position_noise**2 + noise.body_position_bias**2 if obstacle.free_bodies else variance


def _start_poses(obstacle: Obstacle) -> BodyPoses:
    """Poses of the obstacle's free bodies where they start."""
    return body_poses(free_start_state(obstacle))


def _update_sizes(
    touch_state: TouchState,
    places: Float[Array, "6 3"],
    outside: Float[Array, " 6"],
    normal: Float[Array, "6 3"],
    variance: Array | float,
    counts: Bool[Array, " 6"],
) -> tuple[TouchState, Bool[Array, " 6"]]:
    """Update the sizes after some feet were found at the surface. Returns also where the surface was uncertain.

    `places` are `outside` (m) of their planned places along the normal. The measured landmarks of free bodies stay in
    place, whatever the sizes.
    """
    marks = landmark_state(touch_state.first_obstacle, free_start_state(touch_state.first_obstacle))

    def inside(x: Array) -> Array:
        """Depths (m) on the planned face: deep inside the believed obstacle, another face may be nearer."""
        planned, obstacle = places - outside[:, None] * normal, _with_sizes(touch_state.obstacle, x)
        return surface_at(obstacle, planned, body_poses(state_from_landmarks(obstacle, marks))).depth - outside

    return _update_sizes_from_depths(touch_state, inside, variance, counts)


def _update_sizes_from_depths(
    touch_state: TouchState, inside: Callable[[Array], Array], variance: Array | float, counts: Bool[Array, " m"]
) -> tuple[TouchState, Bool[Array, " m"]]:
    """Update the sizes after some points were found at the surface; returns also where it was uncertain.

    `inside` gives the depths (m) of the points for given sizes.
    """
    sizes = _sizes(touch_state.obstacle)
    slopes = jax.jacfwd(inside)(sizes)
    uncertain = jnp.sum((slopes @ touch_state.covariance) * slopes, axis=1) > 0
    sizes, covariance = _least_squares(sizes, touch_state.covariance, inside(sizes), slopes, variance, counts)
    return touch_state._replace(obstacle=_with_sizes(touch_state.obstacle, sizes), covariance=covariance), uncertain


def _least_squares(
    sizes: Float[Array, " n"],
    covariance: Float[Array, "n n"],
    inside: Float[Array, " m"],
    slopes: Float[Array, "m n"],
    variance: Array | float,
    counts: Bool[Array, " m"],
) -> tuple[Float[Array, " n"], Float[Array, "n n"]]:
    """Recursive least squares: sizes and covariance after the points that count were found at the surface."""
    first = sizes
    for k in range(slopes.shape[0]):
        slope = slopes[k]
        spread = covariance @ slope
        gain = jnp.where(counts[k], spread / (slope @ spread + variance), 0.0)
        sizes = sizes - gain * (inside[k] + slope @ (sizes - first))
        covariance = covariance - gain[:, None] * spread
    return sizes, covariance


def _sizes(obstacle: Obstacle) -> Float[Array, " n"]:
    return jnp.stack([jnp.asarray(getattr(obstacle, name), float) for name in learnable_sizes(obstacle)])


def _with_sizes(obstacle: Obstacle, sizes: Float[Array, " n"]) -> Obstacle:
    return replace(obstacle, **{name: sizes[k] for k, name in enumerate(learnable_sizes(obstacle))})  # pyright: ignore
