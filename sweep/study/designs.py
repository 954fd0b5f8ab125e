"""Design of experiments: a grid of listed values, and draws from distributions at each grid point.

Every axis gives a number n, listed or drawn, and turns it into a value of its path:

- n itself;
- with `times: PATH`, n times the value of another parameter at the same point (a ratio such as r/a_r);
- with `relative: s`, (1 + s n) times its own nominal value; n is uniform between -1 and 1 unless given.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sweep.contract.system import SIDES
from sweep.core.errors import InputError, format_name_suggestion, require_choice
from sweep.core.parameters import convert_and_check_value
from sweep.study import adaptive_sampling, design_kinds
from sweep.study.design_kinds.base import GRIDS, Design, DrawContext
from sweep.study.distributions import (
    Distribution,
    format_values,
    parse_number,
    parse_value_list,
    refuse_spreadsheet_formula,
    require_known_keys,
)
from sweep.study.distributions import parse_distribution as parse_distribution
from sweep.study.size_limits import MAX_STUDY_ROLLOUTS

if TYPE_CHECKING:
    import pandas as pd

AXIS_KEYS = {  # meaning of each key of an axis
    "path": "parameter that varies, such as contact.friction; without it the axis is a number that other axes refer to",
    "side": "world: vary what is simulated; belief: what the planner believes; both (default)",
    "values": "list of values; with all other listed axes they form the grid",
    "from": "first value of an evenly spaced list",
    "to": "last value of it",
    "num": "number of values of it",
    "distribution": "distribution to draw values from, instead of a list",
    "relative": "s, or the name of an axis that gives it: the value is (1 + s n) times the nominal one, n from -1 to 1",
    "times": "path of another parameter: the value is the number times that parameter at the same point",
    "with": "name of a listed axis whose values this one goes along with, one by one",
    "nominal": "the number of an axis without a path where it is not varied",
}
PARAMETER_EXAMPLE = "a parameter such as contact.friction"
FORMER_SIDE_KEYS = ("on", True)  # what `side` was called; a bare `on` is YAML's true


@dataclass(frozen=True)
class Axis:
    """One varied parameter of a study; without a path, an auxiliary number from which other axes are computed."""

    name: str
    path: str | None
    side: str
    values: tuple[Any, ...] | None  # listed: a part of the grid
    distribution: Distribution | None  # drawn
    relative: float | str | None  # s, or the name of an axis that gives it
    times: str | None
    along: str | None  # the axis whose values this one's go along with, one by one
    nominal: float  # n of an axis without a path where it is not varied

    @property
    def parameter_column(self) -> str | None:
        """Column of the points table with the parameter's values; None for an axis without a path."""
        return self.path if self.path is None or self.side == "both" else f"{self.side}.{self.path}"

    @property
    def column(self) -> str:
        """Name of the column that users read: that of the parameter, or of the number that it follows from."""
        own = self.path is None or self.times is not None or (self.relative is not None and self.values is not None)
        return f"axis.{self.name}" if own else str(self.parameter_column)

    def nominal_value(self, nominal_of: Callable[[str], Any]) -> Any:
        """Return the value at which the auxiliary number of this axis gives the parameter its nominal value.

        Args:
            nominal_of: Returns the nominal value of a parameter path.

        Raises:
            InputError: A parameter to divide by is a name.
        """
        if self.path is None:
            return self.nominal
        if self.relative is not None:
            return 0.0
        if self.times:
            return _finite(self, self.path, nominal_of) / _finite(self, self.times, nominal_of)
        return nominal_of(self.path)

    def __str__(self) -> str:
        what = format_values(self.values) if self.values is not None else str(self.distribution)
        if self.relative is not None:
            percent = f"{100 * self.relative:g} %" if isinstance(self.relative, float) else self.relative
            return f"nominal x (1 + {percent} x {what})"
        return f"{what}, times {self.times}" if self.times else what


def refuse_ignored_settings(study: Mapping[str, Any]) -> None:
    """Raise `InputError` if a newly composed study sets values that its design ignores.

    Stored studies of earlier versions may have them and stay readable.
    """
    if blank := [name for name in study["axes"] if not str(name).strip()]:
        raise InputError(f"study.axes.{blank[0]!r} is not allowed: a name")
    design = study.get("design")
    if not isinstance(design, Mapping):
        return  # which is refused by what reads it
    defaults = dataclasses.asdict(design_kinds.make_schema()())
    for key, kinds in design_kinds.kinds_by_setting().items():
        usual, value = defaults[key], design[key]
        if design["kind"] not in kinds and value != usual:
            needs = f"it needs kind = {' or '.join(kinds)} (default {usual})"
            raise InputError(
                f"study.design.{key} = {value} is not allowed with study.design.kind = {design['kind']}: {needs}"
            )


def rename_legacy_side_keys(axes: Mapping[str, Any]) -> dict[str, Any]:
    """Rename the key `on` of axes in older files to `side` (world or belief). Raises `InputError` if both are there."""

    def renamed(name: str, axis: Mapping[Any, Any]) -> dict[Any, Any]:
        if "side" in axis and any(key in FORMER_SIDE_KEYS for key in axis):
            raise InputError(f"study.axes.{name}.on is not allowed together with side, its new name")
        return {"side" if key in FORMER_SIDE_KEYS else key: value for key, value in axis.items()}

    return {name: renamed(name, axis) if isinstance(axis, Mapping) else axis for name, axis in axes.items()}


def expand_axis_patterns(axes_config: Mapping[str, Any], paths_below: Callable[[str], Sequence[str]]) -> dict[str, Any]:
    """Expand axes whose path ends in `.*`, such as `plan.off.*`, into one axis for each number below it.

    Args:
        axes_config: Plain axes by name.
        paths_below: Returns the paths of numbers that start with a prefix.

    Returns:
        Plain axes by name, without patterns.

    Raises:
        InputError: A pattern matches nothing.
    """
    axes = {}
    for name, axis in axes_config.items():
        path = axis.get("path") if isinstance(axis, Mapping) else None
        if not isinstance(path, str) or not path.endswith(".*"):
            axes[name] = axis
            continue
        start = path.removesuffix("*")
        found = {f"{name}_{number.removeprefix(start).replace('.', '_')}": number for number in paths_below(start)}
        if not found:
            raise InputError(f"study.axes.{name}.path = {path} matches no number that is not zero")
        axes |= {one: {**axis, "path": number} for one, number in found.items()}
    return axes


def parse_axes(axes_config: Mapping[str, Any]) -> tuple[Axis, ...]:
    """Parse the axes (varied parameters) of a study from plain configuration values. Raises `InputError`."""
    axes = tuple(_axis(f"study.axes.{name}", name, axis) for name, axis in rename_legacy_side_keys(axes_config).items())
    columns = [a.parameter_column for a in axes if a.parameter_column]
    if len(set(columns)) < len(columns):
        raise InputError(f"study.axes vary the same parameter twice: {', '.join(columns)}")
    by_name, used = {a.name: a for a in axes}, {a.relative for a in axes}
    for axis in axes:
        key = f"study.axes.{axis.name}"
        if axis.path is None and axis.name not in used:
            raise InputError(f"{key}.path is missing: {PARAMETER_EXAMPLE}")
        if isinstance(axis.relative, str) and (axis.relative not in by_name or by_name[axis.relative].path):
            raise InputError(f"{key}.relative = {axis.relative!r} is not allowed: a number, or an axis without a path")
        if axis.along is not None:
            leader = by_name.get(axis.along)
            if leader is None or leader.values is None or leader.along is not None or axis.values is None:
                raise InputError(f"{key}.with = {axis.along!r} is not allowed: both axes need listed values")
            if len(leader.values) != len(axis.values):
                counts = f"{len(axis.values)} values, {axis.along} has {len(leader.values)}"
                raise InputError(f"{key} cannot vary with {axis.along}: it has {counts}")
    return axes


def parse_design(values: Mapping[str, Any], axes: tuple[Axis, ...]) -> Design:
    """Parse the design of a study.

    Args:
        values: Plain settings of `study.design`.
        axes: Axes of the study.

    Returns:
        The design.

    Raises:
        InputError: A setting is not allowed, or does not fit the axes.
    """
    fields = {member.name: member for member in dataclasses.fields(design_kinds.make_schema())}
    values = require_known_keys("study.design", values, tuple(fields))
    values = {key: convert_and_check_value(fields[key], value, f"study.design.{key}") for key, value in values.items()}
    drawn = list(drawn_axis_names(axes))
    values["correlation"] = _correlation("study.design.correlation", values.get("correlation") or [], drawn)
    kind = design_kinds.find_kind(values.get("kind", design_kinds.DEFAULT_KIND))
    require_choice(grid := values.get("grid", kind.grid), GRIDS, f"study.design.grid = {grid!r}")
    own = {member.name: member for member in dataclasses.fields(kind)}
    design = kind(
        **{
            key: convert_and_check_value(own[key], value, f"study.design.{key}")
            for key, value in values.items()
            if key in own
        }
    )
    design.check(drawn, [a.name for a in axes if a.values is not None])
    return design


def drawn_axis_names(axes: tuple[Axis, ...]) -> tuple[str, ...]:
    """Return the names of the axes that have a distribution."""
    return tuple(axis.name for axis in axes if axis.distribution is not None)


def _correlation(key: str, pairs_config: Any, drawn: list[str]) -> tuple[tuple[str, str, float], ...]:
    """Parse `[axis, axis, number]` entries. Raises `InputError`, also where no joint distribution exists."""
    pairs = []
    for pair in pairs_config:
        if not isinstance(pair, list | tuple) or len(pair) != 3 or pair[0] == pair[1]:
            raise InputError(f"{key} = {pair!r} is not allowed: two drawn axes and a number, such as [a, b, 0.7]")
        for name in pair[:2]:
            if name not in drawn:
                raise InputError(f"{key}: {name} is not a drawn axis{format_name_suggestion(str(name), drawn)}")
        if not -1 < (share := parse_number(key, pair[2])) < 1:
            raise InputError(f"{key} = {share:g} is not allowed: between -1 and 1")
        pairs.append((str(pair[0]), str(pair[1]), share))
    if (least := np.linalg.eigvalsh(_matrix(tuple(pairs), drawn)).min(initial=1.0)) <= 0:
        pairs_config, some = ", ".join(f"{a}-{b} {c:g}" for a, b, c in pairs), (math.ceil(100 / (1 - least)) - 1) / 100
        raise InputError(
            f"{key}: no distribution has the correlations {pairs_config}: scale them by {some:g} or less, or drop one"
        )
    return tuple(pairs)


def _matrix(pairs: tuple[tuple[str, str, float], ...], names: list[str]) -> np.ndarray:
    """Return the correlation matrix (d, d) of the axes `names`."""
    matrix = np.eye(len(names))
    for a, b, share in pairs:
        i, j = names.index(a), names.index(b)
        matrix[i, j] = matrix[j, i] = share
    return matrix


def _axis(key: str, name: str, axis_config: Any) -> Axis:
    refuse_spreadsheet_formula("study.axes", name)
    axis_config = require_known_keys(key, axis_config, tuple(AXIS_KEYS))
    side, path, times, relative = (axis_config.get(word) for word in ("side", "path", "times", "relative"))
    if (side := side or "both") not in ("both", *SIDES):
        raise InputError(f"{key}.side = {side!r} is not allowed: one of both, world, belief")
    for word, what in (("path", PARAMETER_EXAMPLE), ("times", PARAMETER_EXAMPLE), ("with", "the name of an axis")):
        if (text := axis_config.get(word)) is not None and (not isinstance(text, str) or not text):
            raise InputError(f"{key}.{word} = {text!r} is not allowed: {what}")
    if relative is not None and not isinstance(relative, str):
        relative = parse_number(f"{key}.relative", relative)
    if relative is not None and times is not None:
        raise InputError(f"{key} is not allowed with both relative and times")
    if path is None and (relative is not None or times is not None):
        raise InputError(f"{key}.path is missing: {PARAMETER_EXAMPLE}")
    values = _values(key, axis_config)
    distribution = None
    if values is None:
        default = {"kind": "uniform", "from": -1.0, "to": 1.0} if relative is not None else None
        distribution = parse_distribution(f"{key}.distribution", axis_config.get("distribution", default))
    centre = parse_number(f"{key}.nominal", axis_config.get("nominal", 0.0))
    if "nominal" in axis_config and path is not None:
        raise InputError(f"{key}.nominal = {centre:g} is not allowed: {path} has a nominal value in the configuration")
    return Axis(name, path, side, values, distribution, relative, times, axis_config.get("with"), centre)


def _values(key: str, axis_config: Mapping[str, Any]) -> tuple[Any, ...] | None:
    """Return listed values, or those of a range; None where the axis is drawn."""
    values = axis_config.get("values")
    if values is not None:  # which win over a range, so that a command line can replace a study's range
        return tuple(parse_value_list(f"{key}.values", values))
    ends = [axis_config.get("from"), axis_config.get("to"), axis_config.get("num")]
    if ends == [None] * 3:
        if axis_config.get("distribution") is None and axis_config.get("relative") is None:
            raise InputError(f"{key} needs values, or from, to and num, or a distribution")
        return None
    if axis_config.get("distribution") is not None:
        raise InputError(f"{key} is not allowed with both a range and a distribution")
    if lacking := [name for name, end in zip(("from", "to", "num"), ends, strict=True) if end is None]:
        raise InputError(f"{key}.{lacking[0]} is missing: a range has from, to and num")
    low, high = (parse_number(f"{key}.{name}", end) for name, end in zip(("from", "to"), ends[:2], strict=True))
    if not isinstance(ends[2], int | float) or not 1 <= ends[2] <= MAX_STUDY_ROLLOUTS or ends[2] != int(ends[2]):
        raise InputError(f"{key}.num = {ends[2]!r} is not allowed: a whole number from 1 to {MAX_STUDY_ROLLOUTS}")
    if ends[2] == 1 and low != high:
        raise InputError(f"{key}.num = 1 is not allowed from {low:g} to {high:g}: at least 2, or values: [{low:g}]")
    # shortest decimals, so that the values read, compare and hash as written
    return tuple(float(f"{v:.12g}") for v in np.linspace(low, high, int(ends[2])))


def make_design_table(
    axes: tuple[Axis, ...],
    design: Design,
    seed: int,
    nominal_of: Callable[[str], Any],
    grid: "pd.DataFrame | None" = None,
    round_: adaptive_sampling.RoundDraws | None = None,
) -> "pd.DataFrame":
    """Make the table of a study's grid points and draws.

    The draws are the same at every grid point, so that differences between grid points are not due to the draws.

    Args:
        axes: Axes of the study.
        design: How the axes are combined and drawn.
        seed: Seed of the draws.
        nominal_of: Returns the nominal value of a parameter path.
        grid: Numbers of the listed axes by name; those of the design by default.
        round_: Draws of a round of an adaptive design, in place of those of its first round.

    Returns:
        One row for each draw at each grid point: the columns of the axes, and `draw`, the number of the draw.

    Raises:
        InputError: Axes refer to each other in a circle, or to something that is no number.
    """
    import pandas as pd

    listed, drawn = [a for a in axes if a.values is not None], [a for a in axes if a.distribution]
    if grid is None:
        grid = _one_at_a_time(listed, nominal_of) if listed and design.is_one_at_a_time else _grid(listed)
    shares = draw_quantiles(axes, design, seed) if round_ is None else _spread(round_.quantiles, drawn, design)
    size, count = len(grid), max(len(shares), 1)
    numbers = grid.take(np.repeat(np.arange(size), count)).reset_index(drop=True)
    for i, axis in enumerate(drawn):
        if axis.distribution:
            numbers[axis.name] = np.tile(axis.distribution.quantile(shares[:, i]), size)
    del shares
    columns = _columns(axes, numbers, nominal_of)
    if round_ is not None:
        columns |= {f"axis.{name}": values for name, values in round_.columns.items()}
    columns["draw"] = np.tile(np.arange(count) if round_ is None else round_.numbers, size)
    return pd.DataFrame(columns, copy=False)


def count_points(axes: tuple[Axis, ...], design: Design) -> int:
    """Count the points of a design without making them.

    Args:
        axes: Axes of the study.
        design: How the axes are combined and drawn.

    Returns:
        Number of grid points times number of draws; the largest number for adaptive designs.
    """
    lengths = [len(a.values) for a in axes if a.values is not None and a.along is None]
    draws = design.count_draws(len(drawn_axis_names(axes)))
    return (sum(lengths) if design.is_one_at_a_time else math.prod(lengths)) * max(draws, 1)


def _grid(axes: list[Axis]) -> "pd.DataFrame":
    """Return every combination of the listed values, by name of the axis; the last axis varies fastest."""
    import pandas as pd

    leaders = [a for a in axes if a.along is None]
    lengths = [len(a.values or ()) for a in leaders]
    places = np.unravel_index(np.arange(math.prod(lengths)), lengths) if lengths else ()
    at = {leader.name: place for leader, place in zip(leaders, places, strict=True)}
    columns = {a.name: pd.Series(list(a.values or ())).take(at[a.along or a.name]).array for a in axes}
    return pd.DataFrame(columns, index=range(math.prod(lengths)))


def _one_at_a_time(axes: list[Axis], nominal_of: Callable[[str], Any]) -> "pd.DataFrame":
    """Return the values of one axis after the other, with all other axes at their nominal numbers."""
    import pandas as pd

    centre = {a.name: a.nominal_value(nominal_of) for a in axes}
    arms = [_grid([a for a in axes if leader.name in (a.name, a.along)]) for leader in axes if leader.along is None]
    whole = [pd.DataFrame({name: arm.get(name, n) for name, n in centre.items()}, index=arm.index) for arm in arms]
    return pd.concat(whole).drop_duplicates()  # the arms cross


def draw_quantiles(axes: tuple[Axis, ...], design: Design, seed: int) -> np.ndarray:
    """Draw the quantiles (0 to 1) of all drawn axes.

    Args:
        axes: Axes of the study.
        design: Kind and number of draws, and correlations between axes.
        seed: Seed of the draws.

    Returns:
        Quantiles in (0, 1), one row for each draw and one column for each drawn axis.
    """
    drawn = [a for a in axes if a.distribution]
    if not drawn:
        return np.empty((0, 0))
    return _spread(design.sample(DrawContext(drawn_axis_names(axes), seed)), drawn, design)


def extreme_draws(axes: tuple[Axis, ...]) -> adaptive_sampling.RoundDraws:
    """Return two draws: all drawn axes at the lower ends of their ranges, and at the upper ends."""
    return adaptive_sampling.RoundDraws(
        np.repeat([[0.0], [1.0]], len(drawn_axis_names(axes)), axis=1), np.arange(2), {}
    )


def _spread(shares: np.ndarray, axes: list[Axis], design: Design) -> np.ndarray:
    """Give independent quantiles the correlations of the design (a Gaussian copula)."""
    shares = np.clip(shares, adaptive_sampling.MIN_QUANTILE, 1 - adaptive_sampling.MIN_QUANTILE)
    if design.correlation:
        return design.correlate_quantiles(
            shares, np.linalg.cholesky(_matrix(design.correlation, [a.name for a in axes]))
        )
    return shares


def _columns(axes: tuple[Axis, ...], numbers: "pd.DataFrame", nominal_of: Callable[[str], Any]) -> dict[str, Any]:
    """Compute the columns of the points table from the axes' numbers, by name."""
    by_target = {a.parameter_column: a for a in axes if a.parameter_column}

    def value(axis: Axis, above: tuple[str, ...] = ()) -> Any:
        n = numbers[axis.name]
        if axis.relative is not None:
            base = _finite(axis, str(axis.path), nominal_of)
            if base == 0:
                raise InputError(f"study.axes.{axis.name}.relative has no effect: {axis.path} is nominally 0")
            scale = numbers[axis.relative] if isinstance(axis.relative, str) else axis.relative
            return base * (1 + scale * n)
        if axis.times is None:
            return n
        if axis.name in above:
            raise InputError(f"study.axes.{axis.name}.times refers to itself: {' -> '.join((*above, axis.name))}")
        source = by_target.get(f"{axis.side}.{axis.times}") or by_target.get(axis.times)
        if axis.side == "both" and any(f"{side}.{axis.times}" in by_target for side in SIDES):
            raise InputError(
                f"study.axes.{axis.name}.times = {axis.times} differs between world and belief: set `side`"
            )
        return n * (value(source, (*above, axis.name)) if source else _finite(axis, axis.times, nominal_of))

    columns: dict[str, Any] = {}
    for axis in axes:
        if axis.column != axis.parameter_column:
            columns[axis.column] = numbers[axis.name]
        if axis.parameter_column:
            columns[axis.parameter_column] = value(axis)
    return columns


def _finite(axis: Axis, path: str, nominal_of: Callable[[str], Any]) -> float:
    value = nominal_of(path)
    if isinstance(value, str):
        raise InputError(f"study.axes.{axis.name}: {path} is a name, and a number is needed")
    return float(value)
