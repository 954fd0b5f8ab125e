"""Which drawn numbers make it fail, from rows that are there: how unlike failures' numbers are those of successes.

Unlike is the squared distance of two distributions in the space of a kernel (the Hilbert-Schmidt criterion of a number
and of failing, up to a factor). Of several numbers together it tells what none of them does alone; the Shapley value
shares it out among them, correlated ones too (Da Veiga 2021).
"""

from collections.abc import Iterator
from itertools import combinations
from math import comb

import numpy as np
import pandas as pd
from jaxtyping import Float

from sweep.analysis.intervals import CONFIDENCE
from sweep.analysis.rare import weights
from sweep.analysis.sample import FILLING, some
from sweep.analysis.sensitivity import drawn, numeric
from sweep.core.errors import InputError
from sweep.study.config import Experiment

MOST, FEWEST = 600, 20  # rows of either kind that are looked at
AXES = 10  # of which all sets are gone through
GROUPS = 10  # of rows, one of which is left out at a time to tell the error


def shares(rows: pd.DataFrame, exp: Experiment) -> pd.DataFrame:
    """The share of each drawn number in failing, with its 95 % error, and what it tells `alone`; the largest first.

    Shares sum to 1. Invalid rollouts count as failures. Raises `InputError` where rows are no draws, too few of either
    kind, or numbers too many.
    """
    names = [axis.column for axis in numeric(rows, drawn(rows, exp))]
    if not (exp.study.is_adaptive or exp.study.design.kind in FILLING) or not 0 < len(names) <= AXES:
        raise InputError(f"shares of failing need draws of at most {AXES} numbers")
    plain, failing = _weighted(rows, exp)
    bad, good = (_chosen(weight) for weight in (failing, np.where(rows["outcome"] == "success", plain, 0.0)))
    if min(len(bad), len(good)) < FEWEST:
        raise InputError(f"shares of failing need {FEWEST} failures and successes, here: {len(bad)} and {len(good)}")
    x = rows[names].to_numpy(dtype=float)
    here = np.concatenate([bad, good])
    u = np.stack([_quantiles(x[:, k], plain, x[here, k]) for k in range(len(names))], axis=1)
    apart = dict(_distances(u, _left_out(failing[bad]), _left_out(plain[good])))
    found = np.stack([_shapley(apart, k, len(names)) for k in range(len(names))])
    found = found / found.sum(axis=0)
    alone = np.stack([apart[frozenset([k])] for k in range(len(names))]) / apart[frozenset(range(len(names)))]
    table = {"axis": names, "share": found[:, 0], "error": _error(found), "alone": alone[:, 0]}
    counts = {"failures": len(bad), "successes": len(good)}
    return pd.DataFrame({**table, **counts}).sort_values("share", ascending=False, ignore_index=True)


def _weighted(rows: pd.DataFrame, exp: Experiment) -> tuple[np.ndarray, np.ndarray]:
    """What rows (n,) count for as plain draws, and as failures."""
    if exp.study.is_adaptive:
        return weights(rows, exp)
    return np.ones(len(rows)), (rows["outcome"] != "success").to_numpy(dtype=float)


def _chosen(weight: np.ndarray) -> np.ndarray:
    """Places of some rows that count."""
    places = np.flatnonzero(weight)
    return places[some(len(places), MOST)]


def _quantiles(values: np.ndarray, weight: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The share of plain draws below `at`."""
    order = np.argsort(values, kind="stable")
    below = np.concatenate([[0.0], np.cumsum(weight[order])]) / weight.sum()
    low, high = (below[np.searchsorted(values[order], at, side=side)] for side in ("left", "right"))
    return (low + high) / 2


def _left_out(weight: np.ndarray) -> Float[np.ndarray, "n g"]:
    """Weights that sum to 1: of all rows, and with one group after the other left out."""
    group = np.random.default_rng(0).permutation(len(weight)) % GROUPS
    parts = np.stack([weight, *(np.where(group == k, 0.0, weight) for k in range(GROUPS))], axis=1)
    return parts / parts.sum(axis=0)


def _distances(
    u: Float[np.ndarray, "n d"], bad: Float[np.ndarray, "b g"], good: Float[np.ndarray, "c g"]
) -> Iterator[tuple[frozenset[int], np.ndarray]]:
    """For each set of numbers the squared distance (g,) of failures, the first rows, from successes: without bias.

    The kernel of a number is that of the first Sobolev space on (0, 1): its mean is 1, so that a number which means
    nothing changes no distance.
    """
    b, d = len(bad), u.shape[1]
    apart = np.abs(u[:, None] - u[None])
    kernels = 1 + (u[:, None] - 0.5) * (u[None] - 0.5) + (apart**2 - apart + 1 / 6) / 2

    def within(kernel: np.ndarray, weight: np.ndarray) -> np.ndarray:
        own = np.diagonal(kernel) @ weight**2
        return (((kernel @ weight) * weight).sum(axis=0) - own) / (1 - (weight**2).sum(axis=0))

    for size in range(d + 1):
        for chosen in combinations(range(d), size):
            kernel = np.prod(kernels[:, :, list(chosen)], axis=2)
            across = ((kernel[:b, b:] @ good) * bad).sum(axis=0)
            yield frozenset(chosen), within(kernel[:b, :b], bad) + within(kernel[b:, b:], good) - 2 * across


def _shapley(value: dict[frozenset[int], np.ndarray], k: int, d: int) -> np.ndarray:
    """What number k adds to a set of others, in the mean of all orders."""
    without = [chosen for chosen in value if k not in chosen]
    return np.sum([(value[c | {k}] - value[c]) / comb(d - 1, len(c)) for c in without], axis=0) / d


def _error(found: Float[np.ndarray, "d g"]) -> np.ndarray:
    """Half the interval (d,), by what leaving out a group changes (jackknife)."""
    from scipy.stats import t

    parts = found[:, 1:]
    variance = (GROUPS - 1) / GROUPS * ((parts - parts.mean(axis=1, keepdims=True)) ** 2).sum(axis=1)
    return t.ppf(0.5 + CONFIDENCE / 2, GROUPS - 1) * np.sqrt(variance)
