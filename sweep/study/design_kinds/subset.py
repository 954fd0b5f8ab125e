"""Study design: subset simulation of rare failures."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from sweep.core.constants import CONFIDENCE_LEVEL
from sweep.core.errors import InputError
from sweep.study import subset_simulation
from sweep.study.adaptive_sampling import (
    DEFAULT_LEAD_COLUMN,
    MIN_QUANTILE,
    RoundDraws,
    RoundSummary,
    SearchGenerator,
    summarize_round,
)
from sweep.study.design_kinds.base import AdaptiveDesign, DrawContext, SamplingUnit
from sweep.study.design_kinds.importance import ImportanceSampling
from sweep.study.design_kinds.monte_carlo import advise_independent_draws
from sweep.study.subset_simulation import LevelSettings, SubsetRunResult

if TYPE_CHECKING:
    import pandas as pd

OTHER_DESIGN_ADVICE = (
    f"try another study.design.lead, study.design.kind={ImportanceSampling.kind}, or wider distributions"
)


@dataclass(frozen=True)
class SubsetSimulation(AdaptiveDesign):
    """Subset simulation: independent runs approach rare failures in levels of ever smaller values of a metric."""

    kind: ClassVar[str] = "subset"
    meaning: ClassVar[str] = "failure probabilities below 1e-5, where a metric leads to the failures"
    num_meaning: ClassVar[str] = "those of a level"
    position: ClassVar[int] = 6
    columns: ClassVar[tuple[str, ...]] = ("run", "level", "step", "chain")
    growing_settings: ClassVar[tuple[str, ...]] = ("num", "runs")

    share: float = 0.1  # share of a level's rows that the next one begins with
    target: float = 1e-7  # the least probability that is looked for
    runs: int = 5  # independent repetitions, which tell its error
    lead: str = DEFAULT_LEAD_COLUMN  # column, or sum of some, that shrinks before anything breaks

    @property
    def level_settings(self) -> LevelSettings:
        """Settings of the levels in a run of subset simulation."""
        return LevelSettings(self.num, self.share, self.target)

    def check(self, drawn: Sequence[str], listed: Sequence[str]) -> None:
        """Raise `InputError` if a setting of subset simulation, or an axis, is not allowed.

        Args:
            drawn: Names of the axes with a distribution.
            listed: Names of the axes with listed values.
        """
        super().check(drawn, listed)
        if self.runs < 1:
            raise InputError(f"study.design.runs = {self.runs} is not allowed: at least 1")
        if not MIN_QUANTILE < self.target < 1:
            raise InputError(
                f"study.design.target = {self.target:g} is not allowed: above {MIN_QUANTILE:.2g} and below 1"
            )
        steps = 1 / self.share if self.share > 0 else 0
        if not 0 < self.share <= 0.5 or abs(steps - round(steps)) > 1e-9:
            raise InputError(
                f"study.design.share = {self.share:g} is not allowed: 1 divided by a whole number of at least 2"
            )
        if self.num < subset_simulation.MIN_SEEDS * steps or self.num % round(steps):
            least = f"a multiple of {steps:.0f}, at least {subset_simulation.MIN_SEEDS * steps:.0f}"
            raise InputError(
                f"study.design.num = {self.num} is not allowed: {least} with study.design.share = {self.share:g}"
            )

    @property
    def sampling_unit(self) -> SamplingUnit:
        """The run of subset simulation, which is the unit drawn independently."""
        return SamplingUnit("run")

    @property
    def min_round_size(self) -> int:
        """Number of rollouts in a round: one for each Markov chain of all runs."""
        return self.runs * self.level_settings.chain_count

    def count_draws(self, d: int) -> int:
        """Return the largest number of draws: that of all runs of subset simulation if each one uses all levels."""
        return self.runs * self.level_settings.max_rollouts if self.num else 0

    def start_search(self, ctx: DrawContext) -> SearchGenerator:
        """Start subset simulation: a generator that yields rounds of draws and receives their outcomes."""
        return subset_simulation.start_search(len(ctx.axes), self.level_settings, self.runs, ctx.seed)

    def summarize_finished_round(self, rows: "pd.DataFrame", draws: RoundDraws) -> RoundSummary:
        """Return which draws of a round failed, and their values of `lead`, a metric that shrinks towards failure.

        Args:
            rows: Finished rows of the study, including those of the round.
            draws: The draws of the round.
        """
        return summarize_round(rows, draws, self.lead)

    def estimate_failure(self, rows: "pd.DataFrame", ctx: DrawContext) -> "SubsetEstimate":
        """Estimate the probability of failure as the mean over independent runs.

        Args:
            rows: All rows of the study.
            ctx: Axes and seed of the study.

        Raises:
            InputError: A run is not finished.
        """
        runs = self.replay_search(rows, ctx)
        if runs is None:
            raise InputError(f"the runs of {ctx.study} are not finished: run the rest first")
        return SubsetEstimate(self.target, tuple(runs))

    def weigh_rows(self, rows: "pd.DataFrame", ctx: DrawContext) -> tuple[np.ndarray, np.ndarray]:
        """Return weights (n,) for the nominal distribution, and the share (n,) of each row in the failure probability.

        Only the rows of the first level are drawn from the nominal distribution: they have weight 1, all others 0.

        Args:
            rows: All rows of the study.
            ctx: Axes and seed of the study.

        Raises:
            InputError: A run is not finished.
        """
        import pandas as pd

        failing, places = np.zeros(len(rows)), pd.Index(rows["replicate"])
        for run in self.estimate_failure(rows, ctx).runs:
            number = run.last_level.draw_numbers[
                run.last_level.failed
            ]  # a row counts as often as its chain stayed there
            np.add.at(failing, places.get_indexer(pd.Index(number)), run.probability / max(len(number), 1))
        return (rows["axis.level"] == 0).to_numpy(float), failing


@dataclass(frozen=True)
class SubsetEstimate:
    """A failure probability by independent runs of subset simulation, whose spread gives the error."""

    target: float
    runs: tuple[SubsetRunResult, ...]

    @property
    def run_probabilities(self) -> np.ndarray:
        """The failure probability that each run estimates (runs,)."""
        return np.array([run.probability for run in self.runs])

    @property
    def probability(self) -> float:
        """The estimated probability of failure: the mean over the runs."""
        return float(self.run_probabilities.mean())

    @property
    def stuck_runs(self) -> tuple[SubsetRunResult, ...]:
        """Runs of subset simulation that stopped before they reached the failure region."""
        return tuple(run for run in self.runs if run.end_reason)

    @property
    def coefficient_of_variation(self) -> float:
        """Coefficient of variation of the estimated failure probability, by the spread of runs; NaN for one run."""
        each = self.run_probabilities
        return float(each.std(ddof=1) / np.sqrt(len(each)) / each.mean()) if len(each) > 1 and each.any() else np.nan

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval of the failure probability (log-normal, Student's t over runs); NaN for a single run."""
        from scipy.stats import t

        width = t.ppf(0.5 + CONFIDENCE_LEVEL / 2, max(len(self.runs) - 1, 1)) * np.sqrt(
            np.log1p(self.coefficient_of_variation**2)
        )
        return float(self.probability * np.exp(-width)), float(min(self.probability * np.exp(width), 1.0))

    @property
    def is_reliable(self) -> bool:
        """Whether every run of subset simulation reached failures."""
        return not self.stuck_runs

    def __str__(self) -> str:
        count, rollouts = len(self.runs), sum(run.rollouts for run in self.runs)
        if not self.probability:
            return (
                f"none of {count} runs reached a failure in {rollouts:,} rollouts: {self.runs[0].end_reason}; "
                f"{OTHER_DESIGN_ADVICE}"
            )
        spread = "a single run gives no interval"
        if count > 1:
            low, high = self.interval
            spread = f"{low:.2g} to {high:.2g} (95 %, by the spread of {count} runs: "
            spread += ", ".join(f"{one:.2g}" for one in sorted(self.run_probabilities)) + ")"
        taken = [share for run in self.runs for share in run.acceptance_rates]
        text = f"P(failure) = {self.probability:.3g}, {spread}, {rollouts:,} rollouts"
        if taken:
            text += f"; {min(taken):.0%} to {max(taken):.0%} of a level's proposals were accepted"
        if self.stuck_runs:
            early = f"{len(self.stuck_runs)} of {count} runs ended early: {self.stuck_runs[0].end_reason}"
            text += f"; NOT reliable: {early}; {OTHER_DESIGN_ADVICE}"
        return text + advise_independent_draws(self.probability)


DESIGNS = {"subset": SubsetSimulation}
