"""How rarely something fails, from draws that were sought where it does, with their weights."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from sweep.analysis.intervals import CONFIDENCE
from sweep.core.errors import InputError
from sweep.study import adaptive_designs, importance_sampling
from sweep.study.adaptive_sampling import replay_search
from sweep.study.config import Experiment
from sweep.study.subset_simulation import Outcome

LARGEST = 0.1  # share of the sum that one row may carry in an estimate that is to be trusted
LEAST = 0.01  # share of a mode that a cause has to be told
NEAR = 3  # parameters that are told of a mode
PLAINLY = "study.design.kind=monte_carlo"
INSTEAD = "another study.design.lead may lead to one, study.design.kind=importance needs none, or take wider errors"
WIDER = "a larger study.design.wide, more draws or wider errors may find some"
RARE = 0.1  # probability from which on plain draws tell as much


@dataclass(frozen=True)
class Weighted:
    """A probability of failing, of the last round's draws alone: what these were fitted to was drawn before."""

    probability: float
    low: float
    high: float
    rows: int  # of the last round
    of: int  # in all
    failed: int  # of the last round, invalid ones among them
    invalid: int
    largest: float  # share of the sum that the heaviest failure carries
    plain: float  # plain draws that would say as much; NaN without a failure

    @property
    def interval(self) -> tuple[float, float]:
        """The interval of 95 %, from low to high."""
        return self.low, self.high

    @property
    def trusted(self) -> bool:
        """Whether no single row carries much of the sum."""
        return self.failed > 0 and self.largest <= LARGEST

    def __str__(self) -> str:
        told = f"{self.rows} draws of {self.of}"
        if not self.failed:
            return f"no failure in the last {told}: P(failure) <= {self.high:.2g} (95 %); {WIDER}"
        text = f"P(failure) = {self.probability:.3g}, {self.low:.2g} to {self.high:.2g} (95 %), by the last {told}, "
        text += f"of which {self.failed} failed; {self.plain:,.0f} plain draws would say as much"
        if self.invalid:
            text += f"; {self.invalid} invalid ones count as failures"
        if not self.trusted:
            text += f"; NOT to be trusted: one row carries {self.largest:.0%} of the sum: more draws, or more rounds"
        return text + _not_rare(self.probability)


@dataclass(frozen=True)
class Repeated:
    """A probability of failing by independent runs of subset simulation, whose spread tells its error."""

    target: float
    runs: tuple[Outcome, ...]

    @property
    def each(self) -> np.ndarray:
        """Probabilities that the runs told, one each."""
        return np.array([run.probability for run in self.runs])

    @property
    def probability(self) -> float:
        """Mean of what the runs told."""
        return float(self.each.mean())

    @property
    def stuck(self) -> tuple[Outcome, ...]:
        """Runs that ended before they came to where all fail."""
        return tuple(run for run in self.runs if run.why)

    @property
    def variation(self) -> float:
        """Coefficient of variation of the mean; NaN of one run."""
        each = self.each
        return float(each.std(ddof=1) / np.sqrt(len(each)) / each.mean()) if len(each) > 1 and each.any() else np.nan

    @property
    def interval(self) -> tuple[float, float]:
        """Of 95 %: log-normal, by Student's law of so many runs; NaN of one."""
        from scipy.stats import t

        width = t.ppf(0.5 + CONFIDENCE / 2, max(len(self.runs) - 1, 1)) * np.sqrt(np.log1p(self.variation**2))
        return float(self.probability * np.exp(-width)), float(min(self.probability * np.exp(width), 1.0))

    @property
    def trusted(self) -> bool:
        """Whether all runs came to where all fail."""
        return not self.stuck

    def __str__(self) -> str:
        count, rollouts = len(self.runs), sum(run.rollouts for run in self.runs)
        if not self.probability:
            return f"no run of {count} came to a failure in {rollouts:,} rollouts: {self.runs[0].why}; {INSTEAD}"
        spread = "one run, whose error nothing tells"
        if count > 1:
            low, high = self.interval
            spread = f"{low:.2g} to {high:.2g} (95 %, by the spread of {count} runs: "
            spread += ", ".join(f"{one:.2g}" for one in sorted(self.each)) + ")"
        taken = [share for run in self.runs for share in run.accepted]
        text = f"P(failure) = {self.probability:.3g}, {spread}, {rollouts:,} rollouts"
        if taken:
            text += f"; {min(taken):.0%} to {max(taken):.0%} of a level's proposals were taken"
        if self.stuck:
            early = f"{len(self.stuck)} of {count} runs ended early: {self.stuck[0].why}"
            text += f"; NOT to be trusted: {early}; {INSTEAD}"
        return text + _not_rare(self.probability)


def _not_rare(probability: float) -> str:
    return f"; it is not rare: {PLAINLY} tells as much" if probability > RARE else ""


def rare(rows: pd.DataFrame, exp: Experiment) -> Weighted | Repeated:
    """What a study that seeks failures says. Raises `InputError` where its rounds are not whole."""
    return _repeated(rows, exp) if exp.study.design.kind == "subset" else _weighted(rows, exp)


def _repeated(rows: pd.DataFrame, exp: Experiment) -> Repeated:
    study = exp.study
    runs = replay_search(adaptive_designs.make_search(study.axes, study.design, study.seed), rows, study.design.lead)
    if runs is None:
        raise InputError(f"the runs of {study.name} are not at their end: run the rest first")
    return Repeated(study.design.target, tuple(runs))


def _weighted(rows: pd.DataFrame, exp: Experiment) -> Weighted:
    """Of importance sampling.

    The interval is that of a log-normal estimate; without a failure the bound follows from the plain draws' share.
    """
    from scipy.special import ndtri  # slow to import

    design = exp.study.design
    last = rows[rows["axis.round"] == design.rounds]
    if len(last) < design.num:
        raise InputError(f"the last round of {exp.study.name} has {len(last)} of {design.num} rows: run the rest first")
    failed, n = (last["outcome"] != "success").to_numpy(), len(last)
    share = np.where(failed, last["axis.weight"], 0.0)
    total, square = share.sum(), (share**2).sum()
    counts = {"rows": n, "of": len(rows), "failed": int(failed.sum())}
    counts["invalid"] = int((last["outcome"] == "invalid").sum())
    if not total:
        most = min((1 - (1 - CONFIDENCE) ** (1 / n)) / importance_sampling.PLAIN, 1.0)
        return Weighted(0.0, 0.0, most, **counts, largest=0.0, plain=np.nan)
    p = total / n
    variance = max(square / n - p**2, 0.0) / n
    wide = np.exp(ndtri(0.5 + CONFIDENCE / 2) * np.sqrt(np.log1p(variance / p**2)))
    p, low, high = (float(min(one, 1.0)) for one in (p, p / wide, p * wide))  # weights may sum to more
    plain = p * (1 - p) / variance if variance else np.inf
    return Weighted(p, low, high, **counts, largest=float(share.max() / total), plain=float(plain))


def modes(rows: pd.DataFrame, exp: Experiment) -> pd.DataFrame:
    """Modes of failing by their share of the probability, each with its causes and where it is most unlike plain draws.

    They are those of normals fitted to what failed, as for the next round of importance sampling. How far is in
    standard deviations of the plain draws.
    """
    axes = [axis for axis in exp.study.axes if pd.api.types.is_numeric_dtype(rows[axis.column])]
    x, (plain, failing) = rows[[axis.column for axis in axes]].to_numpy(float), weights(rows, exp)
    here = np.flatnonzero(failing > 0)
    if not len(here):
        return pd.DataFrame()
    middle = np.average(x, axis=0, weights=plain)
    spread = np.sqrt(np.average((x - middle) ** 2, axis=0, weights=plain))
    away, failing = (x[here] - middle) / np.where(spread, spread, 1.0), failing[here] / failing.sum()
    parts = importance_sampling.fit_mixture(away, failing)
    mode, cause, found = (
        importance_sampling.modes(parts)[parts.log_density(away).argmax(axis=1)],
        rows["cause"].iloc[here],
        [],
    )
    for one in np.unique(mode):
        its = mode == one
        share, where = failing[its].sum(), np.average(away[its], axis=0, weights=failing[its])
        causes = pd.Series(failing[its]).groupby(cause[its].to_numpy()).sum().sort_values(ascending=False)
        causes = causes[causes >= LEAST * share]
        named = [f"{name} {weight / share:.0%}" if len(causes) > 1 else name for name, weight in causes.items()]
        far = np.argsort(-np.abs(where))[:NEAR]
        found.append({"cause": ", ".join(named), "share": share, "rows": int(its.sum()),
                      "where, in standard deviations": ", ".join(f"{axes[k].name} {where[k]:+.1f}" for k in far),
                      })  # fmt: skip
    return pd.DataFrame(found).sort_values("share", ascending=False, ignore_index=True)


def weights(rows: pd.DataFrame, exp: Experiment) -> tuple[np.ndarray, np.ndarray]:
    """What rows (n,) count for as plain draws, and as failures: the latter sum to the probability of failing, or so."""
    if exp.study.design.kind == "importance":
        weight = rows["axis.weight"].to_numpy()
        last = (rows["axis.round"] == exp.study.design.rounds) & (rows["outcome"] != "success")
        return weight, np.where(last, weight, 0.0)
    failing, places = np.zeros(len(rows)), pd.Index(rows["replicate"])
    for run in _repeated(rows, exp).runs:
        number = run.level.number[run.level.failed]  # a row counts as often as its chain stayed there
        np.add.at(failing, places.get_indexer(pd.Index(number)), run.probability / max(len(number), 1))
    return (rows["axis.level"] == 0).to_numpy(float), failing
