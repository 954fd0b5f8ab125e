"""Studies: axes over parameters of a system, the table of points, and checks of both.

A column of the points table is a parameter path such as `contact.friction`, prefixed `world.` or `belief.` where only
one of the two varies, or `axis.NAME` for a number from which values are computed (see `sweep.study.designs`).
"""

import dataclasses
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sweep.contract.engine_settings import EngineSettings
from sweep.contract.system import ColumnValues, Parameter, System
from sweep.core.distinct_values import are_all_different
from sweep.core.errors import InputError, require_choice
from sweep.core.expressions import AXIS_NAMES_KEY, condition_mask
from sweep.core.parameters import WHOLE_NUMBER_UNITS, convert_and_check_value, count, is_within_bounds
from sweep.study import design_kinds, designs
from sweep.study.adaptive_sampling import RoundDraws
from sweep.study.analytic_limits import AnalyticParameterLimit
from sweep.study.analytic_limits import parse_limit as parse_theory
from sweep.study.columns import LABEL_COLUMNS, PLACEMENT_COLUMNS, TIMING_COLUMNS
from sweep.study.design_kinds.base import AdaptiveDesign, Design, DrawContext
from sweep.study.designs import Axis
from sweep.study.distributions import require_known_keys
from sweep.study.point_ids import HASHED_DIGITS, point_hashes, point_ids, replicate_noise_seeds, row_noise_seeds
from sweep.study.size_limits import MAX_STUDY_ROLLOUTS

if TYPE_CHECKING:
    import pandas as pd

FEW_COLUMNS = 50  # up to which pandas is fast with columns that were made one by one
DTYPE_BY_ROLE = {"quantity": "float64", "setting": "float64", "count": "int64", "choice": "str", "file": "str"}
Logger = Callable[[str], None]


@dataclass(frozen=True)
class RateExpectation:
    """A bound on the share of rows that meet the condition `that`, among valid rows that meet `where`."""

    where: str | None = None  # condition on columns: the rows that are counted
    that: str = 'outcome == "success"'  # condition that a share of them meets
    at_least: float = 0.0  # least share
    at_most: float = 1.0  # largest share


@dataclass(frozen=True)
class ScenarioSchema:
    """Hydra schema of a scenario, which is simulated at nominal parameters and checked against `expect`."""

    name: str = "nominal"
    expect: list[Any] = field(default_factory=list)


@dataclass(frozen=True)
class _PlainSettings:
    """Settings of a study that need no parsing."""

    name: str = ""  # of the folder of results; the name of the file unless given
    points: str | None = None  # CSV file that takes the place of the axes
    where: str | None = None  # points to keep
    replicates: int = count(1, at_least=1)  # rollouts of each point, each with noise of its own
    seed: int = 0  # of all draws and all noise
    resolution: float = 0.0  # cells that disagree are halved until they are this share of their axis; 0: not at all
    level: float = 0.5  # of the success region, where rollouts of a point differ
    budget: int = count(0)  # most rollouts that refinement may take; 0: no limit
    audit: int = count(0)  # random points in decided cells that are run as a check
    keep_rate: float = 10.0  # samples of the columns `keep` in a simulated second
    keep_rows: int = count(1000, at_least=1)  # of the plan, from its first, whose histories are kept
    invalid_max: float = 0.01  # largest tolerated share of invalid rows
    replays: int = count(6)  # of the most informative rollouts, recorded when the study is complete; 0: none


@dataclass(frozen=True)
class StudySchema(_PlainSettings):
    """Hydra schema of a study, which varies parameters of a scenario."""

    axes: dict[str, Any] = field(default_factory=dict)
    design: Any = field(default_factory=lambda: design_kinds.make_schema()())  # its keys: see `config`
    expect: list[Any] = field(default_factory=list)
    theory: list[Any] = field(default_factory=list)
    keep: list[Any] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class Study(_PlainSettings):
    """A parsed study: points of a grid and of distributions, or of a CSV file, each repeated with different noise."""

    single: bool  # one nominal rollout, shown rather than stored
    axes: tuple[Axis, ...]
    design: Design  # of the axes that have a distribution
    expect: tuple[RateExpectation, ...]
    theory: tuple[AnalyticParameterLimit, ...]  # drawn over its maps
    keep: tuple[str, ...]  # columns whose time histories are kept, see `System.recorded`

    @property
    def is_refined(self) -> bool:
        """Whether the study refines a map of success, so that its next points depend on outcomes of earlier rows."""
        return self.resolution > 0 or self.budget > 0

    @property
    def is_adaptive(self) -> bool:
        """Whether the study samples failures adaptively."""
        return isinstance(self.design, AdaptiveDesign) and self.design.num > 0

    @property
    def adaptive_design(self) -> AdaptiveDesign:
        """The adaptive design of the study. Raises `TypeError` for other designs."""
        if not isinstance(self.design, AdaptiveDesign):
            raise TypeError(f"{self.design.kind} is no adaptive design")
        return self.design

    @property
    def draw_context(self) -> DrawContext:
        """The seed, the names of the drawn axes and the study's name, from which the design makes draws."""
        return DrawContext(designs.drawn_axis_names(self.axes), self.seed, self.name)

    @property
    def is_sequential(self) -> bool:
        """Whether the study runs in rounds, each of which depends on the rows of earlier rounds."""
        return self.is_refined or self.is_adaptive

    @property
    def has_repeats(self) -> bool:
        """Whether several rollouts share a grid point and differ in noise or drawn axes."""
        return self.replicates > 1 or self.design.num > 0

    @property
    def max_rollouts(self) -> int:
        """Largest possible number of rollouts, before equal points are merged."""
        return self.replicates * designs.count_points(self.axes, self.design)

    @classmethod
    def parse(cls, values: Mapping[str, Any], single: bool) -> "Study":
        """Make a study from its plain configuration values.

        Args:
            values: Values by key, as in `StudySchema`.
            single: Whether the study is a single nominal rollout.

        Returns:
            The study.

        Raises:
            InputError: A value is not allowed.
        """
        for member in dataclasses.fields(_PlainSettings):
            convert_and_check_value(member, values[member.name], f"study.{member.name}")
        if values["seed"] < 0:
            raise InputError(f"study.seed = {values['seed']} is not allowed: at least 0")
        if not 0 < values["level"] < 1:
            raise InputError(f"study.level = {values['level']:g} is not allowed: between 0 and 1")
        if not 0 <= values["resolution"] < 1:
            raise InputError(f"study.resolution = {values['resolution']:g} is not allowed: at least 0 and below 1")
        if not 0 < values["keep_rate"] < math.inf:
            raise InputError(f"study.keep_rate = {values['keep_rate']:g} is not allowed: above 0, and finite")
        if not 0 <= values["invalid_max"] <= 1:
            raise InputError(f"study.invalid_max = {values['invalid_max']:g} is not allowed: a share from 0 to 1")
        if values["points"] == "":  # which is no study without them
            raise InputError("study.points =  is not a file")
        name = values["name"]  # of a folder
        if name and (not name.strip(". ") or not re.fullmatch(r"[^/\x00-\x1f\x7f\ud800-\udfff]{1,200}", name)):
            raise InputError(f"study.name = {name!r} is not allowed: a folder name")
        axes = designs.parse_axes(values["axes"])
        design = designs.parse_design(values["design"], axes)
        source = "scenario" if single else "study"
        if isinstance(design, AdaptiveDesign):
            beside = {"where": values["where"], "points": values["points"], "replicates": values["replicates"] > 1}
            for key in (key for key, value in beside.items() if value):
                raise InputError(f"study.{key} is not allowed with study.design.kind = {design.kind}")
        expect = tuple(_expectation(f"{source}.expect.{i}", one) for i, one in enumerate(values["expect"]))
        theory = tuple(parse_theory(f"study.theory.{i}", one) for i, one in enumerate(values["theory"]))
        keep = tuple(dict.fromkeys(map(str, values["keep"])))
        told = {"axes": axes, "design": design, "expect": expect, "theory": theory, "keep": keep, "single": single}
        return cls(**{**values, **told})


def _expectation(key: str, values: Any) -> RateExpectation:
    values = require_known_keys(key, values, ("where", "that", "at_least", "at_most"))
    for limit in ("at_least", "at_most"):
        value = values.get(limit, 0)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= 1:
            raise InputError(f"{key}.{limit} = {value!r} is not allowed: a share from 0 to 1")
    for condition in ("where", "that"):
        if not isinstance(values.get(condition, ""), str | None):
            raise InputError(f"{key}.{condition} = {values[condition]!r} is not allowed: a condition in quotes")
    one = RateExpectation(**values)
    if one.at_least > one.at_most:
        raise InputError(f"{key}.at_least = {one.at_least:g} is not allowed: at most its at_most, {one.at_most:g}")
    return one


def unit_of_column(column: str, system: System, settings: EngineSettings) -> str:
    """Return the unit of an axis column, such as `m`.

    Args:
        column: Column of the points table.
        system: The system of the study.
        settings: Engine settings of the study.

    Returns:
        The unit; empty for pure numbers and names.
    """
    found = "" if column.startswith("axis.") else system.parameter(column, settings).metadata.get("unit", "")
    return "" if found == "-" else found


def needs_recompilation(column: str, system: System, settings: EngineSettings) -> bool:
    """Return whether another value of a column needs another compiled engine.

    Args:
        column: Column of the points table.
        system: The system of the study.
        settings: Engine settings of the study.

    Returns:
        True for engine settings and for parameters that are no quantities.
    """
    return column.startswith("engine.") or system.parameter(column, settings).metadata["role"] != "quantity"


def attach_axis_names(rows: "pd.DataFrame", axes: Iterable[Axis]) -> "pd.DataFrame":
    """Return the rows with the names of the study's axes attached, so that conditions can use them as columns.

    Args:
        rows: Rows or points of the study; their columns stay as they are.
        axes: Axes of the study.

    Returns:
        The same rows, with the columns of the axes by name in `attrs`: see `expressions.find_column`.
    """
    named = rows.copy(deep=False)
    named.attrs[AXIS_NAMES_KEY] = {axis.name: axis.column for axis in axes if axis.column in rows}
    return named


def parameter_columns(table: "pd.DataFrame") -> list[str]:
    """Return the columns of a points table that are varied parameters."""
    return [c for c in table.columns if "." in c and not c.startswith("axis.")]


def expand_kept_time_series(study: Study, system: System) -> tuple[str, ...]:
    """Return the time-series columns that `study.keep` names; a prefix such as `qpos` stands for all columns that begin
    with it.

    Args:
        study: the study.
        system: the simulated system, which names its time series.
    """
    found: dict[str, None] = {}
    for name in study.keep:
        members = [one for one in system.recordable_columns if one.startswith(f"{name}_")]
        found |= dict.fromkeys(members if len(members) > 1 and name not in system.recordable_columns else [name])
    return tuple(found)


def check_kept_time_series(study: Study, system: System, settings: EngineSettings) -> None:
    """Raise `InputError` unless the time-series columns in `study.keep` exist and their rate is allowed.

    Args:
        study: the study.
        system: the simulated system, which names its time series.
        settings: has the control period.

    Raises:
        InputError: a time series is unknown, or the rate is no whole fraction of the control rate.
    """
    for name in study.keep:
        require_choice(name, system.recordable_columns, f"study.keep: {name}")
    ticks = 1 / (settings.control_period * study.keep_rate)
    if study.keep and (round(ticks) < 1 or abs(ticks - round(ticks)) > 1e-6):
        rate = f"a whole fraction of the control rate, {1 / settings.control_period:g} a second"
        raise InputError(f"study.keep_rate = {study.keep_rate:g} is not allowed: {rate}")


def validate_expectations(study: Study, system: System, points: "pd.DataFrame | None" = None) -> None:
    """Raise `InputError` unless the expectations of a study use columns that its rows will have.

    Args:
        study: The study.
        system: Its system.
        points: Points of the study; None where they are not known yet.

    Raises:
        InputError: A condition is malformed or names an unknown column.
    """
    import pandas as pd

    names = (
        *(points if points is not None else ()),
        *PLACEMENT_COLUMNS,
        *LABEL_COLUMNS,
        *TIMING_COLUMNS,
        *system.metric_names,
    )
    rows = pd.DataFrame(columns=list(dict.fromkeys(names)), dtype=object)
    for i, one in enumerate(study.expect):
        for key, condition in (("where", one.where), ("that", one.that)):
            try:
                condition_mask(attach_axis_names(rows, study.axes), condition)
            except InputError as error:
                source = "scenario" if study.single else "study"
                raise InputError(f"{source}.expect.{i}.{key}: {error}") from None


def make_points(
    study: Study,
    system: System,
    settings: EngineSettings,
    grid: "pd.DataFrame | None" = None,
    on_message: Logger | None = None,
    round_: RoundDraws | None = None,
    with_ids: bool = True,
) -> "pd.DataFrame":
    """Make the table of a study's rollouts: axis values, replicate, noise stream and point id.

    Points that are equal to `DIGITS` significant digits are merged. Every replicate of a drawn point has noise of its
    own; the noise of a point from a CSV file depends on its values.

    Args:
        study: The study.
        system: Its system.
        settings: Its engine settings.
        grid: Grid points that replace those of the study.
        on_message: Receives a line if points were merged.
        round_: Draws that replace those of the study, of a round of an adaptive design.
        with_ids: Whether the table is to be simulated. If not, noise streams and point ids, which take most of the
            memory, are left out unless they are needed to merge points.

    Returns:
        One row for each rollout; rows that share a compiled engine are adjacent.

    Raises:
        InputError: The study has too many rollouts, or a value is not allowed.
    """
    rollouts = study.replicates if study.points or grid is not None else study.max_rollouts
    if rollouts > MAX_STUDY_ROLLOUTS:
        raise InputError(f"study {study.name} has {rollouts} rollouts: at most {MAX_STUDY_ROLLOUTS} are allowed")
    if study.points:
        design = _from_csv(study.points)
    else:
        told = partial(system.nominal_parameter_value, settings=settings)
        if study.is_adaptive and round_ is None:
            _check_ends(study, system, settings)
            round_ = next(study.adaptive_design.start_search(study.draw_context))
        design = designs.make_design_table(study.axes, study.design, study.seed, told, grid, round_)
    draw = design.pop("draw") if not study.points else 0
    fields = {c: system.parameter(c, settings) for c in design.columns if not c.startswith("axis.")}
    drawn = [str(axis.parameter_column) for axis in study.axes if axis.distribution and axis.path and not study.points]
    listed = design.columns.difference(drawn) if grid is None else ()  # not those between listed ones
    for column, member in fields.items():
        try:
            _check_values(member, design[column], column, exact=column in listed)
        except InputError as error:
            axis = next((axis for axis in study.axes if axis.parameter_column == column and axis.distribution), None)
            if axis is None or study.points:
                raise
            raise InputError(
                f"{error}; axis {axis.name} draws it: give its distribution `from` and `to` to truncate it"
            ) from None
    whole = [column for column in drawn if fields[column].metadata.get("unit") in WHOLE_NUMBER_UNITS]
    design[whole] = np.rint(design[whole])  # rows say what is simulated
    design = design.astype({column: DTYPE_BY_ROLE[member.metadata["role"]] for column, member in fields.items()})
    if len(fields) > FEW_COLUMNS:
        design = design.copy()
    system.check(design, settings)
    # static axes outermost: every compiled engine runs its rows in one go
    static = [column for column in fields if needs_recompilation(column, system, settings)]
    order = design.groupby(static, sort=False).ngroup().argsort(kind="stable") if static else slice(None)
    design = design.assign(draw=draw).iloc[order]
    if study.where:
        design = design.loc[condition_mask(attach_axis_names(design, study.axes), study.where)]
    table = design.loc[design.index.repeat(study.replicates)] if study.replicates > 1 else design
    table = table.reset_index(drop=True)
    again = np.tile(np.arange(study.replicates), len(design))
    table["replicate"] = table.pop("draw").to_numpy() * study.replicates + again
    # draws of one grid point differ by their number
    drawn_alone = not study.points and grid is None and all(axis.values is None for axis in study.axes)
    if not with_ids and (drawn_alone or are_all_different(point_hashes(table, system))):
        return table
    if study.points:
        table["stream"] = row_noise_seeds(study.seed, table)
    else:
        table["stream"] = replicate_noise_seeds(study.seed, int(table["replicate"].to_numpy().max(initial=0)) + 1)[
            table["replicate"]
        ]
    table["point_id"] = point_ids(hashes := point_hashes(table, system))
    if are_all_different(hashes):  # told in a tenth of the memory that comparing words takes
        return table
    distinct = table.drop_duplicates(rollout_id_columns(table.columns), ignore_index=True)
    if on_message and len(distinct) < len(table):
        on_message(
            f"{len(table) - len(distinct)} of {len(table)} rollouts are left out: "
            f"they equal others in {HASHED_DIGITS} digits"
        )
    return distinct


def _check_values(member: Parameter, values: "pd.Series", column: str, exact: bool = False) -> None:
    """Check that all values lie within their bounds; `exact` also refuses fractions of whole numbers."""
    import pandas as pd

    if values.dtype.kind == "f" and member.metadata["role"] == "quantity":
        between = (values % 1 != 0) & (exact and member.metadata["unit"] in WHOLE_NUMBER_UNITS)
        values = values[~(np.isfinite(values) & is_within_bounds(member, values)) | between].head(1)
    is_word = member.metadata["role"] in ("choice", "file")
    if values.dtype.kind in "OUT" and not is_word:  # of a file: one word makes a column words
        no_number = values[pd.to_numeric(values, errors="coerce").isna()]
        values = (no_number if len(no_number) else values).head(1)
    for value in values.unique().tolist():
        convert_and_check_value(member, value, column)


def extreme_points(study: Study, system: System, settings: EngineSettings) -> "pd.DataFrame":
    """Make two points for each grid point, with all drawn axes at their lower and at their upper ends.

    Args:
        study: The study.
        system: Its system.
        settings: Its engine settings.

    Returns:
        Points table; empty where no axis is drawn.
    """
    told = partial(system.nominal_parameter_value, settings=settings)
    return designs.make_design_table(
        study.axes, study.design, study.seed, told, round_=designs.extreme_draws(study.axes)
    )


def _check_ends(study: Study, system: System, settings: EngineSettings) -> None:
    """Raise `InputError` where a parameter's bounds exclude the tails of its distribution, which a search may reach."""
    table = extreme_points(study, system, settings)
    for column in parameter_columns(table):
        try:
            _check_values(system.parameter(column, settings), table[column], column)
        except InputError as error:
            raise InputError(f"{error}; rare draws reach this value: give the distribution `from` and `to`") from None


def rollout_id_columns(columns: Any) -> list[str]:
    """List the columns that identify a rollout of a study: `point_id`, and the varied engine settings."""
    return ["point_id", *(c for c in columns if c.startswith("engine."))]


def _from_csv(file: str) -> "pd.DataFrame":
    import pandas as pd

    if not Path(file).is_file():
        raise InputError(f"study.points = {file} is not a file")
    try:
        table = pd.read_csv(file, skipinitialspace=True)
    except ValueError as error:
        raise InputError(
            f"study.points = {file} is not a table: {str(error).splitlines()[0].rpartition('C error: ')[2]}"
        ) from None
    if not isinstance(table.index, pd.RangeIndex):  # as of numbers with a decimal comma: pandas shifts them
        if ";" in Path(file).read_text(encoding="utf-8", errors="replace").partition("\n")[0]:
            raise InputError(f"study.points = {file} separates values by semicolons: use commas")
        raise InputError(f"study.points = {file} is not a table: a line has more values than there are column names")
    if table.empty:
        raise InputError(f"study.points = {file} holds no points")
    if len(table.columns) == 1 and ";" in table.columns[0]:
        raise InputError(f"study.points = {file} separates values by semicolons: use commas")
    return table


def replace_settings(settings: EngineSettings, values: ColumnValues) -> EngineSettings:
    """Return engine settings in which the `engine.` columns of a row replace the study's values.

    Args:
        settings: Engine settings of the study.
        values: Values of the row by column; those of `engine.` columns are used.

    Returns:
        The settings.
    """
    for column, value in values.items():
        if column.startswith("engine."):
            settings = dataclasses.replace(settings, **{column.removeprefix("engine."): value})
    return settings
