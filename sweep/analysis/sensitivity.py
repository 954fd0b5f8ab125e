"""What success depends on: success volume, margins, tolerance to errors, and sensitivity to drawn parameters.

Functions take the rows of a study and its `Experiment`, and return a row for each axis. Invalid rollouts are left out
and counted. Axes are named by their column of the table (see `sweep.study.designs.Axis.column`).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce
from statistics import NormalDist
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from sweep.analysis.intervals import CONFIDENCE_LEVEL, Interval, clopper_pearson, student_interval
from sweep.analysis.sampling_units import (
    confidence_interval_unit_ids,
    draw_ids,
    has_dependent_draws,
    success_rates_by_condition,
)
from sweep.analysis.stats import success_rates
from sweep.config.experiment import Experiment
from sweep.core.distinct_values import are_all_different, has_several_values
from sweep.core.errors import InputError
from sweep.core.expressions import find_column
from sweep.study import design_kinds
from sweep.study.design_kinds.base import SensitivityMethod
from sweep.study.designs import Axis, draw_quantiles, drawn_axis_names

PERMUTATION_RANGE, MAX_PERMUTED_NUMBERS = (
    (199, 999),
    100_000_000,
)  # of draws, fewer where there are many rows; numbers permuted in all
MIN_BLOCKS, MIN_RARER_OUTCOMES = (
    128,
    30,
)  # blocks, and draws of the rarer outcome, below which errors of indices do not hold
MIN_PATHS = 20  # trajectories below which the errors of a metric's effects do not hold
MIN_TRIALS_PER_VALUE = 10  # at every value, for a test of how well a fit follows the rates


def listed_value_axes(rows: pd.DataFrame, exp: Experiment) -> list[Axis]:
    """Return the study axes whose values are listed (not drawn) and that vary in the rows.

    Args:
        rows: Rows of a study.
        exp: Its experiment.
    """
    return [a for a in exp.study.axes if a.values is not None and _varies(rows, a)]


def randomly_drawn_axes(rows: pd.DataFrame, exp: Experiment) -> list[Axis]:
    """Return the study axes whose values are drawn from a distribution and that vary in the rows.

    Args:
        rows: Rows of a study.
        exp: Its experiment.
    """
    return [a for a in exp.study.axes if a.distribution is not None and _varies(rows, a)]


def _varies(rows: pd.DataFrame, axis: Axis) -> bool:
    return axis.column in rows and has_several_values(rows[axis.column])


def numeric_axes(rows: pd.DataFrame, axes: list[Axis]) -> list[Axis]:
    """Return those of the given axes whose values are numbers.

    Args:
        rows: Rows of a study.
        axes: Axes with a column in the rows.
    """
    return [a for a in axes if rows[a.column].dtype.kind in "fi"]


def success_volume(rows: pd.DataFrame, exp: Experiment) -> pd.DataFrame:
    """Estimate the share of the random draws that succeed at each combination of listed values, with its 95 % interval.

    The interval is that of `sampling_units.success_rates_by_condition`, and Clopper and Pearson's if draws are
    independent.

    Args:
        rows: Rows of a study with draws; only those that its design counts as a plain sample are used.
        exp: Its experiment.

    Returns:
        The table of `stats.success_rates`: a row for each condition.
    """
    rows = rows[exp.study.design.select_rate_draws(draw_ids(rows, exp), len(drawn_axis_names(exp.study.axes)))]
    return success_rates_by_condition(rows, exp, [a.column for a in listed_value_axes(rows, exp)], clopper_pearson)


@dataclass(frozen=True)
class GridSuccessVolume:
    """Share of a full grid's volume that succeeds: an estimate with a lower and an upper bound.

    The lower bound counts cells all of whose corners succeed, the upper bound cells any of whose corners does.
    Structure smaller than a cell is not seen. A corner without a valid rollout counts for either bound.
    """

    share: float  # by the mean of the corners
    low: float
    high: float
    invalid: int  # rollouts


def grid_success_volume(rows: pd.DataFrame, exp: Experiment) -> GridSuccessVolume:
    """Compute the share of a full grid's volume that succeeds.

    A grid point succeeds if at least half of its valid rollouts do.

    Args:
        rows: Rows of a study with a full grid of numbers.
        exp: Its experiment.

    Raises:
        InputError: The grid is not full, or has no axis of numbers.
    """
    axes = numeric_axes(rows, listed_value_axes(rows, exp))
    if not axes or not exp.study.design.is_full_grid:
        raise InputError("the success volume needs a full grid of numbers")
    by = [a.column for a in axes]
    table = success_rates(rows, by)
    good = (table["share"] >= 0.5).astype(float).where(table["share"].notna())
    values = [np.sort(rows[c].unique()) for c in by]
    places = tuple(np.searchsorted(v, table[c]) for c, v in zip(by, values, strict=True))
    corners = np.full([len(v) for v in values], np.nan)
    corners[places] = good
    of_cell = np.lib.stride_tricks.sliding_window_view(corners, (2,) * len(by))
    sizes = reduce(np.multiply.outer, map(np.diff, values))
    weights, own = sizes / sizes.sum(), tuple(range(-len(by), 0))
    least, most = (np.nan_to_num(f(of_cell, axis=own), nan=empty) for f, empty in ((np.min, 0), (np.max, 1)))
    mean = np.nan_to_num(np.mean(of_cell, axis=own), nan=0.5)
    share, low, high = (float((weights * part).sum()) for part in (mean, least, most))
    return GridSuccessVolume(share, low, high, int(table["invalid"].sum()))


def one_at_a_time_rows(rows: pd.DataFrame, exp: Experiment) -> Iterator[tuple[Axis, float, pd.DataFrame]]:
    """Yield each listed numeric axis with its nominal value and the rows in which all other axes are nominal.

    Where the nominal value of another axis is not on its grid, the nearest value takes its place. An axis that follows
    another one is not listed on its own.

    Args:
        rows: Rows of a study.
        exp: Its experiment.
    """
    axes = listed_value_axes(rows, exp)
    centre = {
        a.column: a.nominal_value(lambda path: exp.system.nominal_parameter_value(path, exp.settings)) for a in axes
    }
    near = {}
    for axis in axes:
        values = rows[axis.column]
        at = centre[axis.column]
        near[axis.column] = (values == at).to_numpy() if isinstance(at, str) else _nearest(values.to_numpy(), at)
    for axis in numeric_axes(rows, [a for a in axes if a.along is None]):
        own = {axis.column, *(a.column for a in axes if a.along == axis.name)}
        others = [hit for name, hit in near.items() if name not in own]
        yield axis, float(centre[axis.column]), rows[np.logical_and.reduce(others)] if others else rows


def _nearest(values: np.ndarray, at: float) -> np.ndarray:
    distance = np.abs(values - at)
    return np.isclose(distance, distance.min(), rtol=1e-9, atol=1e-12 * max(1.0, abs(at)))


def _sides(rows: pd.DataFrame, exp: Experiment) -> Iterator[tuple[dict[str, Any], np.ndarray, pd.DataFrame]]:
    """Yield either side of `one_at_a_time_rows`: key columns, distances (n,) from the nominal value, and rows."""
    for axis, centre, part in one_at_a_time_rows(rows, exp):
        distance = part[axis.column].to_numpy(dtype=float) - centre
        for side, sign in (("below", -1), ("above", 1)):
            here = sign * distance >= -1e-12
            yield {"axis": axis.column, "side": side, "nominal": centre}, np.abs(distance[here]), part[here]


def one_at_a_time_rates(rows: pd.DataFrame, exp: Experiment) -> pd.DataFrame:
    """Compute the success rate at each value of each listed axis, with all other axes at nominal values, and its 95 %
    interval.

    The interval is NaN if the study has neither draws nor noise: a single rollout is not a sample.

    Args:
        rows: Rows of a study.
        exp: Its experiment.

    Returns:
        The table of `stats.success_rates` with the columns `axis` and `value`.
    """
    parts = [
        success_rates_by_condition(part, exp, [axis.column])
        .rename(columns={axis.column: "value"})
        .assign(axis=axis.column)
        for axis, _, part in one_at_a_time_rows(rows, exp)
    ]
    table = pd.concat(parts, ignore_index=True)[["axis", *parts[0].columns.drop("axis")]]
    return table if exp.study.has_repeats else table.assign(low=np.nan, high=np.nan)


def success_ranges_around_nominal(rows: pd.DataFrame, exp: Experiment, level: float = 0.5) -> pd.DataFrame:
    """Compute along each listed axis how far from its nominal value rollouts succeed, with all other axes at nominal
    values.

    Args:
        rows: Rows of a study.
        exp: Its experiment.
        level: Success rate that counts as holding.

    Returns:
        A row for each axis and side. Outwards from the nominal value, `holds_to` is the last value before the first,
        `fails_at`, where the success rate of valid rollouts is below `level`; NaN where there is none. `margin` is the
        distance from nominal to `holds_to`, in the unit of the axis.
    """
    lines = []
    for labels, distance, part in _sides(rows, exp):
        if distance.max(initial=0) <= 1e-12:
            continue
        steps = success_rates(part, [labels["axis"]]).sort_values(labels["axis"], ascending=labels["side"] == "above")
        values, holds = steps[labels["axis"]].to_numpy(dtype=float), (steps["share"] >= level).to_numpy()
        first = len(holds) if holds.all() else int(np.argmin(holds))
        last = values[first - 1] if first else np.nan
        fails = values[first] if first < len(values) else np.nan
        counts = {k: int(steps[k].sum()) for k in ("total", "invalid")}
        result = {"holds_to": last, "fails_at": fails, "margin": abs(last - labels["nominal"])}
        lines.append({**labels, **result, **counts})
    return pd.DataFrame(lines)


@dataclass(frozen=True)
class LogisticFit:
    """A logistic model P(success) = 1 / (1 + exp(-(intercept + slope x))), and its coefficients' covariance (2, 2)."""

    intercept: float
    slope: float
    covariance: np.ndarray

    def probability(self, x: ArrayLike, level: float = CONFIDENCE_LEVEL) -> tuple[np.ndarray, Interval]:
        """Return the fitted probability of success at `x`, with its confidence interval."""
        from scipy.special import expit

        x = np.asarray(x, float)
        line, half = self.intercept + self.slope * x, NormalDist().inv_cdf(0.5 + level / 2) * np.sqrt(self._variance(x))
        return expit(line), Interval(expit(line - half), expit(line + half))

    def x_at_probability(self, probability: float, level: float = CONFIDENCE_LEVEL) -> tuple[float, Interval]:
        """Return the x at which the fitted probability falls to `probability`, with Fieller's confidence interval.

        The interval is the set where the band of P contains `probability`; infinite ends if the slope may be zero.
        """
        from scipy.special import logit

        b, a, target = self.slope, self.intercept, logit(probability)
        if b >= 0:
            return np.inf if a >= target else -np.inf, Interval(np.asarray(-np.inf), np.asarray(np.inf))
        v, z2 = self.covariance, NormalDist().inv_cdf(0.5 + level / 2) ** 2
        square = b * b - z2 * v[1, 1]
        linear, constant = b * (a - target) - z2 * v[0, 1], (a - target) ** 2 - z2 * v[0, 0]
        x = (target - a) / b
        if square <= 0:
            return x, Interval(np.asarray(-np.inf), np.asarray(np.inf))
        root = np.sqrt(max(linear**2 - square * constant, 0.0))
        return x, Interval(np.asarray((-linear - root) / square), np.asarray((-linear + root) / square))

    def _variance(self, x: np.ndarray) -> np.ndarray:
        v = self.covariance
        return v[0, 0] + 2 * v[0, 1] * x + v[1, 1] * x**2


def fit_logistic(x: ArrayLike, success: ArrayLike) -> LogisticFit:
    """Fit a logistic model by Firth's penalised likelihood, which stays finite for separable data.

    Args:
        x: Distances (n,).
        success: Whether each row succeeded (n,).
    """
    x, y = np.asarray(x, float), np.asarray(success, float)
    scale = np.abs(x).max(initial=0) or 1.0
    design = np.stack([np.ones_like(x), x / scale], axis=1)
    b = np.zeros(2)
    information = np.eye(2)
    for _ in range(100):
        p = 1 / (1 + np.exp(-design @ b))
        weight = p * (1 - p)
        information = design.T @ (weight[:, None] * design)
        inverse = np.linalg.pinv(information)
        leverage = weight * np.einsum("ij,jk,ik->i", design, inverse, design)
        step = inverse @ (design.T @ (y - p + leverage * (0.5 - p)))
        b += step * min(1.0, 2.0 / max(np.abs(step).max(), 1e-300))
        if np.abs(step).max() < 1e-8:
            break
    to_x = np.array([1.0, 1.0 / scale])
    return LogisticFit(b[0], b[1] / scale, np.linalg.pinv(information) * np.outer(to_x, to_x))


def goodness_of_fit_p_value(
    fit: LogisticFit, x: np.ndarray, success: np.ndarray, unit: np.ndarray | None = None
) -> float:
    """Test whether the success rates at the values of `x` follow a logistic fit (Pearson's test).

    Args:
        fit: The fit of `fit_logistic` to these rows.
        x: Distances (n,), few of them different.
        success: Whether each row succeeded (n,).
        unit: Independent unit of each row (n,). If rows share one, the covariance of the rates is that between units,
            and at least that of independent rows. None: rows are independent.

    Returns:
        The p-value; NaN with fewer than three values, or fewer than `MIN_TRIALS_PER_VALUE` rows at one.
    """
    from scipy.stats import chi2

    table = pd.DataFrame({"x": x, "success": success}).groupby("x")["success"].agg(["size", "sum"])
    if len(table) < 3 or table["size"].min() < MIN_TRIALS_PER_VALUE:
        return np.nan
    p = fit.probability(table.index.to_numpy())[0]
    expected = table["size"] * p
    if unit is None or len(np.unique(unit)) == len(unit):
        distance = ((table["sum"] - expected) ** 2 / (expected * (1 - p)).clip(lower=1e-12)).sum()
        return float(chi2.sf(distance, len(table) - 2))
    each = pd.DataFrame({"x": x, "unit": unit, "distance": success - fit.probability(x)[0]})
    sums = each.pivot_table(index="unit", columns="x", values="distance", aggfunc="sum", fill_value=0.0)
    apart = sums.to_numpy() - sums.to_numpy().mean(axis=0)
    between, spread = apart.T @ apart, np.sqrt((apart**2).sum(axis=0))
    weight = (expected * (1 - p)).to_numpy()
    correlation = np.divide(between, np.outer(spread, spread), np.eye(len(p)), where=np.outer(spread, spread) > 0)
    np.fill_diagonal(correlation, 1.0)
    deviation = np.sqrt(np.maximum(spread**2 * len(sums) / (len(sums) - 1), weight))
    design = np.stack([np.ones(len(p)), table.index.to_numpy(dtype=float) / np.abs(x).max()], axis=1)
    # what the fit's own two coefficients take up of the deviations
    rest = np.eye(len(p)) - weight[:, None] * design @ np.linalg.pinv(design.T @ (weight[:, None] * design)) @ design.T
    residual, variance = (
        rest @ sums.to_numpy().sum(axis=0),
        rest @ (correlation * np.outer(deviation, deviation)) @ rest.T,
    )
    return float(chi2.sf(residual @ np.linalg.pinv(variance, rcond=1e-6, hermitian=True) @ residual, len(p) - 2))


def tolerated_parameter_errors(rows: pd.DataFrame, exp: Experiment, probability: float = 0.9) -> pd.DataFrame:
    """Estimate along each listed axis how large an error may be until the probability of success falls to
    `probability`.

    Args:
        rows: Rows of a study.
        exp: Its experiment.
        probability: P(success) to hold.

    Returns:
        A row for each axis and side, the other axes nominal: `error`, by a logistic fit over the distance from the
        nominal value; 0 where P is lower already nominally. `low` and `high`, its 95 % interval: where the intervals of
        the rates at the values tried, with straight lines between them, contain `probability`; it does not depend on
        the fit, and is extended to `error`. `high` is infinite where the largest value tried may still succeed often
        enough. `tried`, the largest distance with a valid rollout: an error beyond it is extrapolated. If `fit_p` is
        near 0, the rates do not follow the fit: do not quote `error`.
    """
    lines = []
    for labels, distance, part in _sides(rows, exp):
        valid = (part["outcome"] != "invalid").to_numpy()
        size, success = distance[valid], (part["outcome"] == "success").to_numpy()[valid]
        if size.max(initial=0) <= 1e-12:
            continue
        fit, unit = fit_logistic(size, success), confidence_interval_unit_ids(part, exp)[valid]
        x = max(fit.x_at_probability(probability)[0], 0.0)
        band = success_rates_by_condition(
            part[valid].assign(distance=size.round(12)), exp, ["distance"], clopper_pearson
        )
        low, high = _crossing(band, probability)
        result = {"error": x, "low": min(float(low), x), "high": max(float(high), x)}
        known = {"tried": size.max(), "fit_p": goodness_of_fit_p_value(fit, size, success, unit)}
        lines.append({**labels, **result, **known, "total": len(valid), "invalid": int((~valid).sum())})
    return pd.DataFrame(lines)


def _crossing(band: pd.DataFrame, probability: float) -> Interval:
    """Return where a band of rates, linear between its values, may fall to `probability`; high is inf if it may not."""
    distance = band["distance"].to_numpy()

    def cross(ends: np.ndarray, first: int) -> float:
        part, x = ends[first : first + 2], distance[first : first + 2]
        return float(x[0] + (part[0] - probability) / (part[0] - part[1]) * (x[1] - x[0]))

    low, high = band["low"].to_numpy(), band["high"].to_numpy()
    below, above = np.flatnonzero(low < probability), np.flatnonzero(high >= probability)
    start = distance[-1] if not len(below) else 0.0 if below[0] == 0 else cross(low, below[0] - 1)
    end = 0.0 if not len(above) else np.inf if above[-1] == len(distance) - 1 else cross(high, above[-1])
    return Interval(np.asarray(start), np.asarray(end))


def regional_sensitivity(rows: pd.DataFrame, exp: Experiment) -> pd.DataFrame:
    """Compare the distributions of each drawn parameter among successes and failures (Kolmogorov-Smirnov).

    Args:
        rows: Rows of a study.
        exp: Its experiment.

    Returns:
        A row for each drawn number, the largest `distance` first: the Kolmogorov-Smirnov distance, 0 without influence;
        its p-value `p`; both medians, whose order gives the direction of the effect. If draws have several rows
        (replicates, grid points), `p` is that of a permutation of the draws; it is NaN for designs whose rows are not
        plain draws.

    Raises:
        InputError: There are not both successes and failures.
    """
    from scipy.stats import ks_2samp

    good, bad = (rows["outcome"] == "success").to_numpy(), (rows["outcome"] == "failure").to_numpy()
    if not good.any() or not bad.any():
        raise InputError("regional sensitivity needs successes and failures")
    invalid = int((~good & ~bad).sum())
    draws = draw_ids(rows, exp)
    repeated = not are_all_different(draws[good | bad])
    plain = exp.study.design.follows_distributions and not has_dependent_draws(exp.study)
    lines = []
    for axis in numeric_axes(rows, randomly_drawn_axes(rows, exp)):
        good_ones, bad_ones = rows[axis.column][good], rows[axis.column][bad]
        test: Any = ks_2samp(good_ones, bad_ones)
        p = test.pvalue if plain and not repeated else np.nan
        if plain and repeated:
            p = _permutation_p(rows, exp, axis.column)
        lines.append([axis.column, test.statistic, p, good_ones.median(), bad_ones.median(), len(rows), invalid])
    columns = ["axis", "distance", "p", "median_success", "median_failure", "total", "invalid"]
    return pd.DataFrame(lines, columns=columns).sort_values("distance", ascending=False, ignore_index=True)


def _permutation_p(rows: pd.DataFrame, exp: Experiment, name: str) -> float:
    """P-value of the Kolmogorov-Smirnov distance, by permuting the outcomes of whole draws."""
    _, draw = np.unique(draw_ids(rows, exp), return_inverse=True)
    conditions = [axis.column for axis in listed_value_axes(rows, exp)]
    slot = rows.groupby(conditions, sort=False).ngroup().to_numpy() if conditions else np.zeros(len(rows), dtype=int)
    slot = slot * exp.study.replicates + rows["replicate"].to_numpy() % exp.study.replicates
    gain = np.zeros((draw.max() + 1, slot.max() + 1))
    good, bad = (rows["outcome"] == "success").to_numpy(), (rows["outcome"] == "failure").to_numpy()
    gain[draw, slot] = good / good.sum() - bad / bad.sum()
    values = np.full(gain.shape, np.nan)
    values[draw, slot] = rows[name]
    if (np.nanmax(values, axis=1) == np.nanmin(values, axis=1)).all():
        values, gain = np.nanmax(values, axis=1, keepdims=True), gain.sum(axis=1, keepdims=True)
    order = np.argsort(values, axis=None, kind="stable")  # without a row: last, where nothing is counted
    ordered = values.ravel()[order]
    last = np.append(np.flatnonzero(np.diff(ordered) != 0), len(ordered) - 1)  # of equal values
    rng, number = np.random.default_rng(0), int(np.clip(MAX_PERMUTED_NUMBERS // gain.size, *PERMUTATION_RANGE))

    def distance(gains: np.ndarray) -> np.ndarray:
        return np.abs(np.cumsum(gains.reshape(-1, gain.size)[:, order], axis=1)[:, last]).max(axis=1)

    least, part = distance(gain).item() - 1e-12, max(1, MAX_PERMUTED_NUMBERS // (100 * gain.size))
    sizes = [min(part, number - k) for k in range(0, number, part)]
    places = (np.argsort(rng.random((size, len(gain))), axis=1) for size in sizes)
    return (1 + sum(int((distance(gain[chosen]) >= least).sum()) for chosen in places)) / (1 + number)


def total_effects(values: np.ndarray, weights: list[np.ndarray]) -> np.ndarray:
    """Compute total Sobol indices of values on a full grid.

    Args:
        values: Numbers on the grid, an axis of the array for each parameter.
        weights: Share of each parameter's range that each of its values stands for, an array for each parameter.

    Returns:
        For each parameter (d,) the share of the variance that remains if all others are known: above 0 for every
        parameter that changes a value. NaN where nothing varies.
    """
    shares = [weight / weight.sum() for weight in weights]

    def mean(array: np.ndarray, axes: list[int]) -> np.ndarray:
        for axis in axes:
            share = shares[axis].reshape([-1 if k == axis else 1 for k in range(array.ndim)])
            array = (array * share).sum(axis=axis, keepdims=True)
        return array

    every = list(range(values.ndim))
    variance = mean((values - mean(values, every)) ** 2, every).item()
    left = [mean((values - mean(values, [axis])) ** 2, every).item() for axis in every]
    return np.array(left) / variance if variance > 0 else np.full(values.ndim, np.nan)


def success_or_metric_values(rows: pd.DataFrame, figure: str | None) -> pd.Series:
    """Return the response of a sensitivity analysis by row: 1 or 0 for success, or the column `figure`; NaN for invalid
    rollouts.

    Args:
        rows: Rows of a study (n).
        figure: Column of a metric; None: success.

    Raises:
        InputError: There is no such column.
    """
    value = (
        (rows["outcome"] == "success").astype(float) if not figure else rows[find_column(rows, figure)].astype(float)
    )
    return value.where(rows["outcome"] != "invalid")


def _blocks(
    rows: pd.DataFrame, exp: Experiment, figure: str | None, wanted: SensitivityMethod, what: str
) -> tuple[list[Axis], np.ndarray]:
    """Return the drawn axes of a design, and the values of its blocks (blocks, draws of one); NaN for invalid rows.

    Raises:
        InputError: The design is another one, or rows have several conditions.
    """
    axes = [a for a in exp.study.axes if a.distribution is not None]
    if exp.study.design.sensitivity != wanted or not axes:
        kinds = design_kinds.list_kinds(lambda kind: kind.sensitivity == wanted)
        raise InputError(f"{what} need a study with design.kind = {' or '.join(kinds)}")
    if conditions := listed_value_axes(rows, exp):
        raise InputError(f"{what} need one grid point: choose among {', '.join(a.column for a in conditions)}")
    value, draw, length = (
        success_or_metric_values(rows, figure),
        rows["replicate"] // exp.study.replicates,
        exp.study.design.block_size(len(axes)),
    )
    mean = value.groupby(draw).mean().where(value.notna().groupby(draw).any())
    return axes, mean.reindex(range(exp.study.design.num * length)).to_numpy().reshape(-1, length)


def sobol_indices(rows: pd.DataFrame, exp: Experiment, figure: str | None = None) -> pd.DataFrame:
    """Estimate Sobol indices of success or of a metric from a Saltelli design, with 95 % errors.

    The error is that of a bootstrap, and at least that of the share of blocks that change (Clopper-Pearson). It is NaN
    with fewer than `MIN_BLOCKS` blocks, and for success with fewer than `MIN_RARER_OUTCOMES` draws of the rarer
    outcome. A block of d + 2 rows with an invalid one is left out.

    Args:
        rows: Rows of a study whose design is made for Sobol indices, at one condition.
        exp: Its experiment.
        figure: Column of a metric; None: success.

    Returns:
        A row for each drawn axis: `first`, the share of the variance that the axis explains alone; `total`, the share
        it is involved in, noise included; their errors; the number of complete `blocks`.

    Raises:
        InputError: The design is another one or incomplete, or nothing varies.
    """
    from SALib.analyze import sobol

    axes, whole = _blocks(rows, exp, figure, SensitivityMethod.SOBOL_INDICES, "Sobol indices")
    whole = whole[~np.isnan(whole).any(axis=1)]
    if len(whole) < 2 or whole.std() == 0:
        raise InputError(f"Sobol indices need values that vary: {len(whole)} complete blocks of {whole.shape[1]} draws")
    problem = {"num_vars": len(axes), "names": [a.column for a in axes]}
    # SALib takes a seed of 0 for none
    result = sobol.analyze(problem, whole.ravel(), calc_second_order=False, num_resamples=200, seed=1)
    base = whole[:, [0, -1]]  # columns: A, A with an axis of B for each axis, B
    squares = (whole[:, 1:-1] - base[:, :1]) ** 2
    least = _binomial_error(squares, 1.0 if figure is None else None) / (2 * base.var())
    if len(whole) < MIN_BLOCKS or (figure is None and count_rarer_outcome(base) < MIN_RARER_OUTCOMES):
        least[:] = np.nan
    columns = {"first": result["S1"], "first_error": np.maximum(result["S1_conf"], least)}
    columns |= {"total": result["ST"], "total_error": np.maximum(result["ST_conf"], least)}
    return pd.DataFrame({"axis": problem["names"], **columns, "blocks": len(whole)})


def count_rarer_outcome(successes: np.ndarray) -> float:
    """Count successes or failures, whichever are fewer; outcomes may be shares of replicates."""
    share = float(np.mean(successes))
    return np.size(successes) * min(share, 1 - share)


def _binomial_error(changes: np.ndarray, largest: float | None) -> np.ndarray:
    """Half width that the mean of changes has at least, because only a share of them differs from zero.

    The interval of few changes from their spread is too narrow, and that of none has no width. The interval of their
    share is Clopper and Pearson's.

    Args:
        changes: Sizes of independent changes (n, d), 0 for none.
        largest: The size of any change; None: sizes differ, the largest one seen counts, and NaN where all are zero.
    """
    number, changed = len(changes), (changes != 0).sum(axis=0)
    low, high = clopper_pearson(changed, np.full(changed.shape, number))
    share = changed / number
    if largest is None:
        return (high - share) * np.where(changed > 0, changes.max(axis=0), np.nan)
    return np.maximum(high - share, share - low) * largest


def _path_effects(shares: np.ndarray, values: np.ndarray, step: float) -> np.ndarray:
    """Return the sizes (paths, d) of the elementary effects of values (paths, d + 1) at shares (paths, d + 1, d)."""
    steps = np.diff(shares, axis=1)
    axis = np.abs(steps).argmax(axis=2)
    sizes = np.abs(np.diff(values, axis=1)) / step
    effects = np.empty_like(sizes)
    np.put_along_axis(effects, axis, sizes, axis=1)
    return effects


def elementary_effects(rows: pd.DataFrame, exp: Experiment, figure: str | None = None) -> pd.DataFrame:
    """Estimate elementary effects (Morris) on success or on a metric, with 95 % errors.

    The error is Student's over paths, and at least that of the share of paths with an effect (Clopper-Pearson). It
    is NaN for a metric with fewer than `MIN_PATHS` paths. A path with an invalid rollout is left out.

    Args:
        rows: Rows of a study whose design is made for elementary effects, at one condition.
        exp: Its experiment.
        figure: Column of a metric; None: success.

    Returns:
        A row for each drawn axis, the largest first: `mean_size`, the mean of the effects' sizes (mu*), and its
        `error`; `mean` of the effects; `spread`, their standard deviation, large where an axis interacts or is
        nonlinear; the number of complete `paths`.

    Raises:
        InputError: The design is another one, or fewer than two paths are complete.
    """
    from SALib.analyze import morris

    axes, mean = _blocks(rows, exp, figure, SensitivityMethod.ELEMENTARY_EFFECTS, "elementary effects")
    whole, length = ~np.isnan(mean).any(axis=1), mean.shape[1]
    if whole.sum() < 2:
        raise InputError(f"elementary effects need two complete paths of {length} draws, here: {whole.sum()}")
    chosen = np.repeat(whole, length)
    shares = draw_quantiles(exp.study.axes, exp.study.design, exp.study.seed)[chosen]
    grid = exp.study.design.trajectory_grid
    assert grid is not None  # every design for elementary effects has one
    bounds = [[grid.low, grid.high]] * len(axes)
    problem = {"num_vars": len(axes), "names": [a.column for a in axes], "bounds": bounds}
    result = morris.analyze(problem, shares, mean[whole].ravel(), num_levels=grid.levels, seed=0)
    columns = {"mean_size": "mu_star", "mean": "mu", "spread": "sigma"}
    labels = {name: result[key] for name, key in columns.items()}
    effects = _path_effects(shares.reshape(-1, length, len(axes)), mean[whole], grid.step)
    low, high = np.array([student_interval(sizes) for sizes in effects.T]).T
    least = _binomial_error(effects, 1 / grid.step if figure is None else None)
    error = np.fmax((high - low) / 2, least)
    holds = figure is None or len(effects) >= MIN_PATHS
    labels["error"] = np.where((error > 0) & holds, error, np.nan)
    order = ["axis", "mean_size", "error", "mean", "spread", "paths"]
    table = pd.DataFrame({"axis": problem["names"], **labels, "paths": int(whole.sum())})[order]
    return table.sort_values("mean_size", ascending=False, ignore_index=True)
