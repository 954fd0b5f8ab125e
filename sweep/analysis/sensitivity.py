"""What success depends on: volume of its region, margins, tolerance to errors, sensitivity to what was drawn.

Functions take the rows of a study and its `Experiment`, and give a line for each axis. Invalid rollouts are left out
and counted. Axes go by their column of the table (see `sweep.study.designs.Axis.column`).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from sweep.analysis.intervals import CONFIDENCE, Interval, clopper_pearson
from sweep.analysis.sampling_units import PLAIN, condition_rates, draw_numbers
from sweep.analysis.stats import rates
from sweep.core.errors import InputError
from sweep.core.expressions import column
from sweep.study.config import Experiment
from sweep.study.designs import INNER, LEVELS, Axis, unit_draws

PERMUTATIONS, PERMUTED = (199, 999), 100_000_000  # of draws, fewer where there are many rows; numbers permuted in all
GOODNESS_TRIALS = 10  # at every value, for a test of how well a fit follows the rates


def listed(rows: pd.DataFrame, exp: Experiment) -> list[Axis]:
    """The axes of conditions that vary in `rows`."""
    return [a for a in exp.study.axes if a.values is not None and _varies(rows, a)]


def drawn(rows: pd.DataFrame, exp: Experiment) -> list[Axis]:
    """The axes that were drawn and vary in `rows`."""
    return [a for a in exp.study.axes if a.distribution is not None and _varies(rows, a)]


def _varies(rows: pd.DataFrame, axis: Axis) -> bool:
    return axis.column in rows and rows[axis.column].nunique() > 1


def numeric(rows: pd.DataFrame, axes: list[Axis]) -> list[Axis]:
    """Those of `axes` whose values are numbers."""
    return [a for a in axes if rows[a.column].dtype.kind in "fi"]


def volume(rows: pd.DataFrame, exp: Experiment) -> pd.DataFrame:
    """Share of what was drawn that succeeds, with its 95 % interval, at each condition.

    The interval is that of `sampling_units.condition_rates`, where draws are independent Clopper and Pearson's: safe
    for designs that spread draws more evenly.
    """
    if exp.study.design.kind == "saltelli":  # of the d + 2 rows of a block the first ones are a plain sample
        rows = rows[draw_numbers(rows, exp) % (sum(a.distribution is not None for a in exp.study.axes) + 2) == 0]
    return condition_rates(rows, exp, [a.column for a in listed(rows, exp)], clopper_pearson)


@dataclass(frozen=True)
class GridVolume:
    """Share of a full grid's box that succeeds, between the cells all of whose corners do and those any of which does.

    What is smaller than a cell is not seen. A corner without a valid rollout may be either.
    """

    share: float  # by the mean of the corners
    low: float
    high: float
    invalid: int  # rollouts


def grid_volume(rows: pd.DataFrame, exp: Experiment) -> GridVolume:
    """Of the numbers listed; a grid point succeeds where at least half of its valid rollouts do."""
    axes = numeric(rows, listed(rows, exp))
    if not axes or exp.study.design.grid != "full":
        raise InputError("the volume of a grid needs a full grid of numbers")
    by = [a.column for a in axes]
    table = rates(rows, by)
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
    return GridVolume(share, low, high, int(table["invalid"].sum()))


def arms(rows: pd.DataFrame, exp: Experiment) -> Iterator[tuple[Axis, float, pd.DataFrame]]:
    """For each listed axis of numbers its nominal number, and the rows where the others have theirs, or the next to it.

    An axis that goes along with another is not looked at on its own.
    """
    axes = listed(rows, exp)
    centre = {a.column: a.nominal_number(lambda path: exp.system.nominal(path, exp.settings)) for a in axes}
    near = {}
    for axis in axes:
        values = rows[axis.column]
        at = centre[axis.column]
        near[axis.column] = (values == at).to_numpy() if isinstance(at, str) else _nearest(values.to_numpy(), at)
    for axis in numeric(rows, [a for a in axes if a.along is None]):
        own = {axis.column, *(a.column for a in axes if a.along == axis.name)}
        others = [hit for name, hit in near.items() if name not in own]
        yield axis, float(centre[axis.column]), rows[np.logical_and.reduce(others)] if others else rows


def _nearest(values: np.ndarray, at: float) -> np.ndarray:
    distance = np.abs(values - at)
    return np.isclose(distance, distance.min(), rtol=1e-9, atol=1e-12 * max(1.0, abs(at)))


def _sides(rows: pd.DataFrame, exp: Experiment) -> Iterator[tuple[dict[str, Any], np.ndarray, pd.DataFrame]]:
    """Either side of the `arms`: what a table calls it, distances (n,) from the nominal number, and its rows."""
    for axis, centre, part in arms(rows, exp):
        away = part[axis.column].to_numpy(dtype=float) - centre
        for side, sign in (("below", -1), ("above", 1)):
            here = sign * away >= -1e-12
            yield {"axis": axis.column, "side": side, "nominal": centre}, np.abs(away[here]), part[here]


def along(rows: pd.DataFrame, exp: Experiment) -> pd.DataFrame:
    """Rate of success at each value of each listed axis, the others nominal, with its 95 % interval.

    One rollout of each, without draws or replicates, is a choice and no sample: it has none.
    """
    parts = [
        condition_rates(part, exp, [axis.column]).rename(columns={axis.column: "value"}).assign(axis=axis.column)
        for axis, _, part in arms(rows, exp)
    ]
    table = pd.concat(parts, ignore_index=True)[["axis", *parts[0].columns.drop("axis")]]
    return table if exp.study.noisy else table.assign(low=np.nan, high=np.nan)


def margins(rows: pd.DataFrame, exp: Experiment, level: float = 0.5) -> pd.DataFrame:
    """How far from nominal success holds along each listed axis, the others nominal.

    Outwards from the nominal number, `holds_to` is the last value before the first, `fails_at`, where fewer than
    `level` of the valid rollouts succeed; NaN where there is none. `margin` is the distance to `holds_to`.
    """
    lines = []
    for told, away, part in _sides(rows, exp):
        if away.max(initial=0) <= 1e-12:
            continue
        way = rates(part, [told["axis"]]).sort_values(told["axis"], ascending=told["side"] == "above")
        values, holds = way[told["axis"]].to_numpy(dtype=float), (way["share"] >= level).to_numpy()
        first = len(holds) if holds.all() else int(np.argmin(holds))
        last = values[first - 1] if first else np.nan
        fails = values[first] if first < len(values) else np.nan
        counts = {k: int(way[k].sum()) for k in ("total", "invalid")}
        found = {"holds_to": last, "fails_at": fails, "margin": abs(last - told["nominal"])}
        lines.append({**told, **found, **counts})
    return pd.DataFrame(lines)


@dataclass(frozen=True)
class Logistic:
    """P(success) = 1 / (1 + exp(-(intercept + slope x))), and the covariance (2, 2) of both coefficients."""

    intercept: float
    slope: float
    covariance: np.ndarray
    freedom: float = np.inf  # degrees of freedom of the covariance: that of independent rows comes from the model

    def probability(self, x: ArrayLike, level: float = CONFIDENCE) -> tuple[np.ndarray, Interval]:
        """P at `x`, with its interval."""
        from scipy.special import expit

        x = np.asarray(x, float)
        line, half = self.intercept + self.slope * x, self._quantile(level) * np.sqrt(self._variance(x))
        return expit(line), Interval(expit(line - half), expit(line + half))

    def where(self, probability: float, level: float = CONFIDENCE) -> tuple[float, Interval]:
        """The x at which P falls to `probability`, with its interval (Fieller): where the band of P contains it.

        Infinite ends where the data do not tell that P falls at all.
        """
        from scipy.special import logit

        b, a, target = self.slope, self.intercept, logit(probability)
        if b >= 0:
            return np.inf if a >= target else -np.inf, Interval(np.asarray(-np.inf), np.asarray(np.inf))
        v, z2 = self.covariance, self._quantile(level) ** 2
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

    def _quantile(self, level: float) -> float:
        from scipy.special import ndtri, stdtrit

        return float(ndtri(0.5 + level / 2) if np.isinf(self.freedom) else stdtrit(self.freedom, 0.5 + level / 2))


def logistic(x: ArrayLike, success: ArrayLike) -> Logistic:
    """Fit by Firth's penalised likelihood, which stays finite where all below some x succeed and all above fail."""
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
    return Logistic(b[0], b[1] / scale, np.linalg.pinv(information) * np.outer(to_x, to_x))


def cluster_robust_fit(fit: Logistic, x: np.ndarray, success: np.ndarray, unit: np.ndarray) -> Logistic:
    """A fit with the covariance that rows have which come in units (the sandwich estimate, CR1).

    Args:
        fit: The fit of `logistic` to these rows.
        x: Distances (n,).
        success: Whether each row succeeded (n,).
        unit: Independent unit of each row (n,).
    """
    x, y = np.asarray(x, float), np.asarray(success, float)
    scale = np.abs(x).max(initial=0) or 1.0
    design = np.stack([np.ones_like(x), x / scale], axis=1)
    p = fit.probability(x)[0]
    inverse = np.linalg.pinv(design.T @ ((p * (1 - p))[:, None] * design))
    leverage = p * (1 - p) * np.einsum("ij,jk,ik->i", design, inverse, design)
    _, codes = np.unique(unit, return_inverse=True)
    number = int(codes.max(initial=0)) + 1
    scores = np.zeros((number, 2))
    np.add.at(scores, codes, (y - p + leverage * (0.5 - p))[:, None] * design)
    to_x = np.array([1.0, 1.0 / scale])
    robust = number / max(number - 1, 1) * inverse @ scores.T @ scores @ inverse * np.outer(to_x, to_x)
    return replace(fit, covariance=robust, freedom=max(number - 1, 1))


def goodness(fit: Logistic, x: np.ndarray, success: np.ndarray, unit: np.ndarray | None = None) -> float:
    """P-value of Pearson's test that the rates at the values of `x` follow a fit.

    Args:
        fit: The fit of `logistic` to these rows.
        x: Distances (n,), few of them different.
        success: Whether each row succeeded (n,).
        unit: Independent unit of each row (n,). Where rows share one, the covariance of the rates is that between
            units, and at least that of independent rows. None: rows are independent.

    Returns:
        The p-value; NaN with fewer than three values, or fewer than `GOODNESS_TRIALS` rows at one.
    """
    from scipy.stats import chi2

    table = pd.DataFrame({"x": x, "success": success}).groupby("x")["success"].agg(["size", "sum"])
    if len(table) < 3 or table["size"].min() < GOODNESS_TRIALS:
        return np.nan
    p = fit.probability(table.index.to_numpy())[0]
    expected = table["size"] * p
    if unit is None or len(np.unique(unit)) == len(unit):
        distance = ((table["sum"] - expected) ** 2 / (expected * (1 - p)).clip(lower=1e-12)).sum()
        return float(chi2.sf(distance, len(table) - 2))
    each = pd.DataFrame({"x": x, "unit": unit, "away": success - fit.probability(x)[0]})
    sums = each.pivot_table(index="unit", columns="x", values="away", aggfunc="sum", fill_value=0.0)
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


def tolerance(rows: pd.DataFrame, exp: Experiment, probability: float = 0.9) -> pd.DataFrame:
    """How large an error along each listed axis may be, the others nominal: where P(success) falls to `probability`.

    Args:
        rows: Rows of a study.
        exp: Its experiment.
        probability: P(success) that is asked for.

    Returns:
        A row for each axis and side: `error`, by a logistic fit over the distance from the nominal number; 0 where P is
        lower already nominally. `low` and `high`, its 95 % interval: the fit's own (Fieller) and that of the rates at
        the values tried, straight between them, whichever reaches further, so that it holds where the curve is no
        logistic one. In both, a draw that several values share counts once. `tried`, the largest distance with a valid
        rollout: an error beyond it is a guess. `fit_p` near 0: the rates do not follow the fit, do not quote `error`.
    """
    lines = []
    for told, away, part in _sides(rows, exp):
        valid = (part["outcome"] != "invalid").to_numpy()
        size, success = away[valid], (part["outcome"] == "success").to_numpy()[valid]
        if size.max(initial=0) <= 1e-12:
            continue
        fit, unit = logistic(size, success), draw_numbers(part, exp)[valid]
        x, *ends = fit.where(probability)
        if len(np.unique(unit)) < len(unit):
            ends.append(cluster_robust_fit(fit, size, success, unit).where(probability)[1])
        band = condition_rates(part[valid].assign(away=size.round(12)), exp, ["away"], clopper_pearson)
        ends.append(_crossing(band, probability))
        low, high = min(float(one.low) for one in ends), max(float(one.high) for one in ends)
        found = {"error": max(x, 0.0), "low": max(low, 0.0), "high": max(high, 0.0)}
        known = {"tried": size.max(), "fit_p": goodness(fit, size, success, unit)}
        lines.append({**told, **found, **known, "total": len(valid), "invalid": int((~valid).sum())})
    return pd.DataFrame(lines)


def _crossing(band: pd.DataFrame, probability: float) -> Interval:
    """Where a band of rates, straight between its values, may fall to `probability`; no upper end if it may not."""
    away = band["away"].to_numpy()

    def cross(ends: np.ndarray, first: int) -> float:
        part, x = ends[first : first + 2], away[first : first + 2]
        return float(x[0] + (part[0] - probability) / (part[0] - part[1]) * (x[1] - x[0]))

    low, high = band["low"].to_numpy(), band["high"].to_numpy()
    below, above = np.flatnonzero(low < probability), np.flatnonzero(high >= probability)
    start = away[-1] if not len(below) else 0.0 if below[0] == 0 else cross(low, below[0] - 1)
    end = 0.0 if not len(above) else np.inf if above[-1] == len(away) - 1 else cross(high, above[-1])
    return Interval(np.asarray(start), np.asarray(end))


def regional(rows: pd.DataFrame, exp: Experiment) -> pd.DataFrame:
    """Regional sensitivity: how differently each drawn number is distributed among successes and failures.

    Args:
        rows: Rows of a study.
        exp: Its experiment.

    Returns:
        A row for each drawn number, the largest `distance` first: Kolmogorov and Smirnov's, 0 without any influence;
        `p`, the p-value of none at all; the medians of both, which say in which direction it acts. Where draws have
        several rows (replicates, grid points), `p` is that of a permutation of the draws; it is NaN for designs whose
        rows are no plain draws.

    Raises:
        InputError: There are not both successes and failures.
    """
    from scipy.stats import ks_2samp

    good, bad = (rows["outcome"] == "success").to_numpy(), (rows["outcome"] == "failure").to_numpy()
    if not good.any() or not bad.any():
        raise InputError("regional sensitivity needs successes and failures")
    invalid = int((~good & ~bad).sum())
    draws = draw_numbers(rows, exp)
    repeated = len(np.unique(draws[good | bad])) < (good | bad).sum()
    plain = exp.study.design.kind in PLAIN
    lines = []
    for axis in numeric(rows, drawn(rows, exp)):
        good_ones, bad_ones = rows[axis.column][good], rows[axis.column][bad]
        test: Any = ks_2samp(good_ones, bad_ones)
        p = test.pvalue if plain and not repeated else np.nan
        if plain and repeated:
            p = _permutation_p(rows, exp, axis.column)
        lines.append([axis.column, test.statistic, p, good_ones.median(), bad_ones.median(), len(rows), invalid])
    columns = ["axis", "distance", "p", "median_success", "median_failure", "total", "invalid"]
    return pd.DataFrame(lines, columns=columns).sort_values("distance", ascending=False, ignore_index=True)


def _permutation_p(rows: pd.DataFrame, exp: Experiment, name: str) -> float:
    """P-value of Kolmogorov and Smirnov's distance, by permuting which draw's outcomes belong to whose values."""
    _, draw = np.unique(draw_numbers(rows, exp), return_inverse=True)
    conditions = [axis.column for axis in listed(rows, exp)]
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
    rng, number = np.random.default_rng(0), int(np.clip(PERMUTED // gain.size, *PERMUTATIONS))

    def distance(gains: np.ndarray) -> np.ndarray:
        return np.abs(np.cumsum(gains.reshape(-1, gain.size)[:, order], axis=1)[:, last]).max(axis=1)

    least, part = distance(gain).item() - 1e-12, max(1, PERMUTED // (100 * gain.size))
    sizes = [min(part, number - k) for k in range(0, number, part)]
    places = (np.argsort(rng.random((size, len(gain))), axis=1) for size in sizes)
    return (1 + sum(int((distance(gain[chosen]) >= least).sum()) for chosen in places)) / (1 + number)


def total_effects(values: np.ndarray, weights: list[np.ndarray]) -> np.ndarray:
    """Total Sobol indices of values on a full grid.

    Args:
        values: Numbers on the grid, an axis of the array for each parameter.
        weights: Share of each parameter's range that each of its values stands for, an array for each parameter.

    Returns:
        For each parameter (d,) the share of the variance that is left where all others are known: above 0 for every
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


def measured(rows: pd.DataFrame, figure: str | None) -> pd.Series:
    """1 or 0 for success, or the column `figure`; NaN where a rollout is invalid. Raises `InputError`."""
    value = (rows["outcome"] == "success").astype(float) if not figure else rows[column(rows, figure)].astype(float)
    return value.where(rows["outcome"] != "invalid")


def _blocks(
    rows: pd.DataFrame, exp: Experiment, figure: str | None, kind: str, what: str, more: int
) -> tuple[list[Axis], np.ndarray]:
    """The axes of a design of a `kind`, and the values of its blocks, as long as they and `more`; NaN of invalid rows.

    Raises `InputError` where the design is another one, or rows are of several conditions.
    """
    axes = [a for a in exp.study.axes if a.distribution is not None]
    if exp.study.design.kind != kind or not axes:
        raise InputError(f"{what} need a study with design.kind = {kind}")
    if conditions := listed(rows, exp):
        raise InputError(f"{what} need one grid point: choose among {', '.join(a.column for a in conditions)}")
    value, draw, length = measured(rows, figure), rows["replicate"] // exp.study.replicates, len(axes) + more
    mean = value.groupby(draw).mean().where(value.notna().groupby(draw).any())
    return axes, mean.reindex(range(exp.study.design.num * length)).to_numpy().reshape(-1, length)


def sobol_indices(rows: pd.DataFrame, exp: Experiment, figure: str | None = None) -> pd.DataFrame:
    """Sobol indices of success, or of the column `figure`, from a Saltelli design, with 95 % errors (bootstrap).

    `first` is the share of the variance that an axis explains alone, `total` that in which it takes part; noise counts
    in the latter. A block of d + 2 rows with an invalid one is left out: `blocks` tells how many remain. Raises
    `InputError` where the design is another one, is not complete, or nothing varies.
    """
    from SALib.analyze import sobol

    axes, whole = _blocks(rows, exp, figure, "saltelli", "Sobol indices", 2)
    whole = whole[~np.isnan(whole).any(axis=1)]
    if len(whole) < 2 or whole.std() == 0:
        raise InputError(f"Sobol indices need values that vary: {len(whole)} complete blocks of {whole.shape[1]} draws")
    problem = {"num_vars": len(axes), "names": [a.column for a in axes]}
    # SALib takes a seed of 0 for none
    found = sobol.analyze(problem, whole.ravel(), calc_second_order=False, num_resamples=200, seed=1)
    columns = {"first": "S1", "first_error": "S1_conf", "total": "ST", "total_error": "ST_conf"}
    told = {name: found[key] for name, key in columns.items()}
    return pd.DataFrame({"axis": problem["names"], **told, "blocks": len(whole)})


def elementary_effects(rows: pd.DataFrame, exp: Experiment, figure: str | None = None) -> pd.DataFrame:
    """Morris' elementary effects on success, or on the column `figure`: cheap screening of many axes.

    `mean_size` is the mean of the effects' sizes (mu*) with its 95 % error (bootstrap), `spread` their standard
    deviation, large where an axis interacts or acts unevenly. A path with an invalid rollout is left out: `paths` tells
    how many remain. Raises `InputError` where the design is another one or fewer than two paths are left.
    """
    from SALib.analyze import morris

    axes, mean = _blocks(rows, exp, figure, "morris", "elementary effects", 1)
    whole, length = ~np.isnan(mean).any(axis=1), mean.shape[1]
    if whole.sum() < 2:
        raise InputError(f"elementary effects need two complete paths of {length} draws, here: {whole.sum()}")
    chosen = np.repeat(whole, length)
    shares = unit_draws(exp.study.axes, exp.study.design, exp.study.seed)[chosen]
    problem = {"num_vars": len(axes), "names": [a.column for a in axes], "bounds": [[*INNER]] * len(axes)}
    found = morris.analyze(problem, shares, mean[whole].ravel(), num_levels=LEVELS, seed=0)
    columns = {"mean_size": "mu_star", "error": "mu_star_conf", "mean": "mu", "spread": "sigma"}
    told = {name: found[key] for name, key in columns.items()}
    table = pd.DataFrame({"axis": problem["names"], **told, "paths": int(whole.sum())})
    return table.sort_values("mean_size", ascending=False, ignore_index=True)
