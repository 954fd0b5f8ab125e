"""Pair real trials with simulated rows of equal conditions, for `sweep trials`."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from sweep.analysis import trials as analysis
from sweep.analysis.intervals import CONFIDENCE_LEVEL
from sweep.analysis.sampling_units import draw_ids, has_random_draws
from sweep.analysis.stats import format_percent
from sweep.core.distinct_values import has_several_values
from sweep.core.errors import InputError
from sweep.core.expressions import find_column
from sweep.core.plot_style import COLUMN_WIDTH_IN, new_figure, save_figure
from sweep.report.tables import markdown_table
from sweep.runs import results, store
from sweep.study.importance_sampling import effective_sample_size
from sweep.study.study import attach_axis_names, parameter_columns

OUTCOMES = {"success": True, "1": True, "true": True, "failure": False, "0": False, "false": False}
MIN_EFFECTIVE_DRAWS = 30  # below which updated beliefs are called unreliable
MATCH_TOLERANCE = 1e-9  # relative, of numbers of conditions that are equal


@dataclass(frozen=True)
class TrialsComparison:
    """Result of `sweep trials`: real trials with predicted success rates, their calibration, and updated beliefs."""

    trials: pd.DataFrame  # the file's columns, `predicted` and `rows`
    calibration: analysis.PredictionCalibration
    curve: pd.DataFrame
    conditions: pd.DataFrame  # rates by condition
    correlation: tuple[float, float, float]
    beliefs: pd.DataFrame  # empty without draws at every condition
    effective_draws: float  # of how many draws
    draws: int


def read_trials(file: Path, rows: pd.DataFrame) -> tuple[pd.DataFrame, list[str]]:
    """Read a CSV file of real trials; return the trials, and the names of the columns that are conditions.

    Args:
        file: CSV file.
        rows: Rows of the study, whose axes the conditions are.

    Returns:
        The trials with the boolean column `outcome`, and the names of the other columns as in `rows`.

    Raises:
        InputError: The file cannot be read, or has a column or a value that is not allowed.
    """
    try:
        table = pd.read_csv(file, skipinitialspace=True)
    except (OSError, ValueError) as error:
        raise InputError(f"{file} is not a table: {str(error).splitlines()[0]}") from None
    if "outcome" not in table:
        raise InputError(f"{file} has no column outcome")
    words = table["outcome"].astype(str).str.strip().str.lower().str.removesuffix(".0")
    if unknown := sorted({*words} - {*OUTCOMES}):
        raise InputError(f"{file}: outcome = {unknown[0]} is not allowed: success or failure, 1 or 0")
    names = {name: find_column(rows, str(name)) for name in table if name != "outcome"}
    if fixed := [name for name, column in names.items() if column not in parameter_columns(rows)]:
        raise InputError(f"{file}: {fixed[0]} is not an axis of the study")
    if table.empty or not names:
        raise InputError(f"{file} has no trials, or no conditions")
    return table.rename(columns=names).assign(outcome=words.map(OUTCOMES).astype(bool)), [*names.values()]


def condition_row_mask(rows: pd.DataFrame, condition: pd.Series) -> np.ndarray:
    """Return which simulated rows (n,) have the parameter values of a condition.

    Args:
        rows: Rows of a study.
        condition: Values by column.
    """
    here = np.ones(len(rows), bool)
    for column, value in condition.items():
        if rows[column].dtype.kind in "fi":
            here &= np.isclose(rows[column].to_numpy(float), float(value), rtol=MATCH_TOLERANCE, atol=1e-12)
        else:
            here &= (rows[column].astype(str) == str(value)).to_numpy()
    return here


def compare_trials_with_simulation(file: Path, folder: Path, error_rate: float) -> TrialsComparison:
    """Predict each real trial from simulated rows of equal condition, and weigh parameter draws by the outcomes.

    Args:
        file: CSV file of trials.
        folder: Folder of the study.
        error_rate: Probability that a trial ends otherwise than the simulation with the true parameters.

    Raises:
        InputError: The file is not allowed, or a trial has a condition that was not simulated.
    """
    exp = results.load_experiment(folder)
    rows = attach_axis_names(store.read_rows(folder), exp.study.axes)
    table, columns = read_trials(file, rows)
    valid = rows[rows["outcome"] != "invalid"].reset_index(drop=True)
    success, draws = (valid["outcome"] == "success").to_numpy(), draw_ids(valid, exp)
    known = np.unique(draws)
    predicted, counts = np.empty(len(table)), np.empty(len(table), int)
    simulated = np.full((len(known), len(table)), np.nan)
    for values, places in table.groupby(columns, observed=True).indices.items():
        condition = pd.Series(dict(zip(columns, values if isinstance(values, tuple) else (values,), strict=True)))
        here = condition_row_mask(valid, condition)
        if not here.any():
            words = ", ".join(f"{name} = {value}" for name, value in condition.items())
            raise InputError(f"{file}: {folder} has no valid row with {words}")
        predicted[places] = (success[here].sum() + 0.5) / (here.sum() + 1)
        counts[places] = here.sum()
        rates = pd.Series(success[here].astype(float)).groupby(draws[here]).mean().reindex(known)
        simulated[:, places] = rates.to_numpy()[:, None]
    won = table["outcome"].to_numpy()
    groups = table.assign(predicted=predicted).groupby(columns, observed=True)
    conditions = groups.agg(
        trials=("outcome", "size"), predicted=("predicted", "first"), share=("outcome", "mean")
    ).reset_index()
    unknown = [c for c in parameter_columns(rows) if c not in columns and rows[c].dtype.kind in "fi"]
    unknown = [c for c in unknown if has_several_values(rows[c])]
    complete = ~np.isnan(simulated).any(axis=1)
    beliefs, effective = pd.DataFrame(), float("nan")
    if has_random_draws(exp.study) and exp.study.design.follows_distributions and unknown and complete.sum() > 1:
        weights = analysis.draw_likelihood_weights(simulated[complete], won, error_rate)
        values = valid.groupby(draws)[unknown].first().loc[known[complete]]
        beliefs, effective = analysis.prior_posterior_table(values, weights), effective_sample_size(weights)
    return TrialsComparison(
        table.assign(predicted=predicted, rows=counts),
        analysis.assess_prediction_calibration(predicted, won),
        analysis.reliability_curve(predicted, won),
        conditions,
        analysis.success_rate_correlation(conditions["predicted"].to_numpy(), conditions["share"].to_numpy(float)),
        beliefs,
        effective,
        int(complete.sum()),
    )


def format_trials_comparison(found: TrialsComparison) -> str:
    """Format the comparison of real trials with their predictions as Markdown."""
    own = found.calibration
    judged = (
        "the predictions are not calibrated"
        if own.p_value < 1 - CONFIDENCE_LEVEL
        else "no evidence against calibration"
    )
    interval = "" if np.isnan(own.brier_low) else f" (95 % interval {own.brier_low:.3f} to {own.brier_high:.3f})"
    lines = [
        f"{own.trials} trials at {len(found.conditions)} conditions: {format_percent(own.observed_rate)} succeed, "
        f"{format_percent(own.predicted_rate)} were predicted",
        f"Brier score {own.brier:.3f}{interval}; "
        f"{own.expected_brier:.3f} if every prediction were right (p = {own.p_value:.2g}): {judged}",
    ]
    r, low, high = found.correlation
    if not np.isnan(r):
        lines.append(f"correlation over conditions {r:.2f} (95 % interval {low:.2f} to {high:.2f})")
    curve = found.curve.assign(predicted=[format_percent(v) for v in found.curve["predicted"]])
    lines += ["", markdown_table(curve)]
    if len(found.beliefs):
        lines += [
            "",
            f"Beliefs before and after the trials ({found.effective_draws:.0f} effective of {found.draws} draws):",
            "",
            markdown_table(found.beliefs),
        ]
        if found.effective_draws < MIN_EFFECTIVE_DRAWS:
            lines += [
                "",
                f"fewer than {MIN_EFFECTIVE_DRAWS} effective draws: simulate more draws to see what the trials say",
            ]
    else:
        lines += ["", "beliefs: the study draws no parameter at every condition of the trials"]
    return "\n".join(lines) + "\n"


def save_reliability_plot(found: TrialsComparison, path: Path) -> None:
    """Draw the reliability curve: observed against predicted success rates."""
    figure = new_figure(COLUMN_WIDTH_IN, COLUMN_WIDTH_IN)
    ax = figure.add_subplot()
    curve = 100 * found.curve[["predicted", "share", "low", "high"]]
    ends = np.abs(curve[["low", "high"]].to_numpy().T - curve["share"].to_numpy())
    ax.plot([0, 100], [0, 100], color="0.6", linewidth=0.6)
    ax.errorbar(curve["predicted"], curve["share"], yerr=ends, fmt="o-", color="#00649E", capsize=2, markersize=3)
    ax.set(xlabel="predicted success rate, %", ylabel="observed success rate, %", xlim=(0, 100), ylim=(0, 100))
    ax.set_aspect("equal")
    save_figure(figure, path)
