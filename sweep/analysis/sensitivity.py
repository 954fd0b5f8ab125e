"""What success depends on: volume of its region, margins, tolerance to errors, sensitivity to what was drawn.

Functions take the rows of a study and its `Experiment`, and give a line for each axis. Invalid rollouts are left out
and counted. Axes go by their column of the table (see `sweep.study.designs.Axis.column`).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from sweep.analysis.intervals import CONFIDENCE, Interval, clopper_pearson
from sweep.analysis.stats import rates
from sweep.core.errors import InputError
from sweep.core.expressions import column
from sweep.study.config import Experiment
from sweep.study.designs import INNER, LEVELS, Axis, unit_draws

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

    From independent scrambles of a Sobol sequence by the spread of their shares, otherwise as of independent draws
    (Clopper-Pearson), which is safe for the other designs: they spread more evenly.
    """
    design, by = exp.study.design, [a.column for a in listed(rows, exp)]
    draw = rows["replicate"] // exp.study.replicates
    if design.kind == "saltelli":  # of its d + 2 rows at a time the first ones are a plain sample
        rows = rows[draw % (len(drawn(rows, exp)) + 2) == 0]
    found = rates(rows, by, clopper_pearson)
    if design.kind != "sobol" or design.scrambles < 2:
        return found
    from scipy.stats import t

    parts = rates(rows.assign(scramble=draw % design.scrambles), [*by, "scramble"])
    shares = parts.groupby(by or (lambda _: 0))["share"]
    mean, half = shares.mean(), t.ppf(0.5 + CONFIDENCE / 2, shares.count() - 1) * shares.sem()
    ends = {"share": mean, "low": (mean - half).clip(lower=0), "high": (mean + half).clip(upper=1)}
    return found.assign(**{k: v.to_numpy() for k, v in ends.items()})


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
    """Rate of success at each value of each listed axis, the others nominal, with its Wilson interval.

    One rollout of each, without draws or replicates, is a choice and no sample: it has none.
    """
    parts = [
        rates(part, [axis.column]).rename(columns={axis.column: "value"}).assign(axis=axis.column)
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

    def probability(self, x: ArrayLike, level: float = CONFIDENCE) -> tuple[np.ndarray, Interval]:
        """P at `x`, with its interval."""
        from scipy.special import expit

        x = np.asarray(x, float)
        line, half = self.intercept + self.slope * x, _z(level) * np.sqrt(self._variance(x))
        return expit(line), Interval(expit(line - half), expit(line + half))

    def where(self, probability: float, level: float = CONFIDENCE) -> tuple[float, Interval]:
        """The x at which P falls to `probability`, with its interval (Fieller): where the band of P contains it.

        Infinite ends where the data do not tell that P falls at all.
        """
        from scipy.special import logit

        b, a, target = self.slope, self.intercept, logit(probability)
        if b >= 0:
            return np.inf if a >= target else -np.inf, Interval(np.asarray(-np.inf), np.asarray(np.inf))
        v, z2 = self.covariance, _z(level) ** 2
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


def goodness(fit: Logistic, x: np.ndarray, success: np.ndarray) -> float:
    """How likely rates so far from `fit` are, were it true (Pearson's test); NaN with too few trials or values."""
    from scipy.stats import chi2

    table = pd.DataFrame({"x": x, "success": success}).groupby("x")["success"].agg(["size", "sum"])
    if len(table) < 3 or table["size"].min() < GOODNESS_TRIALS:
        return np.nan
    p = fit.probability(table.index.to_numpy())[0]
    expected = table["size"] * p
    distance = ((table["sum"] - expected) ** 2 / (expected * (1 - p)).clip(lower=1e-12)).sum()
    return float(chi2.sf(distance, len(table) - 2))


def tolerance(rows: pd.DataFrame, exp: Experiment, probability: float = 0.9) -> pd.DataFrame:
    """How large an error along each listed axis may be, the others nominal: where P(success) falls to `probability`.

    A logistic fit over the distance from the nominal number, on either side; `low` to `high` is its 95 % interval. It
    takes rollouts to be independent: draws or replicates. `tried` is the largest distance with a valid rollout; an
    `error` beyond it is a guess, one of 0 means that P is lower already nominally. A `fit_p` near 0 says that the rates
    at the values tried do not follow the fit, so that neither its `error` is to be quoted.
    """
    lines = []
    for told, away, part in _sides(rows, exp):
        valid = (part["outcome"] != "invalid").to_numpy()
        size, success = away[valid], (part["outcome"] == "success").to_numpy()[valid]
        if size.max(initial=0) <= 1e-12:
            continue
        fit = logistic(size, success)
        x, (low, high) = fit.where(probability)
        ends = {"error": max(x, 0.0), "low": max(float(low), 0.0), "high": max(float(high), 0.0)}
        known = {"tried": size.max(), "fit_p": goodness(fit, size, success)}
        lines.append({**told, **ends, **known, "total": len(valid), "invalid": int((~valid).sum())})
    return pd.DataFrame(lines)


def regional(rows: pd.DataFrame, exp: Experiment) -> pd.DataFrame:
    """Regional sensitivity: how differently each drawn number is distributed among successes and failures.

    `distance` is Kolmogorov and Smirnov's, 0 for no influence, with the p-value of none at all; the medians say which
    way it acts. The largest distance comes first. Raises `InputError` where not both successes and failures are there.
    """
    from scipy.stats import ks_2samp

    good, bad = (rows["outcome"] == "success").to_numpy(), (rows["outcome"] == "failure").to_numpy()
    if not good.any() or not bad.any():
        raise InputError("regional sensitivity needs successes and failures")
    invalid = int((~good & ~bad).sum())
    lines = []
    for axis in numeric(rows, drawn(rows, exp)):
        good_ones, bad_ones = rows[axis.column][good], rows[axis.column][bad]
        test: Any = ks_2samp(good_ones, bad_ones)
        lines.append(
            [axis.column, test.statistic, test.pvalue, good_ones.median(), bad_ones.median(), len(rows), invalid]
        )
    columns = ["axis", "distance", "p", "median_success", "median_failure", "total", "invalid"]
    return pd.DataFrame(lines, columns=columns).sort_values("distance", ascending=False, ignore_index=True)


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


def _z(level: float) -> float:
    from scipy.special import ndtri

    return float(ndtri(0.5 + level / 2))
