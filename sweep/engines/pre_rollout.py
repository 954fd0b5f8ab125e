"""Steps before a rollout: optional calibration of the robot, and planning from its belief.

Calibration is computed here, not simulated. It assumes drives so soft that every foot stays where it stands while the
base moves; joint angles then follow from the true sizes. `calibration_rollout` simulates it.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sweep.controllers.observation import draw_free_body_biases, draw_sensor_biases
from sweep.controllers.plan import Plan
from sweep.core.errors import InputError
from sweep.core.rotations import exponential, multiply
from sweep.engines import planning
from sweep.engines.closed_loop import InitialState, start_state
from sweep.estimation import calibration, touch
from sweep.estimation.belief_update import LearnedState, updated_belief
from sweep.estimation.calibration import HEIGHT, MOVES, CalibrationResult, GroundPlane, PoseMeasurements
from sweep.models.case import Case
from sweep.models.legs import JOINT_Q, N_LEGS
from sweep.models.obstacles.surface import Surface, body_poses, free_start_state, surface_at
from sweep.models.posture import Stance, feet_in_world, joint_targets

LEVEL_TOLERANCE_M = 5e-3  # m, tolerance of feet on one plane, since footholds may lie below it
FLOOR_TOLERANCE = 1e-5  # tolerance of ground that is the floor, z = 0
CALIBRATION_ERRORS_KEY, BODY_POSITIONS_KEY = (
    1,
    2,
)  # folded into a rollout's key to draw errors of calibration and of body positions


def prepare_belief(world: Case, belief: Case, key: Array) -> tuple[Case, Plan, LearnedState]:
    """Let the robot estimate sizes by calibration and touch, as configured, and plan from the improved belief.

    Args:
        world: simulated parameters.
        belief: parameters that the planner receives at first.
        key: random key of the rollout.

    Returns:
        The updated belief, the plan that follows from it, and the estimates by which it was updated.
    """
    plan, control = belief.manoeuvre.plan(belief), world.control
    if control.calibrate == "none" and control.touch == "none":
        return belief, plan, LearnedState()
    seen = measure_calibration_poses(world, start_state(world, belief, plan), key)
    learned = LearnedState()
    if control.calibrate != "none":
        calibrated = calibration.estimate_sizes(control, belief.noise, belief.robot, _ground(belief, plan.start), seen)
        learned = learned._replace(calibration=calibrated)
    if control.touch != "none":
        nothing = touch.init_touch_state(control, belief.obstacle)
        if not touch.is_estimated_from_foot_contacts(belief.obstacle):
            touched = touch.update_from_resting_bodies(
                control, belief.noise, nothing, measure_body_positions(world, key)
            )
        else:
            robot, at_first = updated_belief(belief, learned).robot, (seen.position[0], seen.quat[0], seen.angles[0])
            touched = touch.update_from_stance(control, belief.noise, robot, plan.start, nothing, *at_first)
        learned = learned._replace(touch=touched)
    belief = updated_belief(belief, learned)
    plan = belief.manoeuvre.plan(belief)
    if control.replan != "never":
        learned = learned._replace(plan=plan, shortfall=jnp.zeros(()))
    return belief, plan, learned


def check_control_settings(world: Case, belief: Case, plan: Plan) -> None:
    """Raise `InputError` if the key `control` asks for estimates that this robot cannot make on this obstacle.

    To calibrate, all feet have to start on one plane. Only resting obstacles can be touched and planned for again; of
    moving ones only the positions of balls can be learned.

    Args:
        world: simulated parameters.
        belief: parameters that the planner receives.
        plan: nominal plan.
    """
    control, obstacle = world.control, belief.obstacle
    moves = f"obstacle = {obstacle.kind} may move"
    if control.touch != "none" and obstacle.free_bodies and not touch.learnable_sizes(obstacle):
        raise InputError(f"control.touch = {control.touch} is not allowed: {moves}")
    if control.replan != "never" and not touch.is_estimated_from_foot_contacts(obstacle):
        raise InputError(f"control.replan = {control.replan} is not allowed: {moves}")
    if control.replan != "never" and control.touch == "none":
        raise InputError(f"control.replan = {control.replan} is not allowed: it needs control.touch = obstacle")
    if world.control.calibrate != "none":
        check_calibration_stance(belief, plan, control.calibrate)


def check_calibration_stance(belief: Case, plan: Plan, calibrate: str) -> None:
    """Raise `InputError` if a robot that has to calibrate does not start with all feet on one plane.

    Args:
        belief: parameters that the planner receives.
        plan: nominal plan.
        calibrate: value of `control.calibrate`, for the message.
    """
    if not planning.evaluate_planning_function(lambda: _feet_start_level(belief, plan.start)):
        kinds = f"manoeuvre = {belief.manoeuvre.kind} on obstacle = {belief.obstacle.kind}"
        asked = f"control.calibrate = {calibrate} is not allowed"
        raise InputError(f"{asked}: {kinds} does not start with all feet on the floor")


def _feet_start_level(belief: Case, start: Stance) -> Bool[Array, ""]:
    """Whether all feet start on one plane that belongs to no free body."""
    feet, surface = start.feet, _surface_under_feet(belief, start)
    down = feet + surface.depth[:, None] * surface.normal
    even = jnp.abs((down - down[0]) @ surface.normal[0]) < LEVEL_TOLERANCE_M
    return jnp.all(even & (jnp.abs(surface.depth) < LEVEL_TOLERANCE_M) & (surface.body < 0))


def _surface_under_feet(belief: Case, start: Stance) -> Surface:
    """Believed surface under the feet at the start."""
    return surface_at(belief.obstacle, start.feet, body_poses(free_start_state(belief.obstacle)))


def _ground(belief: Case, start: Stance) -> GroundPlane:
    surface, foot = _surface_under_feet(belief, start), start.feet[0]
    normal = surface.normal[0]
    point = foot + surface.depth[0] * normal
    return GroundPlane(point, normal, (jnp.abs(point[2]) > FLOOR_TOLERANCE) | (normal[2] < 1 - FLOOR_TOLERANCE))


def measure_body_positions(world: Case, key: Array) -> Float[Array, "k 3"]:
    """Measure the obstacle's free bodies before the rollout: true positions plus the sensor errors of this rollout (m).

    Args:
        world: simulated parameters.
        key: random key of the rollout.

    Returns:
        Position (k, 3) of each body, world axes.
    """
    noise, free = world.noise, free_start_state(world.obstacle)
    bias = draw_free_body_biases(noise, jax.random.split(key)[0], free)[:, 0]
    draws = jax.random.normal(jax.random.fold_in(key, BODY_POSITIONS_KEY), free.position.shape, float)
    return free.position + bias + noise.body_position_noise / jnp.sqrt(world.control.samples) * draws


def measure_calibration_poses(world: Case, start: InitialState, key: Array) -> PoseMeasurements:
    """Return what the sensors measure in the calibration poses, with the sensor errors of this rollout.

    The feet are put on the ground where the robot starts, and slip a little from pose to pose. A foot that a pose puts
    out of reach does not stand.

    Args:
        world: simulated parameters.
        start: state of MuJoCo at the start.
        key: random key of the rollout.
    """
    control, quat = world.control, start.qpos[3:7]
    feet = feet_in_world(world.robot, start.qpos[:3], quat, start.qpos[JOINT_Q].reshape(N_LEGS, 3))
    ground = surface_at(world.obstacle, feet, body_poses(free_start_state(world.obstacle)))
    feet = feet + ground.depth[:, None] * ground.normal
    slips = jax.random.normal(_error_keys(key)[0], (len(MOVES), N_LEGS, 3), float)
    up = jnp.sum(slips * ground.normal, axis=-1, keepdims=True) * ground.normal
    feet = feet + control.slip * (slips - up) + HEIGHT * up
    position, turned = calibration.base_poses(control, Stance(feet[0], start.qpos[:3], quat))
    angles, shortfall = jax.vmap(joint_targets, (None, 0))(world.robot, Stance(feet, position, turned))
    return add_sensor_errors(world, PoseMeasurements(position, turned, angles, shortfall <= 0), key)


def add_sensor_errors(world: Case, true: PoseMeasurements, key: Array) -> PoseMeasurements:
    """Add a rollout's sensor errors to the exact mean measurements of the calibration poses.

    Args:
        world: simulated parameters; `noise` gives the sizes of errors.
        true: true means over each pose.
        key: random key of the rollout, from which its biases are drawn.
    """
    noise, bias = world.noise, draw_sensor_biases(world.noise, jax.random.split(key)[0])
    draws = jax.random.normal(_error_keys(key)[1], (len(MOVES), 24), float) / jnp.sqrt(world.control.samples)
    turn = bias.turn + noise.orientation_noise * draws[:, 3:6]
    return PoseMeasurements(
        true.position + bias.position + noise.position_noise * draws[:, :3],
        multiply(exponential(turn), true.quat),
        true.angles + bias.joint + noise.joint_noise * draws[:, 6:].reshape(-1, N_LEGS, 3),
        true.loaded,
    )


def calibrate_from_poses(world: Case, belief: Case, true: PoseMeasurements, key: Array) -> CalibrationResult:
    """Estimate the robot's sizes from simulated calibration poses.

    Args:
        world: simulated parameters.
        belief: parameters that the planner receives.
        true: true means over each pose; the rollout's sensor errors are added.
        key: random key of the rollout.
    """
    start = belief.manoeuvre.plan(belief).start
    seen = add_sensor_errors(world, true, key)
    return calibration.estimate_sizes(world.control, belief.noise, belief.robot, _ground(belief, start), seen)


def _error_keys(key: Array) -> Array:
    """Random keys for the slip of the feet, and for sensor noise."""
    return jax.random.split(jax.random.fold_in(key, CALIBRATION_ERRORS_KEY))
