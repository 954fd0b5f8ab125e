"""Export of the six-legged robot as a MuJoCo model, with its plan, tracker and metrics as a controller.

The controller observes the ends of control ticks only, so torques and forces are those at the ends; the robot's own
engines use peaks and means of all physics steps.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

from sweep import metrics
from sweep.contract.engine_settings import EngineSettings
from sweep.controllers.flywheel import MiddleLegFlywheel
from sweep.controllers.layers import ForceFeedforward
from sweep.core.errors import InputError
from sweep.core.outcomes import GOAL_MISSED
from sweep.core.parameters import MAX_WHOLE_NUMBER
from sweep.engines.batching import nominal_plan
from sweep.engines.closed_loop import (
    MAX_DURATION_FACTOR,
    compute_metrics,
    exact_observation,
    init_loop,
    required_sensing_mode,
    run_controller,
    start_state,
    update_metrics,
)
from sweep.engines.pre_rollout import prepare_belief
from sweep.estimation.belief_update import LearnedState
from sweep.metrics.outcome import OutcomeThresholds, threshold_value
from sweep.metrics.tick import REST_DURATION_S, EngineTickReport
from sweep.models.case import Case
from sweep.models.legs import JOINT_NAMES, JOINT_V, N_JOINTS, N_LEGS
from sweep.models.obstacles.surface import body_poses, surface_at
from sweep.models.robot import link_names
from sweep.models.scene import build_native_spec
from sweep.systems.hexapod import iterate_case_parameters, replace_parameter

BELIEF_GROUPS = "robot", "drive", "contact", "obstacle", "manoeuvre"  # groups whose quantities the controller is told


class ExportedController(NamedTuple):
    """Functions and tables that the module of an exported controller contains, such as `begin` and `policy`."""

    begin: Callable[..., Any]
    policy: Callable[..., Any]
    figures: Callable[..., Any]
    parameters: Mapping[str, float]
    measured: Mapping[str, str]


def check_exportable_to_mjcf(case: Case) -> None:
    """Raise `InputError` if a scenario has features that the exported controller cannot have."""
    plan = nominal_plan(case)
    kind = f"manoeuvre.kind = {case.manoeuvre.kind}"
    reasons = {
        f"obstacle.kind = {case.obstacle.kind} is not allowed: the obstacle may move": bool(case.obstacle.free_bodies),
        f"{kind} is not allowed: its controller changes servo gains": plan.find_layer(MiddleLegFlywheel) is not None,
        f"{kind} is not allowed: it plans contact forces before it starts": plan.find_layer(ForceFeedforward)
        is not None,
        "noise is not allowed: a MuJoCo model has noise settings of its own": required_sensing_mode(case.noise)
        != "exact",
        "execution.push_impulse is not allowed: a controller cannot push the robot": case.execution.push_impulse != 0,
        "control is not allowed: an exported controller learns nothing": (case.control.calibrate, case.control.touch)
        != ("none", "none"),
    }
    for reason, holds in reasons.items():
        if holds:
            raise InputError(reason)


def make_mujoco_spec(case: Case, settings: EngineSettings) -> mujoco.MjSpec:
    """Make the MuJoCo spec of the robot for export, with joint angles as controls and sensors that MJX supports.

    Args:
        case: The scenario's parameters.
        settings: Engine settings; the time step is that of the native engine.

    Returns:
        The model, not compiled.
    """
    made = build_native_spec(case, settings.native_time_step)
    made.option.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    for sensor in [*made.sensors]:
        made.delete(sensor)
    for motor in made.actuators:
        motor.gainprm[0] *= case.drive.stiffness
    sensed, site, body = mujoco.mjtSensor, mujoco.mjtObj.mjOBJ_SITE, mujoco.mjtObj.mjOBJ_BODY
    feet = [f"foot{leg + 1}" for leg in range(N_LEGS)]
    for name in feet:
        made.add_sensor(name=f"load_{name}", type=sensed.mjSENS_TOUCH, objtype=site, objname=name)
    made.add_sensor(name="centre", type=sensed.mjSENS_SUBTREECOM, objtype=body, objname="base")
    for name in _links(case):
        made.add_sensor(name=f"at_{name}", type=sensed.mjSENS_FRAMEPOS, objtype=mujoco.mjtObj.mjOBJ_XBODY, objname=name)
    for name in feet:
        made.add_sensor(name=f"at_{name}", type=sensed.mjSENS_FRAMEPOS, objtype=site, objname=name)
    for name in JOINT_NAMES:
        actuator = mujoco.mjtObj.mjOBJ_ACTUATOR
        made.add_sensor(name=f"torque_{name}", type=sensed.mjSENS_ACTUATORFRC, objtype=actuator, objname=name)
    return made


def _links(case: Case) -> list[str]:
    return [f"{link}{leg + 1}" for leg in range(N_LEGS) for link in link_names(case.robot)]


def make_exported_scenario(
    case: Case, settings: EngineSettings, limits: OutcomeThresholds, model: str, controller: str
) -> Any:
    """Make the scenario file of the exported model, with the hexapod's causes of failure as conditions.

    Args:
        case: The scenario's parameters.
        settings: Engine settings.
        limits: Thresholds of the causes.
        model: File of the model.
        controller: Controller, `module:function`.

    Returns:
        Plain values of a scenario file.
    """
    sensors = [sensor.name for sensor in make_mujoco_spec(case, settings).sensors]
    seconds = MAX_DURATION_FACTOR * float(np.sum(np.asarray(nominal_plan(case).duration))) + REST_DURATION_S
    about = {
        "mjcf": model,
        "controller": controller,
        "period": settings.control_period,
        "duration": math.ceil(1.5 * seconds),  # other parameters may ask for more than the nominal ones
        "command": "ramped",
        "observe": ["qpos", "qvel", *sensors],
    }
    return {"system": "mujoco", "model": about, "outcome": dict(_conditions(case, limits))}


def _conditions(case: Case, limits: OutcomeThresholds) -> Iterator[tuple[str, str]]:
    """Yield names and conditions of the causes, those known at a tick first."""
    every = [cause for metric in metrics.applicable_metrics(case) for cause in metric.causes if not cause.invalid]
    for cause in sorted(every, key=lambda cause: cause.known_at == "end"):
        limit = threshold_value(cause, limits)
        if math.isfinite(limit):
            name = cause.name if cause.name != GOAL_MISSED else f"missed_{cause.threshold}"
            yield name, f"{cause.metric} {'<' if cause.below else '>'} {limit!r}"


def make_controller(case: Case, settings: EngineSettings, limits: OutcomeThresholds) -> ExportedController:
    """Make the exported controller, which plans, tracks and computes metrics like the built-in hexapod.

    The nominal world is simulated for the plan, with the belief's values where the belief has them.

    Args:
        case: The scenario's parameters.
        settings: Engine settings; the control period is used.
        limits: Thresholds of the causes.

    Returns:
        Functions and tables that the controller's module exports.
    """
    period = settings.control_period
    numbers = {
        path: value
        for path, value in iterate_case_parameters(case, "")
        if isinstance(value, float) and abs(value) < MAX_WHOLE_NUMBER
    }
    numbers = {path: value for path, value in numbers.items() if path.startswith(BELIEF_GROUPS)}
    measured = {name: what for metric in metrics.applicable_metrics(case) for name, what in metric.columns.items()}

    def believed(belief: Mapping[str, Array]) -> Case:
        now = case
        for path in numbers:
            now = replace_parameter(now, path, belief[path])
        return now

    def begin(belief: Mapping[str, Array], key: Array) -> tuple[Array, Any, Array]:
        own = believed(belief)
        _, plan, _ = prepare_belief(own, own, key)
        start = start_state(own, own, plan)
        loop = init_loop(own, own, plan, start, jnp.zeros(()), key, LearnedState(), sensing="exact")
        _, command = run_controller(own, own, plan, loop, jnp.int32(0), period)
        state = {"plan": plan, "loop": loop, "command": command, "tick": jnp.int32(0)}
        return start.qpos, state, MAX_DURATION_FACTOR * jnp.sum(plan.duration) + REST_DURATION_S

    def policy(belief: Mapping[str, Array], seen: Array, state: Any, key: Array) -> tuple[Array, Any]:
        own, plan, loop, tick = believed(belief), state["plan"], state["loop"], state["tick"]
        now, _ = update_metrics(
            own, plan, limits, loop, state["command"], make_tick_report(own, seen, period), tick - 1, period
        )
        loop = jax.tree.map(lambda a, b: jnp.where(tick > 0, a, b), now, loop)
        loop, command = run_controller(own, own, plan, loop, tick, period)
        angles = loop.servo.target + loop.servo.torque / own.drive.stiffness
        return angles.reshape(N_JOINTS), {"plan": plan, "loop": loop, "command": command, "tick": tick + 1}

    def figures(belief: Mapping[str, Array], state: Any) -> dict[str, Array]:
        found = compute_metrics(believed(belief), state["plan"], state["loop"])
        return {name: jnp.asarray(found[name], float) for name in measured}

    return ExportedController(begin, policy, figures, numbers, measured)


controller = make_controller  # imported by projects that earlier versions exported


def make_tick_report(case: Case, seen: Float[Array, " k"], period: float) -> EngineTickReport:
    """Convert the observation at the end of a control tick to the tick report from which metrics are computed.

    Args:
        case: The scenario's parameters.
        seen: Observation (k,): `qpos`, `qvel` and sensors.
        period: Control period in s.

    Returns:
        The tick, as the robot's own engines report it.
    """
    count, drive = len(_links(case)), case.drive
    sizes = 25, 24, N_LEGS, 3, 3 * count, 3 * N_LEGS, N_JOINTS
    qpos, qvel, load, centre, places, feet, effort = jnp.split(seen, np.cumsum(sizes)[:-1])
    feet, rates = feet.reshape(N_LEGS, 3), qvel[JOINT_V]
    torque = effort - drive.back_emf * rates
    exact = exact_observation(qpos, qvel, 0, load)
    bodies = body_poses(exact.free)
    normals = surface_at(case.obstacle, feet, bodies).normal
    return EngineTickReport(
        torque_peak=jnp.abs(torque).reshape(N_LEGS, 3),
        saturated=(jnp.abs(effort) >= 0.999 * drive.torque_limit).astype(seen.dtype).reshape(N_LEGS, 3),
        force=load[:, None] * normals,
        normal=load,
        tangential=jnp.zeros(N_LEGS),
        residual=jnp.zeros(()),
        work=period * jnp.sum(torque * rates),
        positive_work=period * jnp.sum(jnp.maximum(torque * rates, 0.0)),
        power=(torque * rates).reshape(N_LEGS, 3),
        energy=jnp.zeros(()),
        actual=exact,
        centre_of_mass=centre,
        joints=jnp.concatenate([places.reshape(N_LEGS, -1, 3), feet[:, None]], axis=1),
        bodies=bodies,
    )
