"""How far a plan keeps from what must not be, without physics: its stages played through by inverse kinematics."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from sweep.controllers import forces
from sweep.controllers.frames import Stance, stance_to_world, to_world
from sweep.controllers.layers import HeldLegs
from sweep.controllers.plan import Plan, reference_stance, stage_start
from sweep.controllers.posture import feet_in_hip_axes, feet_in_world, joint_targets, leg_points, mass_centre
from sweep.core.rotations import matrix, rotate, wrap_angle
from sweep.formulas import leg, stepping
from sweep.metrics.geometry import (
    AROUND,
    base_gap,
    edge_distance,
    fold_gap,
    leg_gap,
    link_capsules,
    shin_slopes,
    support_margin,
)
from sweep.models import solids
from sweep.models.case import Case
from sweep.models.obstacles.surface import BodyPoses, body_poses, free_start_state, surface_at
from sweep.models.robot import half_size
from sweep.tune.hold import reserve

LEVEL = 0.999  # least upward part of a level face's normal; on others feet may hold the robot beside their polygon
MID_SWING = 0.05  # m from both ends of a swing, beyond which a foot has to be off the obstacle
JOINTS_AT = 0.02  # share of a stage over which the joints' rate is taken


class Margins(NamedTuple):
    """What is left, negative where something is not as it has to be."""

    base: Float[Array, "*b"]  # m, from the base to the obstacle
    links: Float[Array, "*b"]  # m, from the links to it, of shins all but the foot
    shin: Float[Array, "*b"]  # rad, of the shin of a standing foot over its face
    legs: Float[Array, "*b"]  # m, between legs
    body: Float[Array, "*b"]  # m, from the base to thighs, but for their beginning, and shins
    fold: Float[Array, "*b"]  # m, from shins to thighs, farther from the knee than its fork is deep
    # m, of feet on the outer side of their hips: to the inner one, seldom meant, a leg turns over by half a turn
    outer: Float[Array, "*b"]
    reach: Float[Array, "*b"]  # m, by which the worst leg could be longer or shorter
    swing: Float[Array, "*b"]  # m, from swinging feet to the obstacle, away from where they start and land
    rate: Float[Array, "*b"]  # rad/s, of the fastest joint, negative
    edge: Float[Array, "*b"]  # m, from standing feet to the edges of their face, no more than `AROUND`
    support: Float[Array, "*b"]  # m, of the mass centre in the standing feet's polygon; where all stand on level ground


def margins(case: Case, plan: Plan, stage: Int[Array, ""], u: Float[Array, ""]) -> Margins:
    """At phase `u` of a stage, feet and base where the stages before have planned them, free bodies as they start."""
    free = free_start_state(case.obstacle)
    stance, joints, shortfall = posed(case, plan, stage, u)
    starts, goal = (
        to_world(feet, plan.foot_frame[stage], free)
        for feet in (stage_start(plan, stage, free)[0], plan.foothold[stage])
    )
    _, later, _ = posed(case, plan, stage, u + jnp.where(u > 0.5, -JOINTS_AT, JOINTS_AT))
    rates = wrap_angle(later - joints) / (JOINTS_AT * plan.duration[stage])
    goes = Swing(plan.swing[stage], starts, goal)
    return left(case, body_poses(free), stance, joints, rates, shortfall, goes)


class Swing(NamedTuple):
    """Which feet swing in a stage, and from where to where (m, world axes)."""

    swings: Bool[Array, " 6"]
    starts: Float[Array, "6 3"]
    goal: Float[Array, "6 3"]


def left(
    case: Case,
    bodies: BodyPoses,
    stance: Stance,
    joints: Float[Array, "6 3"],
    rates: Float[Array, "6 3"],
    shortfall: Array,
    swing: Swing,
) -> Margins:
    """What a stance leaves among `bodies`; joint angles (rad), their rates (rad/s), reach that is lacking (m)."""
    robot, obstacle = case.robot, case.obstacle
    solid = obstacle.solids(bodies)
    base = stance.position, matrix(stance.quat), half_size(robot)
    points = leg_points(robot, joints)
    legs = stance.position + rotate(stance.quat[None, None], points)
    foot = legs[:, -1]
    stretch = jnp.linalg.norm(points[:, -1] - points[:, -3], axis=-1)  # from the knee's joint's other end
    reach = jnp.minimum(robot.thigh + robot.shin - stretch, stretch - jnp.abs(robot.thigh - robot.shin)) - shortfall

    goes = jnp.minimum(*(jnp.linalg.norm(foot - at, axis=-1) for at in (swing.starts, swing.goal))) > MID_SWING
    faces = surface_at(obstacle, foot, bodies)
    above = jnp.where(goes & swing.swings, -faces.depth, jnp.inf)
    inside = edge_distance(obstacle, swing.starts, bodies)
    level = jnp.all(swing.swings | (faces.normal[:, 2] > LEVEL))
    centre = stance.position + rotate(stance.quat, mass_centre(robot, joints))
    return Margins(
        base=solids.distance_to_box(solid, *base),
        links=jnp.min(link_capsules(legs, robot).distance_to(solid)),
        shin=jnp.min(jnp.where(swing.swings, jnp.inf, jnp.arcsin(shin_slopes(legs, faces.normal)))),
        legs=leg_gap(legs) - 2 * robot.link_radius,
        body=base_gap(legs, *base[:2], robot),
        fold=fold_gap(legs, robot.fork_ratio * robot.shin + robot.link_radius) - 2 * robot.link_radius,
        outer=jnp.min(leg.SIDE * feet_in_hip_axes(robot, stance)[:, 1]),
        reach=jnp.min(reach),
        swing=jnp.min(above),
        edge=jnp.min(jnp.where(swing.swings, AROUND, inside)),
        support=jnp.where(level, support_margin(stance.feet[:, :2], ~swing.swings, centre[:2]), jnp.inf),
        rate=-jnp.max(jnp.abs(rates)),
    )


def holding(case: Case, plan: Plan, stage: Int[Array, ""], u: Float[Array, ""], bounds: forces.Bounds) -> Array:
    """The `reserve` of forces within `bounds` (shares of the weight) at phase `u` of a stage."""
    return reserve(forces.planned_pose(case, jax.tree.map(_sound, plan), stage, u), bounds)


@jax.custom_vjp
def _sound(x: Array) -> Array:
    """The same, with no slope where it is not finite, as where a leg is stretched: what is lacking there is reach."""
    return x


def _backwards(_: None, slope: Array) -> tuple[Array]:
    # whole numbers, such as those of frames, have none
    return (jnp.where(jnp.isfinite(slope), slope, 0.0) if jnp.issubdtype(slope.dtype, jnp.floating) else slope,)


_sound.defvjp(lambda x: (x, None), _backwards)


def posed(case: Case, plan: Plan, stage: Array, u: Array) -> tuple[Stance, Float[Array, "6 3"], Float[Array, " 6"]]:
    """The stance at phase `u` of a stage (world axes), its joint angles (rad), each foot's lack of reach (m)."""
    robot, free = case.robot, free_start_state(case.obstacle)
    stance = reference_stance(plan, stage, u, *stage_start(plan, stage, free))
    stance = stance_to_world(stance, plan.foot_frame[stage], plan.base_frame[stage], free)
    joints, shortfall = joint_targets(robot, stance)
    legs = plan.layer(HeldLegs)
    if legs is None:
        return stance, joints, shortfall
    before = jnp.maximum(stage - 1, 0)
    origin, _ = joint_targets(robot, reference_stance(plan, before, jnp.ones(()), *stage_start(plan, before, free)))
    origin = jnp.where(legs.held[before][:, None], legs.joints[before], origin)
    held = legs.held[stage]
    way = stepping.trapezoidal_transfer(u, 0.0, 1.0)[0] * (legs.joints[stage] - origin)
    joints = jnp.where(held[:, None], origin + way, joints)
    feet = feet_in_world(robot, stance.position, stance.quat, joints)
    return stance._replace(feet=jnp.where(held[:, None], feet, stance.feet)), joints, jnp.where(held, 0.0, shortfall)
