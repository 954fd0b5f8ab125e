"""Checks of a way from ball to ball that act (monograph 3.5.3): feet farther or nearer, a base that goes on or squats.

All is told at the ends of stages with the balls at rest, in world axes. What passes is left as it is, to the bit.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sweep.controllers.assembly import assemble
from sweep.controllers.ball_state import centre_of_mass
from sweep.controllers.frames import Stance
from sweep.controllers.plan import Stage, ends
from sweep.controllers.posture import in_hips
from sweep.core.rotations import rotate
from sweep.formulas.leg import SIDE
from sweep.models.case import Case
from sweep.models.frames import fixed, koenig
from sweep.models.legs import LEGS
from sweep.models.obstacles.two_balls import TwoBalls
from sweep.models.robot import Robot, mounts

BEYOND = 5e-4  # m, more than asked, by which what acts ends inside
ROUNDS = 4  # the mass centre follows with 0.8 or more of a base's way, and a little of a foot's and of a squat


class Asked(NamedTuple):
    """Limits that the checks keep to."""

    spare: Array | float  # m, of the mass centre between the feet that stand
    straight: Array | float  # share of thigh and shin: the book's modified length of a leg
    above: Array | float  # m, of the base over the balls


class Steps(NamedTuple):
    """S stages: which legs swing, since when feet are where they are (-1: the start), and their balls' centres."""

    swing: Bool[np.ndarray, "s 6"]
    since: Int[np.ndarray, "s 6"]
    centre: Float[Array, "s 6 3"]  # m


def checked(belief: Case, start: Stance, stages: Sequence[Stage], limits: Asked) -> list[Stage]:
    """Stages from `start` (world axes) on that keep the limits wherever the book's remedies can have them do so.

    3: a foot that bounds where the mass centre may be is set farther, along the ball. 5: a base that moves on standing
    feet goes on until the mass centre is between those that stand next. 2: the base is lowered, by L3859 for standing
    legs, too; what then is still out of reach is set nearer, in its vertical plane along x.
    """
    robot, free = belief.robot, belief.on(TwoBalls).start()
    plan = assemble(start, stages, 0.0)
    swing = np.array([[leg in stage.swing for leg in LEGS] for stage in stages])
    since = np.maximum.accumulate(np.where(swing, np.arange(len(stages))[:, None], -1))
    second = np.isin([stage.foot_frames for stage in stages], (koenig(1), fixed(1)))
    steps = Steps(swing, since, jnp.where(second[..., None], free.position[1], free.position[0]))
    planned = now = ends(plan, free)
    for _ in range(ROUNDS):
        now = _farther(robot, now, steps, limits)
        now = _on(robot, now, start, steps, limits)
        now = _nearer(robot, _lower(belief, now, limits), steps, limits)
    base, feet = now.position - planned.position, now.feet - planned.feet
    return [
        replace(stage, position=plan.position[k] + base[k],
                swing={leg: at + feet[k, leg - 1] for leg, at in stage.swing.items()})
        for k, stage in enumerate(stages)
    ]  # fmt: skip


def between(robot: Robot, stances: Stance, stands: Bool[Array, "s 6"] | np.ndarray) -> Float[Array, "2 s"]:
    """How far (m) along x the mass centre is behind the foremost of the feet that stand, and ahead of the rearmost."""
    centre = jax.vmap(lambda stance: centre_of_mass(robot, stance)[0])(stances)
    ahead = stances.feet[..., 0]
    return jnp.stack([jnp.max(jnp.where(stands, ahead, -jnp.inf), axis=1) - centre,
                      centre - jnp.min(jnp.where(stands, ahead, jnp.inf), axis=1)])  # fmt: skip


def stands_next(swing: Bool[Array, "s 6"] | np.ndarray) -> Bool[Array, "s 6"]:
    """Feet between which the mass centre is to be as a stage ends: those that stand, in this one and in the next."""
    swings, following = jnp.any(swing, axis=1)[:, None], jnp.concatenate([swing[1:], jnp.zeros((1, 6), bool)])
    return jnp.where(swings, ~swing, ~following)


def _farther(robot: Robot, now: Stance, steps: Steps, limits: Asked) -> Stance:
    """Check 3: where feet swing, those that stand at the end on which the mass centre has no room are set farther."""
    stands, ahead = ~steps.swing, now.feet[..., 0]
    lacks = jnp.where(steps.swing.any(axis=1), limits.spare - between(robot, now, stands), 0.0)
    lacks = jnp.where(lacks > 0, lacks + BEYOND, 0.0)[..., None]
    foremost = ahead >= jnp.max(jnp.where(stands, ahead, -jnp.inf), axis=1, keepdims=True) - BEYOND
    rearmost = ahead <= jnp.min(jnp.where(stands, ahead, jnp.inf), axis=1, keepdims=True) + BEYOND
    forth, back = jnp.where(stands & foremost, lacks[0], 0.0), jnp.where(stands & rearmost, lacks[1], 0.0)
    way = jnp.zeros_like(ahead)
    for k in range(len(steps.swing)):  # what a foot is to do for all the stages in which it stands there
        here = (steps.since == k) & (k >= 0)
        most = jnp.max(jnp.where(here, forth, 0.0), axis=0) - jnp.max(jnp.where(here, back, 0.0), axis=0)
        way = jnp.where(here, most, way)
    x, y, z = (now.feet - steps.centre)[..., 0], (now.feet - steps.centre)[..., 1], (now.feet - steps.centre)[..., 2]
    up = jnp.sqrt(jnp.maximum(x**2 + z**2 - (x + way) ** 2, 0.0))
    moved = steps.centre + jnp.stack([x + way, y, up], axis=-1)
    return now._replace(feet=jnp.where((way != 0)[..., None], moved, now.feet))


def _on(robot: Robot, now: Stance, start: Stance, steps: Steps, limits: Asked) -> Stance:
    """Check 5: a base that moves on standing feet goes on, the way that it goes, until it may end."""
    moves = ~steps.swing.any(axis=1)
    front, rear = limits.spare - between(robot, now, stands_next(steps.swing))
    way = now.position[:, 0] - jnp.concatenate([start.position[None], now.position[:-1]])[:, 0]
    forth, back = moves & (way > 0) & (rear > 0), moves & (way < 0) & (front > 0)
    by = jnp.where(forth, rear + BEYOND, 0.0) - jnp.where(back, front + BEYOND, 0.0)
    gone = now.position + by[:, None] * jnp.array([1.0, 0.0, 0.0])
    return now._replace(position=jnp.where((forth | back)[:, None], gone, now.position))


def _lower(belief: Case, now: Stance, limits: Asked) -> Stance:
    """Check 2: the base lower where a leg would be too long, if it stays over the balls."""
    robot, balls = belief.robot, belief.on(TwoBalls)
    level, down = _hanging(robot, now)
    most = limits.straight * (robot.thigh + robot.shin)
    by = jnp.max(down - jnp.sqrt(jnp.maximum(most**2 - level**2, 0.0)), axis=1)
    off = jnp.abs(now.position[:, 0, None] - balls.start().position[:, 0]) - robot.body_length / 2
    top = balls.radius + jnp.sqrt(jnp.maximum(balls.radius**2 - jnp.maximum(off, 0.0) ** 2, 0.0))
    room = now.position[:, 2] - robot.body_height / 2 - limits.above - jnp.max(top, axis=1)
    by = jnp.minimum(by, room)
    lowered = now.position - by[:, None] * jnp.array([0.0, 0.0, 1.0])
    return now._replace(position=jnp.where((by > 0)[:, None], lowered, now.position))


def _nearer(robot: Robot, now: Stance, steps: Steps, limits: Asked) -> Stance:
    """Check 2: a foot still too far on the sphere that its leg can reach, its ball and the vertical plane along x."""
    hips = now.position[:, None] + rotate(now.quat[:, None], mounts(robot))
    feet, to_hip = now.feet - steps.centre, hips - steps.centre
    level, down = _hanging(robot, now)
    most = limits.straight * (robot.thigh + robot.shin)
    far = steps.swing & (jnp.hypot(level, down) > most)
    outer = jnp.abs(feet[..., 1] - to_hip[..., 1])
    # circles in that plane: of the ball about its centre, of the leg about its hip
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
    chosen = jnp.where((far & (height2 > 0))[..., None], nearest, now.feet)
    legs = np.arange(len(LEGS))
    kept = jnp.where((steps.since >= 0)[..., None], chosen[np.maximum(steps.since, 0), legs], now.feet)
    return now._replace(feet=kept)


def _hanging(robot: Robot, now: Stance) -> tuple[Float[Array, "s 6"], Float[Array, "s 6"]]:
    """How far (m) feet are beside the joints from which thighs hang, and below."""
    feet = jax.vmap(lambda stance: in_hips(robot, stance))(now)
    outer = jnp.where(SIDE * feet[..., 1] >= 0, 1.0, -1.0)
    return jnp.abs(outer * jnp.hypot(feet[..., 0], feet[..., 1]) - robot.coxa), -feet[..., 2]
