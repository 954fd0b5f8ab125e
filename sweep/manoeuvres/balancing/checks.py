"""Checks that correct a path from ball to ball (monograph 3.5.3): footholds farther or nearer, base farther or lower.

All checks look at the ends of stages with the balls at rest, in world axes. A path that passes is left unchanged to the
bit.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sweep.controllers.ball_state import centre_of_mass
from sweep.controllers.plan import Stage, stage_end_stances
from sweep.core.rotations import rotate
from sweep.formulas.leg import SIDE_BY_LEG
from sweep.models.case import Case
from sweep.models.frames import body_frame_number, koenig_frame_number
from sweep.models.legs import LEGS
from sweep.models.obstacles.two_balls import TwoBalls
from sweep.models.posture import Stance, feet_in_hip_axes, leg_mounts
from sweep.models.robot import Robot
from sweep.planning.compile_plan import compile_plan

OVERSHOOT = 5e-4  # m, by which corrections go beyond their limit
ROUNDS = 4  # of corrections; the mass centre follows 0.8 or more of a base's motion, and a little of a foot's


class ReachAndSupportLimits(NamedTuple):
    """Limits on reach and support that the plan stages from one ball to another must keep."""

    spare: Array | float  # m, least distance of the mass centre from the ends of the support
    straight: Array | float  # longest leg over thigh and shin: the book's modified length of a leg
    above: Array | float  # m, least clearance of the base over the balls


class FootStatesByStage(NamedTuple):
    """Feet over S stages: whether each swings, the stage since which it stands, and the centre of the ball under it."""

    swing: Bool[np.ndarray, "s 6"]
    since: Int[np.ndarray, "s 6"]
    centre: Float[Array, "s 6 3"]  # m


def enforce_reach_and_support(
    belief: Case, start: Stance, stages: Sequence[Stage], limits: ReachAndSupportLimits
) -> list[Stage]:
    """Correct plan stages by the rules of monograph 3.5.3 so that they keep limits of reach and support where possible.

    Check 3: a foot that limits where the mass centre may be is set farther along the ball. Check 5: a base that moves
    on standing feet goes on until the mass centre is between the feet of the next support. Check 2: the base is
    lowered, by L3859 for standing legs, too; a foot that is still out of reach is set nearer, in its vertical plane
    along x.

    Args:
        belief: believed parameters, with balls that touch.
        start: stance before the first stage, world axes.
        stages: the stages in order.
        limits: limits to keep.
    """
    robot, free = belief.robot, belief.obstacle_of_type(TwoBalls).start()
    plan = compile_plan(start, stages, 0.0)
    swing = np.array([[leg in stage.swing for leg in LEGS] for stage in stages])
    since = np.maximum.accumulate(np.where(swing, np.arange(len(stages))[:, None], -1))
    second = np.isin([stage.foot_frames for stage in stages], (koenig_frame_number(1), body_frame_number(1)))
    steps = FootStatesByStage(swing, since, jnp.where(second[..., None], free.position[1], free.position[0]))
    planned = stances = stage_end_stances(plan, free)
    for _ in range(ROUNDS):
        stances = _set_feet_farther(robot, stances, steps, limits)
        stances = _move_base_on(robot, stances, start, steps, limits)
        stances = _set_feet_nearer(robot, _lower_base(belief, stances, limits), steps, limits)
    base, feet = stances.position - planned.position, stances.feet - planned.feet
    return [
        replace(stage, position=plan.position[k] + base[k],
                swing={leg: place + feet[k, leg - 1] for leg, place in stage.swing.items()})
        for k, stage in enumerate(stages)
    ]  # fmt: skip


def mass_centre_margins(
    robot: Robot, stances: Stance, is_stance: Bool[Array, "s 6"] | np.ndarray
) -> Float[Array, "2 s"]:
    """Return how far (m) along x the mass centre is behind the foremost standing foot, and ahead of the rearmost one.

    Args:
        robot: the robot, as believed.
        stances: S stances, world axes.
        is_stance: which feet stand.
    """
    centre = jax.vmap(lambda stance: centre_of_mass(robot, stance)[0])(stances)
    ahead = stances.feet[..., 0]
    return jnp.stack([jnp.max(jnp.where(is_stance, ahead, -jnp.inf), axis=1) - centre,
                      centre - jnp.min(jnp.where(is_stance, ahead, jnp.inf), axis=1)])  # fmt: skip


def support_at_stage_end(swing: Bool[Array, "s 6"] | np.ndarray) -> Bool[Array, "s 6"]:
    """Return which feet (s, 6) support the robot as each stage ends.

    These are the feet that stand in it or, if no foot swings in it, those that stand in the next stage.

    Args:
        swing: which feet swing in each of S stages.
    """
    swings, following = jnp.any(swing, axis=1)[:, None], jnp.concatenate([swing[1:], jnp.zeros((1, 6), bool)])
    return jnp.where(swings, ~swing, ~following)


def _set_feet_farther(robot: Robot, stances: Stance, steps: FootStatesByStage, limits: ReachAndSupportLimits) -> Stance:
    """Check 3: where the support margin of a swing is too small, move the outermost standing feet farther out."""
    stands, ahead = ~steps.swing, stances.feet[..., 0]
    lacks = jnp.where(steps.swing.any(axis=1), limits.spare - mass_centre_margins(robot, stances, stands), 0.0)
    lacks = jnp.where(lacks > 0, lacks + OVERSHOOT, 0.0)[..., None]
    foremost = ahead >= jnp.max(jnp.where(stands, ahead, -jnp.inf), axis=1, keepdims=True) - OVERSHOOT
    rearmost = ahead <= jnp.min(jnp.where(stands, ahead, jnp.inf), axis=1, keepdims=True) + OVERSHOOT
    forward, back = jnp.where(stands & foremost, lacks[0], 0.0), jnp.where(stands & rearmost, lacks[1], 0.0)
    shift = jnp.zeros_like(ahead)
    for k in range(len(steps.swing)):  # largest shift over all stages in which the foot stands there
        stands_here = (steps.since == k) & (k >= 0)
        most = jnp.max(jnp.where(stands_here, forward, 0.0), axis=0) - jnp.max(
            jnp.where(stands_here, back, 0.0), axis=0
        )
        shift = jnp.where(stands_here, most, shift)
    x, y, z = (
        (stances.feet - steps.centre)[..., 0],
        (stances.feet - steps.centre)[..., 1],
        (stances.feet - steps.centre)[..., 2],
    )
    up = jnp.sqrt(jnp.maximum(x**2 + z**2 - (x + shift) ** 2, 0.0))
    moved = steps.centre + jnp.stack([x + shift, y, up], axis=-1)
    return stances._replace(feet=jnp.where((shift != 0)[..., None], moved, stances.feet))


def _move_base_on(
    robot: Robot, stances: Stance, start: Stance, steps: FootStatesByStage, limits: ReachAndSupportLimits
) -> Stance:
    """Check 5: where the margin is too small, move the base further along its motion."""
    moves = ~steps.swing.any(axis=1)
    front, rear = limits.spare - mass_centre_margins(robot, stances, support_at_stage_end(steps.swing))
    step = stances.position[:, 0] - jnp.concatenate([start.position[None], stances.position[:-1]])[:, 0]
    forward, back = moves & (step > 0) & (rear > 0), moves & (step < 0) & (front > 0)
    shift = jnp.where(forward, rear + OVERSHOOT, 0.0) - jnp.where(back, front + OVERSHOOT, 0.0)
    moved = stances.position + shift[:, None] * jnp.array([1.0, 0.0, 0.0])
    return stances._replace(position=jnp.where((forward | back)[:, None], moved, stances.position))


def _lower_base(belief: Case, stances: Stance, limits: ReachAndSupportLimits) -> Stance:
    """Check 2: lower the base where a leg would be too long, while it stays above the balls."""
    robot, balls = belief.robot, belief.obstacle_of_type(TwoBalls)
    level, down = _leg_extents(robot, stances)
    most = limits.straight * (robot.thigh + robot.shin)
    shift = jnp.max(down - jnp.sqrt(jnp.maximum(most**2 - level**2, 0.0)), axis=1)
    outside = jnp.abs(stances.position[:, 0, None] - balls.start().position[:, 0]) - robot.body_length / 2
    top = balls.radius + jnp.sqrt(jnp.maximum(balls.radius**2 - jnp.maximum(outside, 0.0) ** 2, 0.0))
    room = stances.position[:, 2] - robot.body_height / 2 - limits.above - jnp.max(top, axis=1)
    shift = jnp.minimum(shift, room)
    lowered = stances.position - shift[:, None] * jnp.array([0.0, 0.0, 1.0])
    return stances._replace(position=jnp.where((shift > 0)[:, None], lowered, stances.position))


def _set_feet_nearer(robot: Robot, stances: Stance, steps: FootStatesByStage, limits: ReachAndSupportLimits) -> Stance:
    """Check 2: move a foot that is still too far to where its leg reaches the ball, in the vertical plane along x."""
    hips = stances.position[:, None] + rotate(stances.quat[:, None], leg_mounts(robot).hips)
    feet, to_hip = stances.feet - steps.centre, hips - steps.centre
    level, down = _leg_extents(robot, stances)
    most = limits.straight * (robot.thigh + robot.shin)
    far = steps.swing & (jnp.hypot(level, down) > most)
    outer = jnp.abs(feet[..., 1] - to_hip[..., 1])
    # squared radii of circles in that plane: of the ball about its centre, of the leg about its hip
    ball2, leg2 = feet[..., 0] ** 2 + feet[..., 2] ** 2, most**2 - outer**2
    x, z = to_hip[..., 0], to_hip[..., 2]
    apart2 = x**2 + z**2
    share = (apart2 + ball2 - leg2) / (2 * apart2)
    height2 = ball2 / apart2 - share**2
    height = jnp.sqrt(jnp.maximum(height2, 0.0))
    both = [jnp.stack([share * x - side * height * z, feet[..., 1], share * z + side * height * x], axis=-1)
            for side in (-1.0, 1.0)]  # fmt: skip
    one, other = (jnp.sum((point - feet) ** 2, axis=-1) for point in both)
    nearest = steps.centre + jnp.where((one < other)[..., None], *both)
    moved = jnp.where((far & (height2 > 0))[..., None], nearest, stances.feet)
    legs = np.arange(len(LEGS))
    feet_at_stages = jnp.where((steps.since >= 0)[..., None], moved[np.maximum(steps.since, 0), legs], stances.feet)
    return stances._replace(feet=feet_at_stages)


def _leg_extents(robot: Robot, stances: Stance) -> tuple[Float[Array, "s 6"], Float[Array, "s 6"]]:
    """Distances (m) of feet beside and below the joints from which the thighs hang."""
    feet = jax.vmap(lambda stance: feet_in_hip_axes(robot, stance))(stances)
    outer = jnp.where(SIDE_BY_LEG * feet[..., 1] >= 0, 1.0, -1.0)
    return jnp.abs(outer * jnp.hypot(feet[..., 0], feet[..., 1]) - robot.coxa), -feet[..., 2]
