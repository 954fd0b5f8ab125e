"""Specification of how a learned policy was trained (`walk.policy.yaml` beside `walk.onnx`), as checked dataclasses.

Three sources are read: the file, then the metadata that exporters of mjlab and whole_body_tracking write into the
network, then the preset of a training framework. The first one that has a value wins.
"""

import dataclasses
import fnmatch
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sweep.core.errors import InputError, require_choice

SPECIFICATION_SUFFIX = ".policy.yaml"  # of the file beside a network
TERM_UNITS = {  # terms of an observation, with their units
    "joint_positions": "rad",
    "joint_velocities": "rad/s",
    "projected_gravity": "",
    "base_linear_velocity": "m/s",
    "base_angular_velocity": "rad/s",
    "base_height": "m",
    "base_orientation": "",
    "sensor": "",
    "command": "",
    "last_action": "",
    "phase": "",
    "constant": "",
}
MEASURED_TERMS = [
    name for name in TERM_UNITS if name not in ("command", "last_action", "phase", "constant")
]  # have errors
TERM_ALIASES = {  # names of training frameworks for terms
    **dict.fromkeys(("joint_pos", "joint_pos_rel", "joint_angles"), "joint_positions"),
    **dict.fromkeys(("joint_vel", "joint_vel_rel"), "joint_velocities"),
    **dict.fromkeys(("gravity", "gravity_vec"), "projected_gravity"),
    **dict.fromkeys(("base_lin_vel", "linvel", "local_linvel"), "base_linear_velocity"),
    **dict.fromkeys(("base_ang_vel", "gyro"), "base_angular_velocity"),
    **dict.fromkeys(("commands", "velocity_commands", "generated_commands", "twist"), "command"),
    **dict.fromkeys(("actions", "last_act", "last_actions"), "last_action"),
    "gait_phase": "phase",
}
VELOCITY_COMMANDS = {"velocity_x": 1.0, "velocity_y": 0.0, "yaw_rate": 0.0}  # m/s, m/s, rad/s
USUAL_TERM_ORDER = ("base_linear_velocity", "base_angular_velocity", "projected_gravity")
# Playground's environments observe before they store the action and advance the phase; its scripts that play policies
# do so after, which is a lag of 0
LATE_ACTION = {"term": "last_action", "lag": 1}
PRESETS: dict[str, dict[str, Any]] = {  # by the documented conventions of the frameworks' velocity tasks
    "playground": {
        "observation": [*USUAL_TERM_ORDER, "joint_positions", "joint_velocities", LATE_ACTION, "command"],
        "commands": VELOCITY_COMMANDS,
        "action": {"scale": 0.5},
        "sensors": {"base_linear_velocity": "local_linvel", "base_angular_velocity": "gyro"},
    },
    "playground_gait": {
        "observation": [*USUAL_TERM_ORDER, "command", "joint_positions", "joint_velocities", LATE_ACTION,
                        {"term": "phase", "frequency": 1.5, "offsets": [0.0, np.pi], "lag": 1}],
        "commands": VELOCITY_COMMANDS,
        "action": {"scale": 0.5},
        "sensors": {"base_linear_velocity": "local_linvel_pelvis local_linvel",
                    "base_angular_velocity": "gyro_pelvis gyro"},
    },
    "mjlab": {
        "observation": [*USUAL_TERM_ORDER, "joint_positions", "joint_velocities", "last_action", "command"],
        "commands": VELOCITY_COMMANDS,
        "action": {"scale": 0.5},
        "sensors": {"base_linear_velocity": "imu_lin_vel", "base_angular_velocity": "imu_ang_vel"},
    },
    "isaaclab": {
        "observation": [*USUAL_TERM_ORDER, "command", "joint_positions", "joint_velocities", "last_action"],
        "commands": VELOCITY_COMMANDS,
        "action": {"scale": 0.5},
    },
}  # fmt: skip
Numbers = float | tuple[float, ...]


@dataclass(frozen=True)
class ObservationTermSpec:
    """One term of a neural policy's observation: its source, clipping, scale, and number of past ticks."""

    term: str  # what is observed: a name of the table below
    name: str = ""  # name in axes and messages; by default that of the sensor, or of the term
    sensor: str = ""  # name of the sensor of the model from which the term is read
    scale: Numbers = 1.0  # factor of all numbers of the term, or a list with a factor for each
    clip: tuple[float, ...] = ()  # least and largest value before scaling; empty: no limits
    history: int = 0  # number of ticks that are stacked, the present one included; 0: `history` of the policy
    lag: int = 0  # of `last_action` and `phase`: number of ticks by which the term is late
    relative: bool = True  # whether joint positions are relative to the default pose
    joints: tuple[str, ...] = ()  # names of joints in order; by default the joints of the policy
    commands: tuple[str, ...] = ()  # names of commands in order; by default all
    frequency: float = 1.0  # of the term `phase`: frequency of the gait (Hz)
    offsets: tuple[float, ...] = (0.0,)  # of the term `phase`: phase offset of each leg (rad)
    order: str = "cos_sin"  # of the term `phase`: all cosines before all sines, or `sin_cos`: sines first
    values: tuple[float, ...] = ()  # of the term `constant`: its numbers

    @property
    def label(self) -> str:
        """Name of the observation term in columns and messages."""
        return self.name or self.sensor or self.term


@dataclass(frozen=True)
class ActionSpec:
    """Conversion of a policy network's output to controls: `offset + scale * clipped output`, joint by joint."""

    scale: Any = 1.0  # number, list in the order of `joints`, or numbers by pattern of joint names
    offset: Any = "default_pose"  # in the form of `scale`, or the default pose of the joints
    clip: tuple[float, ...] = ()  # least and largest output of the network
    # servo: actions are targets of the model's position actuators; pd: torques are computed from stiffness and damping
    # at every physics step; target: actions are joint targets of motors with a network (group `motor`); direct: actions
    # are controls; auto: servo if the model has position actuators, else pd
    actuation: str = "auto"
    stiffness: Any = None  # of pd: N*m/rad, in the form of `scale`
    damping: Any = 0.0  # of pd: N*m*s/rad, in the form of `scale`
    torque_limit: Any = None  # of pd: N*m, in the form of `scale`, in addition to the limits of the model
    # draws actions from the policy's distribution by the rollout's noise stream; else the mean, or the likeliest choice
    sample: bool = False
    deviation: Any = None  # of sample: standard deviation of the network's output, in the form of `scale`
    deviation_output: str = ""  # of sample: name of the network's output that is the logarithm of the deviation
    choices: Any = None  # of discrete actions: for each output of the network the numbers of the joints, as lists


@dataclass(frozen=True)
class RecurrentSpec:
    """A network input that receives an output of the previous tick, such as an LSTM's state."""

    input: str  # name of the network's input
    output: str  # name of the network's output
    start: float = 0.0  # value in the first tick
    # sizes of the input for one rollout, such as [1, 1, 256]; needed where the network does not say them (TorchScript)
    shape: tuple[int, ...] = ()


@dataclass(frozen=True)
class PolicySpec:
    """Specification of a learned policy: its observation, action, period and joints, as it was trained."""

    preset: str = ""  # conventions of a framework: playground, playground_gait, mjlab or isaaclab
    period: float = 0.0  # time between two calls of the network (s); by default `model.period` of the scenario
    joints: tuple[str, ...] = ()  # names of joints in the order of the network; by default in that of the actuators
    # joint positions, in the form of `action.scale`; by default those of the keyframe at which rollouts start
    default_pose: Any = None
    observation: Any = None  # list of terms in order; with several inputs such a list for each, by the input's name
    history: int = 1  # number of ticks that each term stacks, the present one included
    stacking: str = "by_term"  # all ticks of a term side by side, oldest first; `by_tick`: whole observations instead
    history_start: str = "first"  # fills the history in the first tick: the first observation, or `zeros`
    # commanded numbers by name, such as a velocity; each is an axis `controller.NAME`
    commands: Mapping[str, float] = field(default_factory=dict)
    action: ActionSpec = ActionSpec()  # how the network's output becomes controls, see below
    output: str = ""  # name of the output that is the action; by default the only output that is not recurrent
    recurrent: tuple[RecurrentSpec, ...] = ()  # inputs that receive outputs of the previous tick, see below
    # sensor from which a term is read, by the term's name; of several names, the first that the model has, if any
    sensors: Mapping[str, str] = field(default_factory=dict)


CHOICES = {
    "actuation": ("auto", "servo", "pd", "target", "direct"),
    "stacking": ("by_term", "by_tick"),
    "history_start": ("first", "zeros"),
    "order": ("cos_sin", "sin_cos"),
    "preset": ("", *PRESETS),
}


def parse_policy(error_prefix: str, config: Mapping[str, Any], metadata: Mapping[str, str]) -> PolicySpec:
    """Build the specification of a neural policy from its file, the network's metadata and a preset.

    Args:
        error_prefix: What messages begin with, such as `walk.policy.yaml`.
        config: Content of the file.
        metadata: Metadata of the network.

    Returns:
        The specification, with names, types and choices checked.

    Raises:
        InputError: A key is unknown, or a value is not allowed.
    """
    if not isinstance(config, Mapping):
        raise InputError(f"{error_prefix} is not allowed: keys and values")
    require_choice(config.get("preset", ""), CHOICES["preset"], f"{error_prefix}: preset = {config.get('preset')}")
    merged = dict(PRESETS.get(config.get("preset", ""), {}))
    for source in (read_metadata(error_prefix, metadata), config):
        for key, value in source.items():
            both = key == "action" and isinstance(value, Mapping)
            merged[key] = {**merged.get(key, {}), **value} if both else value
    return _build(PolicySpec, merged, error_prefix)


def read_metadata(error_prefix: str, metadata: Mapping[str, str]) -> dict[str, Any]:
    """Read the comma-separated lists that exporters of mjlab and whole_body_tracking write into a network."""

    def words(key: str) -> list[str]:
        return [one.strip() for one in metadata.get(key, "").split(",") if one.strip()]

    def numbers(key: str) -> list[float] | float | None:
        try:
            found = [float(one) for one in words(key)]
        except ValueError:
            raise InputError(
                f"{error_prefix}: the network's metadata {key} = {metadata[key]!r:.80} are no numbers"
            ) from None
        return found[0] if len(found) == 1 else found or None

    found: dict[str, Any] = {}
    if joints := words("joint_names"):
        found["joints"] = [one.rpartition("/")[2] for one in joints]
    if (pose := numbers("default_joint_pos")) is not None:
        found["default_pose"] = pose
    if terms := words("observation_names"):
        lengths = np.ravel(numbers("observation_history_lengths") or 1).astype(int)
        if len(lengths) not in (1, len(terms)):
            raise InputError(
                f"{error_prefix}: the network's metadata observation_history_lengths has {len(lengths)} numbers, "
                f"observation_names {len(terms)}"
            )
        each = np.broadcast_to(lengths, len(terms)).tolist()
        found["observation"] = [
            one if length <= 1 else {"term": one, "history": length} for one, length in zip(terms, each, strict=True)
        ]
    action = {ours: numbers(theirs) for ours, theirs in
              (("scale", "action_scale"), ("stiffness", "joint_stiffness"), ("damping", "joint_damping"))}  # fmt: skip
    if action := {key: value for key, value in action.items() if value is not None}:
        found["action"] = action
    return found


def parse_terms(error_prefix: str, config: Any) -> tuple[ObservationTermSpec, ...]:
    """Build the observation terms of one network input from a list of names and mappings. Raises `InputError`."""
    if not isinstance(config, list | tuple) or not config:
        raise InputError(
            f"{error_prefix} is not allowed: a list of terms, such as [projected_gravity, joint_positions]"
        )
    found = []
    for k, one in enumerate(config):
        one = {"term": one} if isinstance(one, str) else one
        if not isinstance(one, Mapping) or not isinstance(one.get("term"), str):
            raise InputError(
                f"{error_prefix}[{k}] = {one!r:.80} is not allowed: a term's name, or a mapping with the key term"
            )
        term = TERM_ALIASES.get(one["term"], one["term"])
        require_choice(term, TERM_UNITS, f"{error_prefix}[{k}]: {term}")
        made = _build(ObservationTermSpec, {**one, "term": term}, f"{error_prefix}[{k}]")
        if bool(made.sensor) < (made.term == "sensor"):
            raise InputError(f"{error_prefix}[{k}]: a term `sensor` needs the key sensor")
        if made.lag and made.term not in ("last_action", "phase"):
            raise InputError(f"{error_prefix}[{k}]: lag is not allowed for {made.term}: only for last_action and phase")
        if made.term == "constant" and not made.values:
            raise InputError(f"{error_prefix}[{k}]: a term `constant` needs the key values")
        require_clip_range(f"{error_prefix}[{k}].clip", made.clip)
        found.append(made)
    require_unique_labels(error_prefix, [one.label for one in found], "twice")
    return tuple(found)


def require_unique_labels(error_prefix: str, labels: Sequence[str], where: str) -> None:
    """Raise `InputError` where two observation terms have the same label.

    Args:
        error_prefix: What messages begin with.
        labels: Labels of terms.
        where: Where the two stand, such as `twice`.
    """
    if twice := {one for one in labels if labels.count(one) > 1}:
        raise InputError(f"{error_prefix}: {min(twice)} stands {where}: give each a name of its own (key name)")


def require_clip_range(key: str, clip: Sequence[float]) -> None:
    """Raise `InputError` unless a clip range is empty, or a lower and an upper limit.

    Args:
        key: The key, for messages.
        clip: Its value.
    """
    if clip and (len(clip) != 2 or clip[0] >= clip[1]):
        raise InputError(f"{key} = {list(clip)} is not allowed: the least and the largest value")


def parse_joint_values(error_prefix: str, config: Any, joints: Sequence[str]) -> np.ndarray:
    """Return one number per joint from a number, a list, or a mapping by joint names.

    Args:
        error_prefix: Key, for messages.
        config: A number for all; a list in the order of the joints; or numbers by pattern of names, such as
            `{"*_knee": 0.5, "*": 0.25}`, of which the first that fits counts.
        joints: Names of the joints.

    Returns:
        Numbers (n,).

    Raises:
        InputError: The value has another form, or a joint has no number, or a pattern no joint.
    """
    if isinstance(config, Mapping):
        for pattern in config:
            if not fnmatch.filter(joints, str(pattern)):
                raise InputError(f"{error_prefix}: {pattern} fits no joint (joints: {', '.join(joints)})")
        first = [next((v for k, v in config.items() if fnmatch.fnmatchcase(one, str(k))), None) for one in joints]
        if None in first:
            raise InputError(f"{error_prefix} has no number for joint {joints[first.index(None)]}")
        config = first
    try:
        found = np.asarray(config, float)
    except (TypeError, ValueError):
        found = np.full(0, np.nan)
    if isinstance(config, bool) or found.shape not in ((), (len(joints),)) or not np.isfinite(found).all():
        wanted = f"a number, {len(joints)} numbers (one for each joint), or numbers by pattern of joint names"
        raise InputError(f"{error_prefix} = {config!r:.100} is not allowed: {wanted}")
    return np.broadcast_to(found, (len(joints),)).copy()


def _build(cls: Any, given: Any, error_prefix: str) -> Any:
    """Make a dataclass of this module from plain values, checked. Raises `InputError`."""
    if not isinstance(given, Mapping):
        raise InputError(f"{error_prefix} = {given!r:.80} is not allowed: keys and values")
    fields = {one.name: one for one in dataclasses.fields(cls)}
    made: dict[str, Any] = {}
    for key, value in given.items():
        require_choice(key, fields, f"{error_prefix}: {key}")
        made[key] = _checked(fields[key], value, f"{error_prefix}: {key}")
    missing = [name for name, one in fields.items() if name not in made and _has_no_default(one)]
    if missing:
        raise InputError(f"{error_prefix} needs the key {missing[0]}")
    return cls(**made)


def _has_no_default(one: Any) -> bool:
    return one.default is dataclasses.MISSING and one.default_factory is dataclasses.MISSING


def _checked(one: Any, value: Any, error_prefix: str) -> Any:
    """Return a value of a field in the field's type. Raises `InputError`."""

    def wrong(what: str) -> InputError:
        return InputError(f"{error_prefix} = {value!r:.80} is not allowed: {what}")

    if one.name in CHOICES:
        require_choice(value, CHOICES[one.name], f"{error_prefix} = {value}")
        return value
    match one.type:
        case _ if one.name == "action":
            return _build(ActionSpec, value, error_prefix)
        case _ if one.name == "recurrent":
            if not isinstance(value, list | tuple):
                raise wrong("a list such as [{input: h_in, output: h_out}]")
            return tuple(_build(RecurrentSpec, each, f"{error_prefix}[{k}]") for k, each in enumerate(value))
        case _ if one.name in ("commands", "sensors"):
            kind, what = ((int, float), "numbers") if one.name == "commands" else (str, "sensors")
            if not isinstance(value, Mapping) or not all(isinstance(v, kind) for v in value.values()):
                raise wrong(f"{what} by name")
            if odd := next((name for name in value if not str(name).isidentifier()), None):
                raise InputError(f"{error_prefix} has {odd!r}: a name has letters, digits and _")
            return dict(value)
        case t if t is str:
            if not isinstance(value, str):
                raise wrong("a word")
        case t if t is bool:
            if not isinstance(value, bool):
                raise wrong("true or false")
        case t if t is int:
            least = int(one.name != "lag")
            if type(value) is not int or value < least:
                raise wrong(f"a whole number from {least} on")
        case t if t is float:
            if type(value) not in (int, float) or not np.isfinite(value) or (one.name != "start" and value <= 0):
                raise wrong("a number" if one.name == "start" else "a number above 0")
        case t if t == Numbers or t == tuple[float, ...]:
            numbers = value if isinstance(value, list | tuple) else [value] if t == Numbers else None
            if numbers is None or not all(type(v) in (int, float) and np.isfinite(v) for v in numbers):
                raise wrong("numbers")
            return tuple(map(float, numbers)) if isinstance(value, list | tuple) else float(value)
        case t if t == tuple[int, ...]:
            if not isinstance(value, list | tuple) or not all(type(v) is int and v >= 1 for v in value):
                raise wrong("whole numbers from 1 on")
            return tuple(value)
        case t if t == tuple[str, ...]:
            if not isinstance(value, list | tuple) or not all(isinstance(v, str) for v in value):
                raise wrong("a list of names")
            if len({*value}) < len(value):
                raise wrong("each name once")
            return tuple(value)
        case _:
            pass
    return value
