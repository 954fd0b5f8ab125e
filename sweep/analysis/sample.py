"""Pooling of rows: dropping copies of rollouts, and whether rows are a random sample at all."""

import dataclasses
from collections.abc import Collection

import numpy as np
import pandas as pd

from sweep.analysis import sensitivity
from sweep.analysis.sampling_units import success_rates_by_condition
from sweep.analysis.stats import SuccessRate, success_rate
from sweep.config.experiment import Experiment
from sweep.study.study import parameter_columns


def random_subset_indices(number: int, most: int) -> np.ndarray:
    """Choose at most `most` indices of `number` items at random with a fixed seed; sorted.

    Args:
        number: Number of items.
        most: Largest number of indices.

    Returns:
        Whole numbers (k,), k = min(number, most).
    """
    every = np.arange(number)
    return every if number <= most else np.sort(np.random.default_rng(0).choice(every, most, replace=False))


def drop_repeated_rollouts(rows: pd.DataFrame, exp: Experiment) -> tuple[pd.DataFrame, str]:
    """Drop rows that repeat a noise-free rollout; return the other rows and a sentence that counts the dropped ones.

    Replicates of a point without random errors are copies of the first one.

    Args:
        rows: Rows of a study.
        exp: Its experiment.

    Returns:
        The remaining rows, and a sentence that counts the dropped ones; an empty one if there are none.
    """
    if exp.study.replicates < 2:
        return rows, ""
    points = rows[parameter_columns(rows)].assign(draw=rows["replicate"] // exp.study.replicates)
    again = points.duplicated().to_numpy() & ~exp.system.find_stochastic_rows(rows, exp.settings)
    if not again.any():
        return rows, ""
    number = int(again.sum())
    return rows[~again].reset_index(drop=True), f"{number:,} duplicate noise-free rollouts are counted once"


def is_random_sample(rows: pd.DataFrame, exp: Experiment, condition_columns: Collection[str] = ()) -> bool:
    """Return whether the rows are a random sample at one condition, rather than a deliberate choice of conditions.

    Args:
        rows: Rows of a study.
        exp: Its experiment.
        condition_columns: Columns that define the condition: rows that agree in these are judged.
    """
    if exp.study.is_adaptive or (exp.study.is_refined and not condition_columns):
        return False
    if exp.study.design.num and not exp.study.design.follows_distributions:
        return False
    if exp.study.points:
        return all(c in condition_columns or rows[c].nunique() == 1 for c in parameter_columns(rows))
    return all(axis.column in condition_columns for axis in sensitivity.listed_value_axes(rows, exp))


def pooled_success_rate(rows: pd.DataFrame, exp: Experiment) -> SuccessRate:
    """Compute the success rate of all rows together, with an interval only if they are a random sample.

    Args:
        rows: Rows of a study.
        exp: Its experiment.
    """
    result = success_rate(rows["outcome"])
    ends = (np.nan, np.nan)
    if result.valid_count and is_random_sample(rows, exp):
        one = success_rates_by_condition(rows, exp, []).iloc[0]
        ends = float(one["low"]), float(one["high"])
    return dataclasses.replace(result, low=ends[0], high=ends[1])
