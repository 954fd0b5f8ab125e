"""The closed loop of one rollout, shared by both engines: in each control tick observe, control and update metrics.

All functions are pure and are written for one rollout; the engines batch them.
"""

import dataclasses
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.controllers import tracker
from sweep.controllers.layers import Command
from sweep.controllers.observation import Observation, SensorState, init_sensors, observe
from sweep.controllers.plan import Plan
from sweep.controllers.tracker import TrackerState
from sweep.core.constants import FOOT_LOAD_THRESHOLD_N
from sweep.core.rotations import conjugate, multiply, rotate, rotation_about_vertical
from sweep.estimation.belief_update import LearnedState, initial_obstacle, update_belief_from_touch, updated_belief
from sweep.metrics import accumulator
from sweep.metrics.accumulator import RunningMetrics
from sweep.metrics.outcome import OutcomeThresholds
from sweep.metrics.tick import MAX_DURATION_FACTOR, REST_DURATION_S, EngineTickReport, MetricContext, RolloutStart
from sweep.models.case import Case
from sweep.models.disturbance import ExecutionFaults
from sweep.models.drive import ServoCommand, position_command
from sweep.models.legs import JOINT_Q, JOINT_V, N_JOINTS, N_LEGS
from sweep.models.noise import Noise
from sweep.models.obstacles import surface
from sweep.models.obstacles.charts import stack_components
from sweep.models.obstacles.surface import (
    BodyPoses,
    FreeBodyState,
    Obstacle,
    Surface,
    body_poses,
    free_start_state,
    surface_at,
)
from sweep.models.posture import Stance, feet_in_world, joint_targets

CHUNK_DURATION_S = 1.0  # s of simulated time between two checks whether all rollouts are over, and between replans
LOOKUP_HEIGHT_M = (
    0.1  # m, height above a penetrating foot at which its ground is looked up; more than any error of sizes
)
# A foot surely carries load if the measured load exceeds the threshold by this many standard deviations of its error.
CONTACT_DEVIATIONS = 4.0
MIN_VERTICAL_COSINE = 1e-3  # cosine to the vertical, below which a face is a wall
MAX_DURATION_S = 600.0  # s; longer rollouts are cut off, so that absurd parameters do not hold up a batch


class ClosedLoop(NamedTuple):
    """State of controller, sensors and metrics of one rollout between two control ticks."""

    tracker: TrackerState
    sensors: SensorState | None  # None for exact measurements
    running: RunningMetrics
    actual: Observation  # exact observation at the end of the last tick
    servo: ServoCommand  # drive target of the last tick
    key: Array
    learned: LearnedState


class InitialState(NamedTuple):
    """State of MuJoCo at the start: positions and velocities of base, legs and free bodies."""

    qpos: Float[Array, " nq"]
    qvel: Float[Array, " nv"]


SensingMode = Literal["exact", "late", "noisy"]
ZERO_DELAYS = {"delay": 0.0, "load_delay": 0.0, "body_delay": 0.0}


def required_sensing_mode(noise: Noise) -> SensingMode:
    """Classify which sensor errors have to be simulated: none, only a delay, or random errors.

    Random numbers take a third of the compile time of a walk, so they are left out where all errors are zero. Fields of
    `noise` are numbers or arrays over a batch.
    """

    def is_zero(fields: Noise) -> bool:
        return all(isinstance(x, float) and x == 0 for x in jax.tree.leaves(fields))

    if noise.delay_buffer == 0 and is_zero(noise):
        return "exact"
    return "late" if is_zero(dataclasses.replace(noise, **ZERO_DELAYS)) else "noisy"


def max_tick_count(plans: Plan, period: float) -> int:
    """Return the number of control ticks that the longest rollout of a batch may take.

    Args:
        plans: plans of the batch, stage durations (rollouts, stages) in s. Infinite and NaN durations are ignored.
        period: length of a control tick (s).
    """
    durations = np.sum(np.asarray(plans.duration), axis=-1, dtype=float)
    longest = np.max(durations, initial=0.0, where=np.isfinite(durations))
    return int(np.ceil((min(MAX_DURATION_FACTOR * longest, MAX_DURATION_S) + REST_DURATION_S) / period))


def start_state(world: Case, belief: Case, plan: Plan, free: FreeBodyState | None = None) -> InitialState:
    """Return MuJoCo's state of robot and free bodies at the start of the manoeuvre.

    The robot stands with the joint angles that it believes to be right, displaced by the placement error of
    `world.execution`. It is then lowered or raised along the ground's normal until its lowest foot touches. On free
    bodies it moves vertically, and has their velocity.

    Args:
        world: simulated parameters.
        belief: parameters that the planner received.
        plan: plan of the manoeuvre; its start gives base pose and footholds.
        free: state of the obstacle's free bodies; by default their own start state.

    Returns:
        Positions and velocities in MuJoCo's layout; world axes, SI units.
    """
    free = free_start_state(world.obstacle) if free is None else free
    joints, _ = joint_targets(belief.robot, plan.start)
    start = apply_placement_error(world.execution, plan.start)
    feet = feet_in_world(world.robot, start.position, start.quat, joints)
    ground = _beneath(world.obstacle, feet, rotate(start.quat, jnp.array([0.0, 0.0, 1.0])), body_poses(free))
    along = jnp.array([0.0, 0.0, 1.0]) if world.obstacle.free_bodies else ground.normal[jnp.argmax(ground.depth)]
    slant = ground.normal @ along
    below = jnp.where(
        slant > MIN_VERTICAL_COSINE, ground.depth / jnp.maximum(slant, MIN_VERTICAL_COSINE), -jnp.inf
    )  # walls do not stop a descending foot
    position = start.position + jnp.max(below) * along
    velocity, moving = jnp.zeros_like(position), jnp.zeros_like(feet)
    for k in range(free.position.shape[0]):
        on_it = (ground.body == k)[:, None]
        velocity = velocity + jnp.mean(on_it, axis=0) * free.velocity[k]
        moving = moving + on_it * (free.velocity[k] + jnp.cross(free.turn[k], feet - free.position[k]))
    rates = jnp.zeros_like(joints)
    if world.obstacle.free_bodies:  # not on fixed ground: nothing moves, and a straight leg's angles have no derivative
        stance = start._replace(feet=feet)
        moved = stance._replace(feet=moving, position=velocity, quat=jnp.zeros_like(start.quat))
        _, rates = jax.jvp(lambda s: joint_targets(belief.robot, s)[0], (stance,), (moved,))
    qpos = [position, start.quat, joints.reshape(N_JOINTS), jnp.concatenate([free.position, free.quat], axis=1).ravel()]
    turn = rotate(conjugate(free.quat), free.turn)  # a free joint turns about the body's own axes
    qvel = [velocity, jnp.zeros(3), rates.reshape(N_JOINTS), jnp.concatenate([free.velocity, turn], axis=1).ravel()]
    return InitialState(jnp.concatenate(qpos), jnp.concatenate(qvel))


def _beneath(obstacle: Obstacle, feet: Float[Array, "6 3"], up: Float[Array, " 3"], bodies: BodyPoses) -> Surface:
    """Surface under each foot. A foot inside a solid is treated as if it came from above, also near a vertical wall."""
    at, above = surface_at(obstacle, feet, bodies), surface_at(obstacle, feet + LOOKUP_HEIGHT_M * up, bodies)
    rise = above.normal @ up
    inside = (at.depth > 0) & (at.normal @ up < MIN_VERTICAL_COSINE) & (rise > MIN_VERTICAL_COSINE)
    return at._replace(
        depth=jnp.where(inside, above.depth + LOOKUP_HEIGHT_M * rise, at.depth),
        normal=jnp.where(inside[:, None], above.normal, at.normal),
    )


def apply_placement_error(execution: ExecutionFaults, start: Stance) -> Stance:
    """Displace the start pose by the scenario's placement error (m, and rad about the vertical)."""
    position = start.position + stack_components(execution.start_x, execution.start_y, 0.0)
    turn = rotation_about_vertical(jnp.asarray(execution.start_yaw, float))
    feet = position + rotate(turn[None], start.feet - start.position)
    return Stance(feet, position, multiply(turn, start.quat))


def free_body_state(qpos: Array, qvel: Array, count: int) -> FreeBodyState:
    """Extract the states of the obstacle's free bodies from MuJoCo's `qpos` and `qvel`.

    Args:
        qpos: positions (nq,); the last 7 `count` numbers are those of the free bodies.
        qvel: velocities (nv,); the last 6 `count` numbers are those of the free bodies.
        count: number of free bodies.

    Returns:
        Position, orientation, velocity and angular velocity of each body, world axes.
    """
    pose = qpos[qpos.shape[0] - 7 * count :].reshape(count, 7)
    motion = qvel[qvel.shape[0] - 6 * count :].reshape(count, 6)
    return FreeBodyState(pose[:, :3], pose[:, 3:], motion[:, :3], rotate(pose[:, 3:], motion[:, 3:]))


def exact_observation(qpos: Array, qvel: Array, count: int, load: Float[Array, " 6"]) -> Observation:
    """Make the observation that sensors without error and delay would give in a MuJoCo state.

    Args:
        qpos: positions (nq,) in MuJoCo's layout: base, legs, free bodies.
        qvel: velocities (nv,) likewise.
        count: number of the obstacle's free bodies.
        load: normal force on each foot (N).
    """
    joints, rates = qpos[JOINT_Q].reshape(N_LEGS, 3), qvel[JOINT_V].reshape(N_LEGS, 3)
    base = qpos[:3], qpos[3:7], qvel[:3], qvel[3:6]
    return Observation(
        *base,
        joints,
        rates,
        jnp.zeros_like(joints),
        load > FOOT_LOAD_THRESHOLD_N,
        free_body_state(qpos, qvel, count),
        load,
    )


def init_loop(
    world: Case,
    belief: Case,
    plan: Plan,
    start: InitialState,
    energy: Array,
    key: Array,
    learned: LearnedState,
    sensing: SensingMode,
) -> ClosedLoop:
    """Return the state of controller, sensors and metrics before the first control tick.

    Args:
        world: simulated parameters.
        belief: parameters that the planner received, with estimates made before the start.
        plan: plan of the manoeuvre.
        start: state of MuJoCo at the start.
        energy: mechanical energy at the start (J).
        key: random key of the rollout's noise.
        learned: estimates made before the start.
        sensing: which sensor errors are simulated, see `required_sensing_mode`.
    """
    obs = exact_observation(start.qpos, start.qvel, len(world.obstacle.free_bodies), jnp.full(N_LEGS, jnp.inf))
    bias_key, key = jax.random.split(key)
    sensors = None
    if sensing != "exact":
        marked = obs._replace(free=surface.landmark_state(world.obstacle, obs.free))
        sensors = init_sensors(world.noise, bias_key, marked, has_errors=sensing == "noisy")
    feet = feet_in_world(world.robot, obs.position, obs.quat, obs.angles)
    running = accumulator.begin(RolloutStart(world, plan, obs.position, obs.quat, feet, obs.free, energy, learned))
    servo = position_command(world.drive, obs.angles)
    return ClosedLoop(tracker.init(belief, plan, exact=sensing == "exact"), sensors, running, obs, servo, key, learned)


def run_controller(
    world: Case, belief: Case, first_plan: Plan, loop: ClosedLoop, tick: Array, period: float
) -> tuple[ClosedLoop, Command]:
    """Run the controller for one control tick: observe, update estimates, and compute the joint command.

    The drives then go linearly from the last target to the new one. The controller sees free bodies by their landmarks,
    and computes their poses from the shape that it believes in. A foot may carry load if the measured load exceeds the
    threshold, and surely does if it exceeds it by `CONTACT_DEVIATIONS` standard deviations of the believed load error.

    Args:
        world: simulated parameters.
        belief: parameters that the planner received.
        first_plan: plan from before the start.
        loop: state of the closed loop.
        tick: number of the control tick.
        period: length of a control tick (s).

    Returns:
        The state of the closed loop with the new drive target, and the command.
    """
    sensors, obs, state, learned = loop.sensors, loop.actual, loop.tracker, loop.learned
    has_bodies = bool(world.obstacle.free_bodies)
    if has_bodies:
        obs = obs._replace(free=surface.landmark_state(world.obstacle, obs.free))
    if sensors is not None:
        sensors, obs = observe(world.noise, sensors, obs, jax.random.fold_in(loop.key, tick), tick)
    if has_bodies:
        obs = obs._replace(free=surface.state_from_landmarks(initial_obstacle(belief, learned), obs.free))
    noise, threshold = belief.noise, world.control.load_threshold
    doubt = CONTACT_DEVIATIONS * jnp.sqrt(jnp.square(noise.load_noise) + jnp.square(noise.load_bias))
    obs = obs._replace(maybe_loaded=obs.load > threshold, loaded=obs.load > threshold + doubt)
    plan, foothold_offset = learned.plan or first_plan, None
    if learned.touch is not None:
        state, plan, foothold_offset, learned = update_belief_from_touch(
            world, belief, first_plan, state, learned, obs, period
        )
    if learned.touch is not None or learned.calibration is not None:
        belief = updated_belief(belief, learned)
    truth = None if sensors is None else loop.actual
    state, command = tracker.step(belief, plan, state, obs, period, foothold_offset, truth)
    servo = position_command(world.drive, command.joints - obs.joint_error)
    if command.servo is not None:
        has_law, law = command.servo
        law = law._replace(target=law.target - obs.joint_error)
        servo = ServoCommand(*[jnp.where(has_law, a, b) for a, b in zip(law, servo, strict=True)])
    return loop._replace(tracker=state, sensors=sensors, servo=servo, learned=learned), command


def update_metrics(
    world: Case,
    plan: Plan,
    limits: OutcomeThresholds,
    loop: ClosedLoop,
    command: Command,
    tick: EngineTickReport,
    number: Array,
    period: float,
) -> tuple[ClosedLoop, Float[Array, " w"]]:
    """Update the metrics with one control tick, and end the rollout if it is over.

    A rollout is over once it has rested after its plan, or its time is up. A driving manoeuvre, which ends in motion,
    is over with its plan.

    Args:
        world: simulated parameters.
        plan: plan from before the start.
        thresholds: values of metrics at which causes apply.
        loop: state of the closed loop after `run_controller`.
        command: command of this tick.
        tick: summary of the tick's physics steps.
        number: number of the control tick.
        period: length of a control tick (s).

    Returns:
        The state of the closed loop, and the present values of the metrics that have thresholds (w,), see
        `accumulator.update`.
    """
    plan = loop.learned.plan or plan
    state, time = loop.tracker, loop.running.time + period
    now = MetricContext(
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
    late = running.time - running.time_since_plan_end >= MAX_DURATION_FACTOR * jnp.sum(plan.duration)
    rest = 0.0 if world.manoeuvre.drives_body else REST_DURATION_S
    rested = state.finished & (running.time_since_plan_end > rest - period / 2)
    running = running._replace(is_over=running.is_over | rested | late)
    return loop._replace(running=running, actual=tick.actual), judged


def compute_metrics(world: Case, plan: Plan, loop: ClosedLoop) -> dict[str, Array]:
    """Compute the metrics of a rollout from the metric states accumulated so far.

    Args:
        world: simulated parameters.
        plan: plan from before the start.
        loop: state of the closed loop.
    """
    return accumulator.compute_metrics(world, loop.learned.plan or plan, loop.running, loop.tracker.stage)
