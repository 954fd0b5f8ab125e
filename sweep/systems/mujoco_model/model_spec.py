"""Settings of a MuJoCo model and its controller: files, observations and measurements."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import mujoco
import numpy as np

from sweep.contract.engine import TimeSeriesGroup
from sweep.contract.engine_settings import EngineSettings
from sweep.contract.system import ColumnValues, Parameter
from sweep.core.errors import InputError, require_choice
from sweep.core.metric import array_namespace
from sweep.core.parameters import choice, parameters, quantity
from sweep.systems.mujoco_model import fields, files, initial_state, terrain, terrain_heights
from sweep.systems.mujoco_model.actuator_networks import ActuatorNetwork
from sweep.systems.mujoco_model.disturbances import PUSH_PARAMETERS, PushedBody
from sweep.systems.mujoco_model.motors import MOTOR, MotorGroup, MotorLaw, make_motor_law
from sweep.systems.mujoco_model.payloads import PAYLOAD, Payload, add_payloads
from sweep.systems.mujoco_model.policy_spec import VELOCITY_COMMANDS
from sweep.systems.mujoco_model.schedules import FACTOR, Schedule
from sweep.systems.mujoco_model.terrain import TerrainConfig

DATA_ARRAYS = ("cfrc_ext", "cinert", "cvel", "qfrc_actuator", "subtree_com", "xipos", "xpos", "xquat")  # of mjData
FORCE_SENSORS = tuple(
    int(getattr(mujoco.mjtSensor, f"mjSENS_{kind}"))
    for kind in ("ACCELEROMETER", "FORCE", "TORQUE", "FRAMELINACC", "FRAMEANGACC")
)  # for which MuJoCo computes cfrc_ext
FILE_PATHS = ("model.mjcf", "model.controller", "model.terrain.file")  # whose values are files or modules


@dataclass(frozen=True)
class ModelConfig:
    """Parameters of the configuration group `model`."""

    mjcf: str = ""  # file, from the project's folder
    controller: str = ""  # module:function
    period: float = quantity(0.02, "s", above=0, at_most=1)  # of a control tick
    duration: float = quantity(10.0, "s", above=0, at_most=3600)  # of a rollout, at most
    keyframe: str = ""  # that it starts from; else the model's own pose
    observe: tuple[str, ...] = ()  # qpos, qvel, or sensors by name; none are all sensors, of a model without any both
    data: tuple[str, ...] = ()  # arrays of mjData, such as cfrc_ext, that controllers and metrics read like sensors
    feet: tuple[str, ...] = ()  # touch sensors, whose sites' slips are measured
    collisions: tuple[str, ...] = ()  # touch sensors of what should touch nothing
    direction: tuple[float, ...] = (1.0, 0.0, 0.0)  # that it should go in, of the world's axes
    command: str = choice("held", "held", "ramped")  # over a tick: as given, or evenly from the one before
    # whether sensors belong to the observed positions and velocities, by MuJoCo's forward pass before each observation,
    # or are as the last physics step began, as in studies of before
    sensors: str = choice("stepped", "stepped", "current")
    option: tuple[tuple[str, Any], ...] = ()  # of MuJoCo's other than the file's, by path: how it is simulated
    terrain: TerrainConfig | None = None  # in the place of the floor
    content: str = ""  # digest of model and controller, set by the first run


@parameters
class ModelEngineSettings(EngineSettings):
    """Engine settings of a MuJoCo model, with the additional engines `warp` and `kernel`."""

    name: str = choice("native", "native", "mjx", "warp", "kernel")


NOISE_PARAMETERS = {  # errors of what the controller observes, alike in all components, in their own units
    "noise.white": quantity(0.0, "", at_least=0),  # deviation, drawn anew at every tick
    "noise.bias": quantity(0.0, "", at_least=0),  # deviation of the constant error
    "noise.delay": quantity(0.0, "ticks", at_least=0, at_most=50),  # whole control ticks that it is late by
    "noise.action_delay": quantity(0.0, "steps", at_least=0, at_most=1000),  # physics steps that commands are late by
}

PHYSICAL = ("push", "start", "payload", "motor")  # groups of the world, beside `model` and `noise`

TERM_NOISE_PARAMETERS = {  # errors of one term of a learned policy's observation, in its unit, before clip and scale
    "white": quantity(0.0, "", at_least=0),  # deviation, drawn anew at every tick, beside that of `noise.white`
    "bias": quantity(0.0, "", at_least=0),  # deviation of the constant error, beside that of `noise.bias`
    "delay": quantity(0.0, "ticks", at_least=0, at_most=50),  # whole control ticks, beside those of `noise.delay`
    "dropout": quantity(0.0, "", at_least=0, at_most=1),  # share of ticks in which the last value stays
}


@dataclass(frozen=True)
class ParameterOverrides:
    """Parameter values, by path, in which the simulated world or the belief differs from the nominal model."""

    values: tuple[tuple[str, Any], ...] = ()

    def select_group(self, root: str) -> dict[str, Any]:
        """Return the parameter values whose paths start with the group `root`."""
        return {path: value for path, value in self.values if path.startswith(f"{root}.")}


def append_arrays(sensordata: Any, arrays: Iterable[Any]) -> Any:
    """Append arrays of mjData, flattened, to the sensor values of n rollouts.

    Args:
        sensordata: Sensor values (n, nsensordata).
        arrays: Arrays (n, ...) in the order of `model.data`.

    Returns:
        Numbers (n, k).
    """
    flat = [one.reshape(len(sensordata), -1) for one in arrays]
    return array_namespace(sensordata).concatenate([sensordata, *flat], axis=1) if flat else sensordata


@dataclass(frozen=True)
class ModelSpec:
    """A MuJoCo model with its controller and noise, at nominal values."""

    config: ModelConfig
    controller_values: tuple[tuple[str, float], ...]  # of all `parameters` by path
    delay_buffer: int = 0  # ticks of delay
    action_buffer: int = 0  # physics steps of delay of the commands
    pushes: tuple[PushedBody, ...] = ()
    payloads: tuple[Payload, ...] = ()
    motors: tuple[MotorGroup, ...] = ()
    schedules: tuple[Schedule, ...] = ()
    actuator_networks: tuple[ActuatorNetwork, ...] = ()

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The compiled model with its payloads and the options of the configuration."""
        return self.compile_with_height_fields(1)

    def compile_with_height_fields(self, count: int) -> mujoco.MjModel:
        """Compile the model with a number of level height fields as its terrain, where it has one."""
        compiled = files.load_model(self.config.mjcf, self.config.terrain, count)
        if self.payloads:
            view = compiled.stat
            compiled = self._load_source(count).compile()
            if self.config.terrain:
                compiled.stat.extent, compiled.stat.center[:] = view.extent, view.center
        return fields.replace_scalar_options(compiled, dict(self.config.option))

    def load_source(self) -> mujoco.MjSpec:
        """Load the source (MJCF or URDF) from which the model is compiled. Raises `InputError`."""
        return self._load_source(1)

    def _load_source(self, count: int) -> mujoco.MjSpec:
        source = files.load_spec(self.config.mjcf, self.config.terrain, count)
        return add_payloads(source, self.payloads) if self.payloads else source

    @cached_property
    def motor_law(self) -> MotorLaw | None:
        """Law that clips controls to what motors can deliver; None if no joint has a motor."""
        return make_motor_law(self.model, self.motors, self.actuator_networks)

    def select_model_values(self, world: ParameterOverrides) -> dict[str, Any]:
        """Select the parameter values, by path, that are numbers of the compiled model."""
        own = world.select_group("model").items()
        return {path: value for path, value in own if not terrain.is_terrain_path(path) and path not in FILE_PATHS}

    def make_terrain(self, world: ParameterOverrides, n: int) -> terrain.TerrainBatch | None:
        """Make the terrains of n rollouts; None without terrain.

        Args:
            world: The simulated side.
            n: Number of rollouts.
        """
        shape = self.config.terrain
        if shape is None:
            return None
        own = world.select_group("model")
        values = {**dict(self.controller_values), **own}
        numbers = {name: np.broadcast_to(values[terrain.PREFIX + name], (n,)) for name in terrain_heights.NUMBERS}
        image = files.read_terrain_image(shape.file) if shape.kind == "image" else None
        return terrain.make_terrain_batch(shape, numbers, any(terrain.PREFIX + name in own for name in numbers), image)

    @cached_property
    def controller(self) -> files.LoadedController:
        """The controller that the configuration names, loaded."""
        about = self.config
        return files.load_controller(about.controller, self.model, self.keyframe_index, about.period)

    @cached_property
    def parameters(self) -> dict[str, Parameter]:
        """Parameters of noise, pushes, controller and terrain with units and bounds, by path."""
        pushes = {f"push.{one.name}.{key}": about for one in self.pushes for key, about in PUSH_PARAMETERS.items()}
        own = {f"controller.{name}": quantity(value, "") for name, value in self.controller.parameters.items()}
        learned = self.controller.fitted_policy
        labels = learned.measured_terms if learned else ()
        terms = {f"noise.{label}.{key}": about for label in labels for key, about in TERM_NOISE_PARAMETERS.items()}
        ground = terrain_heights.NUMBERS if self.config.terrain else {}
        grounds = {terrain.PREFIX + name: about for name, about in ground.items()}
        loads = {f"payload.{one.name}.{key}": about for one in self.payloads for key, about in PAYLOAD.items()}
        drives = {f"motor.{one.name}.{key}": about for one in self.motors for key, about in MOTOR.items()}
        start = initial_state.default_parameters(self.model, self.base_qpos_address is not None)
        schedules = {f"schedule.{one.name}.factor": FACTOR for one in self.schedules}
        return NOISE_PARAMETERS | terms | pushes | loads | drives | start | own | schedules | grounds

    @cached_property
    def pushed_bodies(self) -> np.ndarray:
        """Indices (p,) of the bodies that pushes act on."""
        return np.array([self.model.body(one.body).id for one in self.pushes], int)

    @property
    def tracked_commands(self) -> tuple[str, ...]:
        """Names of the velocity commands for which tracking errors are computed."""
        names = tuple(name for name in VELOCITY_COMMANDS if name in self.controller.parameters)
        is_tracked = self.base_qpos_address is not None and (self.controller.fitted_policy or self.schedules)
        return names if is_tracked else ()

    @property
    def base_qpos_address(self) -> int | None:
        """Index in `qpos` of the model's first free joint (its base); None without one."""
        free = np.flatnonzero(self.model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE))
        return int(self.model.jnt_qposadr[free[0]]) if len(free) else None

    def touch_sensors(self, key: str) -> list[int]:
        """Return the ids of the touch sensors that `model.feet` or `model.collisions` lists. Raises `InputError`."""
        names, sensors = getattr(self.config, key), self._sensor_names.values()
        for name in names:
            require_choice(name, sensors, f"model.{key}: {name}")
            if self.model.sensor(name).type != int(mujoco.mjtSensor.mjSENS_TOUCH):
                raise InputError(f"model.{key}: {name} is not a touch sensor")
        return [self.model.sensor(name).id for name in names]

    @property
    def keyframe_index(self) -> int:
        """Index of the keyframe at which rollouts start; -1 for the model's default pose. Raises `InputError`."""
        names, name = [self.model.key(k).name for k in range(self.model.nkey)], self.config.keyframe
        if name:
            require_choice(name, names, f"model.keyframe = {name}")
        return names.index(name) if name else -1

    def observable_state(self, qpos: Any, qvel: Any, sensors: Any) -> Any:
        """Return the observable states (n, s) without noise: positions, velocities and sensors in one array.

        Args:
            qpos: Positions (n, nq).
            qvel: Velocities (n, nv).
            sensors: Sensor values followed by the arrays of `model.data`, see `append_arrays`.
        """
        return array_namespace(qpos).concatenate([qpos, qvel, sensors], axis=1)

    @cached_property
    def data_sizes(self) -> dict[str, int]:
        """Number of elements of each array that `model.data` lists. Raises `InputError`."""
        found, state = {}, mujoco.MjData(self.model)
        for name in self.config.data:
            require_choice(name, DATA_ARRAYS, f"model.data: {name}")
            if name == "cfrc_ext" and not np.isin(self.model.sensor_type, FORCE_SENSORS).any():
                raise InputError(
                    "model.data: cfrc_ext needs an accelerometer, force or torque sensor in the model, because MuJoCo "
                    "computes external forces only for these"
                )
            if name in self._sensor_names.values():
                raise InputError(f"model.data: {name} is the name of a sensor: rename the sensor")
            found[name] = getattr(state, name).size
        return found

    @cached_property
    def _sensor_names(self) -> dict[int, str]:
        return {k: name for k in range(self.model.nsensor) if (name := self.model.sensor(k).name)}

    @property
    def state_size(self) -> int:
        """Number of elements of an observable state: positions, velocities, sensors, and arrays of `model.data`."""
        return self.model.nq + self.model.nv + self.model.nsensordata + sum(self.data_sizes.values())

    @cached_property
    def state_slices(self) -> dict[str, slice]:
        """Slices of the state array in which `qpos`, `qvel`, sensors, and arrays of `model.data` lie, by name."""
        model, first = self.model, self.model.nq + self.model.nv
        found = {"qpos": slice(0, model.nq), "qvel": slice(model.nq, first)}
        starts, sizes = first + model.sensor_adr, model.sensor_dim
        found |= {name: slice(starts[k], starts[k] + sizes[k]) for k, name in self._sensor_names.items()}
        first += model.nsensordata
        for name, size in self.data_sizes.items():
            found[name] = slice(first, first + size)
            first += size
        return found

    def split_state(self, state: Any) -> dict[str, Any]:
        """Split one state array (s,) into positions, velocities and sensors, by name."""
        return {name: state[place] for name, place in self.state_slices.items()}

    def observe_state(self, state: Any) -> Any:
        """Return the observation (k,) of one controller without noise, from an observable state (s,)."""
        if self.controller.observe:
            return self.controller.observe(self.split_state(state))
        return array_namespace(state).concatenate([state[place] for place in self.observed_slices])

    @cached_property
    def observed_slices(self) -> list[slice]:
        """Slices of the observable state that the controller observes: `model.observe`, by default all sensors."""
        model, names = self.model, self.config.observe
        if names and self.controller.observe:
            raise InputError("model.observe is not allowed: the controller has a function `observe`")
        for name in names:
            require_choice(name, self.state_slices, f"model.observe: {name}")
        first = model.nq + model.nv
        usual = slice(first, first + model.nsensordata) if model.nsensordata else slice(0, first)
        return [self.state_slices[name] for name in names] or [usual]

    def believed_values(self, values: ColumnValues) -> dict[str, Any]:
        """Return the controller's believed parameters by its own names: `values` by path, else nominal values."""
        paths = {**self.controller.belief_paths, **{name: f"controller.{name}" for name in self.controller.parameters}}
        return {name: values[path] if path in values else self.nominal_value(path) for name, path in paths.items()}

    @property
    def body_names(self) -> list[str]:
        """Names of the model's bodies, without the world."""
        return [self.model.body(k).name for k in range(1, self.model.nbody)]

    @property
    def choices_by_path(self) -> dict[str, str]:
        """Names that an axis may replace by building another system: files and pushed bodies, by path."""
        files_by_path = {path: self.nominal_file_of_parameter(path) for path in FILE_PATHS}
        return files_by_path | {f"push.{one.name}.body": one.body for one in self.pushes}

    def nominal_file_of_parameter(self, path: str) -> str:
        """Return the nominal file or module of a parameter that names a file, such as `model.mjcf`."""
        owner = self.config.terrain if terrain.is_terrain_path(path) else self.config
        return getattr(owner, path.rpartition(".")[2], "")

    def nominal_value(self, path: str) -> Any:
        """Return the nominal value of a parameter path. Raises `InputError` where there is none."""
        if path in self.choices_by_path:
            return self.choices_by_path[path]
        numbers = dict(self.controller_values)
        return numbers[path] if path in numbers else fields.parameter_field(self.model, path).default

    @property
    def policy_columns(self) -> tuple[str, ...]:
        """Columns of a learned policy's observations and actions; none for other controllers."""
        return self.controller.fitted_policy.recorded_columns if self.controller.fitted_policy else ()

    @property
    def policy_groups(self) -> tuple[TimeSeriesGroup, ...]:
        """The `policy_columns` by observation term, and of the action."""
        return self.controller.fitted_policy.recorded_groups if self.controller.fitted_policy else ()

    def time_series_columns(
        self, qpos: np.ndarray, qvel: np.ndarray, recorded: np.ndarray | None = None
    ) -> dict[str, np.ndarray]:
        """Return the time-series columns, (n,) each, of n recorded states.

        Args:
            qpos: Positions (n, nq).
            qvel: Velocities (n, nv).
            recorded: Observations and actions (n, k) of a learned policy, see `policy_columns`.
        """
        columns = {}
        if (at := self.base_qpos_address) is not None:
            columns = {f"base_{axis}_m": qpos[:, at + k] for k, axis in enumerate("xyz")}
            upright = self.model.qpos0[at + 3 : at + 7]
            columns["tilt_deg"] = arccos_deg(cosine_of_tilt(qpos[:, at + 3 : at + 7], upright))
        columns |= {f"qpos_{k}": qpos[:, k] for k in range(self.model.nq)}
        columns |= {f"qvel_{k}": qvel[:, k] for k in range(self.model.nv)}
        if recorded is None:
            return columns
        return columns | {name: recorded[:, k] for k, name in enumerate(self.policy_columns)}


def cosine_of_tilt(quat: Any, start: Any) -> Any:
    """Return the cosine of the angle between the upward axes of two orientations.

    Args:
        quat: Unit quaternions (..., 4), body to world.
        start: Unit quaternions (..., 4), body to world.

    Returns:
        Cosines (...).
    """
    a, b = (up_axis(array_namespace(quat).moveaxis(one, -1, 0)) for one in (quat, start))
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def up_axis(quat: Any) -> tuple[Any, Any, Any]:
    """Return the z axis of a body in world axes, as three components, from its unit quaternion (4, ...)."""
    w, x, y, z = quat
    return 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)


def arccos_deg(cosine: Any) -> Any:
    """Return the angle of a cosine in degrees; cosines beyond 1 by rounding are clipped."""
    xp = array_namespace(cosine)
    return xp.degrees(xp.arccos(xp.clip(cosine, -1, 1)))
