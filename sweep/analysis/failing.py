"""Attribution of failures to the varied parameters by Shapley values, from existing rows.

The measure is the squared distance between the distributions of the parameters in failures and in successes, in the
space of a kernel (the Hilbert-Schmidt independence criterion of parameters and failure, up to a factor). The distance
of several parameters together contains interactions; Shapley values split it among them, correlated ones too (Da Veiga
2021).
"""

from collections.abc import Iterator, Sequence
from itertools import combinations
from math import comb

import numpy as np
import pandas as pd
from jaxtyping import Float

from sweep.analysis.intervals import CONFIDENCE_LEVEL
from sweep.analysis.rare import draw_and_failure_weights
from sweep.analysis.sample import random_subset_indices
from sweep.analysis.sampling_units import confidence_interval_unit_ids
from sweep.analysis.sensitivity import listed_value_axes, randomly_drawn_axes
from sweep.config.experiment import Experiment
from sweep.core.errors import InputError

MAX_ROWS_PER_OUTCOME, MIN_DRAWS_PER_OUTCOME = 600, 20  # rows of either outcome that are used, and draws that have them
MAX_AXES = 10  # largest number of axes: all their subsets are evaluated
MIN_REPORTED_SHARE = (
    1e-4  # smallest share that is reported: that of a listed axis without influence is a rounding error
)
JACKKNIFE_GROUPS = 10  # groups of the jackknife


def shapley_failure_shares(rows: pd.DataFrame, exp: Experiment) -> pd.DataFrame:
    """Estimate how much each varied parameter contributes to failures (Shapley values), with 95 % intervals; the
    largest first.

    Invalid rollouts count as failures.

    Args:
        rows: Rows of a study with random draws.
        exp: Its experiment.

    Returns:
        A row for each axis, drawn or listed, a number or a name: `share` (shares sum to 1, unless an estimate lies
        beyond 0 to 1 and is cut), NaN where its error is as large as itself; `low` and `high`, the ends of its
        interval; `alone`, the share of the joint distance that the axis has on its own; the numbers of `failures` and
        `successes` that were used.

    Raises:
        InputError: The rows are not random draws, there are too many axes or too few draws of either outcome, or no
            share exceeds its error.
    """
    axes = [axis for axis in (*listed_value_axes(rows, exp), *randomly_drawn_axes(rows, exp)) if axis.along is None]
    plain_draws = exp.study.design.follows_distributions and exp.study.design.num > 0
    if not (exp.study.is_adaptive or plain_draws) or not 0 < len(axes) <= MAX_AXES:
        raise InputError(f"failure shares need random draws of 1 to {MAX_AXES} parameters")
    plain, failing = _weighted(rows, exp)
    bad, good = (_chosen(weight) for weight in (failing, np.where(rows["outcome"] == "success", plain, 0.0)))
    used = np.concatenate([bad, good])
    # rows of one unit are no evidence of their likeness
    unit = np.arange(len(used)) if exp.study.is_adaptive else confidence_interval_unit_ids(rows, exp)[used]
    draws = [len(np.unique(part)) for part in np.split(unit, [len(bad)])]
    if min(draws) < MIN_DRAWS_PER_OUTCOME:
        raise InputError(
            f"failure shares need {MIN_DRAWS_PER_OUTCOME} failed and successful draws each, here: "
            f"{draws[0]} and {draws[1]}"
        )
    kernels = [_kernel(rows[axis.column], plain, used) for axis in axes]
    left_out = _left_out(np.concatenate([failing[bad], plain[good]]), unit)
    apart = dict(_distances(kernels, left_out[: len(bad)], left_out[len(bad) :], unit))
    shapley = np.stack([_shapley(apart, k, len(axes)) for k in range(len(axes))])
    shapley = shapley / shapley.sum(axis=0)
    alone = np.stack([apart[frozenset([k])] for k in range(len(axes))]) / apart[frozenset(range(len(axes)))]
    share, error = np.clip(shapley[:, 0], 0.0, 1.0), _error(shapley)  # unbiased estimates may lie beyond
    certain = share > np.maximum(error, MIN_REPORTED_SHARE)
    if not certain.any():
        raise InputError("no failure share is larger than its error: more failed draws may help")
    table = {"axis": [axis.column for axis in axes], "share": np.where(certain, share, np.nan)}
    table |= {"low": np.clip(share - error, 0, 1), "high": np.clip(share + error, 0, 1), "alone": alone[:, 0]}
    counts = {"failures": len(bad), "successes": len(good)}
    order = np.argsort(-share, kind="stable")
    return pd.DataFrame({**table, **counts}).iloc[order].reset_index(drop=True)


def _kernel(values: pd.Series, plain: np.ndarray, at: np.ndarray) -> Float[np.ndarray, "n n"]:
    """Kernel matrix of some rows in one parameter; its mean over plain draws is 1.

    A number has the kernel of the first Sobolev space on (0, 1), evaluated at its quantiles. A name has an indicator
    kernel, scaled to the same trace.
    """
    if values.dtype.kind in "fi":
        x = values.to_numpy(dtype=float)
        below, upto = _quantiles(x, plain, x[at])
        u, width = (below + upto) / 2, upto - below
        distance = np.abs(u[:, None] - u[None])
        # a listed value stands for all quantiles of its step: their mean, which keeps the kernel's mean at 1
        distance = np.where(distance == 0, width[:, None] / 3, distance)
        square = (u[:, None] - u[None]) ** 2 + (width[:, None] ** 2 + width[None] ** 2) / 12
        return 1 + (u[:, None] - 0.5) * (u[None] - 0.5) + (square - distance + 1 / 6) / 2
    codes, levels = pd.factorize(values)
    weight = np.bincount(codes, plain, len(levels)) / plain.sum()
    equal = (codes[at][:, None] == codes[at][None]) / np.maximum(weight[codes[at]], 1e-12)[None]
    return 1 + (equal - 1) / (6 * max(len(levels) - 1, 1))


def _weighted(rows: pd.DataFrame, exp: Experiment) -> tuple[np.ndarray, np.ndarray]:
    """Return the weight of each row (n,) as a plain draw, and as a failure."""
    if exp.study.is_adaptive:
        return draw_and_failure_weights(rows, exp)
    return np.ones(len(rows)), (rows["outcome"] != "success").to_numpy(dtype=float)


def _chosen(weight: np.ndarray) -> np.ndarray:
    """Return the places of at most `MAX_ROWS_PER_OUTCOME` rows with a positive weight."""
    places = np.flatnonzero(weight)
    return places[random_subset_indices(len(places), MAX_ROWS_PER_OUTCOME)]


def _quantiles(values: np.ndarray, weight: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the weighted shares of values strictly below `at`, and of those up to it."""
    order = np.argsort(values, kind="stable")
    below = np.concatenate([[0.0], np.cumsum(weight[order])]) / weight.sum()
    low, high = (below[np.searchsorted(values[order], at, side=side)] for side in ("left", "right"))
    return low, high


def _left_out(weight: np.ndarray, unit: np.ndarray) -> Float[np.ndarray, "n g"]:
    """Return the weights (n,) of all rows, and those with one group of independent units left out, for each group."""
    _, codes = np.unique(unit, return_inverse=True)
    group = (np.random.default_rng(0).permutation(codes.max() + 1) % JACKKNIFE_GROUPS)[codes]
    return np.stack([weight, *(np.where(group == k, 0.0, weight) for k in range(JACKKNIFE_GROUPS))], axis=1)


def _distances(
    kernels: Sequence[Float[np.ndarray, "n n"]],
    bad: Float[np.ndarray, "b g"],
    good: Float[np.ndarray, "c g"],
    unit: np.ndarray,
) -> Iterator[tuple[frozenset[int], np.ndarray]]:
    """Yield the unbiased squared distance (g,) of failures, the first rows, from successes for each set of parameters.

    Only pairs of rows of different units (n,) count. As the mean of a kernel is 1, a parameter without influence
    changes no distance.

    Args:
        kernels: Kernel matrix of each of d parameters.
        bad: Weights of the failures, with each of g groups left out.
        good: Weights of the successes.
        unit: Number of the independent unit of each row.
    """
    b, d = len(bad), len(kernels)
    other = (unit[:, None] != unit[None]).astype(float)
    blocks = ((slice(0, b), slice(0, b)), (slice(b, None), slice(b, None)), (slice(0, b), slice(b, None)))
    weights = ((bad, bad), (good, good), (bad, good))
    totals = [((other[block] @ right) * left).sum(axis=0) for block, (left, right) in zip(blocks, weights, strict=True)]
    for size in range(d + 1):
        for chosen in combinations(range(d), size):
            kernel = np.ones_like(other)
            for k in chosen:
                kernel *= kernels[k]
            kernel *= other
            failures, successes, across = (
                ((kernel[block] @ right) * left).sum(axis=0) / total
                for block, (left, right), total in zip(blocks, weights, totals, strict=True)
            )
            yield frozenset(chosen), failures + successes - 2 * across


def _shapley(value: dict[frozenset[int], np.ndarray], k: int, d: int) -> np.ndarray:
    """Return the Shapley value of parameter k: what it adds to a set of others, averaged over all orders."""
    without = [chosen for chosen in value if k not in chosen]
    return np.sum([(value[c | {k}] - value[c]) / comb(d - 1, len(c)) for c in without], axis=0) / d


def _error(shapley: Float[np.ndarray, "d g"]) -> np.ndarray:
    """Return half the width of the 95 % intervals (d,), by the jackknife over groups of units."""
    from scipy.stats import t

    parts = shapley[:, 1:]
    variance = (
        (JACKKNIFE_GROUPS - 1) / JACKKNIFE_GROUPS * ((parts - parts.mean(axis=1, keepdims=True)) ** 2).sum(axis=1)
    )
    return t.ppf(0.5 + CONFIDENCE_LEVEL / 2, JACKKNIFE_GROUPS - 1) * np.sqrt(variance)
