"""Margins of a plan without physics: inverse kinematics of its stages, with feet and base exactly as planned."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from sweep.controllers.frames import points_to_world, stance_to_world
from sweep.controllers.layers import JointSpaceLegs
from sweep.controllers.plan import Plan, reference_stance, stage_start_pose
from sweep.core.rotations import matrix, rotate, wrap_angle
from sweep.formulas import leg, stepping
from sweep.models import solids
from sweep.models.case import Case
from sweep.models.geometry import (
    EDGE_SEARCH_RADIUS_M,
    foot_edge_distance,
    gap_between_legs,
    leg_base_gap,
    link_capsules,
    shin_slope_sines,
    support_margin,
    thigh_shin_gap,
)
from sweep.models.obstacles.surface import BodyPoses, body_poses, free_start_state, surface_at
from sweep.models.posture import (
    Stance,
    feet_in_hip_axes,
    feet_in_world,
    joint_targets,
    leg_joint_positions,
    mass_centre,
)
from sweep.models.robot import base_half_size
from sweep.planning import forces
from sweep.planning.force_reserve import force_reserve

MIN_LEVEL_NORMAL = (
    0.999  # least vertical component of a level face's normal; the support polygon is meaningful on these only
)
MID_SWING = 0.05  # m from both ends of a swing; farther along, the foot must be off the obstacle
RATE_INTERVAL = 0.02  # share of a stage over which joint rates are differenced


class PoseMargins(NamedTuple):
    """Margins of a pose (reach, clearance, support); negative where a requirement is violated."""

    base: Float[Array, "*b"]  # m, distance from the base to the obstacle
    links: Float[Array, "*b"]  # m, distance from the links to the obstacle; of shins without the foot
    shin: Float[Array, "*b"]  # rad, least angle between the shin of a standing foot and its face
    legs: Float[Array, "*b"]  # m, distance between legs
    body: Float[Array, "*b"]  # m, distance from the base to shins and thighs, without the beginning of the thighs
    fold: Float[Array, "*b"]  # m, distance from shins to thighs, beyond the depth of the knee's fork
    # m, distance of feet to the outer side of their hips; a foot that crosses to the inner side turns its leg over
    outer: Float[Array, "*b"]
    reach: Float[Array, "*b"]  # m, by which the worst leg could still be extended or folded
    swing: Float[Array, "*b"]  # m, distance of swinging feet from the obstacle, away from lift-off and touchdown
    rate: Float[Array, "*b"]  # rad/s, minus the rate of the fastest joint
    edge: Float[Array, "*b"]  # m, distance of standing feet from the edges of their face, at most `AROUND`
    support: Float[Array, "*b"]  # m, of the mass centre inside the support polygon; infinite unless all faces are level


def planned_margins(case: Case, plan: Plan, stage: Int[Array, ""], u: Float[Array, ""]) -> PoseMargins:
    """Return the margins of reach and clearance of a plan at phase `u` of a stage, with free bodies at their start.

    Args:
        case: The planned case.
        plan: Its plan.
        stage: Index of the stage.
        u: Phase, from 0 to 1.
    """
    free = free_start_state(case.obstacle)
    stance, joints, shortfall = planned_stance(case, plan, stage, u)
    starts, goal = (
        points_to_world(feet, plan.foot_frame[stage], free)
        for feet in (stage_start_pose(plan, stage, free)[0], plan.foothold[stage])
    )
    _, later, _ = planned_stance(case, plan, stage, u + jnp.where(u > 0.5, -RATE_INTERVAL, RATE_INTERVAL))
    rates = wrap_angle(later - joints) / (RATE_INTERVAL * plan.duration[stage])
    goes = SwingEndpoints(plan.swing[stage], starts, goal)
    return stance_margins(case, body_poses(free), stance, joints, rates, shortfall, goes)


class SwingEndpoints(NamedTuple):
    """Feet that swing in a stage, with lift-off and touchdown points (m, world axes)."""

    swings: Bool[Array, " 6"]
    starts: Float[Array, "6 3"]
    goal: Float[Array, "6 3"]


def stance_margins(
    case: Case,
    bodies: BodyPoses,
    stance: Stance,
    joints: Float[Array, "6 3"],
    rates: Float[Array, "6 3"],
    shortfall: Array,
    swing: SwingEndpoints,
) -> PoseMargins:
    """Return the margins of reach, clearance and support of a single stance.

    Args:
        case: The case.
        bodies: Poses of the obstacle's free bodies.
        stance: Poses of base and feet, world axes.
        joints: Joint angles (6, 3), rad.
        rates: Joint rates (6, 3), rad/s.
        shortfall: Distance of each foot target beyond its leg's reach (6,), m.
        swing: Feet that swing, and from where to where.
    """
    robot, obstacle = case.robot, case.obstacle
    solid = obstacle.solids(bodies)
    base = stance.position, matrix(stance.quat), base_half_size(robot)
    points = leg_joint_positions(robot, joints)
    legs = stance.position + rotate(stance.quat[None, None], points)
    foot = legs[:, -1]
    stretch = jnp.linalg.norm(points[:, -1] - points[:, -3], axis=-1)  # from the hip end of the thigh to the foot
    reach = jnp.minimum(robot.thigh + robot.shin - stretch, stretch - jnp.abs(robot.thigh - robot.shin)) - shortfall

    goes = jnp.minimum(*(jnp.linalg.norm(foot - at, axis=-1) for at in (swing.starts, swing.goal))) > MID_SWING
    faces = surface_at(obstacle, foot, bodies)
    above = jnp.where(goes & swing.swings, -faces.depth, jnp.inf)
    inside = foot_edge_distance(obstacle, swing.starts, bodies)
    level = jnp.all(swing.swings | (faces.normal[:, 2] > MIN_LEVEL_NORMAL))
    centre = stance.position + rotate(stance.quat, mass_centre(robot, joints))
    return PoseMargins(
        base=solids.distance_to_box(solid, *base),
        links=jnp.min(link_capsules(legs, robot).distance_to(solid)),
        shin=jnp.min(jnp.where(swing.swings, jnp.inf, jnp.arcsin(shin_slope_sines(legs, faces.normal)))),
        legs=gap_between_legs(legs) - 2 * robot.link_radius,
        body=leg_base_gap(legs, *base[:2], robot),
        fold=thigh_shin_gap(legs, robot.fork_ratio * robot.shin + robot.link_radius) - 2 * robot.link_radius,
        outer=jnp.min(leg.SIDE_BY_LEG * feet_in_hip_axes(robot, stance)[:, 1]),
        reach=jnp.min(reach),
        swing=jnp.min(above),
        edge=jnp.min(jnp.where(swing.swings, EDGE_SEARCH_RADIUS_M, inside)),
        support=jnp.where(level, support_margin(stance.feet[:, :2], ~swing.swings, centre[:2]), jnp.inf),
        rate=-jnp.max(jnp.abs(rates)),
    )


def planned_force_reserve(
    case: Case, plan: Plan, stage: Int[Array, ""], u: Float[Array, ""], bounds: forces.ForceBounds
) -> Array:
    """Return by how much bounds on foot forces can be tightened at phase `u` of a stage, as a share of the weight.

    Args:
        case: The planned case.
        plan: Its plan.
        stage: Index of the stage.
        u: Phase, from 0 to 1.
        bounds: Bounds of foot forces.
    """
    return force_reserve(forces.planned_pose(case, jax.tree.map(_finite_gradient, plan), stage, u), bounds)


@jax.custom_vjp
def _finite_gradient(x: Array) -> Array:
    """Identity whose gradient is 0 where it is not finite, as at a stretched leg; there the reach margin tells."""
    return x


def _finite_gradient_backward(_: None, slope: Array) -> tuple[Array]:
    # integers, such as indices of frames, have no gradient
    return (jnp.where(jnp.isfinite(slope), slope, 0.0) if jnp.issubdtype(slope.dtype, jnp.floating) else slope,)


_finite_gradient.defvjp(lambda x: (x, None), _finite_gradient_backward)


def planned_stance(
    case: Case, plan: Plan, stage: Array, u: Array
) -> tuple[Stance, Float[Array, "6 3"], Float[Array, " 6"]]:
    """Return the planned stance and its joint angles at phase `u` of a stage, by inverse kinematics.

    Args:
        case: The planned case.
        plan: Its plan.
        stage: Index of the stage.
        u: Phase, from 0 to 1.

    Returns:
        The stance (world axes), its joint angles (6, 3), rad, and the shortfall of each foot (6,), m.
    """
    robot, free = case.robot, free_start_state(case.obstacle)
    stance = reference_stance(plan, stage, u, *stage_start_pose(plan, stage, free))
    stance = stance_to_world(stance, plan.foot_frame[stage], plan.base_frame[stage], free)
    joints, shortfall = joint_targets(robot, stance)
    legs = plan.find_layer(JointSpaceLegs)
    if legs is None:
        return stance, joints, shortfall
    before = jnp.maximum(stage - 1, 0)
    origin, _ = joint_targets(
        robot, reference_stance(plan, before, jnp.ones(()), *stage_start_pose(plan, before, free))
    )
    origin = jnp.where(legs.held[before][:, None], legs.joints[before], origin)
    held = legs.held[stage]
    change = stepping.trapezoidal_transfer_timing(u, 0.0, 1.0)[0] * (legs.joints[stage] - origin)
    joints = jnp.where(held[:, None], origin + change, joints)
    feet = feet_in_world(robot, stance.position, stance.quat, joints)
    return stance._replace(feet=jnp.where(held[:, None], feet, stance.feet)), joints, jnp.where(held, 0.0, shortfall)
