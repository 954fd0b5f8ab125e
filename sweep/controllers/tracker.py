"""The controller: follows a plan stage by stage, and turns feet and base into joint targets (monograph 1.3, 1.4)."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sweep.controllers.observation import Observation
from sweep.controllers.plan import Plan, Stance, reference
from sweep.formulas import leg
from sweep.maths import conjugate, exponential, rotate
from sweep.models.robot import Robot
from sweep.models.scene import mount_yaw, mounts


class TrackerState(NamedTuple):
    """What the controller remembers."""

    stage: Int[Array, ""]
    clock: Float[Array, ""]  # s since the stage began
    feet: Float[Array, "6 3"]  # m, commanded footholds when the stage began
    position: Float[Array, " 3"]  # m, planned base when the stage began
    error: Float[Array, " 3"]  # m, measured body error when the stage began
    joints: Float[Array, "6 3"]  # rad, last targets
    finished: Bool[Array, ""]


class Command(NamedTuple):
    """What the controller asks for at the end of a tick."""

    joints: Float[Array, "6 3"]  # rad
    target: Stance
    phase: Float[Array, ""]  # of the stage, 0 to 1
    shortfall: Float[Array, ""]  # m, by how much the worst foot target is out of reach


def joint_targets(robot: Robot, stance: Stance) -> tuple[Float[Array, "6 3"], Float[Array, " 6"]]:
    """Joint angles (rad) of the believed robot in a stance, and how far each foot is out of reach (m)."""
    to_base = jnp.broadcast_to(conjugate(stance.quat), (6, 4))
    foot = rotate(to_base, stance.feet - stance.position) - mounts(robot)
    yaw = np.zeros((6, 3))
    yaw[:, 2] = -mount_yaw(robot)
    foot = rotate(exponential(jnp.asarray(yaw, foot.dtype)), foot)
    return leg.ik(leg.SIDE, foot, robot.coxa, robot.thigh, robot.shin, robot.knees == "mirror")


def init(robot: Robot, plan: Plan) -> TrackerState:
    """At the plan's start, standing as it wants."""
    zero = jnp.zeros((), plan.duration.dtype)
    joints, _ = joint_targets(robot, plan.start)
    return TrackerState(jnp.int32(0), zero, plan.start.feet, plan.start.position, jnp.zeros(3, zero.dtype), joints,
                        jnp.asarray(False))  # fmt: skip


def step(
    robot: Robot, plan: Plan, state: TrackerState, seen: Observation, period: float
) -> tuple[TrackerState, Command]:
    """One control tick of `period` seconds."""
    state = _advance(plan, state._replace(clock=state.clock + period), seen, period)
    phase = jnp.clip(state.clock / plan.duration[state.stage], 0.0, 1.0)
    target = _target(plan, state, phase)
    joints, shortfall = joint_targets(robot, target)
    joints = state.joints + jnp.mod(joints - state.joints + jnp.pi, 2 * jnp.pi) - jnp.pi  # no jump by a full turn
    return state._replace(joints=joints), Command(joints, target, phase, jnp.max(shortfall))


def _target(plan: Plan, state: TrackerState, phase: Array) -> Stance:
    """The stage's reference; the body error that it began with fades out over the stage."""
    wanted = reference(plan, state.stage, phase, state.feet, state.position)
    return wanted._replace(position=wanted.position + (1 - phase) * state.error)


def _advance(plan: Plan, state: TrackerState, seen: Observation, period: float) -> TrackerState:
    """Go on to the next stage when time is up and every swinging foot has touched down, or patience has run out.

    The next stage starts from the commanded footholds, not the reached ones: that keeps the pressure on the ground.
    Feet and body are shifted together by the measured body error, which strains nothing, and the body's part of it
    then fades: without this, errors add up from stage to stage.
    """
    over = state.clock - plan.duration[state.stage]
    landed = jnp.all(seen.loaded | ~plan.swing[state.stage])
    ends = (over >= 0) & (landed | (over >= plan.patience)) & ~state.finished
    last = state.stage == plan.duration.shape[0] - 1
    planned = plan.position[state.stage]
    error = seen.position - planned
    shifted = state._replace(
        stage=jnp.where(last, state.stage, state.stage + 1),
        clock=jnp.where(last, state.clock, jnp.minimum(over, period)),
        feet=jnp.where(plan.swing[state.stage][:, None], plan.foothold[state.stage], state.feet) + error,
        position=planned,
        error=error,
        finished=last,
    )
    hold = last | ~ends
    kept = state._replace(finished=state.finished | (ends & last))
    return TrackerState(*[jnp.where(hold, a, b) for a, b in zip(kept, shifted, strict=True)])
