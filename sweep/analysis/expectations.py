"""Expectations of a study: bounds on the share of its rows that meet a condition."""

import numpy as np
import pandas as pd

from sweep.analysis import rare
from sweep.analysis.sample import is_random_sample
from sweep.analysis.sampling_units import success_rates_by_condition
from sweep.analysis.stats import format_percent
from sweep.config.experiment import Experiment
from sweep.core.expressions import condition_mask
from sweep.study.study import RateExpectation


def unmet_expectations(expectations: tuple[RateExpectation, ...], rows: pd.DataFrame, exp: Experiment) -> list[str]:
    """Return a line of text for each expectation (bound on the share of rows) that the rows of a study do not meet.

    Args:
        expectations: Conditions and the limits of their shares.
        rows: Rows of the study.
        exp: Its experiment: rows that were drawn where failures are count by their weights.

    Raises:
        InputError: A condition names no column, or is none.
    """
    return [line for line in judge_expectations(expectations, rows, exp) if line]


def judge_expectations(expectations: tuple[RateExpectation, ...], rows: pd.DataFrame, exp: Experiment) -> list[str]:
    """Compare the share of rows that meet each expectation's condition with its bounds; with intervals for random
    samples.

    Args:
        expectations: Conditions and the limits of their shares.
        rows: Rows of the study.
        exp: Its experiment: rows that were drawn where failures are count by their weights.

    Returns:
        A line for each expectation: the actual share if it is outside the limits, empty if it is within.

    Raises:
        InputError: A condition names no column, or is none.
    """
    if not expectations:
        return []
    weights = rare.draw_and_failure_weights(rows, exp)[0] if exp.study.is_adaptive else np.ones(len(rows))
    rows = rows.reset_index(drop=True)
    valid = rows[rows["outcome"] != "invalid"]
    return [_judge(one, valid, weights[valid.index], exp) for one in expectations]


def _judge(expectation: RateExpectation, rows: pd.DataFrame, weights: np.ndarray, exp: Experiment) -> str:
    """Compare valid rows (n,) and their weights (n,) with an expectation."""
    chosen = condition_mask(rows, expectation.where)
    counted, weight = rows[chosen], weights[np.asarray(chosen, bool)]
    condition = f" where {expectation.where}" if expectation.where else ""
    what = f"share of {expectation.that}{condition}"
    hit = np.asarray(condition_mask(counted, expectation.that), bool)
    if not weight.sum() > 0:
        return f"expected a {what}, but no valid rollout matches"
    share = float(np.average(hit.astype(float), weights=weight))
    if expectation.at_least <= share <= expectation.at_most:
        return ""
    actual = f"{share:.4g} of {len(counted)}{_interval(counted, hit, exp)}"
    least, most = expectation.at_least, expectation.at_most
    wanted = f"at least {least:g}" if most == 1 else f"at most {most:g}" if least == 0 else f"{least:g} to {most:g}"
    return f"expected {what}: {wanted}, got {actual}"


def _interval(rows: pd.DataFrame, hit: np.ndarray, exp: Experiment) -> str:
    """Write the 95 % interval of a share; empty if the rows are not a random sample."""
    if len(rows) < 2 or not is_random_sample(rows, exp):
        return ""
    rate = success_rates_by_condition(rows.assign(outcome=np.where(hit, "success", "failure")), exp, []).iloc[0]
    return f" (95 % interval {format_percent(rate['low'])} to {format_percent(rate['high'])})"
