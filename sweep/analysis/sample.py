"""What may be pooled: copies of a rollout are no evidence, and only a sample of something has an interval."""

import dataclasses
from collections.abc import Collection

import numpy as np
import pandas as pd

from sweep.analysis import sensitivity
from sweep.analysis.sampling_units import condition_rates
from sweep.analysis.stats import Rate, rate
from sweep.study.config import Experiment
from sweep.study.study import parameter_columns


def some(number: int, most: int) -> np.ndarray:
    """Places among `number`, in order: all, or `most` of them at random, every time the same."""
    every = np.arange(number)
    return every if number <= most else np.sort(np.random.default_rng(0).choice(every, most, replace=False))


def distinct(rows: pd.DataFrame, exp: Experiment) -> tuple[pd.DataFrame, str]:
    """The rows without copies, and a sentence about those; empty without any.

    Replicates of a point that draws no errors repeat its first one: they cannot differ.
    """
    if exp.study.replicates < 2:
        return rows, ""
    points = rows[parameter_columns(rows)].assign(draw=rows["replicate"] // exp.study.replicates)
    again = points.duplicated().to_numpy() & ~exp.system.random(rows, exp.settings)
    if not again.any():
        return rows, ""
    number = int(again.sum())
    return rows[~again].reset_index(drop=True), f"{number:,} copies of noise-free rollouts are counted once"


def is_sample(rows: pd.DataFrame, exp: Experiment, at: Collection[str] = ()) -> bool:
    """Whether the rows are draws or noisy replicates at one condition, and not a choice of conditions.

    Or, with columns `at`, those that have the same values of these.
    """
    if exp.study.is_adaptive or (exp.study.is_refined and not at):
        return False
    if exp.study.design.kind in ("saltelli", "morris") and exp.study.design.num:
        return False
    if exp.study.points:
        return all(c in at or rows[c].nunique() == 1 for c in parameter_columns(rows))
    return all(axis.column in at for axis in sensitivity.listed(rows, exp))


def pooled(rows: pd.DataFrame, exp: Experiment) -> Rate:
    """The rate of success of all rows together, with an interval only where they are a sample."""
    found = rate(rows["outcome"])
    ends = (np.nan, np.nan)
    if found.valid and is_sample(rows, exp):
        one = condition_rates(rows, exp, []).iloc[0]
        ends = float(one["low"]), float(one["high"])
    return dataclasses.replace(found, low=ends[0], high=ends[1])
