"""Predicted success beside the outcomes of real trials: calibration, correlation, and beliefs after the trials."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from sweep.analysis.compare import holm_adjust
from sweep.analysis.intervals import CONFIDENCE_LEVEL, clopper_pearson, student_interval

RELIABILITY_BINS = 5  # of predicted rates, with equal numbers of trials
MIN_CONDITIONS = 4  # for the interval of a correlation


@dataclass(frozen=True)
class PredictionCalibration:
    """How well predicted success rates agree with the outcomes of real trials."""

    trials: int
    brier: float  # mean squared error of the predicted rate: 0 is perfect, 0.25 a coin
    brier_low: float  # of its 95 % interval
    brier_high: float
    expected_brier: float  # if every prediction were the true rate
    p_value: float  # of Spiegelhalter's test that every prediction is the true rate
    predicted_rate: float
    observed_rate: float


def assess_prediction_calibration(
    predicted: np.ndarray, success: np.ndarray, level: float = CONFIDENCE_LEVEL
) -> PredictionCalibration:
    """Compare predicted success rates with outcomes of real trials by Brier score (Brier 1950; Spiegelhalter 1986).

    Args:
        predicted: Predicted success rate of each trial (n,), between 0 and 1.
        success: Whether each trial succeeded (n,).
        level: Confidence level of the interval of the Brier score.
    """
    from scipy.special import ndtr

    observed = np.asarray(success, float)
    squared = (observed - predicted) ** 2
    variance = np.sum((1 - 2 * predicted) ** 2 * predicted * (1 - predicted))
    z = np.sum((observed - predicted) * (1 - 2 * predicted)) / np.sqrt(variance) if variance > 0 else np.nan
    low, high = student_interval(squared, level)
    return PredictionCalibration(
        len(observed),
        float(squared.mean()),
        low,
        high,
        float(np.mean(predicted * (1 - predicted))),
        float(2 * ndtr(-abs(z))),
        float(np.mean(predicted)),
        float(observed.mean()),
    )


def reliability_curve(
    predicted: np.ndarray, success: np.ndarray, bins: int = RELIABILITY_BINS, level: float = CONFIDENCE_LEVEL
) -> pd.DataFrame:
    """Compare observed with predicted success rates of real trials in bins of increasing predicted rate.

    Args:
        predicted: Predicted success rate of each trial (n,).
        success: Whether each trial succeeded (n,).
        bins: Largest number of bins; equal predictions are never divided.
        level: Confidence level of the exact intervals of the observed rates.

    Returns:
        A row for each bin: `trials`, mean `predicted` rate, `success`, `share` that succeeded, `low`, `high`.
    """
    edges = np.unique(np.quantile(predicted, np.linspace(0, 1, bins + 1)[1:-1], method="higher"))
    place = np.searchsorted(edges, predicted, side="right")
    groups = pd.DataFrame({"place": place, "predicted": predicted, "success": success}).groupby("place")
    columns = {"trials": ("success", "size"), "predicted": ("predicted", "mean"), "success": ("success", "sum")}
    table = groups.agg(**columns).reset_index(drop=True)
    low, high = clopper_pearson(table["success"], table["trials"], level)
    return table.assign(share=table["success"] / table["trials"], low=low, high=high)


def success_rate_correlation(
    predicted: np.ndarray, observed: np.ndarray, level: float = CONFIDENCE_LEVEL
) -> tuple[float, float, float]:
    """Correlate predicted with observed success rates over conditions (Pearson).

    Args:
        predicted: Predicted rate at each condition (c,).
        observed: Observed rate at each condition (c,).
        level: Confidence level of Fisher's interval.

    Returns:
        Correlation, and lower and upper end of its interval; NaN where there are too few conditions, or all are equal.
    """
    from scipy.stats import pearsonr

    if len(predicted) < MIN_CONDITIONS or not np.ptp(predicted) > 0 or not np.ptp(observed) > 0:
        return np.nan, np.nan, np.nan
    found: Any = pearsonr(predicted, observed)  # its stub lacks the statistic
    low, high = found.confidence_interval(level)
    return float(found.statistic), float(low), float(high)


def draw_likelihood_weights(simulated: np.ndarray, success: np.ndarray, error_rate: float) -> np.ndarray:
    """Weigh simulated parameter draws by the likelihood of the outcomes of real trials.

    A trial ends as the simulation of the true parameters says, except with probability `error_rate`.

    Args:
        simulated: Success rate of each draw at the condition of each trial (draws, n).
        success: Whether each trial succeeded (n,).
        error_rate: Probability that a trial ends otherwise than the simulation with the true parameters.

    Returns:
        Weights (draws,), whose sum is 1.
    """
    rate = error_rate + (1 - 2 * error_rate) * simulated
    log = np.log(np.where(success, rate, 1 - rate)).sum(axis=1)
    weights = np.exp(log - log.max())
    return weights / weights.sum()


def prior_posterior_table(values: pd.DataFrame, weights: np.ndarray) -> pd.DataFrame:
    """Compare mean and spread of each parameter before and after weighing its draws by the outcomes of real trials.

    Args:
        values: Parameters of the draws, a column each (draws,).
        weights: Weights of the draws (draws,), see `draw_likelihood_weights`.

    Returns:
        A row for each parameter: mean and standard deviation `before` and `after`, the `shift` of the mean in standard
        deviations before, and its p-value by permutations of the weights, corrected for the number of parameters.
    """
    from scipy.special import ndtr

    lines, n = [], len(weights)
    for name in values:
        x = values[name].to_numpy(float)
        mean, spread = x.mean(), x.std(ddof=1)
        after = float(weights @ x)
        after_spread = float(np.sqrt(max(weights @ (x - after) ** 2, 0.0)))
        # variance of the weighted mean if the weights are dealt to the draws at random
        error = spread * np.sqrt(max(np.sum(weights**2) - 1 / n, 0.0))
        p = 2 * ndtr(-abs(after - mean) / error) if error > 0 else 1.0
        lines.append((name, mean, spread, after, after_spread, (after - mean) / spread if spread else 0.0, float(p)))
    columns = ["parameter", "mean_before", "sd_before", "mean_after", "sd_after", "shift", "p_holm"]
    table = pd.DataFrame(lines, columns=columns)
    return table.assign(p_holm=holm_adjust(table["p_holm"].to_numpy()))
