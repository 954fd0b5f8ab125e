"""Sequential comparison of two runs, valid at every look: evidence by an e-process.

Only discordant pairs tell which run is better. If neither is, each of them is as likely to go either way. The evidence
E against that is the likelihood of the discordant pairs, mixed over all other probabilities by the arcsine law, over
the likelihood of a fair coin. It is a martingale of mean 1 if neither run is better, so that it ever reaches 1 / a with
probability at most a (Ville's inequality), however often one looks.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from sweep.analysis.compare import SECOND_RUN_MARK
from sweep.analysis.intervals import CONFIDENCE_LEVEL, confidence_sequence
from sweep.analysis.stats import format_percent

TEST_POWER = 0.9  # of the test of fixed size, printed for comparison


def log_e_value(lost: ArrayLike, gained: ArrayLike) -> np.ndarray:
    """Return the log of the e-value, the evidence against equal success rates, from the pairs that only A or B won."""
    from scipy.special import betaln  # slow to import

    b, c = np.asarray(lost, float), np.asarray(gained, float)
    return betaln(b + 0.5, c + 0.5) - betaln(0.5, 0.5) + (b + c) * np.log(2)


def pairs_for_fixed_sample_test(lost: float, gained: float, level: float = CONFIDENCE_LEVEL) -> float:
    """Estimate how many pairs McNemar's test, looked at once, needs to find a difference with a power of `TEST_POWER`.

    By the normal approximation (Connor 1987); infinite if the shares are equal.

    Args:
        lost: Share of pairs that succeed only in A.
        gained: Share of pairs that succeed only in B.
        level: Confidence level.
    """
    from scipy.special import ndtri

    flips, difference = lost + gained, abs(lost - gained)
    if not difference:
        return np.inf
    spread = np.sqrt(max(flips - difference**2, 0.0))
    return float(((ndtri(0.5 + level / 2) * np.sqrt(flips) + ndtri(TEST_POWER) * spread) / difference) ** 2)


@dataclass(frozen=True)
class SequentialResult:
    """State of a sequential comparison of two runs after the pair that decides it, or after the last pair if none
    does."""

    level: float
    pairs: int  # independent ones that are valid in both runs
    unused_pairs: int  # valid pairs after the deciding one: they were not needed
    invalid: int  # pairs passed over
    lost: int  # A succeeds more often than B
    gained: int
    successes_a: float  # pairs in which A succeeds; of several rows of a draw their share
    successes_b: float
    log_e: float
    is_decided: bool

    def __str__(self) -> str:
        if not self.pairs:
            return f"none of {self.invalid} pairs is valid in both"
        shares = " and ".join(
            f"{name} {format_percent(k / self.pairs)} ({format_percent(float(low))} to {format_percent(float(high))})"
            for name, k in (("A", self.successes_a), ("B", self.successes_b))
            for low, high in [confidence_sequence(k, self.pairs, self.level)]
        )
        needed = 1 / (1 - self.level)
        evidence = f"{np.exp(self.log_e):.3g}, {needed:.3g} decides at {format_percent(self.level)}"
        skipped = f"; {self.invalid} invalid pairs are skipped" if self.invalid else ""
        flips = f"{self.lost} succeed only in A, {self.gained} only in B"
        lines = [f"after {self.pairs} pairs: {flips}; E = {evidence}{skipped}"]
        if self.is_decided:
            better, worse = ("A", "B") if self.lost > self.gained else ("B", "A")
            rest = f"; {self.unused_pairs} remaining pairs were not needed" if self.unused_pairs else ""
            lines.append(f"{better} succeeds more often than {worse}, however often one looked{rest}")
        else:
            lines.append("not decided: more draws may decide it; you may look again after each one")
        lines.append(f"succeed: {shares}; these intervals are valid at any time")
        if np.isfinite(
            once := pairs_for_fixed_sample_test(self.lost / self.pairs, self.gained / self.pairs, self.level)
        ):
            lines.append(f"if these were the true shares, a fixed-sample test would need about {once:.0f} pairs")
        return "\n".join(lines)


def sequential_test(
    pairs: pd.DataFrame, level: float = CONFIDENCE_LEVEL, unit: np.ndarray | None = None
) -> SequentialResult:
    """Compare two runs pair by pair in the order of draws, and stop as soon as the evidence decides.

    Pairs with an invalid rollout are left out. If a unit has several pairs, it counts once: for the run that succeeds
    more often in it.

    Args:
        pairs: Pairs of rows (n), see `compare.pair_rows`.
        level: Confidence level.
        unit: Independent unit of each pair (n,), see `sampling_units.paired_comparison_unit_ids`, numbered in
            the order of the draws.
            None: each pair is one, in the order of `replicate`.
    """
    each = pairs["replicate"].to_numpy() if "replicate" in pairs else np.arange(len(pairs))
    units = each if unit is None else unit
    first, second = pairs["outcome"].to_numpy(), pairs[f"outcome{SECOND_RUN_MARK}"].to_numpy()
    valid = (first != "invalid") & (second != "invalid")
    won = pd.DataFrame({"a": first[valid] == "success", "b": second[valid] == "success"})
    shares = won.groupby(units[valid]).mean()  # in the order of the units
    a, b = shares["a"].to_numpy(), shares["b"].to_numpy()
    lost, gained = np.cumsum(a > b), np.cumsum(b > a)
    evidence = log_e_value(lost, gained)
    over = evidence >= -np.log(1 - level)
    decided = bool(over.any())
    n = int(over.argmax()) + 1 if decided else len(over)
    if not n:
        return SequentialResult(level, 0, 0, len(pairs), 0, 0, 0.0, 0.0, 0.0, False)
    left_out = np.unique(units[~valid & ~np.isin(units, shares.index)])
    if decided:
        left_out = left_out[left_out < shares.index[n - 1]]
    counts = int(lost[n - 1]), int(gained[n - 1]), float(a[:n].sum()), float(b[:n].sum())
    return SequentialResult(level, n, len(over) - n, len(left_out), *counts, float(evidence[n - 1]), decided)
