"""Which rollouts a study consists of: axes over paths of the nominal case, a table of points, and their parameters.

A column of the points table is an axis path such as `contact.friction`, prefixed `world.` or `belief.` where only
one of the two is varied, or `axis.NAME` for a number that values are made from (see `sweep.study.designs`).
"""

import dataclasses
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sweep.core.errors import InputError, suggest
from sweep.core.expressions import mask
from sweep.core.parameters import checked, within
from sweep.engines.settings import EngineSettings
from sweep.engines.states import offered
from sweep.models import plan_table
from sweep.models.case import Case
from sweep.models.plan_table import PlanTable
from sweep.study import designs
from sweep.study.designs import SIDES, Axis, Design
from sweep.study.distributions import known
from sweep.study.identity import DIGITS, point_ids, streams
from sweep.study.theory import Theory
from sweep.study.theory import parse as parse_theory

if TYPE_CHECKING:
    import pandas as pd

DTYPES = {"quantity": "float64", "count": "int64", "choice": "str"}
SIZED, SMALLEST, LARGEST = ("robot", "obstacle"), 0.01, 20.0  # whose lengths (m) from where on, how often the nominal
Values = Mapping[str, Any]
Say = Callable[[str], None]

RELAXING = "contact.stiffness", "contact.damping", "engine.time_step", "engine.name"


@dataclass(frozen=True)
class Expectation:
    """Among the valid rows that match `where`, the share of those matching `that` lies within the limits."""

    where: str | None = None
    that: str = 'outcome == "success"'
    at_least: float = 0.0
    at_most: float = 1.0


@dataclass(frozen=True)
class ScenarioSchema:
    """What is simulated nominally; `expect` must hold when it runs without a study."""

    name: str = "nominal"
    expect: list[Any] = field(default_factory=list)


@dataclass(frozen=True)
class _Plain:
    """What a study's configuration holds as it is."""

    name: str = ""
    points: str | None = None  # CSV file that takes the place of the axes
    where: str | None = None  # points to keep
    replicates: int = 1
    seed: int = 0
    resolution: float = 0.0  # cells that disagree are halved until they are this share of their axis; 0: not at all
    level: float = 0.5  # of the success region, where rollouts of a point differ
    budget: int = 0  # most rollouts that refinement may take; 0: no limit
    audit: int = 0  # random points in decided cells that are run as a check
    keep_rate: float = 10.0  # samples of the columns `keep` in a simulated second
    keep_rows: int = 1000  # of the plan, from its first, whose histories are kept
    invalid_max: float = 0.01  # largest tolerated share of invalid rows


@dataclass(frozen=True)
class StudySchema(_Plain):
    """Which variations of the scenario are run, as the configuration says it; `Study.parse` reads the rest."""

    axes: dict[str, Any] = field(default_factory=dict)
    design: Design = field(default_factory=Design)
    expect: list[Any] = field(default_factory=list)
    theory: list[Any] = field(default_factory=list)
    keep: list[Any] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class Study(_Plain):
    """Points of a grid and of distributions, or of a CSV file, each repeated with different noise."""

    single: bool  # one nominal rollout, shown rather than stored
    axes: tuple[Axis, ...]
    design: Design  # of the axes that have a distribution
    expect: tuple[Expectation, ...]
    theory: tuple[Theory, ...]  # drawn over its maps
    keep: tuple[str, ...]  # columns whose time histories are kept, see `sweep.engines.states`

    @property
    def refined(self) -> bool:
        """Whether what to run next depends on what was found."""
        return self.resolution > 0 or self.budget > 0

    @property
    def noisy(self) -> bool:
        """Whether rollouts of one grid point differ."""
        return self.replicates > 1 or self.design.num > 0

    @property
    def most(self) -> int:
        """Rollouts of its axes and draws, those of equal points among them."""
        return self.replicates * designs.size(self.axes, self.design)

    @classmethod
    def parse(cls, values: Mapping[str, Any], single: bool) -> "Study":
        """From plain values. Raises `InputError`."""
        if values["replicates"] < 1:
            raise InputError(f"study.replicates = {values['replicates']} is not allowed: at least 1")
        if values["seed"] < 0:
            raise InputError(f"study.seed = {values['seed']} is not allowed: at least 0")
        if not 0 < values["level"] < 1:
            raise InputError(f"study.level = {values['level']:g} is not allowed: between 0 and 1")
        if not 0 <= values["resolution"] < 1:
            raise InputError(f"study.resolution = {values['resolution']:g} is not allowed: at least 0 and below 1")
        if not 0 <= values["invalid_max"] <= 1:
            raise InputError(f"study.invalid_max = {values['invalid_max']:g} is not allowed: a share from 0 to 1")
        if values["keep_rows"] < 1:
            raise InputError(f"study.keep_rows = {values['keep_rows']} is not allowed: at least 1")
        for key in ("budget", "audit"):
            if values[key] < 0:
                raise InputError(f"study.{key} = {values[key]} is not allowed: at least 0")
        name = values["name"]  # of a folder
        if name and (not name.strip(". ") or not re.fullmatch(r"[^/\x00-\x1f\x7f]{1,200}", name)):
            raise InputError(f"study.name = {name!r} is not allowed: a folder name")
        axes = designs.parse_axes(values["axes"])
        design = designs.parse_design(values["design"], axes)
        source = "scenario" if single else "study"
        expect = tuple(_expectation(f"{source}.expect.{i}", one) for i, one in enumerate(values["expect"]))
        theory = tuple(parse_theory(f"study.theory.{i}", one) for i, one in enumerate(values["theory"]))
        keep = tuple(dict.fromkeys(values["keep"]))
        told = {"axes": axes, "design": design, "expect": expect, "theory": theory, "keep": keep, "single": single}
        return cls(**{**values, **told})


def _expectation(key: str, given: Any) -> Expectation:
    given = known(key, given, ("where", "that", "at_least", "at_most"))
    for limit in ("at_least", "at_most"):
        value = given.get(limit, 0)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= 1:
            raise InputError(f"{key}.{limit} = {value!r} is not allowed: a share from 0 to 1")
    return Expectation(**given)


def side_and_path(column: str) -> tuple[str, str]:
    """`world.contact.friction` -> (`world`, `contact.friction`)."""
    side, _, path = column.partition(".")
    return (side, path) if side in SIDES else ("both", column)


def parameter(column: str, case: Case, settings: EngineSettings) -> "dataclasses.Field[Any]":
    """The field that a column varies. Raises `InputError` where it names nothing."""
    side, path = side_and_path(column)
    if path.startswith("plan."):
        if side == "world":
            raise InputError(f"axis {column} varies nothing: plans are made of what is believed")
        return plan_table.member(case, path.removeprefix("plan."))
    owner, name = _owner(column, case, settings)
    found = next(f for f in dataclasses.fields(owner) if f.name == name)
    if found.metadata.get("role") not in DTYPES:
        raise InputError(f"axis {column} cannot be varied: only single numbers and names can")
    return found


def nominal(column: str, case: Case, settings: EngineSettings) -> Any:
    """The value of a parameter where it is not varied. Raises `InputError` where `column` names nothing."""
    if side_and_path(column)[1].startswith("plan."):
        return parameter(column, case, settings).default
    return getattr(*_owner(column, case, settings))


def unit(column: str, case: Case, settings: EngineSettings) -> str:
    """Unit of an axis; empty for pure numbers and names."""
    found = "" if column.startswith("axis.") else parameter(column, case, settings).metadata.get("unit", "")
    return "" if found == "-" else found


def _owner(column: str, case: Case, settings: EngineSettings) -> tuple[Any, str]:
    side, path = side_and_path(column)
    owner: Any = case
    groups = [f.name for f in dataclasses.fields(case)] + (["engine"] if side == "both" else [])
    *above, last = path.split(".")
    for step, name in enumerate([*above, last]):
        allowed = groups if step == 0 else [f.name for f in dataclasses.fields(owner)]
        if name not in allowed or (name == last and step == 0):
            parts = [(group, settings if group == "engine" else getattr(case, group)) for group in groups]
            whole = [f"{group}.{name}" for group, part in parts if hasattr(part, name)] if step == 0 else []
            hint = f": did you mean {' or '.join(whole)}?" if whole else suggest(name, allowed)
            before = "".join(f"{p}." for p in path.split(".")[:step])
            raise InputError(f"axis {column} names nothing: {before}{name} is unknown{hint}")
        if step < len(above):
            owner = settings if name == "engine" and step == 0 else getattr(owner, name)
            if not dataclasses.is_dataclass(owner):
                raise InputError(f"axis {column} names nothing: {name} has no parts")
    return owner, last


def is_static(column: str, case: Case, settings: EngineSettings) -> bool:
    """Whether another value of `column` needs another compiled engine."""
    return column.startswith("engine.") or parameter(column, case, settings).metadata["role"] != "quantity"


def parameter_columns(table: "pd.DataFrame") -> list[str]:
    """The columns of `table` that vary a parameter."""
    return [c for c in table.columns if "." in c and not c.startswith("axis.")]


def check_sizes(case: Case) -> None:
    """Raise `InputError` where robot or obstacle is so large that a unit must be wrong."""
    for group in SIZED:
        part = getattr(case, group)
        for member in dataclasses.fields(part):
            _check_size(f"{group}.{member.name}", member, getattr(part, member.name))


def _check_size(column: str, member: "dataclasses.Field[Any]", value: Any) -> None:
    group, nominal = side_and_path(column)[1].partition(".")[0], member.default
    if group not in SIZED or member.metadata.get("unit") != "m" or not isinstance(nominal, float):
        return
    if nominal >= SMALLEST and value > LARGEST * nominal:
        meant = min((value / 100, value / 1000), key=lambda size: abs(math.log(size / nominal)))
        allowed = f"at most {LARGEST:g} times the nominal {nominal:g} m"
        raise InputError(f"{column} = {value:g} is not allowed: is it {meant:g} m? ({allowed})")


def check_keep(study: Study, case: Case, settings: EngineSettings) -> None:
    """Raise `InputError` where time histories are asked for that there are none of."""
    columns = offered(case)
    for name in study.keep:
        if name not in columns:
            raise InputError(f"study.keep: {name} is unknown{suggest(str(name), columns)}")
    ticks = 1 / (settings.control_period * study.keep_rate) if study.keep_rate > 0 else 0.0
    if study.keep and (round(ticks) < 1 or abs(ticks - round(ticks)) > 1e-6):
        rate = f"a whole fraction of the control rate, {1 / settings.control_period:g} a second"
        raise InputError(f"study.keep_rate = {study.keep_rate:g} is not allowed: {rate}")


def points(
    study: Study, case: Case, settings: EngineSettings, grid: "pd.DataFrame | None" = None, say: Say | None = None
) -> "pd.DataFrame":
    """One row per rollout: axis values, replicate, noise stream and point id. Raises `InputError`.

    Points that are equal in all their digits that count are one; `say` is told how many others there were.

    The replicates of a drawn point have numbers of their own, and with them noise of their own. `grid` takes the place
    of the study's grid points (see `designs.table`).
    """
    count = study.replicates if study.points or grid is not None else study.most
    if count > designs.MOST:
        raise InputError(f"study {study.name} has {count} rollouts: at most {designs.MOST} are allowed")
    if study.points:
        design = _from_csv(study.points)
    else:
        design = designs.table(study.axes, study.design, study.seed, lambda path: nominal(path, case, settings), grid)
    draw = design.pop("draw") if not study.points else 0
    fields = {c: parameter(c, case, settings) for c in design.columns if not c.startswith("axis.")}
    for column, member in fields.items():
        _check(member, design[column], column)
    design = design.astype({column: DTYPES[member.metadata["role"]] for column, member in fields.items()})
    _check_step(design, case, settings)
    # static axes outermost: every compiled engine runs its rows in one go
    static = [column for column in fields if is_static(column, case, settings)]
    order = design.groupby(static, sort=False).ngroup().argsort(kind="stable") if static else slice(None)
    design = design.assign(draw=draw).iloc[order].loc[lambda d: mask(d, study.where)]
    table = design.loc[design.index.repeat(study.replicates)].reset_index(drop=True)
    again = np.tile(np.arange(study.replicates), len(design))
    table["replicate"] = table.pop("draw").to_numpy() * study.replicates + again
    table["stream"] = streams(study.seed, int(table["replicate"].to_numpy().max(initial=0)) + 1)[table["replicate"]]
    table["point_id"] = point_ids(table, case)
    distinct = table.drop_duplicates(identity(table.columns), ignore_index=True)
    if say and len(distinct) < len(table):
        say(f"{len(table) - len(distinct)} of {len(table)} rollouts are left out: equal to others in {DIGITS} digits")
    return distinct


def _check(member: "dataclasses.Field[Any]", values: "pd.Series", column: str) -> None:
    """Every value inside the bounds of its parameter; a million numbers at once."""
    import pandas as pd

    largest = values.max() if values.dtype.kind in "fi" else 0.0
    if values.dtype.kind == "f" and member.metadata["role"] == "quantity":
        values = values[~(np.isfinite(values) & within(member, values))].head(1)
    if values.dtype.kind in "OUT" and member.metadata["role"] != "choice":  # of a file: one word makes a column words
        no_number = values[pd.to_numeric(values, errors="coerce").isna()]
        values = (no_number if len(no_number) else values).head(1)
    for value in values.unique().tolist():
        checked(member, value, column)
    _check_size(column, member, largest)


def _check_step(design: "pd.DataFrame", case: Case, settings: EngineSettings) -> None:
    """Raises `InputError` where a step of mjx is longer than contacts take to relax: they would not stay in contact."""
    import pandas as pd

    sides = {path: [c for c in (f"world.{path}", path) if c in design.columns] for path in RELAXING}
    values = {path: design[own[0]] if own else nominal(path, case, settings) for path, own in sides.items()}
    found = pd.DataFrame(values, index=design.index)
    stiffness, damping, step, name = (found[path] for path in RELAXING)
    slow = found[(name == "mjx") & (step * stiffness > damping * (1 + 1e-9))]
    for stiffness, damping, step, _ in slow.head(1).itertuples(index=False):
        raise InputError(
            f"engine.time_step = {step:g} is not allowed: at most contact.damping over contact.stiffness, "
            f"{damping:g} N s/m over {stiffness:g} N/m"
        )


def identity(columns: Any) -> list[str]:
    """The columns that tell one rollout of a study from another: the point, and how it is simulated."""
    return ["point_id", *(c for c in columns if c.startswith("engine."))]


def _from_csv(file: str) -> "pd.DataFrame":
    import pandas as pd

    if not Path(file).is_file():
        raise InputError(f"study.points = {file} is not a file")
    try:
        table = pd.read_csv(file, skipinitialspace=True)
    except ValueError as error:
        raise InputError(f"study.points = {file} is not a table: {str(error).splitlines()[0]}") from None
    if table.empty:
        raise InputError(f"study.points = {file} holds no points")
    return table


def assign[T](owner: T, path: str, value: Any) -> T:
    """`owner` with the member at `path` replaced."""
    if isinstance(owner, PlanTable):
        return owner.changed(path, value)  # pyright: ignore[reportReturnType]
    name, _, rest = path.partition(".")
    inner = assign(getattr(owner, name), rest, value) if rest else value
    return dataclasses.replace(owner, **{name: inner})  # pyright: ignore[reportArgumentType]


def world_and_belief(case: Case, values: Values) -> tuple[Case, Case]:
    """What is simulated and what the planner is told: common values first, then each side's own."""
    sides = {}
    for side in SIDES:
        sides[side] = case
        for here in ("both", side):
            for column, value in values.items():
                on, path = side_and_path(column)
                if on == here and not path.startswith("engine."):
                    sides[side] = assign(sides[side], path, value)
    return sides["world"], sides["belief"]


def with_settings(settings: EngineSettings, values: Values) -> EngineSettings:
    """The engine settings of a row."""
    for column, value in values.items():
        if column.startswith("engine."):
            settings = assign(settings, column.removeprefix("engine."), value)
    return settings
