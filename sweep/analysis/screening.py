"""Sensitivity indices of drawn parameters from any random draws, without a design of their own (by SALib)."""

import numpy as np
import pandas as pd
from scipy.stats import binom

from sweep.analysis.intervals import CONFIDENCE_LEVEL
from sweep.analysis.sampling_units import draw_ids, has_dependent_draws
from sweep.analysis.sensitivity import (
    MIN_RARER_OUTCOMES,
    count_rarer_outcome,
    listed_value_axes,
    numeric_axes,
    randomly_drawn_axes,
    success_or_metric_values,
)
from sweep.config.experiment import Experiment
from sweep.core.errors import InputError
from sweep.study import design_kinds

MIN_DRAWS, MAX_DRAWS = 100, 20_000  # draws that are needed, and that are used
PAWN_SLICES, RBD_HARMONICS = 10, 10  # of PAWN; of RBD-FAST
# permutations for the index of an axis without influence, and the rows that they have in all
MIN_PERMUTATIONS, MAX_PERMUTATIONS, MAX_PERMUTED_ROWS, BLOCK_ROWS = 199, 999, 4_000_000, 20_000


def pawn_indices(rows: pd.DataFrame, exp: Experiment, figure: str | None = None) -> pd.DataFrame:
    """Compute PAWN indices of success or of a metric: how far its distribution moves when an axis is fixed.

    Each axis is cut into ten slices of equally many draws (Pianosi and Wagener 2018).

    Args:
        rows: Rows of a study with plain draws at one condition.
        exp: Its experiment.
        figure: Column of a metric; None: success.

    Returns:
        A row for each drawn axis, the largest first: `median` and `largest` Kolmogorov-Smirnov distance between the
        values in a slice and all values; `by_chance`, which the median of an axis without influence exceeds in at most
        5 % of studies; the number of `draws`.

    Raises:
        InputError: There are fewer than `MIN_DRAWS` draws, or the design is another one.
    """
    from SALib.analyze import pawn as salib

    names, x, y = _sample(rows, exp, figure, "PAWN indices need")
    indices = salib.analyze({"num_vars": len(names), "names": names}, x, y, PAWN_SLICES)
    columns = {"axis": names, "median": indices["median"], "largest": indices["maximum"]}
    table = pd.DataFrame({**columns, "by_chance": _median_by_chance(y), "draws": len(y)})
    return table.sort_values("median", ascending=False, ignore_index=True)


def _median_by_chance(values: np.ndarray) -> float:
    """Return the median PAWN index that an axis without influence exceeds in at most 5 % of studies.

    It is the upper 95 % end of that quantile among permutations, whose number leaves it uncertain.
    """
    ordered, rng = np.sort(values), np.random.default_rng(0)
    last = np.append(np.flatnonzero(np.diff(ordered) != 0), len(values) - 1)  # of equal values
    every = (last + 1) / len(values)
    slices = np.arange(len(values)) * PAWN_SLICES // len(values)
    sizes = np.bincount(slices)[:, None]
    number = int(np.clip(MAX_PERMUTED_ROWS // len(values), MIN_PERMUTATIONS, MAX_PERMUTATIONS))
    medians = []
    while len(medians) < number:  # in blocks, as few large arrays are faster than many small ones
        block = np.tile(slices.astype(np.int8), (max(1, BLOCK_ROWS // len(values)), 1))
        slice_of = rng.permuted(block, axis=1)[:, None]
        within = np.cumsum(slice_of == np.arange(PAWN_SLICES)[:, None], axis=2, dtype=np.int32)[..., last] / sizes
        medians += np.median(np.abs(within - every).max(axis=2), axis=1).tolist()
    rank = min(int(binom.ppf(CONFIDENCE_LEVEL, number, CONFIDENCE_LEVEL)), number - 1)
    return float(np.sort(medians[:number])[rank])


def rbd_fast_indices(rows: pd.DataFrame, exp: Experiment, figure: str | None = None) -> pd.DataFrame:
    """Estimate first-order Sobol indices of success or of a metric by RBD-FAST, with 95 % errors (bootstrap).

    The index is the share of the variance that an axis explains alone (Tarantola, Gatelli and Mara 2006). Its error is
    NaN for low-discrepancy sequences, and for success with fewer than `MIN_RARER` draws of the rarer outcome: it does
    not hold there.

    Args:
        rows: Rows of a study with plain, uncorrelated draws at one condition.
        exp: Its experiment.
        figure: Column of a metric; None: success.

    Returns:
        A row for each drawn axis, the largest first: `first`, its `error`, the number of `draws`.

    Raises:
        InputError: There are fewer than `MIN_DRAWS` draws, the design is another one, or the draws are correlated.
    """
    from SALib.analyze import rbd_fast as salib

    if exp.study.design.correlation:
        raise InputError("RBD-FAST needs draws without correlation")
    names, x, y = _sample(rows, exp, figure, "RBD-FAST needs")
    indices = salib.analyze({"num_vars": len(names), "names": names}, x, y, RBD_HARMONICS, seed=0)
    error = indices["S1_conf"]
    too_few = figure is None and count_rarer_outcome(y) < MIN_RARER_OUTCOMES
    if exp.study.design.is_low_discrepancy or too_few:  # the order of a sequence biases its harmonics
        error = np.full(len(names), np.nan)
    table = pd.DataFrame({"axis": names, "first": indices["S1"], "error": error, "draws": len(y)})
    return table.sort_values("first", ascending=False, ignore_index=True)


def _sample(
    rows: pd.DataFrame, exp: Experiment, figure: str | None, what: str
) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Return the drawn axes, their values (n, d) and the outcome or metric (n,) of valid draws."""
    names = [axis.column for axis in numeric_axes(rows, randomly_drawn_axes(rows, exp))]
    if not exp.study.design.follows_distributions or not names:
        kinds = design_kinds.list_kinds(lambda kind: kind.follows_distributions)
        raise InputError(f"{what} a study with draws of design.kind = {', '.join(kinds)}")
    if has_dependent_draws(exp.study):
        raise InputError(
            f"{what} draws that do not depend on each other, unlike those of a unit of design.kind = "
            f"{exp.study.design.kind}"
        )
    if conditions := listed_value_axes(rows, exp):
        raise InputError(f"{what} one grid point: choose among {', '.join(a.column for a in conditions)}")
    value = success_or_metric_values(rows, figure)
    if exp.study.replicates > 1:  # a draw counts once, by the mean of its valid replicates
        draws = draw_ids(rows, exp)
        value = value.groupby(draws).transform("mean")[~pd.Series(draws).duplicated().to_numpy()]
        rows = rows.loc[value.index]
    valid = value.notna()
    if valid.sum() < MIN_DRAWS:
        raise InputError(f"{what} {MIN_DRAWS} valid draws, here: {valid.sum()}")
    if value[valid].nunique() < 2:
        raise InputError(f"{what} a result that varies: all {valid.sum()} valid draws agree")
    chosen = rows.loc[valid, names].head(MAX_DRAWS)
    return names, chosen.to_numpy(float), value[valid].head(MAX_DRAWS).to_numpy()
