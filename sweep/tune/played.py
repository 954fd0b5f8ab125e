"""A plan on a ball without physics: played through by its own tracker, which is told that all goes as it commands.

Only feet that stand stay where they landed, on the ground or on a body, wherever they are pressed to.
A ball goes as it is meant to. One that is followed where it is seen rolls as the angular momentum of robot and ball
about its lowest point has it, links counted as mass points; it stays where it is while feet stand on the floor, too.
"""

from typing import NamedTuple, cast

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from sweep.controllers import tracker
from sweep.controllers.ball_state import UP
from sweep.controllers.frames import Stance, to_frame, to_world
from sweep.controllers.observation import Observation
from sweep.controllers.plan import MEASURED, Plan
from sweep.controllers.posture import joint_targets, mass_centre
from sweep.controllers.reference_body_motion import ReferenceBodyMotion
from sweep.controllers.tracker import TrackerState
from sweep.core.constants import GRAVITY
from sweep.core.rotations import exponential, multiply, rotate, wrap_angle
from sweep.formulas.ball import ROLLING
from sweep.metrics.geometry import support_margin
from sweep.models.case import Case
from sweep.models.frames import WORLD, body_frame
from sweep.models.obstacles.ball import Ball
from sweep.models.obstacles.surface import FreeState, body_poses, free_start_state, surface_at
from sweep.models.robot import total_mass
from sweep.tune.planned import Margins, Swing, left

SMOOTH = 0.2  # s
SHORT = 1e-3  # s, before the end of a stage, at which there is a tick: feet begin the next one where they are then


class Played(NamedTuple):
    """What was played, by tick."""

    stage: Int[Array, " t"]
    margins: Margins
    free: FreeState
    stance: Stance
    stands: Bool[Array, "t 6"]
    centre: Float[Array, "t 3"]  # m, the robot's mass centre


class Stood(NamedTuple):
    """Feet where they landed."""

    feet: Float[Array, "6 3"]  # m, in their frames
    frame: Int[Array, " 6"]


class Roll(NamedTuple):
    """Of a ball: angular momentum about its lowest point, as K = up x this; the robot's mass centre from its centre."""

    momentum: Float[Array, " 2"]  # kg m^2/s
    centre: Float[Array, " 3"]  # m


def play(case: Case, plan: Plan, period: float, ticks: int) -> Played:
    """Play the plan of `case`, its own world and belief, in `ticks` of `period` s, or less at the end of a stage."""
    free = free_start_state(case.obstacle)
    state = tracker.init(case, plan)
    still, joints = jnp.zeros(3), state.joints
    stood = _standing(case, plan.start.feet, free)
    centre = plan.start.position + rotate(plan.start.quat, mass_centre(case.robot, joints)) - free.position[0]
    seen = Observation(
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

    def tick(carry: tuple, _: None) -> tuple[tuple, Played]:
        state, seen, stood, roll = carry
        remains = plan.duration[state.stage] - state.clock
        h = jnp.where((remains > 2 * SHORT) & (remains <= period + SHORT), remains - SHORT, period)
        state, command = tracker.step(case, plan, state, seen, cast(float, h))
        position, quat = command.target.position, command.target.quat
        stage, free = state.stage, tracker.reference_body_state(plan, state, seen.free)[0]
        swings = plan.swing[stage]
        stood = jax.tree.map(lambda a, b: jnp.where(swings.reshape(-1, *[1] * (a.ndim - 1)), a, b),
                             _standing(case, command.target.feet, free), stood)  # fmt: skip
        feet = to_world(stood.feet, stood.frame, free)
        joints = joint_targets(case.robot, command.target._replace(feet=feet))[0]
        goal = state.goal if isinstance(case.manoeuvre, tracker.Guided) else plan.foothold[stage]
        starts, goal = (to_world(at, plan.foot_frame[stage], free) for at in (state.feet, goal))
        rates = wrap_angle(joints - seen.angles) / h
        swing = Swing(swings, starts, goal)
        now = left(case, body_poses(free), command.target, joints, rates, command.shortfall, swing)
        on_floor = jnp.any(~swings & (stood.frame == WORLD))
        at = position + rotate(quat, mass_centre(case.robot, joints))
        roll, then = _rolled(case, plan, state, roll, free, at - free.position[0], on_floor, h)
        velocity = (position - seen.position) / h
        seen = seen._replace(position=position, quat=quat, velocity=velocity, angles=joints, free=then)
        stance = command.target._replace(feet=feet)
        return (state, seen, stood, roll), Played(stage, now, free, stance, ~swings, at)

    _, found = jax.lax.scan(tick, (state, seen, stood, Roll(jnp.zeros(2), centre)), None, length=ticks)
    return found


def _standing(case: Case, feet: Float[Array, "6 3"], free: FreeState) -> Stood:
    """Feet (m, world) as they would stand on what is nearest."""
    body = surface_at(case.obstacle, feet, body_poses(free)).body
    frame = jnp.array([WORLD, *map(body_frame, range(len(case.obstacle.free_bodies)))])[body + 1]
    return Stood(to_frame(feet, frame, free), frame)


def _rolled(
    case: Case, plan: Plan, state: TrackerState, roll: Roll, free: FreeState, centre: Array, on_floor: Array, h: Array
) -> tuple[Roll, FreeState]:
    """The ball `h` s later, with the robot's mass centre at `centre` (m) from its own.

    K = up x k, k = 7/5 M R v + m ((z + R)(v + u) - x u_z), where the mass centre moves by u over the ball and lies x
    ahead and z above; k changes by m (g x + u_z v).
    """
    programme, follows = plan.layer(ReferenceBodyMotion), jnp.asarray(True)
    if programme is not None:
        follows = jnp.asarray(programme.support.mode)[state.stage, 0] == MEASURED
    assert isinstance(case.obstacle, Ball)
    ball, mass = case.obstacle, total_mass(case.robot)
    u = (centre - roll.centre) / h
    v = free.velocity[0, :2]
    above = centre[2] + ball.radius
    inertia = ROLLING * ball.mass * ball.radius + mass * above
    own = mass * (above * u[:2] - u[2] * centre[:2])
    momentum = roll.momentum + h * mass * (GRAVITY * centre[:2] + u[2] * v)
    rolls = (momentum - own) / inertia
    meant = jnp.where(follows, 0.0, v)
    v = jnp.where(follows & ~on_floor, rolls, meant)
    velocity = jnp.append(v, 0.0)
    turn = jnp.cross(jnp.asarray(UP), velocity) / ball.radius
    moved = jnp.where(follows, h * velocity, 0.0)
    turned = jnp.where(follows, h * turn, 0.0)
    then = FreeState(free.position + moved, multiply(exponential(turned)[None], free.quat), velocity[None], turn[None])
    return Roll(inertia * v + own, centre), then


def zero_moment(found: Played, period: float) -> Float[Array, " t"]:
    """How far (m) the zero-moment point is inside the standing feet's polygon, at height of their mean.

    Of a mass centre that goes as commanded in the mean of `SMOOTH`: drives round off its jumps.
    """
    many = 2 * round(SMOOTH / period / 2) + 1
    padded = jnp.pad(found.centre, ((many // 2 + 1, many // 2 + 1), (0, 0)), mode="edge")
    mean = jax.vmap(lambda x: jnp.convolve(x, jnp.ones(many) / many, mode="valid"), 1, 1)(padded)
    push = (mean[2:] - 2 * mean[1:-1] + mean[:-2]) / period**2

    def inside(stance: Stance, stands: Array, centre: Array, push: Array) -> Array:
        height = centre[2] - jnp.sum(stance.feet[:, 2] * stands) / jnp.maximum(jnp.sum(stands), 1)
        return support_margin(stance.feet[:, :2], stands, centre[:2] - height * push[:2] / (GRAVITY + push[2]))

    return jax.vmap(inside)(found.stance, found.stands, mean[1:-1], push)


def by_stage(found: Played, stages: int) -> Margins:
    """The least of every stage (S,); infinite where none was played."""
    return jax.tree.map(lambda x: jax.ops.segment_min(x, found.stage, stages), found.margins)
