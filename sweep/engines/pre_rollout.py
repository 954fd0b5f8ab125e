"""What comes before a rollout: the robot calibrates itself, if it does, and plans by what it believes then.

Calibration is computed here: with drives soft enough every foot stays where it stands while the base goes its way, so
that joint angles follow from the true sizes. `calibrating` simulates it.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sweep.controllers import calibration, touch
from sweep.controllers.belief_update import LearnedState, updated_belief
from sweep.controllers.calibration import HEIGHT, MOVES, CalibrationResult, Ground, PoseMeasurements
from sweep.controllers.frames import Stance
from sweep.controllers.observation import draw_biases, draw_body_biases
from sweep.controllers.plan import Plan
from sweep.controllers.posture import feet_in_world, joint_targets
from sweep.core.errors import InputError
from sweep.core.rotations import exponential, multiply
from sweep.engines import planning
from sweep.engines.closed_loop import Start, start_state
from sweep.models.case import Case
from sweep.models.legs import JOINT_Q, N_LEGS
from sweep.models.obstacles.surface import Surface, body_poses, free_start_state, surface_at

LEVEL = 5e-3  # m, within which feet are on one plane: footholds may lie below it
FLAT = 1e-5  # within which ground is the floor, z = 0
ERRORS, PLACES = 1, 2  # folded into a rollout's key to draw the errors of calibration, and of the bodies' places


def prepare_belief(world: Case, belief: Case, key: Array) -> tuple[Case, Plan, LearnedState]:
    """What is believed from the start on, the plan that follows, what was learned for it; `key` is the rollout's."""
    plan, control = belief.manoeuvre.plan(belief), world.control
    if control.calibrate == "none" and control.touch == "none":
        return belief, plan, LearnedState()
    seen = measure_poses(world, start_state(world, belief, plan), key)
    learned = LearnedState()
    if control.calibrate != "none":
        calibrated = calibration.estimate_sizes(control, belief.noise, belief.robot, _ground(belief, plan.start), seen)
        learned = learned._replace(calibration=calibrated)
    if control.touch != "none":
        nothing = touch.init_touch(control, belief.obstacle)
        if not touch.is_learned_by_feet(belief.obstacle):
            touched = touch.update_from_resting_bodies(control, belief.noise, nothing, places(world, key))
        else:
            robot, at_first = updated_belief(belief, learned).robot, (seen.position[0], seen.quat[0], seen.angles[0])
            touched = touch.update_from_stance(control, belief.noise, robot, plan.start, nothing, *at_first)
        learned = learned._replace(touch=touched)
    belief = updated_belief(belief, learned)
    plan = belief.manoeuvre.plan(belief)
    if control.replan != "never":
        learned = learned._replace(plan=plan, shortfall=jnp.zeros(()))
    return belief, plan, learned


def check(world: Case, belief: Case, plan: Plan) -> None:
    """Raises `InputError` where `control` asks for what this robot cannot do.

    To calibrate itself it has to start with all feet on one plane; it touches what rests, and plans again by that. Of
    what moves only balls can be learned, as they lie.
    """
    control, obstacle = world.control, belief.obstacle
    moves = f"obstacle = {obstacle.kind} may move"
    if control.touch != "none" and obstacle.free_bodies and not touch.learnable_sizes(obstacle):
        raise InputError(f"control.touch = {control.touch} is not allowed: {moves}")
    if control.replan != "never" and not touch.is_learned_by_feet(obstacle):
        raise InputError(f"control.replan = {control.replan} is not allowed: {moves}")
    if control.replan != "never" and control.touch == "none":
        raise InputError(f"control.replan = {control.replan} is not allowed: it needs control.touch = obstacle")
    if world.control.calibrate != "none":
        check_level(belief, plan, control.calibrate)


def check_level(belief: Case, plan: Plan, calibrate: str) -> None:
    """Raises `InputError` where a robot that is to calibrate itself does not start with all feet on one plane."""
    if not planning.evaluate_plan(lambda: _starts_level(belief, plan.start)):
        kinds = f"manoeuvre = {belief.manoeuvre.kind} on obstacle = {belief.obstacle.kind}"
        asked = f"control.calibrate = {calibrate} is not allowed"
        raise InputError(f"{asked}: {kinds} does not start with all feet on the floor")


def _starts_level(belief: Case, start: Stance) -> Bool[Array, ""]:
    """Whether all feet start on one plane that no body carries."""
    feet, surface = start.feet, _under(belief, start)
    down = feet + surface.depth[:, None] * surface.normal
    even = jnp.abs((down - down[0]) @ surface.normal[0]) < LEVEL
    return jnp.all(even & (jnp.abs(surface.depth) < LEVEL) & (surface.body < 0))


def _under(belief: Case, start: Stance) -> Surface:
    """What is believed to be under the feet at the start."""
    return surface_at(belief.obstacle, start.feet, body_poses(free_start_state(belief.obstacle)))


def _ground(belief: Case, start: Stance) -> Ground:
    surface, foot = _under(belief, start), start.feet[0]
    normal = surface.normal[0]
    point = foot + surface.depth[0] * normal
    return Ground(point, normal, (jnp.abs(point[2]) > FLAT) | (normal[2] < 1 - FLAT))


def places(world: Case, key: Array) -> Float[Array, "k 3"]:
    """Where the sensors of a rollout see the obstacle's free bodies (m) before it begins."""
    noise, free = world.noise, free_start_state(world.obstacle)
    bias = draw_body_biases(noise, jax.random.split(key)[0], free)[:, 0]
    draws = jax.random.normal(jax.random.fold_in(key, PLACES), free.position.shape, float)
    return free.position + bias + noise.body_position_noise / jnp.sqrt(world.control.samples) * draws


def measure_poses(world: Case, start: Start, key: Array) -> PoseMeasurements:
    """What the sensors of a rollout say of the poses, their biases those of its key.

    The feet come down to the ground where the robot starts, and slip a little from pose to pose. A foot that a pose
    puts out of reach does not stand.
    """
    control, quat = world.control, start.qpos[3:7]
    feet = feet_in_world(world.robot, start.qpos[:3], quat, start.qpos[JOINT_Q].reshape(N_LEGS, 3))
    ground = surface_at(world.obstacle, feet, body_poses(free_start_state(world.obstacle)))
    feet = feet + ground.depth[:, None] * ground.normal
    slips = jax.random.normal(_drawn(key)[0], (len(MOVES), N_LEGS, 3), float)
    up = jnp.sum(slips * ground.normal, axis=-1, keepdims=True) * ground.normal
    feet = feet + control.slip * (slips - up) + HEIGHT * up
    position, turned = calibration.base_poses(control, Stance(feet[0], start.qpos[:3], quat))
    angles, shortfall = jax.vmap(joint_targets, (None, 0))(world.robot, Stance(feet, position, turned))
    return add_sensor_errors(world, PoseMeasurements(position, turned, angles, shortfall <= 0), key)


def add_sensor_errors(world: Case, true: PoseMeasurements, key: Array) -> PoseMeasurements:
    """What the sensors of a rollout make of `true` means in each pose, their biases those of its key."""
    noise, bias = world.noise, draw_biases(world.noise, jax.random.split(key)[0])
    draws = jax.random.normal(_drawn(key)[1], (len(MOVES), 24), float) / jnp.sqrt(world.control.samples)
    turn = bias.turn + noise.orientation_noise * draws[:, 3:6]
    return PoseMeasurements(
        true.position + bias.position + noise.position_noise * draws[:, :3],
        multiply(exponential(turn), true.quat),
        true.angles + bias.joint + noise.joint_noise * draws[:, 6:].reshape(-1, N_LEGS, 3),
        true.loaded,
    )


def calibrate_from_poses(world: Case, belief: Case, true: PoseMeasurements, key: Array) -> CalibrationResult:
    """What a rollout's robot learns of its sizes where `true` is what really was in the poses."""
    start = belief.manoeuvre.plan(belief).start
    seen = add_sensor_errors(world, true, key)
    return calibration.estimate_sizes(world.control, belief.noise, belief.robot, _ground(belief, start), seen)


def _drawn(key: Array) -> Array:
    """Keys to draw the feet's slips, and the sensors' noise."""
    return jax.random.split(jax.random.fold_in(key, ERRORS))
