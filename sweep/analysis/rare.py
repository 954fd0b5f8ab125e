"""Rare failures: their probability and their modes, from studies that sample failures adaptively."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from sweep.config.experiment import Experiment
from sweep.study import importance_sampling
from sweep.study.design_kinds.base import FailureEstimate

MIN_CAUSE_SHARE = 0.01  # smallest share of a mode at which a cause is named
PARAMETERS_PER_MODE = 3  # parameters that describe a mode
MODE_PLACE = "where, in standard deviations"  # column: the parameters that describe a mode


def estimate_failure_probability(rows: pd.DataFrame, exp: Experiment) -> FailureEstimate:
    """Estimate the failure probability of a study that samples its failures adaptively.

    Args:
        rows: All rows of the study.
        exp: Its experiment, with an adaptive design.

    Raises:
        InputError: The search is not finished.
    """
    return exp.study.adaptive_design.estimate_failure(rows, exp.study.draw_context)


def failure_modes(rows: pd.DataFrame, exp: Experiment) -> pd.DataFrame:
    """Group failures into modes; list the causes of each mode and the parameter values at which it lies.

    Modes are the components of the normal mixture fitted to the failures, as for the next round of importance sampling.

    Args:
        rows: All rows of an adaptive study.
        exp: Its experiment.

    Returns:
        A row for each mode, the largest first: its `cause`, `share` of the failure probability, number of `rows`, and
        the parameters in which it is farthest from plain draws, in standard deviations of these. Empty without a
        failure.
    """
    table = []
    for one in list_failure_modes(rows, exp):
        share = one.shares.sum()
        named = [f"{name} {weight / share:.0%}" if len(one.causes) > 1 else name for name, weight in one.causes.items()]
        table.append({"cause": ", ".join(named), "share": share, "rows": len(one.rows), MODE_PLACE: one.place})
    return pd.DataFrame(table)


@dataclass(frozen=True)
class FailureMode:
    """A group of failures of one kind: which rows it holds, and what they have in common."""

    rows: np.ndarray  # places (n,) of its rows in the table
    shares: np.ndarray  # share (n,) of each row in the failure probability
    causes: dict[str, float]  # share of each cause in the failure probability, the largest first
    place: str  # parameters in which it is farthest from plain draws, in standard deviations of these


def list_failure_modes(rows: pd.DataFrame, exp: Experiment) -> list[FailureMode]:
    """Return the failure modes of an adaptive study, the one with the largest share first.

    Args:
        rows: All rows of the study.
        exp: Its experiment.
    """
    axes = [axis for axis in exp.study.axes if pd.api.types.is_numeric_dtype(rows[axis.column])]
    x, (plain, failing) = rows[[axis.column for axis in axes]].to_numpy(float), draw_and_failure_weights(rows, exp)
    here = np.flatnonzero(failing > 0)
    if not len(here):
        return []
    middle = np.average(x, axis=0, weights=plain)
    spread = np.sqrt(np.average((x - middle) ** 2, axis=0, weights=plain))
    away, failing = (x[here] - middle) / np.where(spread, spread, 1.0), failing[here] / failing.sum()
    parts = importance_sampling.fit_mixture(away, failing)
    mode = importance_sampling.assign_components_to_modes(parts)[parts.log_density(away).argmax(axis=1)]
    cause, found = rows["cause"].iloc[here].to_numpy(), []
    for one in np.unique(mode):
        members = mode == one
        shares, where = failing[members], np.average(away[members], axis=0, weights=failing[members])
        causes = pd.Series(shares).groupby(cause[members]).sum().sort_values(ascending=False)
        causes = causes[causes >= MIN_CAUSE_SHARE * shares.sum()]
        far = np.argsort(-np.abs(where))[:PARAMETERS_PER_MODE]
        place = ", ".join(f"{axes[k].name} {where[k]:+.1f}" for k in far)
        found.append(FailureMode(here[members], shares, {str(name): float(w) for name, w in causes.items()}, place))
    return sorted(found, key=lambda one: one.shares.sum(), reverse=True)


def draw_and_failure_weights(rows: pd.DataFrame, exp: Experiment) -> tuple[np.ndarray, np.ndarray]:
    """Return weights that turn rows drawn adaptively into estimates for the nominal distribution.

    Args:
        rows: All rows of an adaptive study (n).
        exp: Its experiment.

    Returns:
        Two arrays (n,). With the first as weights, rows represent the nominal distribution. The second is each row's
        share in the failure probability, up to a common factor; 0 for rows that do not count as failures.
    """
    return exp.study.adaptive_design.weigh_rows(rows, exp.study.draw_context)
