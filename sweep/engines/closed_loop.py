"""What both engines do once a control tick: observe, command, measure. Pure functions of one rollout."""

import dataclasses
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.controllers import tracker
from sweep.controllers.belief_update import LearnedState, initial_obstacle, update_from_touch, updated_belief
from sweep.controllers.frames import Stance
from sweep.controllers.layers import Command
from sweep.controllers.observation import Observation, Sensors, init_sensors, observe, with_contact_detection
from sweep.controllers.plan import Plan
from sweep.controllers.posture import feet_in_world, joint_targets
from sweep.controllers.tracker import TrackerState
from sweep.core.constants import LOADED
from sweep.core.rotations import conjugate, multiply, rotate, rotation_about_vertical
from sweep.metrics import accumulator
from sweep.metrics.accumulator import RunningMetrics
from sweep.metrics.metric import GRACE, REST, MetricTick, RolloutStart, Tick
from sweep.metrics.outcome import Thresholds
from sweep.models.case import Case, Driving
from sweep.models.disturbance import Execution
from sweep.models.drive import Servo, position_mode
from sweep.models.legs import JOINT_Q, JOINT_V, N_JOINTS, N_LEGS
from sweep.models.noise import Noise
from sweep.models.obstacles import surface
from sweep.models.obstacles.charts import point
from sweep.models.obstacles.surface import (
    BodyPoses,
    FreeState,
    Obstacle,
    Surface,
    body_poses,
    free_start_state,
    surface_at,
)

CHUNK = 1.0  # s of simulated time between two looks of the host, and from plan to plan of who plans again
CLEAR = 0.1  # m, by which a foot inside is lifted to tell what it stands on: more than errors of sizes put it there
FLAT = 1e-3  # cosine to the vertical, below which a face is a wall
LONGEST = 600.0  # s; a rollout that takes longer is cut off unfinished: absurd parameters must not hold up a batch


class ClosedLoop(NamedTuple):
    """Controller, sensors and figures of one rollout."""

    tracker: TrackerState
    sensors: Sensors | None  # where measurement is not exact
    running: RunningMetrics
    seen: Observation  # the truth at the end of the last tick
    servo: Servo  # what the drives were told last
    key: Array
    learned: LearnedState


class Start(NamedTuple):
    """MuJoCo's positions and velocities: base, legs, free bodies."""

    qpos: Float[Array, " nq"]
    qvel: Float[Array, " nv"]


Sensing = Literal["exact", "late", "noisy"]
DELAYS = {"delay": 0.0, "load_delay": 0.0, "body_delay": 0.0}


def sensing(noise: Noise) -> Sensing:
    """Classify what sensors need to be simulated: nothing, a delay, or random errors as well.

    Random numbers take a third of the compile time of a walk, so they are left out where all errors are zero. Fields of
    `noise` are numbers or arrays over a batch.
    """

    def is_zero(some: Noise) -> bool:
        return all(isinstance(x, float) and x == 0 for x in jax.tree.leaves(some))

    if noise.delay_buffer == 0 and is_zero(noise):
        return "exact"
    return "late" if is_zero(dataclasses.replace(noise, **DELAYS)) else "noisy"


def most_ticks(plans: Plan, period: float) -> int:
    """Control ticks of the longest rollout of a batch; a plan that is not finite has none, one too long is cut off."""
    durations = np.sum(np.asarray(plans.duration), axis=-1, dtype=float)
    longest = np.max(durations, initial=0.0, where=np.isfinite(durations))
    return int(np.ceil((min(GRACE * longest, LONGEST) + REST) / period))


def start_state(world: Case, belief: Case, plan: Plan, free: FreeState | None = None) -> Start:
    """The world at the start, free bodies where the obstacle has them if not `free` says otherwise.

    The robot stands with the joint angles that it believes right, displaced as `execution` says, and lowered along the
    ground's normal (or raised) until its lowest foot touches; on free bodies it goes down upright, and rides along
    with them.
    """
    free = free_start_state(world.obstacle) if free is None else free
    joints, _ = joint_targets(belief.robot, plan.start)
    start = apply_placement_error(world.execution, plan.start)
    feet = feet_in_world(world.robot, start.position, start.quat, joints)
    ground = _beneath(world.obstacle, feet, rotate(start.quat, jnp.array([0.0, 0.0, 1.0])), body_poses(free))
    along = jnp.array([0.0, 0.0, 1.0]) if world.obstacle.free_bodies else ground.normal[jnp.argmax(ground.depth)]
    slant = ground.normal @ along
    below = jnp.where(slant > FLAT, ground.depth / jnp.maximum(slant, FLAT), -jnp.inf)  # no wall stops a foot's descent
    position = start.position + jnp.max(below) * along
    velocity, moving = jnp.zeros_like(position), jnp.zeros_like(feet)
    for k in range(free.position.shape[0]):
        on_it = (ground.body == k)[:, None]
        velocity = velocity + jnp.mean(on_it, axis=0) * free.velocity[k]
        moving = moving + on_it * (free.velocity[k] + jnp.cross(free.turn[k], feet - free.position[k]))
    rates = jnp.zeros_like(joints)
    if world.obstacle.free_bodies:  # on fixed ground nothing moves, and a straight leg's angles have no derivative
        stance = start._replace(feet=feet)
        moved = stance._replace(feet=moving, position=velocity, quat=jnp.zeros_like(start.quat))
        _, rates = jax.jvp(lambda s: joint_targets(belief.robot, s)[0], (stance,), (moved,))
    qpos = [position, start.quat, joints.reshape(N_JOINTS), jnp.concatenate([free.position, free.quat], axis=1).ravel()]
    turn = rotate(conjugate(free.quat), free.turn)  # a free joint turns about the body's own axes
    qvel = [velocity, jnp.zeros(3), rates.reshape(N_JOINTS), jnp.concatenate([free.velocity, turn], axis=1).ravel()]
    return Start(jnp.concatenate(qpos), jnp.concatenate(qvel))


def _beneath(obstacle: Obstacle, feet: Float[Array, "6 3"], up: Float[Array, " 3"], bodies: BodyPoses) -> Surface:
    """The surface under feet that may be inside; within an edge they came from above, however near the wall is."""
    at, above = surface_at(obstacle, feet, bodies), surface_at(obstacle, feet + CLEAR * up, bodies)
    rise = above.normal @ up
    inside = (at.depth > 0) & (at.normal @ up < FLAT) & (rise > FLAT)
    return at._replace(
        depth=jnp.where(inside, above.depth + CLEAR * rise, at.depth),
        normal=jnp.where(inside[:, None], above.normal, at.normal),
    )


def apply_placement_error(execution: Execution, start: Stance) -> Stance:
    """The start with the errors of the robot's placement."""
    position = start.position + point(execution.start_x, execution.start_y, 0.0)
    turn = rotation_about_vertical(jnp.asarray(execution.start_yaw, float))
    feet = position + rotate(turn[None], start.feet - start.position)
    return Stance(feet, position, multiply(turn, start.quat))


def free_state(qpos: Array, qvel: Array, count: int) -> FreeState:
    """The last `count` bodies of a state of MuJoCo: the obstacle's free bodies."""
    pose = qpos[qpos.shape[0] - 7 * count :].reshape(count, 7)
    motion = qvel[qvel.shape[0] - 6 * count :].reshape(count, 6)
    return FreeState(pose[:, :3], pose[:, 3:], motion[:, :3], rotate(pose[:, 3:], motion[:, 3:]))


def truth(qpos: Array, qvel: Array, count: int, load: Float[Array, " 6"]) -> Observation:
    """What exact sensors see of a state of MuJoCo with `count` free bodies, its feet under a `load` (N)."""
    joints, rates = qpos[JOINT_Q].reshape(N_LEGS, 3), qvel[JOINT_V].reshape(N_LEGS, 3)
    base = qpos[:3], qpos[3:7], qvel[:3], qvel[3:6]
    return Observation(*base, joints, rates, jnp.zeros_like(joints), load > LOADED, free_state(qpos, qvel, count), load)


def init(
    world: Case,
    belief: Case,
    plan: Plan,
    start: Start,
    energy: Array,
    key: Array,
    learned: LearnedState,
    sensors_are: Sensing,
) -> ClosedLoop:
    """Before the first tick; `belief` holds what was learned already. `sensors_are`: see `sensing`."""
    seen = truth(start.qpos, start.qvel, len(world.obstacle.free_bodies), jnp.full(N_LEGS, jnp.inf))
    bias_key, key = jax.random.split(key)
    sensors = None
    if sensors_are != "exact":
        marked = seen._replace(free=surface.landmark_state(world.obstacle, seen.free))
        sensors = init_sensors(world.noise, bias_key, marked, has_errors=sensors_are == "noisy")
    feet = feet_in_world(world.robot, seen.position, seen.quat, seen.angles)
    running = accumulator.begin(RolloutStart(world, plan, seen.position, seen.quat, feet, seen.free, energy, learned))
    servo = position_mode(world.drive, seen.angles)
    return ClosedLoop(
        tracker.init(belief, plan, exact=sensors_are == "exact"), sensors, running, seen, servo, key, learned
    )


def act(
    world: Case, belief: Case, plan: Plan, loop: ClosedLoop, tick: Array, period: float
) -> tuple[ClosedLoop, Command]:
    """The controller's part of a tick; the drives then go linearly from the old reference to the new one.

    Free bodies are seen by their landmarks, and taken to be where those that are believed have these.
    """
    sensors, seen = loop.sensors, loop.seen._replace(free=surface.landmark_state(world.obstacle, loop.seen.free))
    if sensors is not None:
        sensors, seen = observe(world.noise, sensors, seen, jax.random.fold_in(loop.key, tick), tick)
    free = surface.state_from_landmarks(initial_obstacle(belief, loop.learned), seen.free)
    seen = with_contact_detection(world.control, belief.noise, seen._replace(free=free))
    state, followed, beside, learned = update_from_touch(world, belief, plan, loop.tracker, loop.learned, seen, period)
    exact = None if sensors is None else loop.seen
    state, command = tracker.step(updated_belief(belief, learned), followed, state, seen, period, beside, exact)
    servo = position_mode(world.drive, command.joints - seen.joint_error)
    if command.servo is not None:
        owned, own = command.servo
        own = own._replace(target=own.target - seen.joint_error)
        servo = Servo(*[jnp.where(owned, a, b) for a, b in zip(own, servo, strict=True)])
    return loop._replace(tracker=state, sensors=sensors, servo=servo, learned=learned), command


def measure(
    world: Case,
    plan: Plan,
    limits: Thresholds,
    loop: ClosedLoop,
    command: Command,
    tick: Tick,
    number: Array,
    period: float,
) -> tuple[ClosedLoop, Float[Array, " w"]]:
    """The metrics' part of a tick, and the figures that it is judged by so far, see `accumulator.update`.

    A rollout that has rested after its plan, or had its time, is over. One that is to end in motion is over with its
    plan: nobody steps on.
    """
    plan = loop.learned.plan or plan
    state, time = loop.tracker, loop.running.time + period
    now = MetricTick(
        world,
        plan,
        state.stage,
        command.phase,
        state.finished,
        state.position,
        command.target,
        command.reference or command.target,
        jnp.max(command.shortfall),
        tick,
        period,
        time,
        loop.learned,
    )
    running, judged = accumulator.update(loop.running, now, limits, number)
    late = running.time - running.rested >= GRACE * jnp.sum(plan.duration)
    rest = 0.0 if isinstance(world.manoeuvre, Driving) else REST
    rested = state.finished & (running.rested > rest - period / 2)
    running = running._replace(over=running.over | rested | late)
    return loop._replace(running=running, seen=tick.truth), judged


def figures_of(world: Case, plan: Plan, loop: ClosedLoop) -> dict[str, Array]:
    """The row's figures of a rollout as far as it has come, see `accumulator.compute`; it began with `plan`."""
    return accumulator.compute(world, loop.learned.plan or plan, loop.running, loop.tracker.stage)
