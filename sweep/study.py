"""Which rollouts a study consists of: axes over paths of the nominal case, a table of points, and their parameters.

A column of the points table is an axis path such as `contact.friction`, prefixed `world.` or `belief.` where only
one of the two is varied.
"""

import dataclasses
import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from sweep.case import Case
from sweep.engines.settings import EngineSettings
from sweep.parameters import InputError, checked, suggest
from sweep.query import mask

SIDES = ("world", "belief")
DTYPES = {"quantity": "float64", "count": "int64", "choice": "str"}
Values = Mapping[str, Any]


@dataclass(frozen=True)
class Axis:
    """Values given to one path, in the world, in the belief or in both."""

    path: str
    on: str
    values: tuple[Any, ...]

    @property
    def column(self) -> str:
        """Its column in the points table."""
        return self.path if self.on == "both" else f"{self.on}.{self.path}"


@dataclass(frozen=True)
class Expectation:
    """Among the valid rows that match `where`, the share of those matching `that` lies within the limits."""

    where: str | None = None
    that: str = 'outcome == "success"'
    at_least: float = 0.0
    at_most: float = 1.0


@dataclass(frozen=True)
class Study:
    """A grid over axes, or the points of a CSV file, each repeated with different noise."""

    name: str
    single: bool  # one nominal rollout, shown rather than stored
    axes: tuple[Axis, ...]
    points: str | None  # CSV file that takes the place of the grid
    where: str | None  # points to keep
    replicates: int
    seed: int
    invalid_max: float  # largest tolerated share of invalid rows
    expect: tuple[Expectation, ...]

    @classmethod
    def parse(cls, values: Mapping[str, Any], single: bool) -> "Study":
        """From plain values. Raises `InputError`."""
        if values["replicates"] < 1:
            raise InputError(f"study.replicates = {values['replicates']} is not allowed: at least 1")
        if values["seed"] < 0:
            raise InputError(f"study.seed = {values['seed']} is not allowed: at least 0")
        if "/" in values["name"]:
            raise InputError(f"study.name = {values['name']!r} is not allowed: a folder name")
        axes = tuple(_axis(f"study.axes.{name}", axis) for name, axis in values["axes"].items())
        source = "scenario" if single else "study"
        expect = tuple(_expectation(f"{source}.expect.{i}", one) for i, one in enumerate(values["expect"]))
        return cls(**{**values, "axes": axes, "expect": expect, "single": single})


def _known(path: str, given: Any, allowed: tuple[str, ...]) -> dict[str, Any]:
    if not isinstance(given, Mapping):
        raise InputError(f"{path} = {given!r} is not allowed: keys and values (allowed: {', '.join(allowed)})")
    for key in given:
        if key not in allowed:
            raise InputError(f"{path}.{key} is unknown{suggest(str(key), allowed)}")
    return {str(k): v for k, v in given.items()}


def _axis(key: str, given: Any) -> Axis:
    given = _known(key, given, ("path", "on", "values", "from", "to", "num"))
    on = given.get("on", "both")
    if on not in ("both", *SIDES):
        raise InputError(f"{key}.on = {on!r} is not allowed: one of both, world, belief")
    if not isinstance(given.get("path"), str):
        raise InputError(f"{key}.path is missing: a parameter such as contact.friction")
    values = given.get("values")
    if values is not None:  # which win over a range, so that a command line can replace a study's range
        if not isinstance(values, list) or not values:
            raise InputError(f"{key}.values = {values!r} is not allowed: a list with at least one value")
        return Axis(given["path"], on, tuple(values))
    ends = [given.get("from"), given.get("to"), given.get("num")]
    if ends == [None] * 3:
        raise InputError(f"{key} needs values, or from, to and num")
    for name, end in zip(("from", "to", "num"), ends, strict=True):
        if (
            isinstance(end, bool)
            or not isinstance(end, int | float)
            or (name == "num" and (end != int(end) or end < 1))
        ):
            raise InputError(
                f"{key}.{name} = {end!r} is not allowed: a {'whole number from 1' if name == 'num' else 'number'}"
            )
    # shortest decimals, so that the values read, compare and hash as written
    return Axis(given["path"], on, tuple(float(f"{v:.12g}") for v in np.linspace(ends[0], ends[1], int(ends[2]))))


def _expectation(key: str, given: Any) -> Expectation:
    given = _known(key, given, ("where", "that", "at_least", "at_most"))
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
    owner: Any = case
    groups = [f.name for f in dataclasses.fields(case)] + (["engine"] if side == "both" else [])
    *above, last = path.split(".")
    for step, name in enumerate([*above, last]):
        allowed = groups if step == 0 else [f.name for f in dataclasses.fields(owner)]
        if name not in allowed or (name == last and step == 0):
            before = "".join(f"{p}." for p in path.split(".")[:step])
            raise InputError(f"axis {column} names nothing: {before}{name} is unknown{suggest(name, allowed)}")
        if step < len(above):
            owner = settings if name == "engine" and step == 0 else getattr(owner, name)
            if not dataclasses.is_dataclass(owner):
                raise InputError(f"axis {column} names nothing: {name} has no parts")
    found = next(f for f in dataclasses.fields(owner) if f.name == last)
    if found.metadata.get("role") not in DTYPES:
        raise InputError(f"axis {column} cannot be varied: only single numbers and names can")
    return found


def is_static(column: str, case: Case, settings: EngineSettings) -> bool:
    """Whether another value of `column` needs another compiled engine."""
    return column.startswith("engine.") or parameter(column, case, settings).metadata["role"] != "quantity"


def points(study: Study, case: Case, settings: EngineSettings) -> pd.DataFrame:
    """One row per rollout: axis values, replicate, noise stream and point id. Raises `InputError`."""
    design = _from_csv(study.points) if study.points else _grid(study.axes)
    fields = {column: parameter(column, case, settings) for column in design.columns}
    for column, member in fields.items():
        for value in design[column].unique().tolist():
            checked(member, value, column)
    design = design.astype({column: DTYPES[member.metadata["role"]] for column, member in fields.items()})
    # static axes outermost: every compiled engine runs its rows in one go
    static = [column for column in fields if is_static(column, case, settings)]
    order = design.groupby(static, sort=False).ngroup().argsort(kind="stable") if static else slice(None)
    design = design.iloc[order].loc[lambda d: mask(d, study.where)]
    table = design.loc[design.index.repeat(study.replicates)].reset_index(drop=True)
    table["replicate"] = np.tile(np.arange(study.replicates), len(design))
    streams = [np.random.SeedSequence([study.seed, r]).generate_state(1)[0] for r in range(study.replicates)]
    table["stream"] = np.asarray(streams, dtype=np.int64)[table["replicate"]]
    table["point_id"] = list(point_ids(table, case))
    return table.drop_duplicates(identity(table.columns), ignore_index=True)


def identity(columns: Any) -> list[str]:
    """The columns that tell one rollout of a study from another: the point, and how it is simulated."""
    return ["point_id", *(c for c in columns if c.startswith("engine."))]


def _grid(axes: tuple[Axis, ...]) -> pd.DataFrame:
    if len({axis.column for axis in axes}) < len(axes):
        raise InputError(f"study.axes name the same parameter twice: {', '.join(axis.column for axis in axes)}")
    if not axes:
        return pd.DataFrame(index=range(1))
    return pd.MultiIndex.from_product([a.values for a in axes], names=[a.column for a in axes]).to_frame(index=False)


def _from_csv(file: str) -> pd.DataFrame:
    if not Path(file).is_file():
        raise InputError(f"study.points = {file} is not a file")
    try:
        table = pd.read_csv(file, skipinitialspace=True)
    except ValueError as error:
        raise InputError(f"study.points = {file} is not a table: {str(error).splitlines()[0]}") from None
    if table.empty:
        raise InputError(f"study.points = {file} holds no points")
    return table


def point_ids(table: pd.DataFrame, case: Case) -> Iterator[str]:
    """Hash of all physical inputs of every row and its replicate; how it is simulated plays no part."""
    columns = [c for c in table.columns if side_and_path(c)[1].partition(".")[0] in _group_names(case)]
    # the nominal texts are made once; a row replaces a few of them
    texts = {f"{side}.{path}": _text(value) for side in SIDES for path, value in _flat(case, "")}
    paths = [(c, *side_and_path(c)) for c in sorted(columns, key=lambda c: side_and_path(c)[0] != "both")]
    for row in table.to_dict("records"):
        here = dict(texts)
        for column, side, path in paths:
            here.update({f"{s}.{path}": _text(row[column]) for s in (SIDES if side == "both" else (side,))})
        content = "\n".join(f"{key}={here[key]}" for key in sorted(here)) + f"\nreplicate={row['replicate']}"
        yield hashlib.blake2b(content.encode(), digest_size=8).hexdigest()


def _group_names(case: Case) -> set[str]:
    return {f.name for f in dataclasses.fields(case)}


def _flat(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    if dataclasses.is_dataclass(value):
        for member in dataclasses.fields(value):
            yield from _flat(getattr(value, member.name), f"{path}.{member.name}" if path else member.name)
    else:
        yield path, value


def _text(value: Any) -> str:
    return f"{float(value):.12g}" if isinstance(value, float | np.floating) else str(value)


def assign[T](owner: T, path: str, value: Any) -> T:
    """`owner` with the member at `path` replaced."""
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
