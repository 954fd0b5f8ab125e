"""Comparisons that may be looked at after every pair, and stop when it suits: evidence by an e-process.

Of two runs of the same draws only discordant pairs tell which is better. If neither were, each of them would be as
likely to go either way. Evidence E against that is the likelihood of what was seen, mixed over all other chances by the
arcsine law, over the likelihood by a fair coin. It is a martingale of mean 1 if neither is better, so that it ever
reaches 1 / a with probability a at most (Ville's inequality), however often one looks.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from sweep.analysis.compare import SECOND
from sweep.analysis.intervals import CONFIDENCE, anytime
from sweep.analysis.stats import percent

POWER = 0.9  # of the test of fixed size that is told beside


def log_evidence(lost: ArrayLike, gained: ArrayLike) -> np.ndarray:
    """log E after so many discordant pairs of each direction, of the shape of the counts."""
    from scipy.special import betaln  # slow to import

    b, c = np.asarray(lost, float), np.asarray(gained, float)
    return betaln(b + 0.5, c + 0.5) - betaln(0.5, 0.5) + (b + c) * np.log(2)


def fixed_size(lost: float, gained: float, level: float = CONFIDENCE) -> float:
    """About how many pairs McNemar's test needs, looked at once, to see shares `lost` and `gained` of all pairs differ.

    By the normal approximation (Connor 1987), with a power of `POWER`; infinite where they do not differ.
    """
    from scipy.special import ndtri

    flips, difference = lost + gained, abs(lost - gained)
    if not difference:
        return np.inf
    spread = np.sqrt(max(flips - difference**2, 0.0))
    return float(((ndtri(0.5 + level / 2) * np.sqrt(flips) + ndtri(POWER) * spread) / difference) ** 2)


@dataclass(frozen=True)
class Verdict:
    """What the pairs say up to the first at which it is decided; up to the last where it is not."""

    level: float
    pairs: int  # that are valid in both runs
    left: int  # valid pairs after the deciding one: they were not needed
    invalid: int  # pairs passed over
    lost: int  # succeed in A, fail in B
    gained: int
    both: int  # succeed in both
    log_e: float
    decided: bool

    @property
    def a(self) -> int:
        """Pairs in which A succeeds."""
        return self.both + self.lost

    @property
    def b(self) -> int:
        """Pairs in which B succeeds."""
        return self.both + self.gained

    def __str__(self) -> str:
        if not self.pairs:
            return f"none of {self.invalid} pairs is valid in both"
        shares = " and ".join(
            f"{name} {percent(k / self.pairs)} ({percent(float(low))} to {percent(float(high))})"
            for name, k in (("A", self.a), ("B", self.b))
            for low, high in [anytime(k, self.pairs, self.level)]
        )
        needed = 1 / (1 - self.level)
        found = f"{np.exp(self.log_e):.3g}, {needed:.3g} decides at {percent(self.level)}"
        skipped = f"; {self.invalid} invalid pairs are passed over" if self.invalid else ""
        flips = f"{self.lost} succeed only in A, {self.gained} only in B"
        lines = [f"after {self.pairs} pairs: {flips}; E = {found}{skipped}"]
        if self.decided:
            better, worse = ("A", "B") if self.lost > self.gained else ("B", "A")
            rest = f"; {self.left} more pairs were not needed" if self.left else ""
            lines.append(f"{better} succeeds more often than {worse}, however often one looked{rest}")
        else:
            lines.append("not decided: more draws may decide it, and one may look again after each")
        lines.append(f"succeed: {shares}, intervals that hold however often one looks")
        if np.isfinite(once := fixed_size(self.lost / self.pairs, self.gained / self.pairs, self.level)):
            lines.append(f"if these were the true shares, a test looked at once would need about {once:.0f} pairs")
        return "\n".join(lines)


def verdict(pairs: pd.DataFrame, level: float = CONFIDENCE) -> Verdict:
    """Go through `pairs` (of `compare.pair`) by replicate, as they were drawn, and stop where it is decided.

    Pairs with an invalid rollout tell nothing of A and B, and are passed over.
    """
    pairs = pairs.sort_values("replicate", kind="stable") if "replicate" in pairs else pairs
    first, second = pairs["outcome"].to_numpy(), pairs[f"outcome{SECOND}"].to_numpy()
    valid = (first != "invalid") & (second != "invalid")
    won, won_b = first[valid] == "success", second[valid] == "success"
    lost, gained, both = (np.cumsum(hit) for hit in (won & ~won_b, ~won & won_b, won & won_b))
    evidence = log_evidence(lost, gained)
    over = evidence >= -np.log(1 - level)
    decided = bool(over.any())
    n = int(over.argmax()) + 1 if decided else len(over)
    if not n:
        return Verdict(level, 0, 0, len(pairs), 0, 0, 0, 0.0, False)
    passed = int(np.flatnonzero(valid)[n - 1]) + 1 - n if decided else int((~valid).sum())
    b, c, wins = (int(count[n - 1]) for count in (lost, gained, both))
    return Verdict(level, n, len(over) - n, passed, b, c, wins, float(evidence[n - 1]), decided)
