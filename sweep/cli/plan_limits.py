"""What limits a tuned plan, in words: the causes of its failed draws, measured from their rows and replays."""

from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float

from sweep.core.outcomes import FAILURE, SUCCESS
from sweep.engines.limiting_parts import describe_limiting_part
from sweep.replay.replay import replay_rollout
from sweep.runs import results, store
from sweep.study.study import parameter_columns

MAX_LIMITS = 3  # pairs of cause and stage that are described
MIN_SEPARATION = 0.85  # of a parameter that is named, see `_share_ordered_alike`
MIN_FAILURES = 3  # failed draws whose sizes are compared with those of successes


def describe_limits(folder: Path) -> list[str]:
    """Describe what limits a plan: which part of the robot fails, by which metric, and at which sizes.

    This is said for each of the most frequent pairs of cause and stage. To find the part, the draw with the least
    margin is simulated again.

    Args:
        folder: Results of simulated draws.

    Returns:
        A line for each of the `MAX_LIMITS` most frequent pairs of cause and stage; none if all draws succeed.
    """
    rows, exp = store.read_rows(folder), results.load_experiment(folder)
    failed = rows[rows["outcome"] == FAILURE]
    lines = []
    for count, group in sorted(
        ((len(group), group) for _, group in failed.groupby(["cause", "stage"])), key=lambda x: -x[0]
    )[:MAX_LIMITS]:
        worst = group.iloc[int(np.argmin(group["margin"].to_numpy()))]
        replay = replay_rollout(folder, str(worst["point_id"]))
        part = describe_limiting_part(replay.trace, str(worst["cause"]), str(worst["stage"]))
        where = f"{worst['cause']} in {worst['stage']}" + (f", {part}" if part else "")
        why = exp.system.explain_cause({str(k): v for k, v in worst.items()}, exp.thresholds)
        sizes = describe_separating_sizes(group, rows[rows["outcome"] == SUCCESS])
        lines.append(f"{count} of {len(rows)} draws fail by {where}: {'; '.join([why, *sizes])}")
    return lines


def describe_separating_sizes(failed: pd.DataFrame, succeeded: pd.DataFrame) -> list[str]:
    """Describe the drawn parameters whose values separate failed draws from successful ones.

    Args:
        failed: Rows of failed draws.
        succeeded: Rows of successful draws.

    Returns:
        For each such parameter, the most separating first, its ranges in both.
    """
    if len(failed) < MIN_FAILURES or not len(succeeded):
        return []
    columns = [name for name in parameter_columns(failed) if failed[name].dtype.kind == "f"]
    shares = {name: _share_ordered_alike(failed[name].to_numpy(), succeeded[name].to_numpy()) for name in columns}
    names = sorted((name for name, share in shares.items() if share >= MIN_SEPARATION), key=lambda name: -shares[name])
    return [f"{name} is {_format_range(failed[name])} in these, {_format_range(succeeded[name])} in successes"
            for name in names]  # fmt: skip


def _share_ordered_alike(first: Float[np.ndarray, " n"], second: Float[np.ndarray, " m"]) -> float:
    """Share of pairs of two values, one from each sample, of which the same sample has the larger one.

    It is 0.5 if the samples do not differ, and 1 if no values overlap.
    """
    above = float(np.mean(first[:, None] > second) + np.mean(first[:, None] == second) / 2)
    return max(above, 1 - above)


def _format_range(values: pd.Series) -> str:
    return f"{values.min():.4g} to {values.max():.4g}"
