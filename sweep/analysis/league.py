"""Ranking of several policies on the same points, with statements that all hold together at one confidence level.

Pairs of policies are compared by the exact test of `sweep compare`, corrected for the number of pairs (Holm).
Differences have simultaneous intervals from a max-t bootstrap over independent units: the largest studentized error of
all differences stays below its bootstrapped quantile. A race, in contrast, may be evaluated after every unit: it
compares pairs by their e-processes, and needs no more rollouts of a policy whose pairs are all decided.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from sweep.analysis.compare import holm_adjust, sign_flip_p_value
from sweep.analysis.intervals import CONFIDENCE_LEVEL, clopper_pearson, korn_graubard_by_group
from sweep.analysis.sequential import log_e_value
from sweep.analysis.stats import sum_by_independent_unit

REPETITIONS = 2000  # of the bootstrap
NOT_DECIDED = "not decided"


@dataclass(frozen=True)
class PairedPolicyOutcomes:
    """Outcomes of several policies on the same points; points that are invalid for a policy are left out."""

    policies: tuple[str, ...]
    success: np.ndarray  # (n, policies), whether each policy succeeds at each point
    unit: np.ndarray | None  # (n,), independent unit of each point; None if the points are not a random sample
    conditions: pd.DataFrame  # (n,) rows: columns of the points
    invalid: tuple[int, ...]  # points at which each policy is invalid

    @property
    def independent_unit_count(self) -> int:
        """Number of independent units (groups of dependent rows); 0 if the points are not a random sample."""
        return 0 if self.unit is None else len(np.unique(self.unit))


def policy_success_rates(league: PairedPolicyOutcomes, level: float = CONFIDENCE_LEVEL) -> pd.DataFrame:
    """Compute the success rate of each policy; with a random sample also intervals that hold together (Bonferroni).

    Args:
        league: Outcomes of the policies.
        level: Confidence level of all intervals together.

    Returns:
        A row for each policy: `policy`, `success`, `valid`, `share`, and with units `low`, `high`.
    """
    n, number = league.success.shape
    won = league.success.sum(axis=0)
    table = pd.DataFrame({"policy": league.policies, "success": won, "valid": n, "share": won / max(n, 1)})
    if league.unit is None or not n:
        return table
    sums, sizes = sum_by_independent_unit(league.success, league.unit)
    own = 1 - (1 - level) / number
    if sizes.max() == 1:
        low, high = clopper_pearson(won, np.full(number, n), own)
    else:
        policy = np.tile(np.arange(number), len(sizes))
        low, high = korn_graubard_by_group(policy, sums.ravel(), np.repeat(sizes, number), number, own)
    return table.assign(low=low, high=high)


def max_t_intervals(
    values: np.ndarray, level: float = CONFIDENCE_LEVEL, repetitions: int = REPETITIONS
) -> tuple[np.ndarray, np.ndarray]:
    """Compute simultaneous intervals of several means from independent observations, by a max-t bootstrap.

    Args:
        values: Observations (u, k) of k quantities.
        level: Confidence level of all intervals together.
        repetitions: Number of bootstrap samples.

    Returns:
        Lower and upper ends (k,). A quantity without variance has an interval without width.
    """
    u, mean = len(values), values.mean(axis=0)
    spread = values.std(axis=0, ddof=1) if u > 1 else np.full(values.shape[1], np.nan)
    times = np.random.default_rng(0).multinomial(u, np.full(u, 1 / u), repetitions)  # (repetitions, u)
    means = times @ values / u
    spreads = np.sqrt(np.maximum(times @ values**2 / u - means**2, 0) * u / max(u - 1, 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.abs(means - mean) / spreads
    largest = np.nanmax(np.where(np.isfinite(t), t, np.nan), axis=1, initial=0.0)
    half = np.quantile(largest, level) * spread
    return mean - half, mean + half


def pairwise_test_table(league: PairedPolicyOutcomes, level: float = CONFIDENCE_LEVEL) -> pd.DataFrame:
    """Compare the success rates of each pair of policies by paired tests, corrected for the number of pairs.

    Args:
        league: Outcomes of the policies.
        level: Confidence level of all verdicts together, and of all intervals together.

    Returns:
        A row for each pair: `a`, `b`, points at which only one succeeds (`only_a`, `only_b`), `difference` of the
        rates. With units also its simultaneous interval `low` to `high`, the corrected p-value `p_holm`, and the
        `verdict`: the name of the better policy, or `NOT_DECIDED`.
    """
    table = _count_pairs(league)
    if league.unit is None or not len(league.success):
        return table.drop(columns="p")
    low, high = max_t_intervals(_pair_changes(league) * (league.independent_unit_count / len(league.success)), level)
    p = holm_adjust(table.pop("p").to_numpy())
    return table.assign(low=low, high=high, p_holm=p, verdict=_verdicts(table, p, level))


def _pair_places(policies: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers of both policies of each pair."""
    return np.triu_indices(len(policies), 1)


def _pair_changes(league: PairedPolicyOutcomes) -> np.ndarray:
    """Return the successes of the first minus those of the second policy, (units, pairs)."""
    assert league.unit is not None
    sums, _ = sum_by_independent_unit(league.success, league.unit)
    first, second = _pair_places(league.policies)
    return (sums[:, first] - sums[:, second]).astype(int)


def _count_pairs(league: PairedPolicyOutcomes) -> pd.DataFrame:
    """Return the counts of each pair with the p-value of its own test; NaN if the points are no random sample."""
    success = league.success.astype(int)
    first, second = _pair_places(league.policies)
    change = success[:, first] - success[:, second]  # (n, pairs)
    p = np.full(len(first), np.nan)
    if league.unit is not None and len(success):
        p = np.array([sign_flip_p_value(one) for one in _pair_changes(league).T])
    return pd.DataFrame(
        {
            "a": [league.policies[k] for k in first],
            "b": [league.policies[k] for k in second],
            "only_a": (change > 0).sum(axis=0),
            "only_b": (change < 0).sum(axis=0),
            "difference": change.sum(axis=0) / max(len(success), 1),
            "p": p,
        }
    )


def _verdicts(table: pd.DataFrame, p_holm: np.ndarray, level: float) -> list[str]:
    better = np.where(table["difference"] > 0, table["a"], table["b"])
    return [str(one) if p <= 1 - level else NOT_DECIDED for one, p in zip(better, p_holm, strict=True)]


def decided_win_matrix(pairs: pd.DataFrame, policies: Sequence[str]) -> np.ndarray:
    """Return a matrix (policies, policies): True where the policy of the row is decided to beat that of the column.

    Args:
        pairs: Pairs with their verdicts.
        policies: Names of the policies, in the order of the result.
    """
    place = {name: k for k, name in enumerate(policies)}
    better = np.zeros((len(policies), len(policies)), bool)
    for a, b, verdict in zip(pairs["a"], pairs["b"], pairs["verdict"], strict=True):
        if verdict != NOT_DECIDED:
            better[place[verdict], place[b if verdict == a else a]] = True
    return better


def standings(rates: pd.DataFrame, better: np.ndarray) -> pd.DataFrame:
    """Sort policies by success rate, and add the ranks that the verdicts on pairs allow each policy.

    Args:
        rates: Table of `policy_success_rates`.
        better: Which policies are better than which (policies, policies), see `decided_win_matrix`.

    Returns:
        The sorted table with `places`, such as `1 to 2`, and the numbers of policies that it `beats`, and is
        `beaten_by`.
    """
    number = len(rates)
    beaten, beats = better.sum(axis=0), better.sum(axis=1)
    places = [f"{1 + up}" if 1 + up == number - down else f"{1 + up} to {number - down}" for up, down in
              zip(beaten, beats, strict=True)]  # fmt: skip
    table = rates.assign(places=places, beats=beats, beaten_by=beaten)
    return table.sort_values("share", ascending=False, kind="stable").reset_index(drop=True)


def policy_success_rates_by_condition(
    league: PairedPolicyOutcomes, by: Sequence[str], level: float = CONFIDENCE_LEVEL
) -> pd.DataFrame:
    """Compute the success rate of each policy at each condition, and which policies may be the best one there.

    Args:
        league: Outcomes of the policies.
        by: Columns of `league.conditions` whose values are the conditions.
        level: Confidence level of the verdicts at all conditions together.

    Returns:
        A row for each condition: its values, `points`, the rate of each policy, and with units `best`: the policies
        that no other one beats there, the most successful first.
    """
    lines, counts = [], []
    for values, places in league.conditions.groupby(list(by), observed=True).indices.items():
        unit = None if league.unit is None else league.unit[places]
        part = PairedPolicyOutcomes(league.policies, league.success[places], unit, league.conditions.iloc[places], ())
        counts.append(_count_pairs(part))
        rates = dict(zip(league.policies, part.success.mean(axis=0), strict=True))
        named = values if isinstance(values, tuple) else (values,)
        lines.append({**dict(zip(by, named, strict=True)), "points": len(places), **rates})
    table = pd.DataFrame(lines)
    if league.unit is None:
        return table
    every = pd.concat(counts, ignore_index=True)
    every["verdict"] = _verdicts(every, holm_adjust(every["p"].to_numpy()), level)
    best = []
    for number, line in enumerate(lines):
        pairs = every.iloc[number * len(counts[0]) : (number + 1) * len(counts[0])]
        beaten = decided_win_matrix(pairs, league.policies).any(axis=0)
        left = [name for name, lost in zip(league.policies, beaten, strict=True) if not lost]
        best.append(", ".join(sorted(left, key=lambda name, line=line: -line[name])))
    return table.assign(best=best)


@dataclass
class PolicyRace:
    """A sequential comparison of several policies, whose verdicts hold whenever one looks or stops.

    Each pair has the e-process of `sequential.log_e_value` over the units that both policies have. Pairs are decided by
    Holm's procedure on the largest evidence so far. A pair that follows from decided ones (A beats B, B beats C) is
    decided, too, and no longer counts among the hypotheses that remain. With probability `level` no verdict is ever
    wrong, whatever policies are stopped, and whenever.
    """

    number: int  # policies
    level: float = CONFIDENCE_LEVEL
    only: np.ndarray = field(init=False)  # (policies, policies): units in which the first succeeds more often
    evidence: np.ndarray = field(init=False)  # (policies, policies): largest log e-value while the first leads
    better: np.ndarray = field(init=False)  # (policies, policies): the first is decided to be better

    def __post_init__(self) -> None:
        """Start without units."""
        shape = self.number, self.number
        self.only, self.evidence = np.zeros(shape), np.zeros(shape)
        self.better = np.zeros(shape, bool)

    def add_unit_success_rates(self, shares: np.ndarray) -> None:
        """Add the success rates of independent units (groups of dependent rows), and decide pairs of policies.

        Args:
            shares: Success rate of each policy in each unit (u, policies), NaN where it has none.
        """
        for row in shares:
            up = row[:, None] > row[None, :]  # False where one is NaN
            first, second = np.nonzero(up)
            if not len(first):
                continue
            self.only[first, second] += 1
            # evidence grows only for the one that leads, and has just won
            leads = self.only[first, second] > self.only[second, first]
            first, second = first[leads], second[leads]
            now = log_e_value(self.only[first, second], self.only[second, first])
            if (now > self.evidence[first, second]).any():
                self.evidence[first, second] = np.maximum(self.evidence[first, second], now)
                self._decide()

    def _decide(self) -> None:
        while True:
            is_open = ~(self.better | self.better.T)
            np.fill_diagonal(is_open, False)
            remaining = is_open.sum() // 2
            strong = is_open & (self.evidence >= np.log(max(remaining, 1) / (1 - self.level)))
            if not strong.any():
                return
            for winner, loser in zip(*np.nonzero(strong), strict=True):
                if not self.better[loser, winner]:
                    self.better[winner, loser] = True
            for k in range(self.number):  # what follows
                self.better |= np.outer(self.better[:, k], self.better[k])

    def undecided_policies(self, only_best: bool = False) -> np.ndarray:
        """Return which policies (policies,) need more rollouts.

        Args:
            only_best: Whether only the best policy is wanted: a policy that another one beats is then done.
        """
        if only_best:
            left = ~self.better.any(axis=0)
            return left if left.sum() > 1 else np.zeros(self.number, bool)
        is_open = ~(self.better | self.better.T)
        np.fill_diagonal(is_open, False)
        return is_open.any(axis=1)
