"""The contract between studies and what they study.

Studies, their analysis and reports know a system by this alone: parameters by path, two sides that they never look
into, engines that take those, figures by column, and causes by name.
"""

import dataclasses
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, Self

import numpy as np

from sweep.engines.base import Engine
from sweep.engines.settings import EngineSettings

if TYPE_CHECKING:
    import pandas as pd

SIDES = "world", "belief"  # what is simulated, and what the controller is told
Parameter = dataclasses.Field[Any]  # with role, unit and bounds: see `sweep.core.parameters`
Values = Mapping[str, Any]  # by column
Kinds = Mapping[str, Mapping[str, type]]  # classes by group and kind
Limits = Any  # of figures, by which a system judges


class AuditVariant(NamedTuple):
    """A way to simulate that should make no difference, see `sweep audit`."""

    description: str
    change: Callable[[EngineSettings], EngineSettings] = lambda settings: settings
    columns: Mapping[str, Callable[[Any], Any]] = MappingProxyType({})  # other values of parameters, of each row's own


class System(Protocol):
    """What is studied, at its nominal parameters. Hashable; equal ones simulate alike.

    A column is the path of a parameter such as `contact.friction`, or `engine.name`, prefixed `world.` or `belief.`
    where only one side has it.
    """

    @property
    def case(self) -> Any:
        """The nominal world, which is the nominal belief, too."""
        ...

    @property
    def groups(self) -> Collection[str]:
        """What paths of its parameters start with, `engine` apart."""
        ...

    @property
    def causes(self) -> Mapping[str, str]:
        """What each cause means, in the order of their definition."""
        ...

    def cause_meanings(self, limits: Limits) -> Mapping[str, str]:
        """What each cause means, as in `causes`, with the values of its thresholds."""
        ...

    @property
    def invalid_causes(self) -> Collection[str]:
        """The causes for which a rollout is invalid rather than failed."""
        ...

    @property
    def metric_names(self) -> Collection[str]:
        """All that a row may say of what was measured."""
        ...

    @property
    def bookkeeping_metrics(self) -> Collection[str]:
        """Figures that outcomes are derived from and that say nothing beside them."""
        ...

    @property
    def history_columns(self) -> Collection[str]:
        """Columns of time histories."""
        ...

    @property
    def replay_formats(self) -> Collection[str]:
        """As what `sweep replay` can show a rollout: its options."""
        ...

    @property
    def unsupported_commands(self) -> Mapping[str, str]:
        """Commands that it has no use for, with why."""
        ...

    @property
    def audit_variants(self) -> Mapping[str, AuditVariant]:
        """Ways in which `sweep audit` simulates rollouts again, by name."""
        ...

    def settings_summary(self, settings: EngineSettings) -> Mapping[str, str]:
        """What is simulated and how, for a reader: values by the words for them."""
        ...

    def source_files(self) -> Mapping[str, Path]:
        """What it is read from, by the place in its project: a crate has them. Raises `InputError`."""
        ...

    def parameter(self, column: str, settings: EngineSettings) -> Parameter:
        """What a column varies. Raises `InputError` where it names nothing that can be varied."""
        ...

    def nominal(self, column: str, settings: EngineSettings) -> Any:
        """The value of a parameter where it is not varied. Raises `InputError` where `column` names nothing."""
        ...

    def physical_inputs(self, paths: Sequence[str]) -> Iterator[tuple[str, Any]]:
        """All that physically tells one rollout from another, by path, nominal; `paths` are varied."""
        ...

    def default_inputs(self, paths: Sequence[str]) -> Iterator[tuple[str, Any]]:
        """Of these, the values at which an input plays no part in a point's id."""
        ...

    def inactive_reason(self, column: str, settings: EngineSettings, ends: tuple[Any, Any]) -> str:
        """Explain why a column that was seen to change nothing cannot change anything.

        Args:
            column: path of the parameter.
            settings: settings of the engine.
            ends: first and last value between which it changed nothing.

        Returns:
            The cause in words, where model and configuration prove it; else nothing.
        """
        ...

    def find_random_rows(self, rows: "pd.DataFrame", settings: EngineSettings) -> np.ndarray:
        """Which rows draw something, so that replicates of one point differ."""
        ...

    def check(self, table: "pd.DataFrame", settings: EngineSettings) -> None:
        """Raise `InputError` where values of a table, each within its bounds, are not allowed together."""
        ...

    def make_sides(self, values: Values) -> tuple[Any, Any]:
        """World and belief with `values`, numbers or arrays over a batch: common ones first, then each side's own."""
        ...

    def with_delay_buffer(self, table: "pd.DataFrame") -> Self:
        """Itself with memory, such as a delay's, that is long enough for all points of `table`."""
        ...

    def make_engine(self, settings: EngineSettings, world: Any, belief: Any, limits: Limits) -> Engine:
        """A compiled engine for sides of this structure. Raises `InputError` where there is none."""
        ...

    def cpu_threshold(self, settings: EngineSettings) -> int:
        """Rollouts that end on the CPU before a GPU has begun; 0 where none are known to."""
        ...

    def device(self, settings: EngineSettings) -> str:
        """What an engine runs on, as far as it may change bits."""
        ...

    def run_id(self, settings: EngineSettings) -> str:
        """Hash of how a row is simulated: rows are equal bit for bit only at an equal one."""
        ...

    def judge(self, figures: Mapping[str, np.ndarray], limits: Limits, stages: Sequence[str]) -> dict[str, np.ndarray]:
        """The labels (`sweep.study.columns.LABELS`) of each row; a pure function of the stored figures."""
        ...

    def parse_threshold(self, text: str) -> tuple[str, Any]:
        """A key of `outcome` and its value, as a user says them in a word. Raises `InputError`."""
        ...

    def thresholds(self, limits: Limits) -> Mapping[str, float]:
        """By the figure that they are for."""
        ...

    def explain_cause(self, row: Mapping[str, Any], limits: Limits) -> str:
        """The cause of a row in words, with the figure and its threshold; empty for a success."""
        ...


class Nominal(NamedTuple):
    """What a configuration says of what is studied."""

    system: System
    settings: EngineSettings
    limits: Limits
    derived_values: Mapping[str, Any] = {}  # values that the configuration is to say from now on


def split_side(column: str) -> tuple[str, str]:
    """`world.contact.friction` -> (`world`, `contact.friction`)."""
    side, _, path = column.partition(".")
    return (side, path) if side in SIDES else ("both", column)


def values_by_side(values: Values) -> dict[str, dict[str, Any]]:
    """The values of each side by path: common ones first, then its own; what is the engine's is left out."""
    placed = [(*split_side(column), value) for column, value in values.items() if not column.startswith("engine.")]
    return {
        side: {path: value for here in ("both", side) for on, path, value in placed if on == here} for side in SIDES
    }


def judge_rollout(system: System, metrics: Mapping[str, Any], limits: Limits, stages: Sequence[str]) -> dict[str, Any]:
    """Label a single rollout with its outcome.

    Args:
        system: system of the rollout.
        metrics: its metrics, plain numbers by column name.
        limits: thresholds of the outcomes.
        stages: names of the plan's stages.

    Returns:
        Outcome, cause and the other labels by column name.
    """
    row = {name: np.asarray([value], dtype=float) for name, value in metrics.items()}
    return {name: values[0] for name, values in system.judge(row, limits, stages).items()}
