"""How rarely something fails, from draws that were sought where it does, with their weights."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from sweep.analysis.intervals import CONFIDENCE
from sweep.core.errors import InputError
from sweep.study.config import Experiment
from sweep.study.importance import PLAIN

LARGEST = 0.1  # share of the sum that one row may carry in an estimate that is to be trusted
NEAR = 3  # parameters that are told of a cause


@dataclass(frozen=True)
class Rare:
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
    def trusted(self) -> bool:
        """Whether no single row carries much of the sum."""
        return self.failed > 0 and self.largest <= LARGEST

    def __str__(self) -> str:
        told = f"{self.rows} draws of {self.of}"
        if not self.failed:
            return f"no failure in the last {told}: P(failure) <= {self.high:.2g} (95 %)"
        text = f"P(failure) = {self.probability:.3g}, {self.low:.2g} to {self.high:.2g} (95 %), by the last {told}, "
        text += f"of which {self.failed} failed; {self.plain:,.0f} plain draws would say as much"
        if self.invalid:
            text += f"; {self.invalid} invalid ones count as failures"
        if not self.trusted:
            text += f"; NOT to be trusted: one row carries {self.largest:.0%} of the sum: more draws, or more rounds"
        return text


def rare(rows: pd.DataFrame, exp: Experiment) -> Rare:
    """What a study of importance sampling says. Raises `InputError` where its last round is not whole.

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
        most = min((1 - (1 - CONFIDENCE) ** (1 / n)) / PLAIN, 1.0)
        return Rare(0.0, 0.0, most, **counts, largest=0.0, plain=np.nan)
    p = total / n
    variance = max(square / n - p**2, 0.0) / n
    wide = np.exp(ndtri(0.5 + CONFIDENCE / 2) * np.sqrt(np.log1p(variance / p**2)))
    plain = p * (1 - p) / variance if variance else np.inf
    ends = float(p / wide), float(min(p * wide, 1.0))
    return Rare(float(p), *ends, **counts, largest=float(share.max() / total), plain=float(plain))


def modes(rows: pd.DataFrame, exp: Experiment) -> pd.DataFrame:
    """Causes of failing by their share of the probability, each with where it is most unlike plain draws.

    How far is in standard deviations of the plain draws, which the weights tell.
    """
    axes = [axis for axis in exp.study.axes if pd.api.types.is_numeric_dtype(rows[axis.column])]
    x, weight = rows[[axis.column for axis in axes]].to_numpy(float), rows["axis.weight"].to_numpy()
    middle = np.average(x, axis=0, weights=weight)
    spread = np.sqrt(np.average((x - middle) ** 2, axis=0, weights=weight))
    last = (rows["axis.round"] == exp.study.design.rounds).to_numpy()
    failed = last & (rows["outcome"] != "success").to_numpy()
    found = []
    for cause, index in rows[failed].groupby("cause").groups.items():
        here = rows.index.get_indexer(index)
        away = (np.average(x[here], axis=0, weights=weight[here]) - middle) / np.where(spread, spread, 1.0)
        far = np.argsort(-np.abs(away))[:NEAR]
        where = ", ".join(f"{axes[k].name} {away[k]:+.1f}" for k in far)
        found.append({"cause": cause, "share": weight[here].sum() / weight[failed].sum(), "rows": len(here),
                      "where, in standard deviations": where})  # fmt: skip
    return pd.DataFrame(found).sort_values("share", ascending=False, ignore_index=True) if found else pd.DataFrame()
