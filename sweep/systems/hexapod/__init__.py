"""The built-in six-legged robot on its obstacles as a system for studies."""

import dataclasses
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from sweep.backends import devices, run_id
from sweep.contract.engine import Engine, Trace
from sweep.contract.engine_settings import EngineSettings
from sweep.contract.system import (
    SIDES,
    AuditVariant,
    ClassesByKind,
    ColumnValues,
    Parameter,
    PushColumns,
    SystemSetup,
    split_side_prefix,
    split_world_and_belief,
)
from sweep.core.errors import InputError, format_name_suggestion, require_choice
from sweep.core.groups import GROUPS
from sweep.core.parameters import build_instance, build_instance_by_kind
from sweep.engines.states import available_columns
from sweep.manoeuvres import MANOEUVRES
from sweep.metrics import outcome
from sweep.metrics.outcome import OutcomeThresholds
from sweep.models.case import Case, Manoeuvre, complete_manoeuvre_class
from sweep.models.control import Control
from sweep.models.noise import Noise
from sweep.models.obstacles import OBSTACLES
from sweep.models.obstacles.surface import Obstacle
from sweep.models.obstacles.user_obstacle import check_user_obstacle
from sweep.models.plan_numbers import PlanTable
from sweep.planning import plan_table
from sweep.planning.plan_table import (
    DIRECTIONS,
    FORTH,
    WAY,
    Content,
)

if TYPE_CHECKING:
    import mujoco
    import pandas as pd
    from matplotlib.figure import Figure

VARIABLE_ROLES = "quantity", "count", "choice"
MAX_DELAY_TICKS = 100  # ticks: of what is measured and of the load, each at most 50
SIZE_GROUPS, MIN_SCALED_LENGTH_M, MAX_SIZE_RATIO = (
    ("robot", "obstacle"),
    0.01,
    20.0,
)  # whose lengths (m) from where on, how often the nominal
ROWS_PER_CHECK = 1 << 16  # rows whose bodies are checked at a time
RELAXATION_PARAMETERS = "contact.stiffness", "contact.damping", "engine.time_step", "engine.name"
PARAMETERS_OF_ENGINE = {
    "mjx": ("engine.time_step", "engine.dynamics", "engine.iterations"),
    "native": ("engine.native_time_step",),
}
LATER_INPUTS = (
    "noise.load_",
    "noise.position_offset_",
    "noise.orientation_offset_",
)  # inputs of before were as by default
RANDOM_INPUTS: dict[str, float | str] = {
    f"noise.{f.name}": 0 for f in dataclasses.fields(Noise) if f.name.endswith(("_noise", "_bias"))
}
RANDOM_INPUTS["control.calibrate"] = "none"
AUDIT_VARIANTS = {
    "again": AuditVariant("as before, in batches of another width"),
    "half_step": AuditVariant(
        "half the time step",
        lambda s: replace(s, time_step=s.time_step / 2, native_time_step=s.native_time_step / 2),
    ),
    "float64": AuditVariant("in double precision", lambda s: replace(s, precision="float64")),
    "other_engine": AuditVariant(
        "on the other engine",
        lambda s: replace(s, name="native" if s.name == "mjx" else "mjx", solid=False),
    ),
    "solid": AuditVariant("with solid bodies, on native", lambda s: replace(s, name="native", solid=True)),
}

PUSH = PushColumns(("execution.push_impulse",), "execution.push_direction", "execution.push_time")


@dataclass(frozen=True)
class Hexapod:
    """The built-in six-legged robot with its obstacle and manoeuvre; implements `System`."""

    case: Case
    searched_ranges: plan_table.Ranges = dataclasses.field(default_factory=dict, compare=False)  # of the case's plan

    groups = tuple(f.name for f in dataclasses.fields(Case))
    cause_names = tuple(outcome.CAUSE_MEANINGS)
    cause_meanings = staticmethod(outcome.cause_meanings)
    invalid_causes = tuple(outcome.INVALID_CAUSES)
    metric_names = frozenset({*outcome.COLUMN_MEANINGS, *outcome.BOOKKEEPING_COLUMNS})
    bookkeeping_metrics = frozenset(outcome.BOOKKEEPING_COLUMNS | {"finite", "finished", "end_stage"})
    replay_formats = ("mcap", "states", "model", "plot", "png", "video")
    unsupported_commands = MappingProxyType({"policy": "its controllers are built in"})
    audit_variants = AUDIT_VARIANTS
    push_columns = MappingProxyType({"push": PUSH})
    device = staticmethod(run_id.describe_device)
    run_id = staticmethod(run_id.run_id)
    judge = staticmethod(outcome.classify)
    explain_cause = staticmethod(outcome.explain_cause)

    @property
    def replay_plots(self) -> "dict[str, Callable[[Trace], Figure]]":
        """Functions that plot a replayed rollout over time, by plot name."""
        from sweep.systems.hexapod.plots import PLOTS  # slow to import

        return PLOTS

    def state_values_by_column(self, trace: Trace) -> dict[str, np.ndarray]:
        """Return the time-series columns that `study.keep` can record, with their values at every sample of a trace."""
        names = "qpos", "qvel", "joint_torque", "foot_force"
        record = {name: np.moveaxis(getattr(trace, name), 0, -1) for name in names}
        return {name: np.asarray(column(record)) for name, column in available_columns(trace.world).items()}

    def model_xml(self, trace: Trace, settings: EngineSettings) -> str:
        """Return the MuJoCo model of a recorded rollout as MJCF, with numbers to six digits.

        The contact of the `mjx` engine is its own and not part of the model.

        Args:
            trace: The rollout.
            settings: Settings of the engine, which give the time step.
        """
        from sweep.models import scene  # slow to import

        if settings.name == "native":
            spec = scene.build_native_spec(trace.world, settings.native_time_step, settings.solid)
        else:
            spec = scene.build_spec(trace.world)
            spec.option.timestep = settings.time_step_s
        spec.compile()
        return spec.to_xml()

    @property
    def recordable_columns(self) -> tuple[str, ...]:
        """Names of the time-series columns that `study.keep` can record."""
        return tuple(available_columns(self.case))

    def source_files(self) -> dict[str, Path]:
        """Return an empty mapping: the hexapod needs no files beside its configuration."""
        return {}

    def start_pose(self) -> "tuple[mujoco.MjModel, np.ndarray]":
        """Return the MuJoCo model of the nominal robot, and the positions (nq,) at which its plan starts."""
        from sweep.engines.batching import nominal_plan  # slow to import
        from sweep.engines.closed_loop import start_state
        from sweep.models import scene

        start = start_state(self.case, self.case, nominal_plan(self.case))
        return scene.compile_model(self.case), np.asarray(start.qpos, float)

    @property
    def engine_names(self) -> tuple[str, ...]:
        """Names of the engines: this package's own, and C MuJoCo."""
        return EngineSettings.__dataclass_fields__["name"].metadata["options"]

    def select_engine(self, settings: EngineSettings, name: str) -> EngineSettings:
        """Return the settings with which another engine simulates the same; only `native` has solid links."""
        return replace(settings, name=name, solid=settings.solid and name == "native")

    def settings_summary(self, settings: EngineSettings) -> dict[str, str]:
        """Return robot, manoeuvre, obstacle, engine and its settings as texts for readers of a report, by name."""
        about = {"robot": "hexapod", "manoeuvre": self.case.manoeuvre.kind, "obstacle": self.case.obstacle.kind}
        step = f"{1000 * settings.time_step_s:g} ms"
        return {**about, "engine": settings.name, "step": step, "precision": settings.precision}

    def parameter(self, column: str, settings: EngineSettings) -> Parameter:
        """Return unit, bounds and default of a parameter of robot, obstacle, manoeuvre, engine settings or plan."""
        side, path = split_side_prefix(column)
        if path.startswith("plan."):
            if side == "world":
                raise InputError(f"axis {column} varies nothing: plans depend on the belief only")
            return plan_table.plan_number_field(self.case, path.removeprefix("plan."))
        owner, name = self._owner(column, settings)
        found = next(f for f in dataclasses.fields(owner) if f.name == name)
        if found.metadata.get("role") not in VARIABLE_ROLES:
            raise InputError(f"axis {column} cannot be varied: it is neither a single number nor a name")
        return found

    def nominal_parameter_value(self, column: str, settings: EngineSettings) -> Any:
        """Return the nominal value of a parameter of robot, obstacle, manoeuvre, engine settings or plan."""
        if split_side_prefix(column)[1].startswith("plan."):
            return self.parameter(column, settings).default
        return getattr(*self._owner(column, settings))

    def _owner(self, column: str, settings: EngineSettings) -> tuple[Any, str]:
        side, path = split_side_prefix(column)
        owner: Any = self.case
        groups = [*self.groups] + (["engine"] if side == "both" else [])
        *above, last = path.split(".")
        for step, name in enumerate([*above, last]):
            allowed = groups if step == 0 else [f.name for f in dataclasses.fields(owner)]
            if name not in allowed or (name == last and step == 0):
                parts = [(group, settings if group == "engine" else getattr(self.case, group)) for group in groups]
                whole = [f"{group}.{name}" for group, part in parts if hasattr(part, name)] if step == 0 else []
                hint = (
                    f": did you mean {' or '.join(whole)}?"
                    if whole
                    else format_name_suggestion(name, {*allowed} - {name})
                )
                before = "".join(f"{p}." for p in path.split(".")[:step])
                raise InputError(f"axis {column} is not allowed: {before}{name} is unknown{hint}")
            if step < len(above):
                owner = settings if name == "engine" and step == 0 else getattr(owner, name)
                if not dataclasses.is_dataclass(owner):
                    raise InputError(f"axis {column} is not allowed: {name} has no parts")
        return owner, last

    def iterate_physical_inputs(self, paths: Sequence[str]) -> Iterator[tuple[str, Any]]:
        """Yield path and value of all parameters that affect results: of robot, obstacle, manoeuvre and plan."""
        yield from iterate_case_parameters(self.case, "")
        yield from _plan_inputs(self.case, plan_table.plan_content(self.case))

    def inputs_left_out_of_point_ids(self, paths: Sequence[str]) -> Iterator[tuple[str, Any]]:
        """Yield path and default of newer inputs; point ids omit these defaults so that ids of old rows stay valid.

        Point ids of earlier rows thus stay valid.
        """
        yield from iterate_case_parameters(Control(), "control")
        yield from (
            (path, value) for path, value in iterate_case_parameters(Noise(), "noise") if path.startswith(LATER_INPUTS)
        )
        yield from _plan_inputs(self.case, plan_table.default_plan_content(self.case))

    def check(self, table: "pd.DataFrame", settings: EngineSettings) -> None:
        """Raise `InputError` for sizes in a wrong unit, robots that MuJoCo cannot compile, and too long time steps."""
        for column in table.columns:
            if not column.startswith("axis.") and table[column].dtype.kind == "f":
                _check_size(column, self.parameter(column, settings), table[column].max())
        self._check_coxa(table, settings)
        self._check_built(table)
        self._check_step(table, settings)

    def controller_range_warnings(self, table: "pd.DataFrame", settings: EngineSettings) -> Iterator[str]:
        """Yield a warning for each believed size that leaves the range for which the plan's numbers were optimized."""
        for path, (low, high) in self.searched_ranges.items():
            values = _of_side(self, _select_paths(table, (path,)), "belief", path, settings)
            if values.min() < low or values.max() > high:
                yield (
                    f"{path} is {_format_ends(values.min(), values.max())}; the numbers of the plan were searched for "
                    f"{_format_ends(low, high)}"
                )

    def _check_coxa(self, table: "pd.DataFrame", settings: EngineSettings) -> None:
        """Raise `InputError` where two-link legs have a coxa: no engine and no model has a link for it."""
        table = _select_paths(table, ("robot.legs", "robot.coxa"))
        for side in SIDES:
            legs, coxa = (_of_side(self, table, side, path, settings) for path in ("robot.legs", "robot.coxa"))
            wrong = (legs == "two_link") & (coxa != 0)
            if wrong.any():
                raise InputError(f"robot.coxa = {coxa[wrong].iloc[0]:g} is not allowed: 0 m, or robot.legs=three_link")

    def _check_built(self, table: "pd.DataFrame") -> None:
        """Raise `InputError` for the first row whose robot or obstacle is too small for MuJoCo, whatever the engine."""
        from sweep.models import scene  # which imports MuJoCo

        world = [c for c in table.columns if split_side_prefix(c)[0] != "belief"]
        varied = [c for c in world if split_side_prefix(c)[1].startswith(("robot.", "obstacle."))]
        sizes = [c for c in varied if table[c].dtype.kind == "f"]
        if not sizes:
            return
        distinct = table[varied].drop_duplicates()
        names = [c for c in varied if c not in sizes]
        kinds = [part for _, part in distinct.groupby(names)] if names else [distinct]
        for part in (kind.iloc[k : k + ROWS_PER_CHECK] for kind in kinds for k in range(0, len(kind), ROWS_PER_CHECK)):
            words = {name: part[name].iloc[0] for name in names}
            case, _ = self.make_world_and_belief({**words, **{name: part[name].to_numpy() for name in sizes}})
            for _, row in part[scene.find_too_light_bodies(case)].iterrows():
                said = ", ".join(f"{name} = {row[name]:g}" for name in sizes)
                raise InputError(f"{said} is not allowed: a body's mass or inertia is too small for MuJoCo")

    def _check_step(self, table: "pd.DataFrame", settings: EngineSettings) -> None:
        """Raise `InputError` where a time step of mjx exceeds the relaxation time of contacts."""
        import pandas as pd

        table = _select_paths(table, RELAXATION_PARAMETERS)
        found = pd.DataFrame({path: _of_side(self, table, "world", path, settings) for path in RELAXATION_PARAMETERS})
        stiffness, damping, step, name = (found[path] for path in RELAXATION_PARAMETERS)
        slow = found[(name == "mjx") & (step * stiffness > damping * (1 + 1e-9))]
        for stiffness, damping, step, _ in slow.head(1).itertuples(index=False):
            raise InputError(
                f"engine.time_step = {step:g} is not allowed: at most {damping / stiffness:g} s, which is "
                f"contact.damping / contact.stiffness = {damping:g} N s/m / {stiffness:g} N/m"
            )

    def max_rollouts_for_cpu(self, settings: EngineSettings) -> int:
        """Return the most rollouts that a CPU finishes sooner than a GPU: one tile of the fused compiler per core."""
        from sweep.fused.llvm import TILE_LANES  # whose library what is wrong need not wait for

        return TILE_LANES * devices.count_cores() if settings.is_fusible else 0

    def explain_inactive_column(self, column: str, settings: EngineSettings, ends: tuple[Any, Any]) -> str:
        """Explain why a parameter may have no effect: only the simulation, controller or another engine uses it."""
        side, path = split_side_prefix(column)
        if side == "world" and path.startswith(("manoeuvre.", "control.")):
            return "plans depend on the belief only"
        if other := next(
            (engine for engine, own in PARAMETERS_OF_ENGINE.items() if path in own and engine != settings.name), ""
        ):
            return f"engine {other} uses it"
        return "sensor errors are part of the world" if side == "belief" and path.startswith("noise.") else ""

    def find_stochastic_rows(self, rows: "pd.DataFrame", settings: EngineSettings) -> np.ndarray:
        """Return which rows (n,) draw random numbers: those with sensor errors or calibration."""
        found = np.zeros(len(rows), dtype=bool)
        for path, none in RANDOM_INPUTS.items():
            column = next((c for c in (f"world.{path}", path) if c in rows), None)
            found |= (rows[column] if column else self.nominal_parameter_value(path, settings)) != none
        return found

    def make_world_and_belief(self, values: ColumnValues) -> tuple[Case, Case]:
        """Make the parameters of the simulated world and those that the controller believes, from values by column."""
        sides = split_world_and_belief(values).values()
        world, belief = (
            reduce(lambda case, one: replace_parameter(case, *one), own.items(), self.case) for own in sides
        )
        return world, belief

    def allocate_delay_buffers(self, table: "pd.DataFrame") -> "Hexapod":
        """Return this system with sensor buffers long enough for the longest sensor delay in a study's points."""

        def of(name: str) -> Any:
            columns = [c for c in table.columns if split_side_prefix(c)[1] == f"noise.{name}"]
            return table[columns].max(axis=1) if columns else getattr(self.case.noise, name)

        longest = np.max(np.maximum(of("delay") + of("load_delay"), of("body_delay")))
        room = max(min(math.ceil(longest), MAX_DELAY_TICKS), self.case.noise.delay_buffer)
        return Hexapod(replace_parameter(self.case, "noise.delay_buffer", room))

    def make_engine(self, settings: EngineSettings, world: Case, belief: Case, limits: OutcomeThresholds) -> Engine:
        """Compile the engine of the hexapod that the settings name, for batches of one width."""
        from sweep import engines  # slow to import

        return engines.make_engine(settings, world, belief, limits)

    def parse_threshold(self, text: str) -> tuple[str, float]:
        """Parse a threshold of a metric, such as `slip_max_m<0.02`; maxima allow only `<`, minima only `>`."""
        sign = next((s for s in ("<=", ">=", "<", ">", "=") if s in text), None)
        key, _, value = text.partition(sign or "=")
        try:
            number = float(value)
        except ValueError:
            raise InputError(f"{text!r} is not a threshold, such as 'slip_max_m<0.02'") from None
        fields = dataclasses.fields(OutcomeThresholds)  # pyright: ignore[reportArgumentType]
        require_choice(key.strip(), [field.name for field in fields], f"outcome.{key.strip()}")
        if sign and sign != "=" and ("max" in key) != ("<" in sign):
            raise InputError(f"{text!r} is not allowed: {key.strip()} is a {'maximum' if 'max' in key else 'minimum'}")
        return key.strip(), number

    def thresholds(self, limits: OutcomeThresholds) -> dict[str, float]:
        """Return the failure thresholds of metrics, by name of the metric."""
        return {cause.metric: outcome.threshold_value(cause, limits) for cause in outcome.CAUSES if cause.threshold}


def build_nominal_system(values: Mapping[str, Any], kinds: ClassesByKind) -> SystemSetup:
    """Build the hexapod at nominal parameters from a plain configuration."""
    classes = {"engine": EngineSettings, "outcome": OutcomeThresholds}
    classes |= {name: group.load() for name, group in GROUPS.items() if group.in_case and group.has_single_class}
    parts = {group: build_instance(cls, values[group], group) for group, cls in classes.items()}
    settings, given = parts.pop("engine"), dataclasses.asdict(parts.pop("outcome"))
    parts |= {group: build_instance_by_kind(kinds[group], values[group], group) for group in ("obstacle", "manoeuvre")}
    complete_manoeuvre_class(type(parts["manoeuvre"]))  # a class of a user module may not inherit from `Manoeuvre`
    table, searched_ranges = _table(values["plan"], parts["manoeuvre"])
    case = Case(**parts, plan=table)
    if not _suits(type(case.obstacle), case.manoeuvre):
        needed = " or ".join(kind for kind, cls in OBSTACLES.items() if _suits(cls, case.manoeuvre))
        both = f"obstacle.kind = {case.obstacle.kind} is not allowed: manoeuvre.kind = {case.manoeuvre.kind}"
        raise InputError(f"{both} needs {needed}")
    if not type(case.obstacle).__module__.startswith("sweep."):
        check_user_obstacle(case.obstacle)
    for group in SIZE_GROUPS:
        part = getattr(case, group)
        for member in dataclasses.fields(part):
            _check_size(f"{group}.{member.name}", member, getattr(part, member.name))
    return SystemSetup(Hexapod(case, searched_ranges), settings, outcome.resolve_thresholds(given, case))


def plan_numbers(file: str, read: Callable[[str], str]) -> dict[str, float | str]:
    """Return the numbers and formulas in a plan file, by their dotted path in it.

    Args:
        file: Name of the file.
        read: Returns the text of the file of a name.

    Returns:
        Numbers, and formulas as text, by path.
    """
    places = {key: chart for cls in OBSTACLES.values() for key, chart in cls.charts.items()}
    plan, _ = plan_table.split_search_ranges(plan_table.merge_plan_with_bases(file, read))
    return plan_table.numbers_by_path(plan, places)


def replace_parameter[T](owner: T, path: str, value: Any) -> T:
    """Return a copy of nested dataclasses in which the member at a dotted path has another value.

    Args:
        owner: The dataclass.
        path: Dotted path of the member.
        value: Its new value.

    Returns:
        The copy.
    """
    if isinstance(owner, PlanTable):
        return owner.replace_number(path, value)  # pyright: ignore[reportReturnType]
    name, _, rest = path.partition(".")
    inner = replace_parameter(getattr(owner, name), rest, value) if rest else value
    return dataclasses.replace(owner, **{name: inner})  # pyright: ignore[reportArgumentType]


def _table(given: Any, manoeuvre: Any) -> tuple[PlanTable, plan_table.Ranges]:
    """Return the plan table of a configuration, empty for the manoeuvre's own plan, and the ranges of its search."""
    kind = manoeuvre.kind
    if not given:
        if manoeuvre.default_plan_name == "":
            raise InputError(f"plan is missing: manoeuvre.kind = {kind} has no default plan")
        return PlanTable(), plan_table.default_searched_ranges(manoeuvre.default_plan_name)
    if not isinstance(given, Mapping):
        raise InputError(f"plan = {given} is not allowed: `sweep list` shows the choices")
    if manoeuvre.default_plan_name is None:
        raise InputError(f"plan is not allowed: manoeuvre.kind = {kind} has no plan file")
    plan_table.check_plan_content(given)
    given, searched_ranges = plan_table.split_search_ranges(given)
    require_choice(way := given.get(WAY, FORTH), DIRECTIONS, f"plan.{WAY} = {way}")
    if way != FORTH and not manoeuvre.two_way:
        raise InputError(f"plan.{WAY} = {way} is not allowed: manoeuvre.kind = {kind} goes {FORTH} only")
    return PlanTable(json.dumps(given)), searched_ranges


def _suits(obstacle: type[Obstacle], manoeuvre: Manoeuvre) -> bool:
    """Return whether a manoeuvre can use obstacles of a class, by the nearest base class that any manoeuvre needs."""
    asked = {cls for kind in MANOEUVRES.values() for cls in kind.needs}
    nearest = next((cls for cls in obstacle.__mro__ if cls in asked), None)
    return nearest in manoeuvre.needs or (Obstacle in manoeuvre.needs and bool(obstacle.charts))


def _select_paths(table: "pd.DataFrame", paths: Sequence[str]) -> "pd.DataFrame":
    """Select the columns of some paths on either side; of a table that varies none of them, one row stands for all."""
    columns = [c for c in table.columns if split_side_prefix(c)[1] in paths]
    return table[columns] if columns else table.iloc[:1]


def _of_side(
    system: Hexapod, table: "pd.DataFrame", side: str, path: str, settings: EngineSettings
) -> "pd.Series[Any]":
    """Return the value of a parameter on one side for each row: varied there, varied on both, or nominal."""
    import pandas as pd

    column = next((c for c in (f"{side}.{path}", path) if c in table.columns), None)
    return table[column] if column else pd.Series(system.nominal_parameter_value(path, settings), index=table.index)


def _format_ends(low: float, high: float) -> str:
    """Format a range, or a single value."""
    return f"{low:.4g} to {high:.4g}" if f"{low:.4g}" != f"{high:.4g}" else f"{low:.4g}"


def _check_size(column: str, member: Parameter, value: Any) -> None:
    """Raise `InputError` where a length is so far above its nominal value that its unit must be wrong."""
    group, nominal = split_side_prefix(column)[1].partition(".")[0], member.default
    if group not in SIZE_GROUPS or member.metadata.get("unit") != "m" or not isinstance(nominal, float):
        return
    if nominal >= MIN_SCALED_LENGTH_M and value > MAX_SIZE_RATIO * nominal:
        meant = min((value / 100, value / 1000), key=lambda size: abs(math.log(size / nominal)))
        allowed = f"at most {MAX_SIZE_RATIO:g} times the nominal {nominal:g} m"
        raise InputError(f"{column} = {value:g} is not allowed: is it {meant:g} m? ({allowed})")


def _plan_inputs(case: Case, plan: Content) -> Iterator[tuple[str, Any]]:
    """Yield the numbers of a plan by path, and its words and formulas as one text."""
    places = case.obstacle.charts
    found = plan_table.numbers_by_path(plan, places).items()
    yield from ((f"plan.{path}", value) for path, value in found if not isinstance(value, str))
    words = plan_table.map_numbers(plan, places, lambda path, value: value if isinstance(value, str) else 0)
    yield "plan", json.dumps(words)


def iterate_case_parameters(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    """Yield dotted path and value of all parameters in nested dataclasses, except numbers of the plan."""
    if isinstance(value, PlanTable):
        return  # see `_plan_inputs`
    if dataclasses.is_dataclass(value):
        for member in dataclasses.fields(value):
            yield from iterate_case_parameters(
                getattr(value, member.name), f"{path}.{member.name}" if path else member.name
            )
    else:
        yield path, value
