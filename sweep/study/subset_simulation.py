"""Subset simulation of rare failures, by adaptive conditional sampling along a metric that leads to failure.

A level holds the rows whose `lead` is at most that of the best share of the level before, and all failed rows. Markov
chains continue from these rows in the standard-normal space of the draws; a proposal is accepted where it stays within
the level (Au and Beck 2001; Papaioannou et al. 2015). The failure probability is the product of the levels' shares.
Independent runs give its error.
"""

from collections.abc import Generator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from sweep.study.adaptive_sampling import PROPOSAL_DECIMALS, RoundDraws, RoundSummary, SearchGenerator

TARGET_ACCEPTANCE = 0.44  # share of proposals that is aimed at
INITIAL_PROPOSAL_WIDTH = 0.6  # of the first proposals, in standard deviations
MIN_PROPOSAL_WIDTH = 0.05
MAX_PLATEAU_FACTOR = 2.0  # a level may have so many times the rows that it is to have, if they have one lead
MIN_SEEDS = 10  # rows below it that chains are then begun from instead


class LevelRows(NamedTuple):
    """Rows of one level in a run of subset simulation; a rejected proposal repeats the previous row."""

    points: Float[np.ndarray, "n d"]
    draw_numbers: Int[np.ndarray, " n"]  # of their draws
    failed: Bool[np.ndarray, " n"]
    lead: Float[np.ndarray, " n"]  # -inf where failed

    def select_rows(self, which: np.ndarray) -> "LevelRows":
        """Return the rows at some indices or where a mask holds."""
        return LevelRows(*(part[which] for part in self))

    def merge_rows_by_mask(self, which: np.ndarray, others: "LevelRows") -> "LevelRows":
        """Return these rows where the mask `which` (n,) holds, and `others` elsewhere."""
        u = np.where(which[:, None], self.points, others.points)
        return LevelRows(u, *(np.where(which, a, b) for a, b in zip(self[1:], others[1:], strict=True)))


class SubsetRunResult(NamedTuple):
    """Result of one run of subset simulation."""

    probability: float
    last_level: LevelRows  # the last
    lead_bounds: tuple[float, ...]  # of the lead, level by level
    acceptance_rates: tuple[float, ...]  # share of proposals, level by level
    rollouts: int
    end_reason: str  # it ended before it came to where all fail; empty where it did not


@dataclass(frozen=True)
class LevelSettings:
    """Settings of the levels in a run of subset simulation."""

    num: int  # rows of a level
    share: float  # of them that the next level begins with
    target: float  # probability below which a run is given up

    @property
    def chain_count(self) -> int:
        """Number of Markov chains of a level."""
        return round(self.num * self.share)

    @property
    def steps_per_chain(self) -> int:
        """Number of steps of a chain after its first row."""
        return round(1 / self.share) - 1

    @property
    def max_levels(self) -> int:
        """Largest number of levels of a run."""
        return int(np.ceil(np.log(self.target) / np.log(self.share) - 1e-9)) + 2

    @property
    def max_rollouts(self) -> int:
        """Largest number of rollouts of a run."""
        return self.num + (self.max_levels - 1) * self.chain_count * self.steps_per_chain


def start_search(d: int, settings: LevelSettings, runs: int, seed: int) -> SearchGenerator:
    """Start independent runs of subset simulation: a generator that yields rounds of draws and receives their outcomes.

    Each round holds one step of all runs. The draws of a run do not depend on the number of runs.

    Args:
        d: Number of drawn axes.
        settings: Settings of the levels.
        runs: Number of runs.
        seed: Seed of the draws.

    Returns:
        The search; its result is a list of `SubsetRunResult`, one for each run.
    """
    going = {number: _run(d, settings, seed, number) for number in range(runs)}
    asked, ended = {number: next(run) for number, run in going.items()}, {}
    while asked:
        sizes = [len(draws.numbers) for draws in asked.values()]
        found = yield _together(list(asked.values()))
        ends, answers = np.cumsum(sizes), {}
        for (number, _), end, size in zip(asked.items(), ends, sizes, strict=True):
            try:
                answers[number] = going[number].send(found.select_draws(slice(end - size, end)))
            except StopIteration as stop:
                ended[number] = stop.value
        asked = answers
    return [ended[number] for number in range(runs)]


def _together(parts: list[RoundDraws]) -> RoundDraws:
    """Join the draws of several runs into one round."""
    columns = {name: np.concatenate([part.columns[name] for part in parts]) for name in parts[0].columns}
    quantiles = np.concatenate([part.quantiles for part in parts])
    numbers = np.concatenate([part.numbers for part in parts])
    return RoundDraws(quantiles, numbers, columns)


def _run(d: int, settings: LevelSettings, seed: int, run: int) -> Generator[RoundDraws, RoundSummary, SubsetRunResult]:
    """Run subset simulation once. Its draws are numbered from `run * settings.max_rollouts` on."""
    rng = np.random.default_rng([seed, run])
    rollouts, width, p, bounds, accepted = 0, INITIAL_PROPOSAL_WIDTH, 1.0, [], []

    def draws(u: np.ndarray, level: int, step: int) -> RoundDraws:
        from scipy.special import ndtr  # slow to import

        n = len(u)
        columns = {"run": np.full(n, run), "level": np.full(n, level), "step": np.full(n, step), "chain": np.arange(n)}
        numbers = run * settings.max_rollouts + rollouts + np.arange(n)
        return RoundDraws(ndtr(u), numbers, {name: values.astype(float) for name, values in columns.items()})

    u = np.round(rng.standard_normal((settings.num, d)), PROPOSAL_DECIMALS)
    asked = draws(u, 0, 0)
    level = _level(u, asked, (yield asked))
    rollouts += settings.num
    for number in range(1, settings.max_levels + 1):
        inside, bound = choose_next_level(level.lead, settings)
        why = _explain_end(inside, bound, settings, p, number)
        if why is not None:
            return SubsetRunResult(p * float(level.failed.mean()), level, tuple(bounds), tuple(accepted), rollouts, why)
        p *= float(inside.mean())
        bounds.append(bound)
        seeds = rng.permutation(np.flatnonzero(inside))
        here = level.select_rows(np.resize(seeds, settings.chain_count))
        states, taken = [here], []
        for step in range(1, settings.steps_per_chain + 1):
            apart = rng.standard_normal(here.points.shape)
            u = np.round(np.sqrt(1 - width**2) * here.points + width * apart, PROPOSAL_DECIMALS)
            asked = draws(u, number, step)
            there = _level(u, asked, (yield asked))
            rollouts += len(u)
            stays = there.lead <= bound
            here = there.merge_rows_by_mask(stays, here)
            states.append(here)
            taken.append(float(stays.mean()))
            width *= np.exp((taken[-1] - TARGET_ACCEPTANCE) / np.sqrt(step))
            width = round(float(np.clip(width, MIN_PROPOSAL_WIDTH, 1.0)), PROPOSAL_DECIMALS)
        accepted.append(float(np.mean(taken)))
        level = LevelRows(*(np.concatenate(parts) for parts in zip(*states, strict=True)))
    raise AssertionError("a run has no more levels than `_over` allows")


def _level(u: np.ndarray, draws: RoundDraws, summary: RoundSummary) -> LevelRows:
    """Make the rows of a level. A lead of NaN counts as infinite, so it never leads to failure."""
    lead = np.where(summary.failed, -np.inf, np.nan_to_num(summary.lead, nan=np.inf, neginf=np.finfo(float).min))
    return LevelRows(u, draws.numbers, summary.failed, lead)


def _explain_end(
    inside: Bool[np.ndarray, " n"], bound: float, settings: LevelSettings, p: float, number: int
) -> str | None:
    """Explain why a run ends after this level: empty where it reached failure, None where it continues."""
    if bound == -np.inf:  # all that is in the next level has failed
        return ""
    if p * settings.share < settings.target or number >= settings.max_levels:
        return f"fewer than {settings.share:g} of the rows fail down to {settings.target:g}"
    return f"the lead is {bound:.4g} in all rows of a level: it leads nowhere" if inside.all() else None


def choose_next_level(lead: Float[np.ndarray, " n"], settings: LevelSettings) -> tuple[Bool[np.ndarray, " n"], float]:
    """Choose the rows that begin the next level: those nearest to failure, with the smallest values of `lead`.

    Args:
        lead: Leads of the rows of this level, (n,).
        settings: Settings of the levels; `settings.chain_count` rows are wanted.

    Returns:
        Which rows are in the next level (n,), and its largest lead. Where many rows tie at that bound, only rows below
        it
        are chosen, and several chains start from the same row.
    """
    bound = float(np.sort(lead)[settings.chain_count - 1])
    inside, below = lead <= bound, lead < bound
    if inside.sum() <= MAX_PLATEAU_FACTOR * settings.chain_count or below.sum() < MIN_SEEDS:
        return inside, bound
    return below, float(lead[below].max())
