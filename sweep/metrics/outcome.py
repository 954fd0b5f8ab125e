"""Classification of rows: from metrics and thresholds to success, failure with a cause, or invalid."""

import dataclasses
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from sweep.core.errors import InputError
from sweep.core.metric import Cause, column_unit, merge_columns
from sweep.core.outcomes import GOAL_MISSED, CauseVerdicts, cause_margin, classify_rows, find_least_margins, judge_cause
from sweep.core.parameters import format_unit, parameters
from sweep.metrics import CAUSES, METRICS, applicable_metrics
from sweep.models.case import Case

_MEANING = {cause.name: cause.sentence for cause in CAUSES} | {
    GOAL_MISSED: "the manoeuvre's goal was missed; the column `limit` says which part of it"
}
FAILURE_MEANINGS = {cause.name: _MEANING[cause.name] for cause in CAUSES if not cause.invalid}
INVALID_CAUSES = {cause.name: _MEANING[cause.name] for cause in CAUSES if cause.invalid}
CAUSE_MEANINGS = {**FAILURE_MEANINGS, **INVALID_CAUSES}
COLUMN_MEANINGS = merge_columns(METRICS)
BOOKKEEPING_COLUMNS = {
    f"{cause.name}_{what}" for cause in CAUSES for what in ("time_s", "stage")
}  # when causes were met


class OutcomeThresholds:
    """Thresholds of metrics beyond which a rollout counts as failed or invalid; null means the manoeuvre's default."""

    meanings: ClassVar = {cause.threshold: f"{cause.name}: {cause.sentence}" for cause in CAUSES if cause.threshold}

    if TYPE_CHECKING:  # a field for each threshold of a cause

        def __init__(self, **values: float | None) -> None: ...
        def __getattr__(self, threshold: str) -> Any: ...


for _cause in CAUSES:
    if _cause.threshold:
        OutcomeThresholds.__annotations__[_cause.threshold] = float if _cause.default is not None else float | None
        setattr(OutcomeThresholds, _cause.threshold, _cause.threshold_parameter())
parameters(OutcomeThresholds)


def resolve_thresholds(values: Mapping[str, float | None], case: Case) -> OutcomeThresholds:
    """Return the outcome thresholds of a study, with null values replaced by the defaults of its manoeuvre.

    Args:
        values: Values by key of `outcome`.
        case: A case of the kind.

    Raises:
        InputError: A value is for a metric that such a rollout does not have.
    """
    known = {cause.threshold: cause for metric in applicable_metrics(case) for cause in metric.causes}
    chosen = {}
    for field in dataclasses.fields(OutcomeThresholds):  # pyright: ignore[reportArgumentType]
        value, cause = values.get(field.name, field.default), known.get(field.name)
        if cause is None and value != field.default:
            kinds = f"manoeuvre = {case.manoeuvre.kind} on obstacle = {case.obstacle.kind}"
            raise InputError(f"outcome.{field.name} = {value} is not allowed: {kinds} has no such metric")
        if value is None and cause is not None:
            value = case.manoeuvre.goal.get(field.name, cause.default_for(case))
        chosen[field.name] = value
    return OutcomeThresholds(**chosen)


def cause_meanings(limits: OutcomeThresholds) -> dict[str, str]:
    """Return a sentence on each cause of failure or invalidity, with the value of its threshold.

    Args:
        limits: thresholds of the study. A threshold that its manoeuvre does not have is named only.

    Returns:
        Sentence by name of the cause: `a standing foot slipped by more than 0.02 m (slip_max_m)`.
    """
    return CAUSE_MEANINGS | {cause.name: f"{sentence} ({cause.threshold})" if sentence != cause.sentence else sentence
                             for cause in CAUSES if cause.name != GOAL_MISSED
                             for sentence in [cause_sentence_with_threshold(cause, limits)]}  # fmt: skip


def cause_sentence_with_threshold(cause: Cause, limits: OutcomeThresholds) -> str:
    """Return the sentence that explains a cause of failure, with value and unit of its threshold filled in."""
    if not cause.threshold or not np.isfinite(limit := threshold_value(cause, limits)):
        return cause.sentence
    unit = format_unit(column_unit(cause.threshold))
    value = f"{limit:.4g} {unit}".strip().replace(" deg", "°")
    return re.sub(rf"\b{cause.threshold}\b", value, cause.sentence)


def threshold_value(cause: Cause, limits: OutcomeThresholds) -> float:
    """Return the value of the threshold at which a cause of failure or invalidity applies.

    Args:
        cause: The cause.
        limits: The thresholds of a study.

    Returns:
        The threshold in the metric's unit; infinite where there is none, so that the cause never holds.
    """
    return cause.limit(getattr(limits, cause.threshold) if cause.threshold else cause.default)


def classify(
    figures: Mapping[str, np.ndarray], limits: OutcomeThresholds, stages: Sequence[str]
) -> dict[str, np.ndarray]:
    """Label rollouts as success, failure or invalid with their causes, from stored metrics and thresholds alone.

    The cause that occurred first decides. If several occur in the same tick, those that make a row invalid take
    precedence. Causes that are known only at the end come last. With thresholds other than those of the run a cause may
    have no recorded time: it then comes at the end, with time NaN.

    Args:
        figures: Metrics (n,) by column.
        limits: Thresholds.
        stages: Names of the plan's stages.

    Returns:
        Labels (n,) by column: `outcome`, `cause`, `stage`, `t_cause_s`; `limit`, the threshold that was crossed;
        `margin`, the least distance of a metric to the threshold of a failure in units of that threshold; and
        `margin_of`, which threshold that is.
    """
    f = {key: np.asarray(value) for key, value in figures.items()}
    causes = sorted((c for c in CAUSES if c.metric in f), key=lambda c: not c.invalid)
    return classify_rows([_judge_cause(c, f, limits) for c in causes], f["end_stage"], stages)


def least_margins(
    causes: Sequence[Cause], figures: Mapping[str, np.ndarray], limits: OutcomeThresholds
) -> tuple[np.ndarray, np.ndarray]:
    """Find for each row the failure threshold that its metrics come closest to, and the margin to this threshold.

    Causes without a finite threshold do not count; a metric that is NaN is beyond its threshold.

    Args:
        causes: Causes to compare; those that make a row invalid are skipped.
        figures: Metrics (n,) by column.
        limits: Thresholds.

    Returns:
        The least margin (n,), and the key of its threshold (n,), or the cause's name if it has no threshold.
    """
    margins = {c.threshold or c.name: cause_margin(c, figures, threshold_value(c, limits)) for c in causes}
    return find_least_margins({key: margin for key, margin in margins.items() if margin is not None})


def explain_cause(row: Mapping[str, Any], limits: OutcomeThresholds) -> str:
    """Explain in words why the rollout of a row failed or is invalid.

    Args:
        row: The row by column.
        limits: Thresholds.

    Returns:
        A sentence with the metric and its threshold; empty for a success.
    """
    for cause in CAUSES:
        if cause.name == row["cause"] and cause.threshold == row["limit"] and cause.metric in row:
            value = f" ({cause.metric} {float(row[cause.metric]):.4g}, " if cause.threshold else ""
            side = "at least" if cause.below else "at most"
            return cause_sentence_with_threshold(cause, limits) + (
                value and f"{value}{side} {threshold_value(cause, limits):.4g})"
            )
    return CAUSE_MEANINGS.get(str(row["cause"]), "")


def _judge_cause(cause: Cause, f: Mapping[str, np.ndarray], limits: OutcomeThresholds) -> CauseVerdicts:
    """Judge rows by a cause. A comparison with NaN is false, hence the explicit check of every figure."""
    judged = judge_cause(cause, f, threshold_value(cause, limits), f["end_stage"])
    if cause.name != "not_finite":
        return judged
    unknown = np.any([np.isnan(v.astype(float)) for key, v in f.items() if key not in BOOKKEEPING_COLUMNS], axis=0)
    return dataclasses.replace(judged, holds=judged.holds | unknown)
