"""Probability of rare failures, from importance sampling or subset simulation."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from sweep.analysis.intervals import CONFIDENCE
from sweep.config.experiment import Experiment
from sweep.core.errors import InputError
from sweep.study import adaptive_designs, importance_sampling
from sweep.study.adaptive_sampling import replay_search
from sweep.study.subset_simulation import RunResult

LARGEST = 0.1  # largest share of the sum that one row may carry in a reliable estimate
LEAST = 0.01  # smallest share of a mode at which a cause is named
NEAR = 3  # parameters that describe a mode
PLAINLY = "study.design.kind=monte_carlo"
INSTEAD = "try another study.design.lead, study.design.kind=importance, or wider distributions"
WIDER = "try a larger study.design.wide, more draws, or wider distributions"
RARE = 0.1  # failure probability from which on plain draws are as good


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
    largest: float  # share of the sum that the heaviest failure carries
    equivalent_plain_draws: float  # plain draws that would say as much; NaN without a failure

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval: lower and upper end."""
        return self.low, self.high

    @property
    def is_reliable(self) -> bool:
        """Whether no single row carries more than `LARGEST` of the weighted sum."""
        return self.failed > 0 and self.largest <= LARGEST

    def __str__(self) -> str:
        draws = f"{self.rows} draws of {self.total_rows}"
        if not self.failed:
            return f"no failure in the last {draws}: P(failure) <= {self.high:.2g} (95 %); {WIDER}"
        text = f"P(failure) = {self.probability:.3g}, {self.low:.2g} to {self.high:.2g} (95 %), by the last {draws}, "
        text += f"of which {self.failed} failed; as precise as {self.equivalent_plain_draws:,.0f} plain draws"
        if self.invalid:
            text += f"; {self.invalid} invalid ones count as failures"
        if not self.is_reliable:
            text += f"; NOT reliable: one row carries {self.largest:.0%} of the sum; use more draws or more rounds"
        return text + _not_rare(self.probability)


@dataclass(frozen=True)
class SubsetEstimate:
    """A failure probability by independent runs of subset simulation, whose spread gives the error."""

    target: float
    runs: tuple[RunResult, ...]

    @property
    def run_probabilities(self) -> np.ndarray:
        """The failure probability that each run estimates (runs,)."""
        return np.array([run.probability for run in self.runs])

    @property
    def probability(self) -> float:
        """The mean over runs."""
        return float(self.run_probabilities.mean())

    @property
    def stuck_runs(self) -> tuple[RunResult, ...]:
        """The runs that stopped before they reached the failure region."""
        return tuple(run for run in self.runs if run.why)

    @property
    def variation(self) -> float:
        """Coefficient of variation of the mean; NaN for a single run."""
        each = self.run_probabilities
        return float(each.std(ddof=1) / np.sqrt(len(each)) / each.mean()) if len(each) > 1 and each.any() else np.nan

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval: log-normal, with Student's t for the number of runs; NaN for a single run."""
        from scipy.stats import t

        width = t.ppf(0.5 + CONFIDENCE / 2, max(len(self.runs) - 1, 1)) * np.sqrt(np.log1p(self.variation**2))
        return float(self.probability * np.exp(-width)), float(min(self.probability * np.exp(width), 1.0))

    @property
    def is_reliable(self) -> bool:
        """Whether every run reached the failure region."""
        return not self.stuck_runs

    def __str__(self) -> str:
        count, rollouts = len(self.runs), sum(run.rollouts for run in self.runs)
        if not self.probability:
            return f"none of {count} runs reached a failure in {rollouts:,} rollouts: {self.runs[0].why}; {INSTEAD}"
        spread = "a single run gives no interval"
        if count > 1:
            low, high = self.interval
            spread = f"{low:.2g} to {high:.2g} (95 %, by the spread of {count} runs: "
            spread += ", ".join(f"{one:.2g}" for one in sorted(self.run_probabilities)) + ")"
        taken = [share for run in self.runs for share in run.accepted]
        text = f"P(failure) = {self.probability:.3g}, {spread}, {rollouts:,} rollouts"
        if taken:
            text += f"; {min(taken):.0%} to {max(taken):.0%} of a level's proposals were accepted"
        if self.stuck_runs:
            early = f"{len(self.stuck_runs)} of {count} runs ended early: {self.stuck_runs[0].why}"
            text += f"; NOT reliable: {early}; {INSTEAD}"
        return text + _not_rare(self.probability)


def _not_rare(probability: float) -> str:
    return f"; it is not rare: {PLAINLY} is as precise" if probability > RARE else ""


def estimate_failure_probability(rows: pd.DataFrame, exp: Experiment) -> WeightedEstimate | SubsetEstimate:
    """Estimate the failure probability of a study that samples its failures adaptively.

    Args:
        rows: All rows of the study.
        exp: Its experiment, with `design.kind` importance or subset.

    Raises:
        InputError: The last round, or a run, is incomplete.
    """
    return _repeated(rows, exp) if exp.study.design.kind == "subset" else _weighted(rows, exp)


def _repeated(rows: pd.DataFrame, exp: Experiment) -> SubsetEstimate:
    study = exp.study
    runs = replay_search(adaptive_designs.make_search(study.axes, study.design, study.seed), rows, study.design.lead)
    if runs is None:
        raise InputError(f"the runs of {study.name} are not finished: run the rest first")
    return SubsetEstimate(study.design.target, tuple(runs))


def _weighted(rows: pd.DataFrame, exp: Experiment) -> WeightedEstimate:
    """Estimate by importance sampling.

    The interval is that of a log-normal estimate; without a failure the bound follows from the share of plain draws in
    the proposal.
    """
    from scipy.special import ndtri  # slow to import

    design = exp.study.design
    last = rows[rows["axis.round"] == design.rounds]
    if len(last) < design.num:
        raise InputError(f"the last round of {exp.study.name} has {len(last)} of {design.num} rows: run the rest first")
    failed, n = (last["outcome"] != "success").to_numpy(), len(last)
    share = np.where(failed, last["axis.weight"], 0.0)
    total, square = share.sum(), (share**2).sum()
    counts = {"rows": n, "total_rows": len(rows), "failed": int(failed.sum())}
    counts["invalid"] = int((last["outcome"] == "invalid").sum())
    if not total:
        most = min((1 - (1 - CONFIDENCE) ** (1 / n)) / importance_sampling.PLAIN, 1.0)
        return WeightedEstimate(0.0, 0.0, most, **counts, largest=0.0, equivalent_plain_draws=np.nan)
    p = total / n
    variance = max(square / n - p**2, 0.0) / n
    wide = np.exp(ndtri(0.5 + CONFIDENCE / 2) * np.sqrt(np.log1p(variance / p**2)))
    p, low, high = (float(min(one, 1.0)) for one in (p, p / wide, p * wide))  # weights may sum to more
    plain = p * (1 - p) / variance if variance else np.inf
    return WeightedEstimate(
        p, low, high, **counts, largest=float(share.max() / total), equivalent_plain_draws=float(plain)
    )


def failure_modes(rows: pd.DataFrame, exp: Experiment) -> pd.DataFrame:
    """Group failures into modes, with the causes of each and where it lies.

    Modes are the components of the normal mixture fitted to the failures, as for the next round of importance sampling.

    Args:
        rows: All rows of an adaptive study.
        exp: Its experiment.

    Returns:
        A row for each mode, the largest first: its `cause`, `share` of the failure probability, number of `rows`, and
        the parameters in which it is farthest from plain draws, in standard deviations of these. Empty without a
        failure.
    """
    axes = [axis for axis in exp.study.axes if pd.api.types.is_numeric_dtype(rows[axis.column])]
    x, (plain, failing) = rows[[axis.column for axis in axes]].to_numpy(float), weights_of_draws_and_failures(rows, exp)
    here = np.flatnonzero(failing > 0)
    if not len(here):
        return pd.DataFrame()
    middle = np.average(x, axis=0, weights=plain)
    spread = np.sqrt(np.average((x - middle) ** 2, axis=0, weights=plain))
    away, failing = (x[here] - middle) / np.where(spread, spread, 1.0), failing[here] / failing.sum()
    parts = importance_sampling.fit_mixture(away, failing)
    mode, cause, table = (
        importance_sampling.assign_modes(parts)[parts.log_density(away).argmax(axis=1)],
        rows["cause"].iloc[here],
        [],
    )
    for one in np.unique(mode):
        members = mode == one
        share, where = failing[members].sum(), np.average(away[members], axis=0, weights=failing[members])
        causes = pd.Series(failing[members]).groupby(cause[members].to_numpy()).sum().sort_values(ascending=False)
        causes = causes[causes >= LEAST * share]
        named = [f"{name} {weight / share:.0%}" if len(causes) > 1 else name for name, weight in causes.items()]
        far = np.argsort(-np.abs(where))[:NEAR]
        table.append({"cause": ", ".join(named), "share": share, "rows": int(members.sum()),
                      "where, in standard deviations": ", ".join(f"{axes[k].name} {where[k]:+.1f}" for k in far),
                      })  # fmt: skip
    return pd.DataFrame(table).sort_values("share", ascending=False, ignore_index=True)


def weights_of_draws_and_failures(rows: pd.DataFrame, exp: Experiment) -> tuple[np.ndarray, np.ndarray]:
    """Return the weight of each row as a plain draw (n,), and as a failure (n,).

    The weights of failures sum to the failure probability, up to a factor.

    Args:
        rows: All rows of an adaptive study (n).
        exp: Its experiment.
    """
    if exp.study.design.kind == "importance":
        weight = rows["axis.weight"].to_numpy()
        last = (rows["axis.round"] == exp.study.design.rounds) & (rows["outcome"] != "success")
        return weight, np.where(last, weight, 0.0)
    failing, places = np.zeros(len(rows)), pd.Index(rows["replicate"])
    for run in _repeated(rows, exp).runs:
        number = run.level.number[run.level.failed]  # a row counts as often as its chain stayed there
        np.add.at(failing, places.get_indexer(pd.Index(number)), run.probability / max(len(number), 1))
    return (rows["axis.level"] == 0).to_numpy(float), failing
