"""Outcome of a rollout: `success`, `failure` with the cause that came first, or `invalid`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sweep.core.metric import Cause

SUCCESS, FAILURE, INVALID = "success", "failure", "invalid"
GOAL_MISSED = "goal_missed"  # the cause of all parts of a goal, of whatever system
ColumnArrays = Mapping[str, np.ndarray]  # metrics (n,) by name


@dataclass(frozen=True)
class CauseVerdicts:
    """Judgement of n rows by one cause: whether and when it applies, and the margin; input of `classify_rows`."""

    name: str
    key: str  # of the threshold in `outcome`; empty without one
    invalid: bool  # it makes rows invalid rather than failed
    holds: np.ndarray  # (n,)
    time: np.ndarray  # s, (n,): when it first held; infinite where that is known at the end only
    stage: np.ndarray  # (n,): number of the stage in which it first held
    margin: np.ndarray | None = None  # (n,): distance from the threshold, negative where it holds; None without one


def judge_cause(cause: Cause, columns: ColumnArrays, limit: float, end_stage: np.ndarray) -> CauseVerdicts:
    """Judge rows by a cause: whether its metric is beyond the threshold, since when, and by which margin.

    Args:
        cause: The cause.
        columns: Metrics (n,) by name.
        limit: Its threshold; infinite where there is none.
        end_stage: Number of the last stage (n,).
    """
    match cause.known_at:
        case "start":
            time = np.zeros(end_stage.shape)
        case "tick":
            time = np.nan_to_num(columns[f"{cause.name}_time_s"].astype(float), nan=np.inf)
        case _:
            time = np.full(end_stage.shape, np.inf)
    return CauseVerdicts(
        cause.name,
        cause.threshold,
        cause.invalid,
        np.asarray(cause.holds(columns[cause.metric], limit)),
        time,
        end_stage if cause.known_at == "end" else columns[f"{cause.name}_stage"],
        cause_margin(cause, columns, limit),
    )


def cause_margin(cause: Cause, columns: ColumnArrays, limit: float) -> np.ndarray | None:
    """Return the distance of n rows from a cause's threshold, divided by the scale of the cause.

    Args:
        cause: The cause.
        columns: Metrics (n,) by name.
        limit: Its threshold.

    Returns:
        Margins; None for causes of invalidity, and for those without a finite threshold.
    """

    def values(name: str) -> np.ndarray | None:
        return np.asarray(columns[name], float) if name in columns else None

    if cause.invalid or not (cause.threshold or cause.twin) or not np.isfinite(limit):
        return None
    return cause.margin(values(cause.metric), limit, values(cause.margin_companion_metric))


def classify_rows(
    causes: Sequence[CauseVerdicts], end_stage: np.ndarray, stages: Sequence[str], unknown_margin: float = -np.inf
) -> dict[str, np.ndarray]:
    """Give each row an outcome, a cause and a margin, from the judgements of all causes.

    The cause that held first in time decides. Of causes at the same time the first of the sequence decides: systems
    name those of `invalid` first.

    Args:
        causes: Causes of n rows, in the order in which they decide at the same time.
        end_stage: Number of the last stage (n,).
        stages: Names of the stages.
        unknown_margin: What a margin that is NaN counts as, when the least is sought.

    Returns:
        Labels (n,) by column: `outcome`, `cause`, `stage`, `t_cause_s`; `limit`, the threshold that was crossed;
        `margin`, the least distance to the threshold of a failure in units of that threshold; and `margin_of`, which
        threshold that is.
    """
    holds = np.stack([cause.holds for cause in causes])
    times = np.where(holds, np.stack([cause.time for cause in causes]), np.nan)
    any_holds = holds.any(axis=0)
    first = np.argmin(np.nan_to_num(times, nan=np.inf, posinf=np.finfo(float).max), axis=0)
    time = np.take_along_axis(times, first[None], axis=0)[0]
    stage = np.take_along_axis(np.stack([cause.stage for cause in causes]), first[None], axis=0)[0]
    stage = np.where(np.isfinite(time), stage, end_stage).astype(int)
    names, keys, verdicts = np.array(
        [(cause.name, cause.key, INVALID if cause.invalid else FAILURE) for cause in causes], dtype=object
    ).T
    labels = np.array([*stages, ""], dtype=object)
    margins = {cause.key or cause.name: cause.margin for cause in causes if cause.margin is not None}
    margin, margin_of = find_least_margins(margins, unknown_margin)
    return {
        "outcome": np.where(any_holds, verdicts[first], SUCCESS),
        "cause": np.where(any_holds, names[first], ""),
        "stage": np.where(any_holds, labels[np.clip(stage, -1, len(stages) - 1)], ""),
        "t_cause_s": np.where(any_holds & np.isfinite(time), time, np.nan),
        "limit": np.where(any_holds, keys[first], ""),
        "margin": margin,
        "margin_of": margin_of,
    }


def find_least_margins(
    margins: Mapping[str, np.ndarray], unknown_margin: float = -np.inf
) -> tuple[np.ndarray, np.ndarray]:
    """Find for each of n rows the threshold to which it is nearest, and its margin to that threshold.

    Args:
        margins: Distances (n,) from thresholds, by key.
        unknown_margin: What a distance that is NaN counts as.

    Returns:
        The least margin (n,), and the key of its threshold (n,).
    """
    values = np.stack([*margins.values()])
    nearest = np.argmin(np.where(np.isnan(values), unknown_margin, values), axis=0)
    return np.take_along_axis(values, nearest[None], axis=0)[0], np.array([*margins], dtype=object)[nearest]
