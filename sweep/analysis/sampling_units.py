"""The independent unit of a study: the rows that count as one observation.

Rows of one unit share a draw, a scramble or a trajectory, so that they carry less information than as many independent
rows. Every interval and p-value takes its units from this module, and whether the rows are a random sample at all: the
points of a grid were chosen, so that an interval of their success rate has no meaning.
"""

from collections.abc import Callable

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from sweep.analysis.intervals import Interval, confidence_sequence, student_interval, wilson
from sweep.analysis.stats import success_rates
from sweep.config.experiment import Experiment
from sweep.core.distinct_values import are_all_different, has_several_values, rank_distinct_values
from sweep.study.design_kinds.base import SamplingUnit
from sweep.study.designs import drawn_axis_names
from sweep.study.study import Study, parameter_columns

REPLICATE = SamplingUnit("replicate")  # of a grid: its noise is the same at every grid point
NO_UNIT = SamplingUnit("none")  # of a grid without noise


def has_random_draws(study: Study) -> bool:
    """Return whether the points of a study are drawn at random by its design, rather than taken from a grid or a
    file."""
    return study.design.num > 0 and not study.points


def independent_unit(study: Study) -> SamplingUnit:
    """Return what counts as one independent observation of a study: the sampling unit of its design, or a replicate."""
    if has_random_draws(study):
        return study.design.sampling_unit
    return REPLICATE if study.replicates > 1 else NO_UNIT


def draw_ids(rows: pd.DataFrame, exp: Experiment) -> np.ndarray:
    """Return the number of the random draw to which each row belongs; for a study without draws, the number of its
    replicate.

    Args:
        rows: Rows of a study (n), with the column `replicate`.
        exp: Its experiment.

    Returns:
        Whole numbers (n,), the same for rows of one draw at every grid point.
    """
    return rows["replicate"].to_numpy() // (exp.study.replicates if has_random_draws(exp.study) else 1)


def unit_numbers(rows: pd.DataFrame, exp: Experiment) -> np.ndarray | None:
    """Return for each row the number of the independent unit (a draw or replicate) that it belongs to; None if rows are
    no random sample.

    Args:
        rows: Rows of a study (n), with the column `replicate`.
        exp: Its experiment.

    Returns:
        Whole numbers (n,), the same for rows that depend on each other. None for a grid without noise, and for adaptive
        draws, which were placed where earlier ones failed.
    """
    study, draws = exp.study, draw_ids(rows, exp)
    if has_random_draws(study):
        return study.design.unit_numbers(draws, len(drawn_axis_names(study.axes)))
    return draws if study.replicates > 1 else None


def has_dependent_draws(study: Study) -> bool:
    """Return whether the draws of a study come in groups, such as trajectories, whose draws may be alike.

    False where the design spreads the draws of a unit more evenly than independent ones, and where one draw of each
    unit is a plain sample.
    """
    design, d = study.design, len(drawn_axis_names(study.axes))
    if not has_random_draws(study) or design.sampling_unit.is_even:
        return False
    return bool(design.select_rate_draws(np.arange(design.block_size(d)), d).sum() > 1)


def confidence_interval_unit_ids(rows: pd.DataFrame, exp: Experiment) -> np.ndarray:
    """Return for each row (n,) the number of the group of rows that confidence intervals treat as one observation.

    Args:
        rows: Rows of a study (n), with the column `replicate`.
        exp: Its experiment.

    Returns:
        Whole numbers (n,): the independent unit, but the draw where a unit's draws are spread more evenly than
        independent ones, and where rows are no random sample.
    """
    units = unit_numbers(rows, exp) if has_dependent_draws(exp.study) else None
    return draw_ids(rows, exp) if units is None else units


def paired_comparison_unit_ids(rows: pd.DataFrame, exp: Experiment) -> np.ndarray | None:
    """Return for each row the number of the independent unit that it belongs to when two runs of the same rows are
    compared.

    Args:
        rows: Rows of one of the runs (n), with the column `replicate`.
        exp: Its experiment.

    Returns:
        As `unit_numbers`, except that each draw is a unit of its own if the design spreads the draws of a unit more
        evenly than independent ones, so that the test is conservative. Also None for replicates of a grid, whose
        points were chosen, so that no share of them is an estimate.
    """
    unit = independent_unit(exp.study)
    if unit == REPLICATE:
        varied = [c for c in parameter_columns(rows) if has_several_values(rows[c])]
        return None if varied else draw_ids(rows, exp)
    return draw_ids(rows, exp) if unit.is_even else unit_numbers(rows, exp)


def has_independent_rows(rows: pd.DataFrame, exp: Experiment) -> bool:
    """Return whether every row is a separate draw, so that rows are independent or spread more evenly than independent
    rows.

    Replicates at a single condition are draws of their noise.

    Args:
        rows: Rows of a study, with the column `replicate`.
        exp: Its experiment.
    """
    study = exp.study
    if independent_unit(study) == REPLICATE:
        plain = not any(has_several_values(rows[c]) for c in parameter_columns(rows))
    else:
        plain = study.design.follows_distributions and has_random_draws(study)
    return plain and not study.is_refined and are_all_different(draw_ids(rows, exp))


def interval_method(study: Study) -> str:
    """Return the name of the method that computes the intervals of a study's success rates, for captions."""
    unit = independent_unit(study)
    return f"Student's t over {unit.plural}" if unit.is_even and not study.budget else interval_method_by_draw(study)


def interval_method_by_draw(study: Study) -> str:
    """Return the name of the interval method for success rates whose rows are grouped by draw, for captions."""
    if study.budget:
        return "confidence sequence"
    if has_dependent_draws(study):
        return f"Korn-Graubard, by {study.design.sampling_unit.name}"
    return "Korn-Graubard, by draw" if study.replicates > 1 and has_random_draws(study) else "Wilson"


def describe_sample_size(rows: pd.DataFrame, exp: Experiment) -> str:
    """State how many independent observations the rows of a study are, or that they are no random sample.

    Args:
        rows: Rows of the study, with the column `replicate`.
        exp: Its experiment.
    """
    units = unit_numbers(rows, exp)
    number = 0 if units is None else rank_distinct_values(units).max(initial=-1) + 1
    if number <= 1:  # one replicate of a grid is the grid
        return "the points were chosen: no random sample" if len(rows) > 1 else "a single rollout"
    unit = independent_unit(exp.study)
    if unit.is_independent:
        return f"{number:,} independent {unit.plural}"
    return f"{number:,} {unit.plural}, spread more evenly than independent ones"


def success_rates_by_condition(
    rows: pd.DataFrame,
    exp: Experiment,
    by: list[str],
    interval: Callable[[ArrayLike, ArrayLike], Interval] = wilson,
) -> pd.DataFrame:
    """Compute the success rate at each condition, with the 95 % interval that suits the study's design.

    Args:
        rows: Rows of a study.
        exp: Its experiment.
        by: Columns of listed axes, whose values are the conditions; without any, all rows are one condition.
        interval: Function of successes and trials to the interval, where every row is a unit of its own.

    Returns:
        The table of `stats.success_rates`. With a budget the interval is a confidence sequence. If the design spreads
        the draws of a unit evenly, it is Student's t interval of the units' rates, or that of independent draws if all
        rates are equal. Else see `stats.success_rates`.
    """
    study, units = exp.study, confidence_interval_unit_ids(rows, exp)
    if study.budget:
        return success_rates(rows, by, confidence_sequence, units)
    table = success_rates(rows, by, interval, units)
    if not independent_unit(study).is_even or table.empty:
        return table
    parts = success_rates(rows.assign(unit=unit_numbers(rows, exp)), [*by, "unit"])
    ends = parts.groupby(by or (lambda _: 0), observed=True)["share"].agg(
        lambda shares: student_interval(shares.dropna())
    )
    low, high = (pd.Series([end[k] for end in ends]) for k in (0, 1))
    return table.assign(low=low.clip(lower=0).fillna(table["low"]), high=high.clip(upper=1).fillna(table["high"]))
