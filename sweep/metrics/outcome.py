"""Classification of rows: from metrics and thresholds to success, failure with a cause, or invalid."""

import dataclasses
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from sweep.core.errors import InputError
from sweep.core.outcomes import FAILURE, INVALID, SUCCESS
from sweep.core.parameters import UNITS, format_unit, parameters
from sweep.metrics import CAUSES, METRICS, applicable_metrics
from sweep.metrics.metric import GOAL, Cause
from sweep.models.case import Case

_MEANING = {cause.name: cause.sentence for cause in CAUSES} | {
    GOAL: "the manoeuvre's goal was missed; the column `limit` says which part of it"
}
FAILURES = {cause.name: _MEANING[cause.name] for cause in CAUSES if not cause.invalid}
INVALID_CAUSES = {cause.name: _MEANING[cause.name] for cause in CAUSES if cause.invalid}
MEANING = {**FAILURES, **INVALID_CAUSES}
COLUMNS = {name: meaning for metric in METRICS for name, meaning in metric.columns.items()}
BOOKKEEPING = {f"{cause.name}_{what}" for cause in CAUSES for what in ("time_s", "stage")}  # when causes were met


class Thresholds:
    """When a rollout counts as failed, or as not to be trusted; null is what the manoeuvre's goal says."""

    meanings: ClassVar = {cause.threshold: f"{cause.name}: {cause.sentence}" for cause in CAUSES if cause.threshold}

    if TYPE_CHECKING:  # a field for each threshold of a cause

        def __init__(self, **values: float | None) -> None: ...
        def __getattr__(self, threshold: str) -> Any: ...


for _cause in CAUSES:
    if _cause.threshold:
        Thresholds.__annotations__[_cause.threshold] = float if _cause.default is not None else float | None
        setattr(Thresholds, _cause.threshold, _cause.quantity())
parameters(Thresholds)


def thresholds(values: Mapping[str, float | None], case: Case) -> Thresholds:
    """Resolve the thresholds of a kind of world; null values become those of the manoeuvre's goal.

    Args:
        values: Values by key of `outcome`.
        case: A case of the kind.

    Raises:
        InputError: A value is for a metric that such a rollout does not have.
    """
    known = {cause.threshold: cause for metric in applicable_metrics(case) for cause in metric.causes}
    chosen = {}
    for field in dataclasses.fields(Thresholds):  # pyright: ignore[reportArgumentType]
        value, cause = values.get(field.name, field.default), known.get(field.name)
        if cause is None and value != field.default:
            kinds = f"manoeuvre = {case.manoeuvre.kind} on obstacle = {case.obstacle.kind}"
            raise InputError(f"outcome.{field.name} = {value} is not allowed: {kinds} has no such figure")
        if value is None and cause is not None:
            value = case.manoeuvre.goal.get(field.name, cause.default_for(case))
        chosen[field.name] = value
    return Thresholds(**chosen)


def cause_meanings(limits: Thresholds) -> dict[str, str]:
    """Say what each cause of failure or invalidity means, with the value of its threshold.

    Args:
        limits: thresholds of the study. A threshold that its manoeuvre does not have is named only.

    Returns:
        Sentence by name of the cause: `a standing foot slipped by more than 0.02 m (slip_max_m)`.
    """
    return MEANING | {cause.name: f"{sentence} ({cause.threshold})" if sentence != cause.sentence else sentence
                      for cause in CAUSES if cause.name != GOAL
                      for sentence in [sentence_with_limit(cause, limits)]}  # fmt: skip


def sentence_with_limit(cause: Cause, limits: Thresholds) -> str:
    """The sentence of a cause with the value and unit of its threshold, where it has one, in place of its key."""
    if not cause.threshold or not np.isfinite(limit := threshold_value(cause, limits)):
        return cause.sentence
    unit = format_unit(UNITS.get(cause.threshold.rpartition("_")[2], "-"))
    value = f"{limit:.4g} {unit}".strip().replace(" deg", "°")
    return re.sub(rf"\b{cause.threshold}\b", value, cause.sentence)


def threshold_value(cause: Cause, limits: Thresholds) -> float:
    """Look up the threshold of a cause.

    Args:
        cause: The cause.
        limits: The thresholds of a study.

    Returns:
        The threshold in the metric's unit; infinite where there is none, so that the cause never holds.
    """
    value = getattr(limits, cause.threshold) if cause.threshold else cause.default
    return (-np.inf if cause.below else np.inf) if value is None else value


def classify(figures: Mapping[str, np.ndarray], limits: Thresholds, stages: Sequence[str]) -> dict[str, np.ndarray]:
    """Label each row with its outcome; a pure function of the stored metrics.

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
    holds = np.stack([_holds(c, f, threshold_value(c, limits)) for c in causes])
    times = np.where(holds, np.stack([_time(c, f) for c in causes]), np.nan)
    any_holds = holds.any(axis=0)
    first = np.argmin(np.nan_to_num(times, nan=np.inf, posinf=np.finfo(float).max), axis=0)
    time = np.take_along_axis(times, first[None], axis=0)[0]
    stage = np.take_along_axis(np.stack([_stage(c, f) for c in causes]), first[None], axis=0)[0]
    stage = np.where(np.isfinite(time), stage, f["end_stage"]).astype(int)
    verdict = np.array([INVALID if c.invalid else FAILURE for c in causes], dtype=object)[first]
    labels = np.array([*stages, ""], dtype=object)
    margin, margin_of = least_margins(causes, f, limits)
    return {
        "outcome": np.where(any_holds, verdict, SUCCESS),
        "cause": np.where(any_holds, np.array([c.name for c in causes], dtype=object)[first], ""),
        "stage": np.where(any_holds, labels[np.clip(stage, -1, len(stages) - 1)], ""),
        "t_cause_s": np.where(any_holds & np.isfinite(time), time, np.nan),
        "limit": np.where(any_holds, np.array([c.threshold for c in causes], dtype=object)[first], ""),
        "margin": margin,
        "margin_of": margin_of,
    }


def least_margins(
    causes: Sequence[Cause], figures: Mapping[str, np.ndarray], limits: Thresholds
) -> tuple[np.ndarray, np.ndarray]:
    """Find the failure whose threshold is nearest to each row.

    Causes without a finite threshold do not count; a metric that is NaN is beyond its threshold.

    Args:
        causes: Causes to compare; those that make a row invalid are skipped.
        figures: Metrics (n,) by column.
        limits: Thresholds.

    Returns:
        The least margin (n,), and the key of its threshold (n,), or the cause's name if it has no threshold.
    """
    judged = [
        (cause, limit)
        for cause in causes
        if not cause.invalid
        and (cause.threshold or cause.twin)
        and np.isfinite(limit := threshold_value(cause, limits))
    ]

    def value(name: str) -> np.ndarray | None:
        return np.asarray(figures[name], float) if name in figures else None

    margins = np.stack([c.margin(value(c.metric), limit, value(c.companion)) for c, limit in judged])
    nearest = np.argmin(np.nan_to_num(margins, nan=-np.inf), axis=0)
    names = np.array([cause.threshold or cause.name for cause, _ in judged], dtype=object)
    return np.take_along_axis(margins, nearest[None], axis=0)[0], names[nearest]


def explain_cause(row: Mapping[str, Any], limits: Thresholds) -> str:
    """Explain the cause of a row in words.

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
            return sentence_with_limit(cause, limits) + (
                value and f"{value}{side} {threshold_value(cause, limits):.4g})"
            )
    return MEANING.get(str(row["cause"]), "")


def _holds(cause: Cause, f: Mapping[str, np.ndarray], limit: float) -> np.ndarray:
    """A comparison with NaN is false, hence the explicit check of every figure."""
    holds = np.asarray(cause.holds(f[cause.metric], limit))
    if cause.name != "not_finite":
        return holds
    return holds | np.any([np.isnan(v.astype(float)) for key, v in f.items() if key not in BOOKKEEPING], axis=0)


def _time(cause: Cause, f: Mapping[str, np.ndarray]) -> np.ndarray:
    match cause.known_at:
        case "start":
            return np.zeros(f["end_stage"].shape)
        case "tick":
            return np.nan_to_num(f[f"{cause.name}_time_s"].astype(float), nan=np.inf)
        case _:
            return np.full(f["end_stage"].shape, np.inf)


def _stage(cause: Cause, f: Mapping[str, np.ndarray]) -> np.ndarray:
    return f["end_stage"] if cause.known_at == "end" else f[f"{cause.name}_stage"]
