"""A user's MuJoCo model with a user's controller as a system for studies.

Paths are `model.<kind>.<name>.<field>[.component]` (see `fields`), `noise.white`, `noise.bias`, `noise.delay`, and
`controller.<name>` for the entries of the controller's `PARAMETERS`.
"""

import dataclasses
import functools
import hashlib
import json
import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from sweep.backends import mujoco_versions, run_id
from sweep.contract.engine import Trace
from sweep.contract.engine_settings import EngineSettings
from sweep.contract.system import (
    AuditVariant,
    ClassesByKind,
    ColumnValues,
    Parameter,
    PushColumns,
    SystemSetup,
    split_side_prefix,
    split_world_and_belief,
)
from sweep.core.conditions import UNTRUSTED, Condition, parse_conditions
from sweep.core.errors import InputError, require_choice
from sweep.core.outcomes import classify_rows, judge_cause
from sweep.core.parameters import build_instance, choice, convert_and_check_value, file_name, quantity
from sweep.systems.mujoco_model import (
    disturbances,
    fields,
    files,
    inactive_parameters,
    initial_state,
    motors,
    payloads,
    policy_spec,
    schedules,
    terrain,
    terrain_heights,
    tracking,
)
from sweep.systems.mujoco_model.accumulator import MetricAccumulator
from sweep.systems.mujoco_model.engine import ON_NATIVE, ModelEngine, NativeModelEngine, print_note_once
from sweep.systems.mujoco_model.metrics import CAUSES
from sweep.systems.mujoco_model.model_spec import (
    FILE_PATHS,
    PHYSICAL,
    ModelConfig,
    ModelEngineSettings,
    ModelSpec,
    ParameterOverrides,
)

if TYPE_CHECKING:
    import mujoco
    import pandas as pd

ENGINE_AXES = (
    "name",
    "width",
    "precision",
)  # settings that the engine of a user model reads, beside the period of a tick
ENGINE_SETTINGS = (*ENGINE_AXES, "control_period", "cross_check")
OTHER_CONE = {"elliptic": "pyramidal", "pyramidal": "elliptic"}
AUDIT_VARIANTS = {
    "again": AuditVariant("as before, in batches of another width"),
    "half_step": AuditVariant("half the time step", columns={"model.option.timestep": lambda step: step / 2}),
    "float64": AuditVariant("in double precision", lambda s: replace(s, precision="float64")),
    "other_engine": AuditVariant(
        "on the other engine", lambda s: replace(s, name="mjx" if s.name == "native" else "native")
    ),
    "other_cone": AuditVariant("with the other friction cone", columns={"model.option.cone": OTHER_CONE.get}),
}
INVALID_CAUSES = tuple(cause.name for cause in CAUSES if cause.invalid)
CAUSE_MEANINGS = {cause.name: cause.sentence for cause in CAUSES}


def label_rollouts(
    figures: Mapping[str, np.ndarray], limits: tuple[Condition, ...], stages: Sequence[str]
) -> dict[str, np.ndarray]:
    """Label rollouts with outcome and cause: built-in causes first, then the scenario's first condition that holds."""
    none = np.zeros(len(next(iter(figures.values()))), int)
    causes = [judge_cause(cause, figures, cause.limit(cause.default), none) for cause in CAUSES]
    causes += [condition.judge_rows(figures) for condition in limits]
    return classify_rows(causes, none, stages, unknown_margin=np.inf)


@dataclass(frozen=True)
class MujocoModel(ModelSpec):
    """A user's MuJoCo model with its controller; implements `System`."""

    conditions: tuple[Condition, ...] = ()
    values: str = ""  # configuration as JSON, from which variants with other files are built
    listed: tuple[tuple[str, tuple[str, ...]], ...] = ()  # files that axes list, by path

    case = ParameterOverrides()
    groups = ("model", "controller", "noise", *PHYSICAL, "schedule")
    invalid_causes = (*INVALID_CAUSES, UNTRUSTED)
    bookkeeping_metrics = frozenset({*INVALID_CAUSES, ON_NATIVE})
    replay_formats = ("mcap", "states", "png", "video")
    replay_plots = MappingProxyType({})
    unsupported_commands = MappingProxyType(
        {
            "tune": "vary the controller's parameters as axes instead (controller.*)",
            "export-model": "it is a MuJoCo model already",
        }
    )
    audit_variants = MappingProxyType(AUDIT_VARIANTS)
    device = staticmethod(run_id.describe_device)
    explain_inactive_column = inactive_parameters.explain_inactive
    judge = staticmethod(label_rollouts)

    @property
    def cause_names(self) -> tuple[str, ...]:
        """Names of all causes of failure or invalidity: those of the scenario's conditions, then built-in ones."""
        return tuple(self.cause_meanings(self.conditions))

    def cause_meanings(self, limits: tuple[Condition, ...]) -> dict[str, str]:
        """Return the meaning of each cause of failure by name; conditions contain their thresholds."""
        return {one.cause: one.meaning for one in limits} | CAUSE_MEANINGS

    @property
    def metric_names(self) -> tuple[str, ...]:
        """Names of the metrics of any MuJoCo model, and those of its controller."""
        tracked = tracking.tracking_columns(self.tracked_commands)
        return (*MetricAccumulator(self).columns, *self.controller.metric_meanings, *tracked)

    def state_values_by_column(self, trace: Trace) -> dict[str, np.ndarray]:
        """Return positions and velocities of the model at every sample of a trace, by column."""
        return self.time_series_columns(trace.qpos, trace.qvel) | dict(trace.columns)

    def model_xml(self, trace: Trace, settings: EngineSettings) -> str:
        """Raise `InputError`: there is nothing to export, as the user's model is a file already."""
        raise InputError("--model is not allowed: the model is a file of the project")

    @property
    def recordable_columns(self) -> tuple[str, ...]:
        """Names of time-series columns: positions, velocities, and inputs and outputs of a learned policy."""
        state = self.time_series_columns(self.model.qpos0[None], np.zeros((1, self.model.nv)))
        return (*state, *self.policy_columns)

    def source_files(self) -> dict[str, Path]:
        """Return the source files of the model and its controller, by path within the project."""
        if _content_digest(self) != self.config.content:
            raise InputError("model or controller changed after the study was run")
        found, place = {}, files.project_folder().resolve()
        for file in _list_source_files(self):
            if not file.resolve().is_relative_to(place):
                raise InputError(f"{file} is not allowed: a crate contains only files of the project")
            found[str(file.resolve().relative_to(place))] = file
        return found

    @property
    def push_columns(self) -> dict[str, PushColumns]:
        """Parameters of each push of the scenario, by its name."""
        paths = {one.name: f"push.{one.name}." for one in self.pushes}
        return {
            name: PushColumns((f"{path}impulse", f"{path}force"), f"{path}direction", f"{path}start", f"{path}body")
            for name, path in paths.items()
        }

    def start_pose(self) -> "tuple[mujoco.MjModel, np.ndarray]":
        """Return the nominal model, and the positions (nq,) of its keyframe or default pose."""
        at = self.keyframe_index
        return self.model, np.array(self.model.qpos0 if at < 0 else self.model.key_qpos[at])

    @property
    def engine_names(self) -> tuple[str, ...]:
        """Names of the engines that simulate MuJoCo models."""
        return ModelEngineSettings.__dataclass_fields__["name"].metadata["options"]

    def select_engine(self, settings: EngineSettings, name: str) -> EngineSettings:
        """Return the settings with which another engine simulates the same rollouts."""
        return replace(settings, name=name)

    def settings_summary(self, settings: EngineSettings) -> dict[str, str]:
        """Return files, engine and time step as texts for readers of a report, by name."""
        listed = {path: ", ".join(names) for path, names in self.listed}
        model, controller = (listed.get(path, self.nominal_file_of_parameter(path)) for path in FILE_PATHS[:2])
        about = {"model": model, "controller": controller, "engine": settings.name}
        return {**about, "step": f"{1000 * self.model.opt.timestep:g} ms"}

    def parameter(self, column: str, settings: EngineSettings) -> Parameter:
        """Return unit, bounds and default of a parameter of the model, controller, noise or engine."""
        path = split_side_prefix(column)[1]
        require_choice(
            root := path.partition(".")[0], (*self.groups, "engine"), f"axis {column} is not allowed: {root}"
        )
        if path in FILE_PATHS:
            if column != path:
                raise InputError(f"axis {column} is not allowed: a file belongs to both sides, leave out side")
            return file_name(self.nominal_file_of_parameter(path))
        if path in self.choices_by_path:  # beside files: pushed bodies
            if column != path:
                raise InputError(f"axis {column} is not allowed: a pushed body belongs to both sides, leave out side")
            return choice(self.choices_by_path[path], *self.body_names)
        if terrain.is_terrain_path(path):
            return self._terrain_parameter(path)
        if root == "model":
            found = fields.parameter_field(self.model, path)
            fields.require_variable_parameter(self.load_source, self.model, path)
            return found
        those = {
            f"engine.{one.name}": one for one in dataclasses.fields(ModelEngineSettings) if one.name in ENGINE_AXES
        }
        require_choice(path, {**self.parameters, **those}, f"axis {column} is not allowed: {path}")
        if root == "engine":
            return those[path]
        return dataclasses.field(default=self.nominal_value(path), metadata=self.parameters[path].metadata)

    def _terrain_parameter(self, path: str) -> Parameter:
        """Return the field of a parameter of the terrain. Raises `InputError`."""
        shape, name = self.config.terrain, path.removeprefix(terrain.PREFIX)
        if shape is None:
            raise InputError(f"axis {path} is not allowed: the scenario has no model.terrain")
        require_choice(name, terrain.PARAMETERS, f"axis {path} is not allowed: {name}")
        value = self.nominal_value(path) if path in self.parameters else getattr(shape, name)
        return dataclasses.field(default=value, metadata=terrain.PARAMETERS[name].metadata)

    def nominal_parameter_value(self, column: str, settings: EngineSettings) -> Any:
        """Return the nominal value of a parameter of the model or its settings."""
        root, _, name = column.partition(".")
        return getattr(settings, name) if root == "engine" else self.parameter(column, settings).default

    def iterate_physical_inputs(self, paths: Sequence[str]) -> Iterator[tuple[str, Any]]:
        """Yield the inputs that affect results: a digest of the model, settings of the rollout, and varied numbers."""
        about = self.config
        yield from self.controller_values
        yield "model", about.content
        sensors = () if about.sensors == ModelConfig.sensors else (about.sensors,)  # ids of before stay as they are
        data = (about.data,) if about.data else ()  # likewise
        rollout = (about.period, about.duration, about.keyframe, about.observe, about.command, *sensors, *data)
        yield "model.rollout", repr(rollout)
        if self.config.terrain:
            yield from self.config.terrain.values_by_path().items()
        yield from self._varied_numbers(paths)
        for name, parts in (("push", self.pushes), ("payload", self.payloads), ("motor", self.motors),
                            ("schedule", self.schedules), ("network", self.actuator_networks)):  # fmt: skip
            if parts:
                yield name, repr([tuple(one) for one in parts])

    def max_rollouts_for_cpu(self, settings: EngineSettings) -> int:
        """Return 0, so that runs never move to the CPU because they have few rollouts."""
        return 0

    def inputs_left_out_of_point_ids(self, paths: Sequence[str]) -> Iterator[tuple[str, Any]]:
        """Yield path and nominal value of inputs that point ids omit while they have these values."""
        yield from self._varied_numbers(paths)
        yield "noise.action_delay", 0.0
        yield from ((path, 0.0) for path in self.parameters if path.startswith(f"{initial_state.START}."))

    def _varied_numbers(self, paths: Sequence[str]) -> Iterator[tuple[str, Any]]:
        yield from ((path, self.nominal_value(path)) for path in paths
                    if path.startswith("model.") and not terrain.is_terrain_path(path))  # fmt: skip

    def controller_range_warnings(self, table: "pd.DataFrame", settings: EngineSettings) -> tuple[str, ...]:
        """Return nothing: the ranges for which a user's controller was made are unknown."""
        return ()

    def check(self, table: "pd.DataFrame", settings: EngineSettings) -> None:
        """Raise `InputError` for varied parameters without effect, an invalid controller, or an unsuitable engine."""
        columns = [c for c in map(str, table.columns) if "." in c and not c.startswith("axis.")]
        for column in columns:
            if column.startswith(("world.controller.", "world.schedule.")):
                raise InputError(f"axis {column} varies nothing: the controller's parameters belong to the belief")
        for path in (path for path in FILE_PATHS if path in columns):
            known = {self.nominal_file_of_parameter(path), *dict(self.listed).get(path, ())}
            for name in set(table[path]) - known:
                raise InputError(f"{path} = {name} is not allowed: an axis of the study lists the files in its values")
        shaping = [c for c in columns if self.parameter(c, settings).metadata["role"] != "quantity"]
        distinct: list[Any] = table[shaping].drop_duplicates().to_dict("records") if shaping else [{}]
        varied = {
            path for side, path in map(split_side_prefix, columns) if side != "belief" and path.startswith("model.")
        }
        grounds = {path for path in varied if terrain.is_terrain_path(path)}
        varied -= {*grounds, *FILE_PATHS}
        self._check_terrain(table, grounds)
        for path in sorted(path for path in varied if fields.is_group(path)):
            members = fields.group_members(self.model, path)
            print_note_once(f"{path} moves {len(members)} numbers, {members[0]} to {members[-1]}")
        started: set[tuple[str, str]] = set()
        for values in distinct:
            ways = {c.removeprefix("engine."): value for c, value in values.items() if c.startswith("engine.")}
            system = self.with_choices(values)
            system.require_parameters(columns if system is not self else (), settings)
            made = self.make_engine(replace(settings, **ways), *self.make_world_and_belief(values), limits=None)
            for line in made.check_varied_parameters(
                [*fields.select_batchable_values(system.model, dict.fromkeys(varied)), *grounds]
            ):
                print_note_once(line)
            new = {(path, system.nominal_file_of_parameter(path)) for path in FILE_PATHS[:2]} - started
            if new and system is not self:
                made.check_first_controls()
            started |= new
        self.make_engine(settings, *self.make_world_and_belief({}), limits=None).check_first_controls()

    def require_parameters(self, columns: Iterable[str], settings: EngineSettings) -> None:
        """Raise `InputError` if a study varies a parameter that this model or its controller does not have.

        Args:
            columns: Columns of the study.
            settings: Engine settings.
        """
        for column in columns:
            try:
                self.parameter(column, settings)
            except InputError as error:
                chosen = f"model.mjcf = {self.config.mjcf}, model.controller = {self.config.controller}"
                raise InputError(f"{error} (with {chosen})") from None

    def with_choices(self, values: ColumnValues) -> "MujocoModel":
        """Return this system with other model or controller files, or pushes on other bodies.

        Args:
            values: Values by path; those of `choices_by_path` count.

        Raises:
            InputError: The files do not fit together.
        """
        chosen = {path: str(values[path]) for path in self.choices_by_path if path in values}
        if all(name == self.choices_by_path[path] for path, name in chosen.items()):
            return self
        made = _build_variant(self.values, tuple(chosen.items()), self.config.content)
        room = max(made.delay_buffer, self.delay_buffer), max(made.action_buffer, self.action_buffer)
        return replace(made, delay_buffer=room[0], action_buffer=room[1])

    def _check_terrain(self, table: "pd.DataFrame", paths: Collection[str]) -> None:
        """Refuse terrains whose heights leave the range of height fields, and those without their image.

        Args:
            table: Points.
            paths: Paths of the terrain's parameters that vary.
        """
        shape = self.config.terrain
        if shape is None:
            return
        columns = {path: next(c for c in (f"world.{path}", path) if c in table) for path in paths}
        static = [path for path in paths if self._terrain_parameter(path).metadata["role"] != "quantity"]
        groups = table.groupby([columns[path] for path in static]) if static else [((), table)]
        for values, rows in groups:
            chosen = shape.replace_settings(dict(zip(static, values, strict=True)))
            terrain.check_terrain_size(chosen)
            numbers = {
                name: rows[columns[path]].to_numpy() if path in columns else self.nominal_value(path)
                for name, path in ((name, terrain.PREFIX + name) for name in terrain_heights.NUMBERS)
            }
            terrain.check_height_range(chosen, numbers)

    def find_stochastic_rows(self, rows: "pd.DataFrame", settings: EngineSettings) -> np.ndarray:
        """Return which rows draw random numbers, for sensor errors or possibly in the controller."""
        return np.ones(len(rows), dtype=bool)

    def make_world_and_belief(self, values: ColumnValues) -> tuple[ParameterOverrides, ParameterOverrides]:
        """Make the values for the simulated world and those that the controller believes, from values by column."""
        world, belief = (
            ParameterOverrides(tuple(chosen.items())) for chosen in split_world_and_belief(values).values()
        )
        return world, belief

    def allocate_delay_buffers(self, table: "pd.DataFrame") -> "MujocoModel":
        """Return this system with observation and command buffers long enough for the longest delays in a study."""

        def longest(path: str) -> int:
            varied = [table[c].max() for c in table.columns if split_side_prefix(c)[1] == path]
            return math.ceil(max([self.nominal_value(path), *varied]))

        terms = [longest(path) for path in self.parameters if path.startswith("noise.") and path.count(".") > 1
                 and path.endswith(".delay")]  # fmt: skip
        room = longest("noise.delay") + max(terms, default=0)
        action_room = max(self.action_buffer, longest("noise.action_delay"))
        return replace(self, delay_buffer=max(self.delay_buffer, room), action_buffer=action_room)

    def make_engine(
        self, settings: EngineSettings, world: ParameterOverrides, belief: ParameterOverrides, limits: Any
    ) -> ModelEngine:
        """Compile an engine that simulates the model on C MuJoCo, MJX or a kernel."""
        chosen = self.with_choices(dict(world.values))
        model, shape = self.select_model_values(world), chosen.config.terrain
        shared = {
            path: value
            for path, value in model.items()
            if path not in fields.select_batchable_values(chosen.model, model)
        }
        ground = shape.replace_settings(world.select_group("model")) if shape else None
        option = (*chosen.config.option, *shared.items())
        system = replace(chosen, config=replace(chosen.config, option=option, terrain=ground))
        made = self._make_engine(system, settings)
        made.columns = None if chosen is self else self.metric_names
        return made

    def _make_engine(self, system: "MujocoModel", settings: EngineSettings) -> ModelEngine:
        if settings.name == "native":
            return NativeModelEngine(system, settings)
        if settings.name == "kernel":
            from sweep.systems.mujoco_model.kernel_engine import KernelModelEngine  # slow to import

            return KernelModelEngine(system, settings)
        mujoco_versions.require_mjx(f"engine.name = {settings.name}", "engine=native")
        from sweep.systems.mujoco_model.mjx import MjxModelEngine  # slow to import

        return MjxModelEngine(system, settings)

    def run_id(self, settings: EngineSettings) -> str:
        """Hash everything that decides how a row is simulated; C MuJoCo's batch width and threads are left out."""
        settings = replace(settings, width=0) if settings.name == "native" else settings
        kernels = (f"warp-lang {metadata.version('warp-lang')}",) if settings.name == "warp" else ()
        return run_id.run_id(settings, _content_digest(self), *kernels)

    def parse_threshold(self, text: str) -> tuple[str, str]:
        """Parse a condition such as `goal=travelled_m >= 1`."""
        key, _, condition = (part.strip() for part in text.partition("="))
        if not key.isidentifier() or not condition:
            raise InputError(f"{text!r} is not allowed: a name and a condition, such as 'goal=travelled_m >= 1'")
        return key, condition

    def thresholds(self, limits: tuple[Condition, ...]) -> dict[str, float]:
        """Return the thresholds of the scenario's conditions that compare a metric with a number, by metric."""
        return {one.threshold[0]: one.threshold[1] for one in limits if one.threshold}

    def explain_cause(self, row: Mapping[str, Any], limits: tuple[Condition, ...]) -> str:
        """Return the condition of the scenario that ended a rollout, with the metric's value."""
        for one in limits:
            if one.cause == row["cause"] and one.threshold:
                return f"{one.meaning} ({one.threshold[0]} {float(row[one.threshold[0]]):.4g})"
        return self.cause_meanings(limits).get(str(row["cause"]), "")


def build_nominal_system(values: Mapping[str, Any], kinds: ClassesByKind) -> SystemSetup:
    """Build the system of a MuJoCo model at nominal parameters from a plain configuration."""
    about = _parse_model(values["model"])
    settings, usual = build_instance(ModelEngineSettings, values["engine"], "engine"), ModelEngineSettings()
    for field in dataclasses.fields(usual):
        if field.name not in ENGINE_SETTINGS and getattr(settings, field.name) != getattr(usual, field.name):
            raise InputError(f"engine.{field.name} is not allowed: the model's file sets it")
    system, groups = (
        MujocoModel(about, ()),
        {group: values.get(group) or {} for group in ("noise", "controller", "start")},
    )
    bodies = system.body_names
    pushes, pushed = disturbances.parse_pushes(values.get("push") or {}, bodies)
    loads, loaded = payloads.parse_payloads(values.get("payload") or {}, bodies)
    drives, networks, driven = motors.parse_motors(values.get("motor") or {}, system.model)
    system = replace(system, pushes=pushes, payloads=loads, motors=drives, actuator_networks=networks)
    given, folder = values.get("schedule") or {}, files.project_folder()
    orders, ordered = schedules.parse_schedules(given, [*system.controller.parameters], folder)
    system = replace(system, schedules=orders)
    asked = _flatten(groups) | pushed | loaded | driven | ordered
    asked |= terrain.parse_terrain(values["model"].get("terrain"))[1]
    for path in asked:
        require_choice(path, system.parameters, path)
    numbers = tuple(
        (path, convert_and_check_value(one, asked.get(path, one.default), path))
        for path, one in system.parameters.items()
    )
    _ = system.observed_slices, system.keyframe_index  # which refuse unknown names
    conditions = parse_conditions(values.get("outcome") or {}, system.metric_names, CAUSE_MEANINGS)
    listed = _list_axis_files(values.get("study") or {})
    plain = {key: value for key, value in values.items() if key not in ("study", "cluster", "out")}
    system = replace(system, listed=listed, values=json.dumps(plain, default=str))
    content = about.content or _content_digest(system)
    system = replace(system, config=replace(about, content=content), controller_values=numbers, conditions=conditions)
    if about.terrain:
        known = dict(numbers)
        terrain.check_height_range(
            about.terrain, {name: known[terrain.PREFIX + name] for name in terrain_heights.NUMBERS}
        )
    settings, told = replace(settings, control_period=about.period), {**values["model"], "content": content}
    return SystemSetup(system, settings, conditions, {"model": told})


def _flatten(given: Mapping[str, Any], path: str = "") -> dict[str, Any]:
    """Return values by path, such as `noise.height.white`, from mappings in mappings."""
    found: dict[str, Any] = {}
    for key, value in given.items():
        name = f"{path}{key}"
        found |= _flatten(value, f"{name}.") if isinstance(value, Mapping) else {name: value}
    return found


def _parse_model(given: Mapping[str, Any]) -> ModelConfig:
    """What a configuration's `model` says, checked."""
    said = {key: value for key, value in given.items() if value is not None}
    for key in ("mjcf", "controller", "keyframe"):
        if not isinstance(said.get(key, ""), str):
            raise InputError(f"model.{key} = {said[key]!r} is not allowed: a word")
    for key in ("observe", "data", "feet", "collisions"):
        names = said.get(key, ())
        if not isinstance(names, list | tuple) or not all(isinstance(one, str) for one in names):
            raise InputError(f"model.{key} = {names!r} is not allowed: a list of names")
        if key != "observe" and len({*names}) < len(names):
            raise InputError(f"model.{key} = {names!r} is not allowed: each name once")
        said[key] = tuple(names)
    direction, option = said.get("direction", ModelConfig.direction), said.get("option", {})
    along = direction if isinstance(direction, list | tuple) else ()
    along = tuple(convert_and_check_value(quantity(0.0, ""), one, "model.direction") for one in along)
    if len(along) != 3 or not any(along):
        raise InputError(f"model.direction = {direction!r} is not allowed: a vector in world axes, such as [1, 0, 0]")
    if not isinstance(option, Mapping):
        raise InputError(f"model.option = {option!r} is not allowed: names and values, such as {{cone: elliptic}}")
    said["terrain"], _ = terrain.parse_terrain(said.get("terrain"))
    model, paths = (
        files.load_model(said.get("mjcf", ""), said["terrain"]),
        {f"model.option.{name}": value for name, value in option.items()},
    )
    options = tuple(
        (path, convert_and_check_value(fields.parameter_field(model, path), value, path))
        for path, value in paths.items()
    )
    spec = files.read_policy_spec(said.get("controller", ""))
    if spec and spec.period and said.setdefault("period", spec.period) != spec.period:
        name, told = (
            said["controller"],
            f"its {policy_spec.SPECIFICATION_SUFFIX.removeprefix('.')} says {spec.period:g} s",
        )
        raise InputError(f"model.period = {said['period']} is not allowed for {name}: {told}")
    about = build_instance(ModelConfig, {**said, "direction": along, "option": options}, "model")
    if about.duration < about.period:
        allowed = f"at least model.period, {about.period:g} s"
        raise InputError(f"model.duration = {about.duration:g} is not allowed: {allowed}")
    return about


def _content_digest(system: MujocoModel) -> str:
    digest, ground = f"{files.digest_model(system.model)}-{system.controller.digest}", system.config.terrain
    if ground and ground.file:
        digest += f"-{_digest_listed('model.terrain.file', ground.file, ground)}"
    for one in system.actuator_networks:
        digest += f"-{one.digest}"
    if system.listed:
        found = [(path, name, _digest_listed(path, name, ground)) for path, names in system.listed for name in names]
        digest += f"-{hashlib.blake2b(repr(found).encode(), digest_size=8).hexdigest()}"
    return digest


def _digest_listed(path: str, name: str, ground: terrain.TerrainConfig | None) -> str:
    """Hash what a value of an axis over files names. Raises `InputError`."""
    if path == "model.mjcf":
        return files.digest_model(files.load_model(name, ground))
    return files.digest_file_contents(_listed_files(path, name))


def _listed_files(path: str, name: str) -> list[Path]:
    """List the files of a model, a controller or an image, by its name. Raises `InputError`."""
    match path:
        case "model.mjcf":
            return files.list_files(name)
        case "model.controller":
            return files.controller_files(name)
        case _:
            return [files.require_file("terrain.file", name, ".png")]


def _list_source_files(system: MujocoModel) -> list[Path]:
    """List all files that define a system, those of axes included."""
    found = [*files.list_files(system.config.mjcf), *system.controller.files]
    if image := system.nominal_file_of_parameter("model.terrain.file"):
        found += _listed_files("model.terrain.file", image)
    for one in system.actuator_networks:
        found += files.controller_files(one.file)
    return found + [file for path, names in system.listed for name in names for file in _listed_files(path, name)]


def _list_axis_files(study: Mapping[str, Any]) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """List the files that the axes of a plain study name, by path. Raises `InputError` where one leaves the project."""
    axes = study.get("axes") or {}
    axes = [axis for axis in axes.values() if isinstance(axis, Mapping)] if isinstance(axes, Mapping) else []
    found = {
        str(axis["path"]): tuple(str(name) for name in axis.get("values") or ())
        for axis in axes
        if axis.get("path") in FILE_PATHS and isinstance(axis.get("values") or (), list | tuple)
    }
    for path, name in ((path, name) for path, names in found.items() for name in names):
        files.require_inside_project(path, name)
    return tuple(sorted(found.items()))


@functools.lru_cache(maxsize=64)
def _build_variant(values: str, chosen: tuple[tuple[str, str], ...], content: str) -> MujocoModel:
    """Build a system from a plain configuration as JSON, with other files or bodies by path. Raises `InputError`.

    The digest of all contents is an argument, so that a changed file is read again.
    """
    plain = json.loads(values)
    plain["model"].pop("content", None)
    for path, name in chosen:
        *parents, key = path.split(".")
        group = plain
        for parent in parents:
            group = group[parent]
        group[key] = name
    try:
        system = build_nominal_system(plain, {}).system
    except InputError as error:
        told = ", ".join(f"{path} = {name}" for path, name in chosen if f"{path} = {name}" not in str(error))
        raise InputError(f"{error} ({told})" if told else str(error)) from None
    if not isinstance(system, MujocoModel):
        raise TypeError("a configuration of a MuJoCo model is needed")
    return system
