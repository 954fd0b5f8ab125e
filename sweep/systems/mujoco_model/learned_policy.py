"""A learned policy fitted to a model: observation from the state, network, and controls from the action."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from sweep.contract.engine import TimeSeriesGroup, hinge_and_slide_joints
from sweep.core.errors import InputError, require_choice
from sweep.core.project import read_yaml
from sweep.core.rotations import conjugate, rotate
from sweep.systems.mujoco_model import actuation, policy_spec
from sweep.systems.mujoco_model.onnx_network import Network
from sweep.systems.mujoco_model.policy_spec import ActionSpec, ObservationTermSpec, PolicySpec, RecurrentSpec

TERM_SIZES = {"projected_gravity": 3, "base_linear_velocity": 3, "base_angular_velocity": 3, "base_height": 1,
         "base_orientation": 4}  # fmt: skip
EARLIER_ACTIONS = "earlier actions"  # key of the policy's memory of actions before the last, newest first
FREE_JOINT = int(mujoco.mjtJoint.mjJNT_FREE)


class ObservationTerm(NamedTuple):
    """One term of a neural policy's observation, such as joint positions, with size and scale for a model."""

    spec: ObservationTermSpec
    size: int
    unit: str
    history: int  # ticks
    measurement_slice: slice | None  # place in what is measured; None for a term that is not
    scale: np.ndarray  # (size,)


class LearnedPolicy(NamedTuple):
    """A neural-network policy prepared for one robot model: controller functions, actuators and scaling."""

    spec: PolicySpec
    inputs: Mapping[str, tuple[ObservationTerm, ...]]  # by the network's input
    joints: tuple[str, ...]
    offset: np.ndarray  # (k,) of the action, by joint
    scale: np.ndarray  # (k,) of the action
    begin: Callable[..., Any]
    observe: Callable[..., Any]
    policy: Callable[..., Any]
    actuators: np.ndarray  # (k,) index of the actuator of each joint
    joint_control: actuation.JointPdControl | None  # None where controls are constant over a tick
    command_units: tuple[str, ...]  # (k,) of the control of each joint; empty where the network gives controls
    assemble: Callable[..., Any]  # (belief, observation, state) -> numbers of each input, by name, and the next state

    def split_inputs_into_terms(self, numbers: Mapping[str, Any]) -> dict[str, list[tuple[str, str, np.ndarray]]]:
        """Split the input vectors of the network into their observation terms, such as joint positions.

        Where an input contains earlier ticks, only the numbers of the latest tick are returned.

        The unit of a scaled term ends with its scale, such as `rad/s x 0.05`.

        Args:
            numbers: Vector of each network input, by name of the input.

        Returns:
            By name of the input: label, unit and numbers (size,) of each term.
        """
        found: dict[str, list[tuple[str, str, np.ndarray]]] = {}
        for name, terms in self.inputs.items():
            sizes = [one.size for one in terms]
            if self.spec.stacking == "by_term":
                ends = np.cumsum([one.size * one.history for one in terms])
            else:
                ends = len(numbers[name]) - sum(sizes) + np.cumsum(sizes)
            found[name] = [
                (one.spec.label, _scaled_unit(one), np.asarray(numbers[name][end - one.size : end]))
                for one, end in zip(terms, ends, strict=True)
            ]
        return found

    @property
    def recorded_columns(self) -> tuple[str, ...]:
        """Names of the time-series columns with the policy's observation and action."""
        return tuple(column for group in self.recorded_groups for column in group.columns)

    @property
    def recorded_groups(self) -> tuple[TimeSeriesGroup, ...]:
        """Time-series columns of each observation term, and of the action, which are numbers of the network."""
        found = []
        for name, terms in self.inputs.items():
            start = f"observation_{name}" if len(self.inputs) > 1 else "observation"
            for one in terms:
                head, parts = f"{start}_{one.spec.label}", self._component_names(one)
                columns = {f"{head}_{part}" if part else head: part for part in parts}
                title = f"{start.replace('_', ' ', 1)}: {one.spec.label.replace('_', ' ')}"
                found.append(TimeSeriesGroup(title, one.unit if np.all(one.scale == 1) else "scaled", columns))
        return (*found, TimeSeriesGroup("action", "", {f"action_{joint}": joint for joint in self.joints}))

    def _component_names(self, term: ObservationTerm) -> tuple[str, ...]:
        """Names of a term's numbers: of joints, of commands, or their index; none for a single number."""
        one = term.spec
        if one.term in ("joint_positions", "joint_velocities", "last_action") and not one.sensor:
            return one.joints or self.joints
        if one.term == "command":
            return one.commands or tuple(self.spec.commands)
        return tuple(map(str, range(term.size))) if term.size > 1 else ("",)

    @staticmethod
    def latest_observation_and_action(state: Mapping[str, Any]) -> tuple[Any, Any]:
        """Return the latest observation (..., k) and action (..., joints) from states of the policy after a tick."""
        return state["seen"], state["action"]

    @property
    def measured_terms(self) -> dict[str, ObservationTerm]:
        """Observation terms that come from sensors and therefore have sensor errors, by label."""
        return {
            one.spec.label: one for terms in self.inputs.values() for one in terms if one.measurement_slice is not None
        }


def _scaled_unit(term: ObservationTerm) -> str:
    if (term.scale == 1).all():
        return term.unit
    scales = " ".join(f"{one:g}" for one in dict.fromkeys(term.scale.tolist()))
    return f"{term.unit} x {scales}".lstrip()


def spec_path(network: Path) -> Path:
    """Return the path of the specification file that belongs to a network's file."""
    return network.with_name(f"{network.stem}{policy_spec.SPECIFICATION_SUFFIX}")


def read_spec(file: Path, metadata: Mapping[str, str]) -> PolicySpec:
    """Read the specification of a neural policy from its file. Raises `InputError`.

    Args:
        file: The YAML file.
        metadata: Metadata of the network.
    """
    return policy_spec.parse_policy(file.name, read_yaml(file, file.name) or {}, metadata)


def bind_policy_to_model(
    error_prefix: str, spec: PolicySpec, network: Network, model: mujoco.MjModel, keyframe: int, period: float
) -> LearnedPolicy:
    """Prepare a neural policy for a model: look up joints and sensors by name, and check all sizes.

    Args:
        error_prefix: What messages begin with, such as `walk.policy.yaml`.
        spec: The specification.
        network: The network.
        model: The model.
        keyframe: Index of the keyframe that rollouts start from; -1 for the model's default pose.
        period: s between two calls of the network.

    Returns:
        The policy.

    Raises:
        InputError: A name is unknown, or a size differs.
    """
    joints = _joint_names(error_prefix, spec.joints or actuation.actuated_joints(model), model)
    pose = model.key_qpos[keyframe] if keyframe >= 0 else model.qpos0
    places = np.array([model.jnt_qposadr[model.joint(one).id] for one in joints], int)
    default = (pose[places] if spec.default_pose is None
               else policy_spec.parse_joint_values(
                   f"{error_prefix}: default_pose", spec.default_pose, joints))  # fmt: skip
    defaults = dict(zip(joints, default, strict=True))
    inputs = _fit_inputs(error_prefix, spec, network, model, joints)
    output = _action_output(error_prefix, spec, network)
    scale, offset, control, actuators = _fit_action(error_prefix, spec.action, model, joints, default)

    choices, draw = _fit_distribution(error_prefix, spec.action, network, joints)
    wanted = len(joints) if choices is None else len(choices)

    def require_action_of(size: int | None) -> None:  # None: the network does not say
        if size not in (None, wanted):
            what = f"{wanted} joints have actions" if choices is None else f"action.choices has {wanted}"
            raise InputError(f"{error_prefix}: {network.name} gives {size} numbers as {output}: {what}")

    require_action_of(network.outputs[output][-1] if network.outputs[output] else None)
    resting = model.key_ctrl[keyframe] if keyframe >= 0 else np.zeros(model.nu)
    measured = [one for terms in inputs.values() for one in terms if one.measurement_slice is not None]
    readers = [_make_reader(one, model, joints, defaults, pose) for one in measured]

    def observe(state: Mapping[str, Any]) -> Any:
        parts = [read(state) for read in readers]
        return jnp.concatenate(parts) if parts else jnp.zeros(0)

    lag = max((one.spec.lag for terms in inputs.values() for one in terms if one.spec.term == "last_action"), default=0)

    def begin(belief: Mapping[str, Any], key: Any) -> tuple[None, dict[str, Any], None]:
        memory = {one.input: jnp.full(_recurrent_shape(network, one), one.start, float) for one in spec.recurrent}
        past = {}
        for name, terms in inputs.items():
            if spec.stacking == "by_tick" and terms[0].history > 1:
                past[name] = jnp.zeros((terms[0].history, sum(one.size for one in terms)))
            elif spec.stacking == "by_term":
                past |= {f"{name}/{one.spec.label}": jnp.zeros((one.history, one.size))
                         for one in terms if one.history > 1}  # fmt: skip
        seen = jnp.zeros(sum(one.size for terms in inputs.values() for one in terms))
        if lag:
            past[EARLIER_ACTIONS] = jnp.zeros((lag, len(joints)))
        state = {"tick": jnp.int32(0), "action": jnp.zeros(len(joints)), "past": past, "memory": memory, "seen": seen}
        return None, state, None

    def push(past: Any, new: Any, tick: Any) -> Any:
        later = jnp.concatenate([past[1:], new[None]])
        if spec.history_start == "zeros":
            return later
        return jnp.where(tick == 0, jnp.broadcast_to(new, past.shape), later)

    def assemble(belief: Mapping[str, Any], seen: Any, state: Mapping[str, Any]) -> tuple[dict[str, Any], Any]:
        tick, past, found, present = state["tick"], dict(state["past"]), {}, []
        for name, terms in inputs.items():
            parts = []
            for one in terms:
                new = (
                    seen[one.measurement_slice]
                    if one.measurement_slice is not None
                    else _compute_term(one, spec, belief, state, period)
                )
                new = jnp.clip(new, *one.spec.clip) if one.spec.clip else new
                new = new * one.scale
                present.append(new.astype(float))
                if (key := f"{name}/{one.spec.label}") in past:
                    past[key] = push(past[key], new, tick)
                    new = past[key].reshape(-1)
                parts.append(new)
            whole = jnp.concatenate(parts)
            if name in past:
                past[name] = push(past[name], whole, tick)
                whole = past[name].reshape(-1)
            found[name] = whole.astype(float)
        if lag:
            past[EARLIER_ACTIONS] = jnp.concatenate([state["action"][None], past[EARLIER_ACTIONS][:-1]])
        return found, {**state, "past": past, "seen": jnp.concatenate(present)}

    def policy(belief: Mapping[str, Any], seen: Any, state: Any, key: Any) -> tuple[Any, Any]:
        numbers, state = assemble(belief, seen, state)
        given = {name: one.reshape(network.input_shape(name)) for name, one in numbers.items()}
        found = network.evaluate({**given, **state["memory"]})
        action = found[output].reshape(-1)
        require_action_of(action.size)
        action = draw(action, found, key)
        action = jnp.clip(action, *spec.action.clip) if spec.action.clip else action
        controls = jnp.asarray(resting, float).at[actuators].set(offset + scale * action)
        memory = {one.input: found[one.output].astype(float).reshape(_recurrent_shape(network, one))
                  for one in spec.recurrent}  # fmt: skip
        new = {"tick": state["tick"] + 1, "action": action.astype(float), "memory": memory}
        return controls, {**state, **new}

    return LearnedPolicy(
        spec, inputs, tuple(joints), offset, scale, begin, observe, policy, actuators, control,
        _command_units(spec.action, model, joints, actuators, control), assemble
    )  # fmt: skip


def _joint_names(error_prefix: str, names: Any, model: mujoco.MjModel) -> list[str]:
    """Return the names of hinge and slide joints as the model has them. Raises `InputError`."""
    known = {model.joint(j).name: j for j in range(model.njnt)}
    for name in names:
        require_choice(name, [one for one in known if one], f"{error_prefix}: joint {name}")
        if known[name] not in hinge_and_slide_joints(model):
            raise InputError(f"{error_prefix}: joint {name} is not allowed: a hinge or a slide")
    if not len(names):
        raise InputError(f"{error_prefix} needs the key joints: the model has no actuators of joints")
    return list(names)


def _fit_inputs(
    error_prefix: str, spec: PolicySpec, network: Network, model: mujoco.MjModel, joints: list[str]
) -> dict[str, tuple[ObservationTerm, ...]]:
    """Fit the terms of each input of the network. Raises `InputError`."""
    for one in spec.recurrent:
        require_choice(one.input, network.inputs, f"{error_prefix}: recurrent input {one.input}")
        require_choice(one.output, network.outputs, f"{error_prefix}: recurrent output {one.output}")
    wanted = [name for name in network.inputs if name not in {one.input for one in spec.recurrent}]
    given = spec.observation
    if given is None:
        raise InputError(f"{error_prefix} needs the key observation, or a preset")
    if not isinstance(given, Mapping):
        if len(wanted) != 1:
            names = ", ".join(wanted)
            raise InputError(f"{error_prefix}: {network.name} has the inputs {names}: give the terms of each by its "
                             "name, or name recurrent ones (key recurrent)")  # fmt: skip
        given = {wanted[0]: given}
    for name in given:
        require_choice(name, wanted, f"{error_prefix}: observation.{name}")
    if missing := [name for name in wanted if name not in given]:
        raise InputError(
            f"{error_prefix}: the network's input {missing[0]} has no terms (key observation.{missing[0]})"
        )
    at, found = 0, {}
    for name in wanted:
        terms = []
        for one in policy_spec.parse_terms(f"{error_prefix}: observation", given[name]):
            term = _fit_term(error_prefix, one, spec, model, joints, at)
            at += term.size if term.measurement_slice is not None else 0
            terms.append(term)
        if spec.stacking == "by_tick" and len({one.history for one in terms}) > 1:
            raise InputError(f"{error_prefix}: stacking = by_tick is not allowed: terms have different histories")
        sizes = [one.size * one.history for one in terms]
        declared = [one for one in network.input_shape(name) if one != 1]
        if -1 not in declared and math.prod(declared) != sum(sizes):
            parts = ", ".join(f"{one.spec.label} {size}" for one, size in zip(terms, sizes, strict=True))
            raise InputError(f"{error_prefix}: {network.name} takes {math.prod(declared)} numbers as {name}: "
                             f"its terms have {sum(sizes)} ({parts})")  # fmt: skip
        found[name] = tuple(terms)
    labels = [one.spec.label for terms in found.values() for one in terms if one.measurement_slice is not None]
    policy_spec.require_unique_labels(error_prefix, labels, "in two inputs")
    return found


def _fit_term(
    error_prefix: str, one: ObservationTermSpec, spec: PolicySpec, model: mujoco.MjModel, joints: list[str], at: int
) -> ObservationTerm:
    """Fit a term whose numbers, if they are measured, begin at the place `at`. Raises `InputError`."""
    error_prefix = f"{error_prefix}: {one.label}"
    sensors = {name: k for k in range(model.nsensor) if (name := model.sensor(k).name)}
    instead = next((name for name in spec.sensors.get(one.term, "").split() if name in sensors), "")
    if not one.sensor and instead:
        one = ObservationTermSpec(**{**vars(one), "sensor": instead, "name": one.label})
    if one.sensor:
        require_choice(one.sensor, sensors, f"{error_prefix}: sensor {one.sensor}")
        size = int(model.sensor_dim[sensors[one.sensor]])
        if one.term != "sensor" and size != TERM_SIZES.get(one.term, size):
            raise InputError(
                f"{error_prefix}: sensor {one.sensor} has {size} numbers, the term has {TERM_SIZES[one.term]}"
            )
    elif one.term in ("joint_positions", "joint_velocities"):
        size = len(_joint_names(error_prefix, one.joints or joints, model))
    elif one.term == "last_action":
        size = len(joints)
    elif one.term == "command":
        names = one.commands or tuple(spec.commands)
        for name in names:
            require_choice(name, spec.commands, f"{error_prefix}: command {name}")
        size = len(names)
        if not size:
            raise InputError(f"{error_prefix} needs the key commands, such as {{velocity_x: 1.0}}")
    elif one.term == "phase":
        size = 2 * len(one.offsets)
    elif one.term == "constant":
        size = len(one.values)
    else:
        if not (model.jnt_type == FREE_JOINT).any():
            raise InputError(f"{error_prefix} is not allowed: the model has no free joint; name a sensor (key sensor)")
        size = TERM_SIZES[one.term]
    scale = np.asarray(one.scale, float)
    if scale.shape not in ((), (size,)):
        raise InputError(f"{error_prefix}: scale has {scale.size} numbers: the term has {size}")
    raw = slice(at, at + size) if one.sensor or one.term in policy_spec.MEASURED_TERMS else None
    return ObservationTerm(
        one, size, policy_spec.TERM_UNITS[one.term], one.history or spec.history, raw, np.broadcast_to(scale, (size,))
    )


def _make_reader(
    term: ObservationTerm, model: mujoco.MjModel, joints: list[str], defaults: Mapping[str, float], pose: np.ndarray
) -> Callable[[Mapping[str, Any]], Any]:
    """Make the function that reads a measured term from the state by name."""
    one = term.spec
    if one.sensor:
        return lambda state: state[one.sensor]
    if one.term in ("joint_positions", "joint_velocities"):
        ids = [model.joint(name).id for name in one.joints or joints]
        if one.term == "joint_velocities":
            dofs = model.jnt_dofadr[ids]
            return lambda state: state["qvel"][dofs]
        places = model.jnt_qposadr[ids]
        rest = [defaults.get(name, pose[at]) for name, at in zip(one.joints or joints, places, strict=True)]
        rest = np.array(rest) if one.relative else np.zeros(len(ids))
        return lambda state: state["qpos"][places] - rest
    base = int(np.flatnonzero(model.jnt_type == FREE_JOINT)[0])
    at, dof = int(model.jnt_qposadr[base]), int(model.jnt_dofadr[base])
    turn = slice(at + 3, at + 7)
    readers: dict[str, Callable[[Mapping[str, Any]], Any]] = {
        "projected_gravity": lambda state: rotate(conjugate(state["qpos"][turn]), jnp.array([0.0, 0.0, -1.0])),
        "base_linear_velocity": lambda state: rotate(conjugate(state["qpos"][turn]), state["qvel"][dof : dof + 3]),
        "base_angular_velocity": lambda state: state["qvel"][dof + 3 : dof + 6],  # MuJoCo has it in the body's axes
        "base_height": lambda state: state["qpos"][at + 2 : at + 3],
        "base_orientation": lambda state: state["qpos"][turn],
    }
    return readers[one.term]


def _compute_term(
    term: ObservationTerm, spec: PolicySpec, belief: Mapping[str, Any], state: Mapping[str, Any], period: float
) -> Any:
    """Compute a term that is not measured."""
    one = term.spec
    if one.term == "last_action":
        return state["past"][EARLIER_ACTIONS][one.lag - 1] if one.lag else state["action"]
    if one.term == "command":
        return jnp.stack([jnp.asarray(belief[name], float) for name in one.commands or spec.commands])
    if one.term == "constant":
        return jnp.asarray(one.values, float)
    tick = jnp.maximum(state["tick"] - one.lag, 0)
    angle = 2 * math.pi * ((one.frequency * period * tick) % 1.0) + jnp.asarray(one.offsets)
    waves = jnp.cos(angle), jnp.sin(angle)
    return jnp.concatenate(waves if one.order == "cos_sin" else waves[::-1])


def _fit_distribution(
    error_prefix: str, spec: ActionSpec, network: Network, joints: list[str]
) -> tuple[np.ndarray | None, Callable[[Any, Mapping[str, Any], Any], Any]]:
    """Return the choices (c, k) of discrete actions, and the function that makes an action of the network's output.

    The function takes the output, all outputs by name, and a random key. Raises `InputError`.
    """
    if spec.deviation_output:
        require_choice(spec.deviation_output, network.outputs, f"{error_prefix}: action.deviation_output")
    if spec.choices is not None:
        try:
            choices: np.ndarray = np.asarray(spec.choices, float)
        except (TypeError, ValueError):
            choices = np.zeros(0)
        if choices.ndim != 2 or choices.shape[1] != len(joints) or not np.isfinite(choices).all():
            such = f"a list of actions, each {len(joints)} numbers (one for each joint)"
            raise InputError(f"{error_prefix}: action.choices = {spec.choices!r:.80} is not allowed: {such}")

        def choose(logits: Any, found: Mapping[str, Any], key: Any) -> Any:
            number = jax.random.gumbel(key, logits.shape, jnp.float32).astype(logits.dtype) if spec.sample else 0.0
            return jnp.asarray(choices, float)[jnp.argmax(logits + number)]

        return choices, choose
    if not spec.sample:
        return None, lambda mean, found, key: mean
    if (spec.deviation is None) != bool(spec.deviation_output):
        needs = (
            "needs action.deviation or action.deviation_output" if spec.deviation is None else "needs only one of both"
        )
        way = "; without them leave sample out, which runs the mean action"
        raise InputError(f"{error_prefix}: action.sample = true {needs}{way}")
    fixed = (None if spec.deviation is None
             else policy_spec.parse_joint_values(
                 f"{error_prefix}: action.deviation", spec.deviation, joints))  # fmt: skip

    def draw(mean: Any, found: Mapping[str, Any], key: Any) -> Any:
        size = fixed if fixed is not None else jnp.exp(found[spec.deviation_output].reshape(-1))
        return mean + size * jax.random.normal(key, mean.shape, jnp.float32).astype(mean.dtype)

    return None, draw


def _command_units(
    spec: ActionSpec, model: mujoco.MjModel, joints: list[str], actuators: np.ndarray, control: Any
) -> tuple[str, ...]:
    """Return the unit of each joint's command: that of the joint, times the gear of a position actuator."""
    if spec.actuation == "direct":
        return ("",) * len(joints)
    gears = (
        np.ones(len(joints)) if control is not None or spec.actuation == "target" else model.actuator_gear[actuators, 0]
    )
    slides = [model.joint(name).type[0] == int(mujoco.mjtJoint.mjJNT_SLIDE) for name in joints]
    units = ["m" if slide else "rad" for slide in slides]
    return tuple(unit if gear == 1 else f"{unit} x {gear:g}" for unit, gear in zip(units, gears, strict=True))


def _recurrent_shape(network: Network, one: RecurrentSpec) -> tuple[int, ...]:
    shape = one.shape or network.input_shape(one.input)
    if -1 in shape:
        raise InputError(f"{network.name}: recurrent input {one.input} has no fixed size: give its sizes (key shape)")
    return shape


def _action_output(error_prefix: str, spec: PolicySpec, network: Network) -> str:
    """Return the name of the output that is the action. Raises `InputError`."""
    if spec.output:
        require_choice(spec.output, network.outputs, f"{error_prefix}: output = {spec.output}")
        return spec.output
    others = {spec.action.deviation_output, *(one.output for one in spec.recurrent)}
    rest = [name for name in network.outputs if name not in others]
    if len(rest) != 1:
        raise InputError(f"{error_prefix}: {network.name} has the outputs {', '.join(network.outputs)}: name the "
                         "action's (key output), or recurrent ones (key recurrent)")  # fmt: skip
    return rest[0]


def _fit_action(
    error_prefix: str, spec: ActionSpec, model: mujoco.MjModel, joints: list[str], default: np.ndarray
) -> tuple[np.ndarray, np.ndarray, actuation.JointPdControl | None, np.ndarray]:
    """Return scale and offset of the action (k,), the joint controller if there is one, and actuators (k,)."""
    policy_spec.require_clip_range(f"{error_prefix}: action.clip", spec.clip)
    actuators, numbers = actuation.find_actuators(error_prefix, model, joints), policy_spec.parse_joint_values
    scale = numbers(f"{error_prefix}: action.scale", spec.scale, joints)
    offset = (np.array(default, float) if spec.offset == "default_pose" and spec.actuation != "direct" else
              np.zeros(len(joints)) if spec.offset == "default_pose" else
              numbers(f"{error_prefix}: action.offset", spec.offset, joints))  # fmt: skip
    servos = actuation.is_servo(model)[actuators]
    way = spec.actuation
    if way == "auto":
        way = "servo" if servos.all() else "pd"
    if way == "servo":
        if not servos.all():
            odd = joints[int(np.argmin(servos))]
            raise InputError(f"{error_prefix}: action.actuation = servo is not allowed: joint {odd} has no position "
                             "actuator; give pd, with stiffness and damping")  # fmt: skip
        gear = model.actuator_gear[actuators, 0]
        return scale * gear, offset * gear, None, actuators
    if way in ("target", "direct"):
        return scale, offset, None, actuators
    motors = (model.actuator_biastype == int(mujoco.mjtBias.mjBIAS_NONE))[actuators]
    if not motors.all():
        odd = joints[int(np.argmin(motors))]
        raise InputError(f"{error_prefix}: action.actuation = pd is not allowed: joint {odd} has an actuator "
                         "of its own law; give servo or direct")  # fmt: skip
    if spec.stiffness is None:
        raise InputError(
            f"{error_prefix} needs the key action.stiffness: the joints have motors, and no position actuators"
        )
    stiffness = numbers(f"{error_prefix}: action.stiffness", spec.stiffness, joints)
    damping = numbers(f"{error_prefix}: action.damping", spec.damping, joints)
    limit = (np.full(len(joints), np.inf) if spec.torque_limit is None
             else numbers(f"{error_prefix}: action.torque_limit", spec.torque_limit, joints))  # fmt: skip
    return scale, offset, actuation.make_joint_control(model, actuators, stiffness, damping, limit), actuators
