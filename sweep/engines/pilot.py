"""What both engines do once a control tick: observe, command, measure. Pure functions of one rollout."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.case import Case
from sweep.controllers import tracker
from sweep.controllers.observation import Noise, Observation, Sensors, install, observe
from sweep.controllers.plan import Plan
from sweep.controllers.posture import foot_positions
from sweep.controllers.tracker import Command, TrackerState, joint_targets
from sweep.maths import rotate
from sweep.metrics import stream
from sweep.metrics.outcome import Thresholds
from sweep.metrics.stream import Running, Tick
from sweep.models.drive import Servo, position_mode
from sweep.models.obstacles.surface import Bodies

GRACE = 1.2  # a rollout is over at this multiple of its planned duration, finished or not
LONGEST = 3600.0  # s; a rollout that takes longer is not finished: absurd parameters must not hold up a batch


class Pilot(NamedTuple):
    """Controller, sensors and figures of one rollout."""

    tracker: TrackerState
    sensors: Sensors
    running: Running
    seen: Observation  # the truth at the end of the last tick
    servo: Servo  # what the drives were told last
    key: Array


def is_quiet(noise: Noise) -> bool:
    """Whether measurement is exact, so that no random number need be drawn. Plain or batched parameters."""
    return noise.delay_buffer == 0 and all(isinstance(x, float) and x == 0 for x in jax.tree.leaves(noise))


def most_ticks(plans: Plan, period: float) -> int:
    """Control ticks of the longest rollout of a batch; a plan that is not finite has none, one too long is cut off."""
    durations = np.asarray(jnp.sum(plans.duration, axis=-1), dtype=float)
    longest = np.max(durations, initial=0.0, where=np.isfinite(durations))
    return int(np.ceil(min(GRACE * longest, LONGEST) / period))


def start_pose(world: Case, belief: Case, plan: Plan) -> tuple[Float[Array, " 7"], Float[Array, "6 3"]]:
    """Base pose and joint angles at the start.

    The robot stands with the joint angles that it believes right, lowered along the ground's normal (or raised) until
    its lowest foot touches.
    """
    joints, _ = joint_targets(belief.robot, plan.start)
    feet = plan.start.position + rotate(plan.start.quat[None], foot_positions(world.robot, joints))
    nowhere = Bodies(jnp.zeros((0, 3)), jnp.zeros((0, 3, 3)))
    ground = world.obstacle.surface(feet, (-1,) * 6, nowhere)
    lowest = jnp.argmax(ground.depth)
    position = plan.start.position + ground.depth[lowest] * ground.normal[lowest]
    return jnp.concatenate([position, plan.start.quat]), joints


def embark(world: Case, belief: Case, plan: Plan, pose: Array, joints: Array, energy: Array, key: Array) -> Pilot:
    """Before the first tick, standing still at `pose`."""
    still, nothing = jnp.zeros(3, pose.dtype), jnp.zeros((6, 3), pose.dtype)
    truth = Observation(pose[:3], pose[3:7], still, still, joints, nothing, nothing, jnp.ones(6, bool))
    bias_key, key = jax.random.split(key)
    sensors = install(world.noise, bias_key, truth)
    running = stream.begin(plan, pose[:3], energy)
    return Pilot(tracker.init(belief.robot, plan), sensors, running, truth, position_mode(world.drive, joints), key)


def decide(
    world: Case, belief: Case, plan: Plan, pilot: Pilot, tick: Array, period: float, quiet: bool
) -> tuple[Pilot, Command]:
    """The controller's part of a tick; the drives then go linearly from the old reference to the new one."""
    sensors, seen = pilot.sensors, pilot.seen
    if not quiet:
        sensors, seen = observe(world.noise, sensors, seen, jax.random.fold_in(pilot.key, tick))
    state, command = tracker.step(belief.robot, plan, pilot.tracker, seen, period)
    servo = position_mode(world.drive, command.joints - seen.joint_error)
    if command.own is not None:
        owned, own = command.own
        own = own._replace(target=own.target - seen.joint_error)
        servo = Servo(*[jnp.where(owned, a, b) for a, b in zip(own, servo, strict=True)])
    return pilot._replace(tracker=state, sensors=sensors, servo=servo), command


def measure(
    world: Case, plan: Plan, limits: Thresholds, pilot: Pilot, command: Command, tick: Tick, period: float
) -> Pilot:
    """The metrics' part of a tick. A rollout that has finished, or had its time, is over."""
    running = stream.update(world, plan, limits, pilot.tracker, command, pilot.running, tick, period)
    late = running.time >= GRACE * jnp.sum(plan.duration)
    running = running._replace(over=running.over | pilot.tracker.finished | late)
    truth = Observation(tick.position, tick.quat, tick.velocity, tick.spin, tick.angles, tick.rates,
                        jnp.zeros_like(command.joints), tick.loaded)  # fmt: skip
    return pilot._replace(running=running, seen=truth)
