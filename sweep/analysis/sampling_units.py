"""The independent unit of a design: the rows of a study that count as one observation.

Rows of one unit share a draw, a scramble or a trajectory, so that they carry less information than as many independent
rows. Every interval and p-value takes its units from this module, and whether the rows are a random sample at all: the
points of a grid were chosen, so that an interval of their success rate has no meaning.
"""

from collections.abc import Callable
from enum import StrEnum

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from sweep.analysis.intervals import Interval, confidence_sequence, student_interval, wilson
from sweep.analysis.stats import rates
from sweep.config.experiment import Experiment
from sweep.study.study import Study, parameter_columns


class Unit(StrEnum):
    """What a design draws independently."""

    DRAW = "draw"  # with all its replicates and grid points
    SCRAMBLE = "scramble"  # of a Sobol sequence, whose draws depend on each other
    BLOCK = "block"  # of a Saltelli design: d + 2 draws
    TRAJECTORY = "trajectory"  # of a Morris design: d + 1 draws
    RUN = "run"  # of subset simulation
    REPLICATE = "replicate"  # of a grid: its noise is the same at every grid point
    NONE = "none"  # a grid without noise


UNITS = {
    "monte_carlo": Unit.DRAW,
    "latin_hypercube": Unit.DRAW,
    "sobol": Unit.SCRAMBLE,
    "saltelli": Unit.BLOCK,
    "morris": Unit.TRAJECTORY,
    "importance": Unit.DRAW,
    "subset": Unit.RUN,
}  # by `study.design.kind`
PLAIN = ("monte_carlo", "latin_hypercube", "sobol")  # designs whose draws follow the distributions of the axes


def independent_unit(study: Study) -> Unit:
    """Return which rows of a study count as one independent draw: a row, a scramble, a trajectory, a pair, or none."""
    if study.points or not study.design.num:
        return Unit.REPLICATE if study.replicates > 1 else Unit.NONE
    if study.design.kind == "sobol" and study.design.scrambles == 1:
        return Unit.DRAW  # one scramble has no spread: independent draws vary more, so that their interval is safe
    return UNITS[study.design.kind]


def draw_numbers(rows: pd.DataFrame, exp: Experiment) -> np.ndarray:
    """Return the number of the draw of each row; of a grid, the replicate.

    Args:
        rows: Rows of a study (n), with the column `replicate`.
        exp: Its experiment.

    Returns:
        Whole numbers (n,), the same for rows of one draw at every grid point.
    """
    study = exp.study
    drawn = study.design.num > 0 and not study.points
    return rows["replicate"].to_numpy() // (study.replicates if drawn else 1)


def unit_numbers(rows: pd.DataFrame, exp: Experiment) -> np.ndarray | None:
    """Return the number of the independent unit of each row, or None if the rows are not a random sample.

    Args:
        rows: Rows of a study (n), with the column `replicate`.
        exp: Its experiment.

    Returns:
        Whole numbers (n,), the same for rows that depend on each other. None for a grid without noise, and for adaptive
        draws, which were placed where earlier ones failed.
    """
    study, draws = exp.study, draw_numbers(rows, exp)
    length = sum(axis.distribution is not None for axis in study.axes)
    match independent_unit(study):
        case Unit.NONE | Unit.RUN:
            return None
        case Unit.DRAW if study.design.kind == "importance":
            return None
        case Unit.SCRAMBLE:
            return draws % study.design.scrambles
        case Unit.BLOCK:
            return draws // (length + 2)
        case Unit.TRAJECTORY:
            return draws // (length + 1)
        case _:
            return draws


def pair_units(rows: pd.DataFrame, exp: Experiment) -> np.ndarray | None:
    """Return the number of the independent unit of each row, for the comparison of two runs of the same rows.

    Args:
        rows: Rows of one of the runs (n), with the column `replicate`.
        exp: Its experiment.

    Returns:
        As `unit_numbers`, except that each draw of a scramble is a unit of its own: a Sobol sequence spreads them more
        evenly than independent draws, so that the test is conservative. Also None for replicates of a grid, whose
        points were chosen, so that no share of them is an estimate.
    """
    unit = independent_unit(exp.study)
    if unit == Unit.REPLICATE:
        varied = [c for c in parameter_columns(rows) if rows[c].nunique() > 1]
        return None if varied else draw_numbers(rows, exp)
    return draw_numbers(rows, exp) if unit == Unit.SCRAMBLE else unit_numbers(rows, exp)


def has_independent_rows(rows: pd.DataFrame, exp: Experiment) -> bool:
    """Whether every row is a draw of its own, and the draws are independent or more evenly spread than that.

    Replicates at a single condition are draws of their noise.

    Args:
        rows: Rows of a study, with the column `replicate`.
        exp: Its experiment.
    """
    study = exp.study
    if independent_unit(study) == Unit.REPLICATE:
        plain = all(rows[c].nunique() <= 1 for c in parameter_columns(rows))
    else:
        plain = study.design.kind in PLAIN and study.design.num > 0 and not study.points
    return plain and not study.is_refined and len(np.unique(draw_numbers(rows, exp))) == len(rows)


def interval_method(study: Study) -> str:
    """Name the method of the intervals of `condition_rates`, for titles and captions."""
    scrambled = independent_unit(study) == Unit.SCRAMBLE and not study.budget
    return "Student's t over scrambles" if scrambled else draw_interval_method(study)


def draw_interval_method(study: Study) -> str:
    """Name the method of the intervals of `stats.rates` by draw, for captions."""
    if study.budget:
        return "confidence sequence"
    repeated = study.replicates > 1 and study.design.num > 0 and not study.points
    return "Korn-Graubard, by draw" if repeated else "Wilson"


def condition_rates(
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
        The table of `stats.rates`. With a budget the interval is a confidence sequence. With scrambles it is Student's
        t interval of their rates, or that of independent draws if all rates are equal. Else see `stats.rates`.
    """
    study, draws = exp.study, draw_numbers(rows, exp)
    if study.budget:
        return rates(rows, by, confidence_sequence, draws)
    table = rates(rows, by, interval, draws)
    if independent_unit(study) != Unit.SCRAMBLE or table.empty:
        return table
    parts = rates(rows.assign(scramble=unit_numbers(rows, exp)), [*by, "scramble"])
    ends = parts.groupby(by or (lambda _: 0), observed=True)["share"].agg(
        lambda shares: student_interval(shares.dropna())
    )
    low, high = (pd.Series([end[k] for end in ends]) for k in (0, 1))
    return table.assign(low=low.clip(lower=0).fillna(table["low"]), high=high.clip(upper=1).fillna(table["high"]))
