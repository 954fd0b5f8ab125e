"""Study design: importance sampling of failures."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from sweep.core.constants import CONFIDENCE_LEVEL
from sweep.core.errors import InputError
from sweep.study import importance_sampling
from sweep.study.adaptive_sampling import SearchGenerator
from sweep.study.design_kinds.base import AdaptiveDesign, DrawContext
from sweep.study.design_kinds.monte_carlo import advise_independent_draws

if TYPE_CHECKING:
    import pandas as pd

MAX_RELIABLE_SHARE = 0.1  # largest share of the sum that one row may carry in a reliable estimate
WIDER_PROPOSAL_ADVICE = "try a larger study.design.wide, more draws, or wider distributions"


@dataclass(frozen=True)
class ImportanceSampling(AdaptiveDesign):
    """Importance sampling: each round draws from a proposal fitted to the failures of earlier rounds."""

    kind: ClassVar[str] = "importance"
    meaning: ClassVar[str] = "failure probabilities down to about 1e-5"
    num_meaning: ClassVar[str] = "those of a round"
    position: ClassVar[int] = 5
    columns: ClassVar[tuple[str, ...]] = ("weight", "round")

    wide: float = 2.0  # how many times as wide the first round's normals are
    rounds: int = 2  # rounds of `num` draws each, after the first

    def check(self, drawn: Sequence[str], listed: Sequence[str]) -> None:
        """Raise `InputError` if a setting of importance sampling, or an axis, is not allowed.

        Args:
            drawn: Names of the axes with a distribution.
            listed: Names of the axes with listed values.
        """
        super().check(drawn, listed)
        if not 1 <= self.wide <= 5:
            raise InputError(f"study.design.wide = {self.wide:g} is not allowed: from 1 to 5")
        if self.rounds < 1:
            raise InputError(f"study.design.rounds = {self.rounds} is not allowed: at least 1")
        if self.num < 2:  # a single draw has no error
            raise InputError(f"study.design.num = {self.num} is not allowed: at least 2")

    @property
    def min_round_size(self) -> int:
        """Number of rollouts in each round."""
        return self.num

    def count_draws(self, d: int) -> int:
        """Return the number of draws in all rounds of importance sampling."""
        return self.num * (self.rounds + 1)

    def start_search(self, ctx: DrawContext) -> SearchGenerator:
        """Start importance sampling: a generator that yields rounds of draws and receives their outcomes."""
        return importance_sampling.start_search(len(ctx.axes), self.num, self.wide, self.rounds, ctx.seed)

    def estimate_failure(self, rows: "pd.DataFrame", ctx: DrawContext) -> "WeightedEstimate":
        """Estimate the probability of failure from the importance weights of the failures in the last round.

        The interval is that of a log-normal estimate; without a failure the bound follows from the share of plain draws
        in the proposal.

        Args:
            rows: All rows of the study.
            ctx: Axes and seed of the study.

        Raises:
            InputError: The last round is incomplete.
        """
        from scipy.special import ndtri  # slow to import

        last = rows[rows["axis.round"] == self.rounds]
        if len(last) < self.num:
            raise InputError(f"the last round of {ctx.study} has {len(last)} of {self.num} rows: run the rest first")
        failed, n = (last["outcome"] != "success").to_numpy(), len(last)
        share = np.where(failed, last["axis.weight"], 0.0)
        total, square = share.sum(), (share**2).sum()
        counts = {"rows": n, "total_rows": len(rows), "failed": int(failed.sum())}
        counts["invalid"] = int((last["outcome"] == "invalid").sum())
        if not total:
            most = min((1 - (1 - CONFIDENCE_LEVEL) ** (1 / n)) / importance_sampling.PLAIN_SHARE, 1.0)
            return WeightedEstimate(0.0, 0.0, most, **counts, largest_weight_share=0.0, equivalent_plain_draws=np.nan)
        p = total / n
        variance = max(square / n - p**2, 0.0) / n
        wide = np.exp(ndtri(0.5 + CONFIDENCE_LEVEL / 2) * np.sqrt(np.log1p(variance / p**2)))
        p, low, high = (float(min(one, 1.0)) for one in (p, p / wide, p * wide))  # weights may sum to more
        plain = float(p * (1 - p) / variance) if variance else np.inf
        return WeightedEstimate(
            p, low, high, **counts, largest_weight_share=float(share.max() / total), equivalent_plain_draws=plain
        )

    def weigh_rows(self, rows: "pd.DataFrame", ctx: DrawContext) -> tuple[np.ndarray, np.ndarray]:
        """Return the importance weights (n,) of all rows, and the same with 0 for all but failures of the last round.

        Args:
            rows: All rows of the study.
            ctx: Axes and seed of the study.
        """
        weight = rows["axis.weight"].to_numpy()
        last = (rows["axis.round"] == self.rounds) & (rows["outcome"] != "success")
        return weight, np.where(last, weight, 0.0)


@dataclass(frozen=True)
class WeightedEstimate:
    """A failure probability by importance sampling, from the draws of the last round alone.

    Earlier rounds fitted the proposal, so that they are not part of the estimate.
    """

    probability: float
    low: float
    high: float
    rows: int  # of the last round
    total_rows: int  # in all
    failed: int  # of the last round, invalid ones among them
    invalid: int
    largest_weight_share: float  # share of the sum that the heaviest failure carries
    equivalent_plain_draws: float  # plain draws that would say as much; NaN without a failure

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval: lower and upper end."""
        return self.low, self.high

    @property
    def is_reliable(self) -> bool:
        """Whether no single row makes up more than the share `MAX_RELIABLE_SHARE` of the estimated probability."""
        return self.failed > 0 and self.largest_weight_share <= MAX_RELIABLE_SHARE

    def __str__(self) -> str:
        draws = f"{self.rows} draws of {self.total_rows}"
        if not self.failed:
            return f"no failure in the last {draws}: P(failure) <= {self.high:.2g} (95 %); {WIDER_PROPOSAL_ADVICE}"
        text = f"P(failure) = {self.probability:.3g}, {self.low:.2g} to {self.high:.2g} (95 %), by the last {draws}, "
        text += f"of which {self.failed} failed; as precise as {self.equivalent_plain_draws:,.0f} plain draws"
        if self.invalid:
            text += f"; {self.invalid} invalid ones count as failures"
        if not self.is_reliable:
            text += f"; NOT reliable: one row carries {self.largest_weight_share:.0%} of the sum; "
            text += "use more draws or more rounds"
        return text + advise_independent_draws(self.probability)


DESIGNS = {"importance": ImportanceSampling}
