"""The interface through which studies use the systems that they simulate.

Studies, analysis and reports use a system only through this contract: parameters by path, two sides (world and belief)
that are opaque to them, engines that simulate both, metrics by column, and causes by name.
"""

import dataclasses
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, Self

import numpy as np

from sweep.contract.engine import Engine, Trace
from sweep.contract.engine_settings import EngineSettings

if TYPE_CHECKING:
    import mujoco
    import pandas as pd
    from matplotlib.figure import Figure

SIDES = "world", "belief"  # what is simulated, and what the controller is told
Parameter = dataclasses.Field[Any]  # with role, unit and bounds: see `sweep.core.parameters`
ColumnValues = Mapping[str, Any]  # by column
ClassesByKind = Mapping[str, Mapping[str, type]]  # classes by group and kind
Limits = Any  # of figures, by which a system judges


class AuditVariant(NamedTuple):
    """A variant of the simulation, such as a smaller time step, that should not change outcomes; `sweep audit` runs
    it."""

    description: str
    change: Callable[[EngineSettings], EngineSettings] = lambda settings: settings
    columns: Mapping[str, Callable[[Any], Any]] = MappingProxyType({})  # other values of parameters, of each row's own


class PushColumns(NamedTuple):
    """Paths of the parameters of one push on a body of the simulated system."""

    sizes: tuple[str, ...]  # of which a study varies one: impulse (N s) or force (N)
    direction: str  # rad in the horizontal plane, from the world's x axis
    start: str  # s, from the start of the rollout
    body: str = ""  # name of the pushed body; empty where it cannot vary


class System(Protocol):
    """Interface of a simulated system (robot, environment, controller) with nominal parameters.

    Systems that compare equal simulate alike.

    A column is the path of a parameter such as `contact.friction`, or `engine.name`, prefixed `world.` or `belief.`
    where only one side has it.
    """

    @property
    def case(self) -> Any:
        """All parameters at nominal values, of the simulated world and equally of what the controller believes."""
        ...

    @property
    def groups(self) -> Collection[str]:
        """Names of the parameter groups, such as `robot`, with which paths of parameters begin; without `engine`."""
        ...

    @property
    def cause_names(self) -> Sequence[str]:
        """Names of all causes of failure or invalidity, in the order of definition."""
        ...

    def cause_meanings(self, limits: Limits) -> Mapping[str, str]:
        """Return what each cause of failure or invalidity means, by name, with the values of its thresholds."""
        ...

    @property
    def invalid_causes(self) -> Collection[str]:
        """Names of the causes that make a rollout invalid (not simulated correctly) rather than failed."""
        ...

    @property
    def metric_names(self) -> Collection[str]:
        """Columns of all metrics that a row may have."""
        ...

    @property
    def bookkeeping_metrics(self) -> Collection[str]:
        """Names of metrics that only serve to derive outcomes, and that no table shows."""
        ...

    @property
    def recordable_columns(self) -> Collection[str]:
        """Names of the time-series columns that `study.keep` can store for each row."""
        ...

    @property
    def replay_formats(self) -> Collection[str]:
        """Output options of `sweep replay` that this system supports."""
        ...

    @property
    def replay_plots(self) -> Mapping[str, Callable[[Trace], "Figure"]]:
        """Functions that plot the time series (trace) of a rollout, by name."""
        ...

    def state_values_by_column(self, trace: Trace) -> Mapping[str, np.ndarray]:
        """Return the simulated states at the F frames of a trace, arrays (F,) by column, for `replay --states`."""
        ...

    def model_xml(self, trace: Trace, settings: EngineSettings) -> str:
        """Return the MuJoCo model (MJCF) with which a trace was simulated, for `replay --model`.

        Args:
            trace: The rollout.
            settings: Settings of the engine, which give the time step.
        """
        ...

    @property
    def unsupported_commands(self) -> Mapping[str, str]:
        """Commands that do not work for this system, each with the reason."""
        ...

    @property
    def audit_variants(self) -> Mapping[str, AuditVariant]:
        """Variants of the simulation that `sweep audit` compares with the original, by name."""
        ...

    @property
    def push_columns(self) -> Mapping[str, PushColumns]:
        """Parameters of each push that the scenario may have, by name of the push."""
        ...

    def start_pose(self) -> "tuple[mujoco.MjModel, np.ndarray]":
        """Return the nominal MuJoCo model, and the positions (nq,) at which its rollouts start."""
        ...

    @property
    def engine_names(self) -> Sequence[str]:
        """Names of all engines that may simulate the system, installed or not."""
        ...

    def select_engine(self, settings: EngineSettings, name: str) -> EngineSettings:
        """Return the settings with which another engine simulates the same rollouts.

        Args:
            settings: Settings of the present engine.
            name: The other engine, one of `engine_names`.
        """
        ...

    def settings_summary(self, settings: EngineSettings) -> Mapping[str, str]:
        """Summarize for readers what is simulated and with which settings, as a mapping from labels to values."""
        ...

    def source_files(self) -> Mapping[str, Path]:
        """Return the files that define the system, by path within the project. Raises `InputError`."""
        ...

    def parameter(self, column: str, settings: EngineSettings) -> Parameter:
        """Return unit, bounds and default of a column's parameter. Raises `InputError` if it cannot vary."""
        ...

    def nominal_parameter_value(self, column: str, settings: EngineSettings) -> Any:
        """Return the nominal value of the parameter that a column holds. Raises `InputError` for an unknown column."""
        ...

    def iterate_physical_inputs(self, paths: Sequence[str]) -> Iterator[tuple[str, Any]]:
        """Yield path and nominal value of every physical input of a rollout, such as masses and numbers of plans.

        Args:
            paths: Paths that vary.
        """
        ...

    def inputs_left_out_of_point_ids(self, paths: Sequence[str]) -> Iterator[tuple[str, Any]]:
        """Yield parameters and the values at which point ids (hashes) omit them, as earlier versions lacked them.

        Args:
            paths: Paths that vary.
        """
        ...

    def explain_inactive_column(self, column: str, settings: EngineSettings, ends: tuple[Any, Any]) -> str:
        """Explain why a parameter may change no metric, such as one that only the planner uses; empty if unknown."""
        ...

    def find_stochastic_rows(self, rows: "pd.DataFrame", settings: EngineSettings) -> np.ndarray:
        """Return which of n rows use random numbers, so that repeating them with other seeds gives other results."""
        ...

    def check(self, table: "pd.DataFrame", settings: EngineSettings) -> None:
        """Raise `InputError` if a row of the points table combines parameter values that are not allowed together."""
        ...

    def controller_range_warnings(self, table: "pd.DataFrame", settings: EngineSettings) -> Iterable[str]:
        """Yield a warning for each parameter whose values leave the range for which the controller was made."""
        ...

    def make_world_and_belief(self, values: ColumnValues) -> tuple[Any, Any]:
        """Make the simulated parameters (world) and the planner's (belief) from values by column.

        Args:
            values: Numbers, or arrays over a batch, by column.

        Returns:
            World and belief.
        """
        ...

    def allocate_delay_buffers(self, table: "pd.DataFrame") -> Self:
        """Return this system with buffers long enough for the longest sensor delay in a points table, and no shorter
        than before."""
        ...

    def make_engine(self, settings: EngineSettings, world: Any, belief: Any, limits: Limits) -> Engine:
        """Compile the engine that simulates this system with the given settings.

        Args:
            settings: Engine settings.
            world: Simulated parameters, whose structure is compiled.
            belief: Parameters that the planner receives.
            limits: Thresholds of outcomes.

        Raises:
            InputError: No engine can simulate this.
        """
        ...

    def max_rollouts_for_cpu(self, settings: EngineSettings) -> int:
        """Return the number of rollouts up to which a CPU finishes before a GPU would have started; 0 if unknown."""
        ...

    def device(self, settings: EngineSettings) -> str:
        """Name the hardware on which an engine runs, in as much detail as can change the bits of a row."""
        ...

    def run_id(self, settings: EngineSettings) -> str:
        """Return a hash of how rows are simulated; rows with equal hash are reproducible bit for bit."""
        ...

    def judge(self, figures: Mapping[str, np.ndarray], limits: Limits, stages: Sequence[str]) -> dict[str, np.ndarray]:
        """Derive outcome, cause and other labels (`sweep.study.columns.LABEL_COLUMNS`) of rows from their metrics.

        Args:
            figures: Metrics (n,) by column.
            limits: Thresholds.
            stages: Names of the plan's stages.

        Returns:
            Labels (n,) by column.
        """
        ...

    def parse_threshold(self, text: str) -> tuple[str, Any]:
        """Parse a threshold such as `slip_max_m<0.02` into its key in the group `outcome` and its value. Raises
        `InputError`."""
        ...

    def thresholds(self, limits: Limits) -> Mapping[str, float]:
        """Return the thresholds of the causes of failure or invalidity, by the metric to which each applies."""
        ...

    def explain_cause(self, row: Mapping[str, Any], limits: Limits) -> str:
        """Explain why a row failed or is invalid, with metric and threshold; empty for a success."""
        ...


class SystemSetup(NamedTuple):
    """A system with engine settings and outcome thresholds, as a configuration gives them."""

    system: System
    settings: EngineSettings
    limits: Limits
    derived_values: Mapping[str, Any] = {}  # values that the configuration is to say from now on


def split_side_prefix(column: str) -> tuple[str, str]:
    """Split a column into world or belief, and path: `world.contact.friction` into `world` and `contact.friction`.

    A column without a side belongs to `both`.
    """
    side, _, path = column.partition(".")
    return (side, path) if side in SIDES else ("both", column)


def split_world_and_belief(values: ColumnValues) -> dict[str, dict[str, Any]]:
    """Return the values for world and for belief by path, without engine settings; columns for both apply first."""
    placed = [
        (*split_side_prefix(column), value) for column, value in values.items() if not column.startswith("engine.")
    ]
    return {
        side: {path: value for here in ("both", side) for on, path, value in placed if on == here} for side in SIDES
    }


def judge_rollout(system: System, metrics: Mapping[str, Any], limits: Limits, stages: Sequence[str]) -> dict[str, Any]:
    """Derive outcome, cause and other labels of a single rollout from its metrics.

    Args:
        system: The system that was simulated.
        figures: Metrics by column, plain numbers.
        limits: Thresholds of the system.
        stages: Names of the plan's stages.

    Returns:
        Labels by column, see `System.judge`.
    """
    row = {name: np.asarray([value], dtype=float) for name, value in metrics.items()}
    return {name: values[0] for name, values in system.judge(row, limits, stages).items()}
