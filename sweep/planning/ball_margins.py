"""Margins of a plan on a ball without physics: the tracker runs, and every command is assumed to be reached at once.

Standing feet stay where they landed, on the ground or on a body. The ball follows its reference. A ball whose motion
the controller measures rolls instead by the angular momentum of robot and ball about the ball's lowest point, with
links counted as point masses; it rests while any foot stands on the floor.
"""

from typing import NamedTuple, cast

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from sweep.controllers import tracker
from sweep.controllers.ball_state import UP
from sweep.controllers.frames import points_to_frame, points_to_world
from sweep.controllers.observation import Observation
from sweep.controllers.plan import MEASURED, Plan
from sweep.controllers.reference_body_motion import FreeBodyReferenceMotion
from sweep.controllers.tracker import TrackerState
from sweep.core.constants import GRAVITY
from sweep.core.rotations import exponential, multiply, rotate, wrap_angle
from sweep.formulas.ball import ROLLING_INERTIA
from sweep.models.case import Case
from sweep.models.frames import WORLD_FRAME, body_frame_number
from sweep.models.geometry import support_margin
from sweep.models.obstacles.ball import Ball
from sweep.models.obstacles.surface import FreeBodyState, body_poses, free_start_state, surface_at
from sweep.models.posture import Stance, joint_targets, mass_centre
from sweep.models.robot import total_mass
from sweep.planning.kinematic_margins import PoseMargins, SwingEndpoints, stance_margins

SMOOTHING_TIME = 0.2  # s, over which the mass centre's path is averaged
# s before the end of a stage at which a tick ends, so that feet begin the next stage where they are at the end
END_OFFSET = 1e-3


class KinematicPlayback(NamedTuple):
    """Poses, speeds and margins of a plan on a ball in each control tick, computed by kinematics alone."""

    stage: Int[Array, " t"]
    margins: PoseMargins
    free: FreeBodyState
    stance: Stance
    stands: Bool[Array, "t 6"]
    centre: Float[Array, "t 3"]  # m, the robot's mass centre


class FootContacts(NamedTuple):
    """Points where the feet last landed (m), each in the axes of the body under the foot."""

    feet: Float[Array, "6 3"]  # m, in their frames
    frame: Int[Array, " 6"]


class BallRoll(NamedTuple):
    """Rolling state of a ball: angular momentum about its lowest point, and the robot's mass centre relative to it.

    The angular momentum is K = up x `momentum`.
    """

    momentum: Float[Array, " 2"]  # kg m^2/s
    centre: Float[Array, " 3"]  # m


def play_plan_kinematically(case: Case, plan: Plan, period: float, ticks: int) -> KinematicPlayback:
    """Run a plan on a ball through the tracker with exact sensors and without physics.

    Args:
        case: The case, which is both world and belief.
        plan: Its plan.
        period: Duration of a tick, s; the last tick of a stage is shorter.
        ticks: Number of ticks.

    Returns:
        Stage, margins, ball, stance and mass centre by tick.
    """
    free = free_start_state(case.obstacle)
    state = tracker.init(case, plan)
    still, joints = jnp.zeros(3), state.joints
    contacts = _contacts_at(case, plan.start.feet, free)
    centre = plan.start.position + rotate(plan.start.quat, mass_centre(case.robot, joints)) - free.position[0]
    observation = Observation(
        plan.start.position,
        plan.start.quat,
        still,
        still,
        joints,
        jnp.zeros((6, 3)),
        jnp.zeros((6, 3)),
        jnp.ones(6, bool),
        free,
    )

    def tick(carry: tuple, _: None) -> tuple[tuple, KinematicPlayback]:
        state, observation, contacts, roll = carry
        remains = plan.duration[state.stage] - state.clock
        h = jnp.where((remains > 2 * END_OFFSET) & (remains <= period + END_OFFSET), remains - END_OFFSET, period)
        state, command = tracker.step(case, plan, state, observation, cast(float, h))
        position, quat = command.target.position, command.target.quat
        stage, free = state.stage, tracker.stage_free_body_reference(plan, state, observation.free)[0]
        swings = plan.swing[stage]
        contacts = jax.tree.map(lambda a, b: jnp.where(swings.reshape(-1, *[1] * (a.ndim - 1)), a, b),
                             _contacts_at(case, command.target.feet, free), contacts)  # fmt: skip
        feet = points_to_world(contacts.feet, contacts.frame, free)
        joints = joint_targets(case.robot, command.target._replace(feet=feet))[0]
        goal = state.goal if case.manoeuvre.is_guided else plan.foothold[stage]
        starts, goal = (points_to_world(at, plan.foot_frame[stage], free) for at in (state.feet, goal))
        rates = wrap_angle(joints - observation.angles) / h
        swing = SwingEndpoints(swings, starts, goal)
        margins = stance_margins(case, body_poses(free), command.target, joints, rates, command.shortfall, swing)
        on_floor = jnp.any(~swings & (contacts.frame == WORLD_FRAME))
        centre = position + rotate(quat, mass_centre(case.robot, joints))
        roll, next_free = _roll_ball(case, plan, state, roll, free, centre - free.position[0], on_floor, h)
        velocity = (position - observation.position) / h
        observation = observation._replace(
            position=position, quat=quat, velocity=velocity, angles=joints, free=next_free
        )
        stance = command.target._replace(feet=feet)
        return (state, observation, contacts, roll), KinematicPlayback(stage, margins, free, stance, ~swings, centre)

    _, played = jax.lax.scan(tick, (state, observation, contacts, BallRoll(jnp.zeros(2), centre)), None, length=ticks)
    return played


def _contacts_at(case: Case, feet: Float[Array, "6 3"], free: FreeBodyState) -> FootContacts:
    """Contacts of feet (m, world axes) with the surface nearest to each."""
    body = surface_at(case.obstacle, feet, body_poses(free)).body
    frame = jnp.array([WORLD_FRAME, *map(body_frame_number, range(len(case.obstacle.free_bodies)))])[body + 1]
    return FootContacts(points_to_frame(feet, frame, free), frame)


def _roll_ball(
    case: Case,
    plan: Plan,
    state: TrackerState,
    roll: BallRoll,
    free: FreeBodyState,
    centre: Array,
    on_floor: Array,
    h: Array,
) -> tuple[BallRoll, FreeBodyState]:
    """Roll the ball for `h` s, with the robot's mass centre at `centre` (m) from the ball's centre.

    K = up x k, k = 7/5 M R v + m ((z + R)(v + u) - x u_z), where the mass centre moves by u over the ball and lies x
    ahead and z above; k changes by m (g x + u_z v).
    """
    body_motion, follows = plan.find_layer(FreeBodyReferenceMotion), jnp.asarray(True)
    if body_motion is not None:
        follows = jnp.asarray(body_motion.support.mode)[state.stage, 0] == MEASURED
    assert isinstance(case.obstacle, Ball)
    ball, mass = case.obstacle, total_mass(case.robot)
    u = (centre - roll.centre) / h
    v = free.velocity[0, :2]
    above = centre[2] + ball.radius
    inertia = ROLLING_INERTIA * ball.mass * ball.radius + mass * above
    own = mass * (above * u[:2] - u[2] * centre[:2])
    momentum = roll.momentum + h * mass * (GRAVITY * centre[:2] + u[2] * v)
    rolls = (momentum - own) / inertia
    reference = jnp.where(follows, 0.0, v)
    v = jnp.where(follows & ~on_floor, rolls, reference)
    velocity = jnp.append(v, 0.0)
    turn = jnp.cross(jnp.asarray(UP), velocity) / ball.radius
    moved = jnp.where(follows, h * velocity, 0.0)
    turned = jnp.where(follows, h * turn, 0.0)
    next_free = FreeBodyState(
        free.position + moved, multiply(exponential(turned)[None], free.quat), velocity[None], turn[None]
    )
    return BallRoll(inertia * v + own, centre), next_free


def zmp_margin(played: KinematicPlayback, period: float) -> Float[Array, " t"]:
    """Return the margin (m, one per tick) of the zero-moment point inside the support polygon at foot height.

    The mass centre's path is averaged over `SMOOTHING_TIME`, as drives smooth the jumps of commands.

    Args:
        played: The played plan.
        period: Duration of a tick, s.

    Returns:
        Margin by tick (t,); negative outside.
    """
    width = 2 * round(SMOOTHING_TIME / period / 2) + 1
    padded = jnp.pad(played.centre, ((width // 2 + 1, width // 2 + 1), (0, 0)), mode="edge")
    mean = jax.vmap(lambda x: jnp.convolve(x, jnp.ones(width) / width, mode="valid"), 1, 1)(padded)
    push = (mean[2:] - 2 * mean[1:-1] + mean[:-2]) / period**2

    def inside(stance: Stance, stands: Array, centre: Array, push: Array) -> Array:
        height = centre[2] - jnp.sum(stance.feet[:, 2] * stands) / jnp.maximum(jnp.sum(stands), 1)
        return support_margin(stance.feet[:, :2], stands, centre[:2] - height * push[:2] / (GRAVITY + push[2]))

    return jax.vmap(inside)(played.stance, played.stands, mean[1:-1], push)


def stage_minima(played: KinematicPlayback, stages: int) -> PoseMargins:
    """Return the least value that each margin (reach, clearance, support, ...) takes in each stage.

    Args:
        played: The played plan.
        stages: Number of stages.

    Returns:
        Margins (stages,); infinite for a stage that was not played.
    """
    return jax.tree.map(lambda x: jax.ops.segment_min(x, played.stage, stages), played.margins)
