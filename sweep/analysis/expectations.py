"""What a study expects of its rows: shares within limits."""

import numpy as np
import pandas as pd

from sweep.analysis import rare
from sweep.analysis.sample import is_sample
from sweep.analysis.sampling_units import condition_rates
from sweep.analysis.stats import format_percent
from sweep.core.expressions import mask
from sweep.study.config import Experiment
from sweep.study.study import Expectation


def unmet_expectations(expectations: tuple[Expectation, ...], rows: pd.DataFrame, exp: Experiment) -> list[str]:
    """A line for each expectation that the rows do not meet, with the interval of the share where they are a sample.

    Args:
        expectations: Conditions and the limits of their shares.
        rows: Rows of the study.
        exp: Its experiment: rows that were drawn where failures are count by their weights.

    Raises:
        InputError: A condition names no column, or is none.
    """
    if not expectations:
        return []
    lines = []
    weights = rare.draw_and_failure_weights(rows, exp)[0] if exp.study.is_adaptive else np.ones(len(rows))
    rows = rows.reset_index(drop=True)
    valid = rows[rows["outcome"] != "invalid"]
    for one in expectations:
        chosen = valid[mask(valid, one.where)]
        what = f"share of {one.that}" + (f" where {one.where}" if one.where else "")
        hit = mask(chosen, one.that)
        weight = weights[chosen.index]
        if not weight.sum() > 0:
            lines.append(f"expected a {what}, but no valid rollout matches")
            continue
        share = float(np.average(np.asarray(hit, float), weights=weight))
        if not one.at_least <= share <= one.at_most:
            found = f"{share:.4g} of {len(chosen)}{_interval(chosen, np.asarray(hit, bool), exp)}"
            lines.append(f"expected {what} from {one.at_least:g} to {one.at_most:g}, got {found}")
    return lines


def _interval(rows: pd.DataFrame, hit: np.ndarray, exp: Experiment) -> str:
    """The 95 % interval of a share in words; empty where rows are no sample."""
    if len(rows) < 2 or not is_sample(rows, exp):
        return ""
    found = condition_rates(rows.assign(outcome=np.where(hit, "success", "failure")), exp, []).iloc[0]
    return f" (95 % interval {format_percent(found['low'])} to {format_percent(found['high'])})"
