"""How many rollouts a study needs: widths of intervals and power of tests, exact or simulated.

The exact functions sum over the binomial law of the counts. The simulated ones draw the independent units of a pilot
study again, so that rows of a unit stay together, and apply the interval or the test that `sweep stats` and
`sweep compare` apply.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sweep.analysis.certify import most_failures_that_certify
from sweep.analysis.compare import sign_flip_p_value
from sweep.analysis.intervals import (
    CONFIDENCE_LEVEL,
    MIN_UNITS_FOR_VARIANCE,
    Interval,
    korn_graubard,
    wilson,
)
from sweep.analysis.sampling_units import has_random_draws, independent_unit
from sweep.analysis.sequential import TEST_POWER, log_e_value
from sweep.analysis.stats import format_percent, sum_by_independent_unit
from sweep.core.errors import InputError
from sweep.study.designs import drawn_axis_names
from sweep.study.study import Study

MAX_REQUIRED_ROLLOUTS = 10**10  # a study that needs more is not planned
TAIL = 1e-12  # probability of counts that are left out at either end of a binomial law
CHECKED_SIZES = 32  # sizes beyond the answer that have to meet the goal, too: the power of exact tests is a saw
MAX_EXACT = 50_000  # rollouts of two independent policies; above, the normal law takes the place of the binomial one
REPETITIONS = 1000  # simulated studies
DRY_RUN_RATES = (0.5, 0.9, 0.99)  # success rates for which `sweep run --dry-run` prints an expected half-width

IntervalFunction = Callable[[ArrayLike, ArrayLike, float], Interval]


class SuccessCountDistribution(NamedTuple):
    """Possible numbers of successes with their probabilities, without extremely improbable numbers."""

    counts: np.ndarray  # (k,), consecutive whole numbers
    probability: np.ndarray  # (k,)


def truncated_binomial_distribution(trials: int, probability: float) -> SuccessCountDistribution:
    """Return the binomial distribution of the number of successes, without its outermost tails.

    Args:
        trials: Number of trials.
        probability: Probability of a success.
    """
    from scipy.stats import binom

    low, high = (int(binom.ppf(q, trials, probability)) for q in (TAIL, 1 - TAIL))
    counts = np.arange(max(low, 0), min(high, trials) + 1)
    return SuccessCountDistribution(counts, binom.pmf(counts, trials, probability))


def find_smallest_sample_size(meets_goal: Callable[[int], bool], start: int = 1, checked: int = CHECKED_SIZES) -> int:
    """Find the smallest size of a study that meets a goal and above which every size meets it.

    The search doubles and bisects. It then passes over sizes whose successors miss the goal again.

    Args:
        meets_goal: Function of a size; false for small sizes, true for large ones, possibly alternating in between.
        start: Smallest size to try.
        checked: Number of successors that have to meet the goal, too.

    Raises:
        InputError: Not even `MAX_REQUIRED_ROLLOUTS` meet the goal.
    """
    high = max(start, 1)
    while not meets_goal(high):
        high *= 2
        if high > MAX_REQUIRED_ROLLOUTS:
            raise InputError(
                f"more than {MAX_REQUIRED_ROLLOUTS:.0e} rollouts are needed: choose a goal that is easier to meet"
            )
    low = max(high // 2, start - 1)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if meets_goal(middle) else (middle, high)
    size, passed = high, 0
    while passed < checked:
        passed += 1
        if not meets_goal(size + passed):
            size, passed = size + passed + 1, 0
    return size


def half_width_distribution(
    trials: int, rate: float, interval: IntervalFunction, level: float = CONFIDENCE_LEVEL
) -> tuple[np.ndarray, np.ndarray]:
    """Return the possible half-widths of the confidence interval of a success rate, with their probabilities.

    Args:
        trials: Number of independent rollouts.
        rate: True success rate.
        interval: Function of successes, trials and level to the interval.
        level: Confidence level.

    Returns:
        Half-widths (k,) and probabilities (k,) of the possible numbers of successes, without those in the tails.
    """
    counts, probability = truncated_binomial_distribution(trials, rate)
    low, high = interval(counts, np.full(len(counts), trials), level)
    return (high - low) / 2, probability


def expected_half_width(
    trials: int, rate: float, interval: IntervalFunction = wilson, level: float = CONFIDENCE_LEVEL
) -> float:
    """Return the mean half-width of the confidence interval of a success rate.

    Args:
        trials: Number of independent rollouts.
        rate: True success rate.
        interval: Function of successes, trials and level to the interval.
        level: Confidence level.
    """
    widths, probability = half_width_distribution(trials, rate, interval, level)
    return float(np.average(widths, weights=probability))


def rollouts_for_half_width(
    rate: float,
    half_width: float,
    power: float = TEST_POWER,
    interval: IntervalFunction = wilson,
    level: float = CONFIDENCE_LEVEL,
) -> int:
    """Return how many independent rollouts narrow the interval of a success rate enough with a given probability.

    Args:
        rate: True success rate.
        half_width: Largest half-width of the interval.
        power: Probability that the interval is at most that wide.
        interval: Function of successes, trials and level to the interval.
        level: Confidence level.
    """

    def meets_goal(trials: int) -> bool:
        widths, probability = half_width_distribution(trials, rate, interval, level)
        return bool(probability[widths <= half_width].sum() >= power)

    return find_smallest_sample_size(meets_goal)


def discordant_pair_shares(a: float, b: float, correlation: float) -> tuple[float, float]:
    """Return the shares of pairs of rollouts in which only policy A, and only policy B, succeeds.

    Args:
        a: Success rate of A.
        b: Success rate of B.
        correlation: Correlation of the two outcomes of a pair, 0 if they are independent.

    Raises:
        InputError: No joint law of outcomes has this correlation.
    """
    spread = float(np.sqrt(a * (1 - a) * b * (1 - b)))
    both = a * b + correlation * spread
    low, high = max(0.0, a + b - 1), min(a, b)
    if not low - 1e-12 <= both <= high + 1e-12:
        least, most = ((end - a * b) / spread for end in (low, high))
        raise InputError(
            f"--correlation = {correlation:g} is not allowed for rates {a:g} and {b:g}: {least:.3g} to {most:.3g}"
        )
    both = float(np.clip(both, low, high))
    return a - both, b - both


def mcnemar_power(pairs: int, lost: float, gained: float, level: float = CONFIDENCE_LEVEL) -> float:
    """Return the power of McNemar's exact two-sided test of equal success rates, for paired rollouts.

    Args:
        pairs: Number of independent pairs.
        lost: Share of pairs that succeed only in A.
        gained: Share of pairs that succeed only in B.
        level: Confidence level.
    """
    from scipy.stats import binom

    flips, probability = truncated_binomial_distribution(pairs, lost + gained)
    most = binom.ppf((1 - level) / 2, flips, 0.5)  # of the rarer direction: none at -1
    most = np.where(2 * binom.cdf(most, flips, 0.5) <= 1 - level, most, most - 1)
    share = lost / (lost + gained) if lost + gained else 0.5
    rejected = binom.cdf(most, flips, share) + binom.cdf(most, flips, 1 - share)
    return float((probability * rejected).sum())


def unpaired_test_power(rollouts: int, a: float, b: float, level: float = CONFIDENCE_LEVEL) -> float:
    """Return the power of the two-sided score test of equal success rates, for independent rollouts of A and B.

    The test compares the difference of the rates with its standard error at the pooled rate.

    Args:
        rollouts: Number of rollouts of each.
        a: Success rate of A.
        b: Success rate of B.
        level: Confidence level.
    """
    from scipy.special import ndtr, ndtri

    if rollouts > MAX_EXACT:
        own = np.sqrt((a * (1 - a) + b * (1 - b)) / rollouts)
        null = np.sqrt((a + b) * (1 - (a + b) / 2) / rollouts)
        return float(ndtr((abs(a - b) - ndtri(0.5 + level / 2) * null) / own))
    (first, p), (second, q) = truncated_binomial_distribution(rollouts, a), truncated_binomial_distribution(rollouts, b)
    pooled = (first[:, None] + second) / (2 * rollouts)
    error = np.sqrt(2 * pooled * (1 - pooled) / rollouts)
    rejected = np.abs(first[:, None] - second) / rollouts > ndtri(0.5 + level / 2) * error
    return float(p @ rejected @ q)


def pairs_until_decision(
    lost: float, gained: float, level: float = CONFIDENCE_LEVEL, repetitions: int = REPETITIONS
) -> tuple[float, float]:
    """Simulate how many pairs of rollouts the sequential test `sweep compare --anytime` needs until it decides.

    Args:
        lost: Share of pairs that succeed only in A.
        gained: Share of pairs that succeed only in B.
        level: Confidence level.
        repetitions: Number of simulated comparisons.

    Returns:
        The median number of pairs, and the number that suffices in nine of ten comparisons.
    """
    flips = lost + gained
    theta = lost / flips
    rate = theta * np.log(2 * theta or 1) + (1 - theta) * np.log(2 * (1 - theta) or 1)  # growth of log E in a flip
    most = int(20 * (-np.log(1 - level) + 5) / rate) + 50
    rng = np.random.default_rng(0)
    needed = np.empty(repetitions)
    for k in range(repetitions):
        first = np.cumsum(rng.random(most) < theta)
        log_e = log_e_value(first, np.arange(1, most + 1) - first)
        decisive = int((log_e >= -np.log(1 - level)).argmax()) + 1
        needed[k] = decisive + rng.negative_binomial(decisive, flips)  # pairs that do not flip come in between
    return float(np.median(needed)), float(np.quantile(needed, TEST_POWER))


def certification_power(draws: int, share: float, rate: float, failures: float, confidence: float) -> float:
    """Return the probability that fresh draws certify that the failure probability of a region is low enough.

    Args:
        draws: Number of fresh draws.
        share: Share of the draws that fall into the region.
        rate: True failure probability within the region.
        failures: Failure probability to certify.
        confidence: Confidence of the guarantee.
    """
    from scipy.stats import binom

    inside, probability = truncated_binomial_distribution(draws, share)
    allowed = most_failures_that_certify(inside, failures, confidence)
    return float((probability * np.where(allowed < 0, 0.0, binom.cdf(allowed, inside, rate))).sum())


class UnitSuccessCounts(NamedTuple):
    """Successes and rollouts of each independent unit (group of dependent rows) of a small first study."""

    won: np.ndarray  # (u,)
    trials: np.ndarray  # (u,)
    is_even: bool  # whether the design spreads the draws of a unit evenly


def count_unit_successes(success: np.ndarray, unit: np.ndarray, is_even: bool) -> UnitSuccessCounts:
    """Count the successes and the rows of each independent unit (group of dependent rows).

    Args:
        success: Whether each valid row succeeded (n,).
        unit: Its independent unit (n,), see `sampling_units.unit_numbers`.
        is_even: Whether the design spreads the draws of a unit evenly.
    """
    return UnitSuccessCounts(*sum_by_independent_unit(success, unit), is_even)


def simulated_half_widths(
    pilot: UnitSuccessCounts, units: int, level: float = CONFIDENCE_LEVEL, repetitions: int = REPETITIONS
) -> np.ndarray:
    """Simulate half-widths of the interval of a success rate by resampling the units of a small pilot study.

    Each simulated study draws its units from the pilot's with replacement. Its interval is that of `sweep stats`:
    Student's t over units that are spread evenly, Korn and Graubard's over units of several rows, else Wilson's.

    Args:
        pilot: Units of the pilot study (u).
        units: Number of units of the planned study.
        level: Confidence level.
        repetitions: Number of simulated studies.

    Returns:
        Half-widths (repetitions,).
    """
    from scipy.stats import t

    rng, number = np.random.default_rng(0), len(pilot.won)
    times = rng.multinomial(units, np.full(number, 1 / number), repetitions)  # (repetitions, u)
    won, trials = times @ pilot.won, times @ pilot.trials
    share = won / trials
    if pilot.is_even:
        own = pilot.won / pilot.trials
        spread = np.sqrt(np.maximum(times @ own**2 - units * (times @ own / units) ** 2, 0) / max(units - 1, 1))
        return t.ppf(0.5 + level / 2, max(units - 1, 1)) * spread / np.sqrt(units)
    if pilot.trials.max() == 1:
        low, high = wilson(won, trials, level)
        return (high - low) / 2
    # the sum over units of (k - p n)^2, multiplied out
    sums = [times @ one for one in (pilot.won**2, pilot.won * pilot.trials, pilot.trials**2)]
    squared = np.maximum(sums[0] - 2 * share * sums[1] + share**2 * sums[2], 0)
    rare = np.minimum(times @ (pilot.won > 0), times @ (pilot.won < pilot.trials))
    low, high = korn_graubard(won, trials, squared, np.full(repetitions, units), rare, level)
    return (high - low) / 2


def units_for_half_width(
    pilot: UnitSuccessCounts, half_width: float, power: float = TEST_POWER, level: float = CONFIDENCE_LEVEL
) -> int:
    """Return how many independent units narrow a success rate's interval enough in a share `power` of simulations.

    Args:
        pilot: Units of the pilot study (u).
        half_width: Largest half-width of the interval.
        power: Probability that the interval is at most that wide.
        level: Confidence level.

    Raises:
        InputError: The pilot has too few units, or all of them end alike.
    """
    share = pilot.won / pilot.trials
    if len(share) < MIN_UNITS_FOR_VARIANCE or not np.ptp(share) > 0:
        raise InputError(
            f"--pilot has {len(share)} independent units: at least {MIN_UNITS_FOR_VARIANCE} that do not all end alike"
        )
    start = MIN_UNITS_FOR_VARIANCE
    return find_smallest_sample_size(
        lambda units: bool(np.mean(simulated_half_widths(pilot, units, level) <= half_width) >= power), start, checked=0
    )


def simulated_sign_flip_power(
    differences: np.ndarray, units: int, level: float = CONFIDENCE_LEVEL, repetitions: int = REPETITIONS
) -> float:
    """Simulate the power of the paired test of `sweep compare` by resampling the units of a small pilot comparison.

    Args:
        differences: Successes of A minus successes of B in each unit of the pilot (u,), whole numbers.
        units: Number of units of the planned comparison.
        level: Confidence level.
        repetitions: Number of simulated comparisons.
    """
    rng = np.random.default_rng(0)
    drawn = rng.choice(differences, (repetitions, units))
    if np.abs(differences).max() <= 1:  # McNemar's test
        from scipy.stats import binom

        lost, gained = (drawn > 0).sum(axis=1), (drawn < 0).sum(axis=1)
        return float(np.mean(2 * binom.cdf(np.minimum(lost, gained), lost + gained, 0.5) <= 1 - level))
    return float(np.mean([sign_flip_p_value(one) <= 1 - level for one in drawn]))


def describe_expected_half_width(study: Study) -> str:
    """Describe how wide the intervals of a study's success rates will be, before it runs; empty without intervals.

    The rate is unknown, so that a few rates are listed. Where rows depend on each other by an unknown amount, the text
    gives both extremes.
    """
    unit = independent_unit(study)
    if unit.name == "none" or study.is_sequential or (has_random_draws(study) and not study.design.gives_rate):
        return ""
    is_drawn = has_random_draws(study)
    draws = study.design.count_draws(len(drawn_axis_names(study.axes))) if is_drawn else study.replicates
    rows = draws * study.replicates if is_drawn else draws
    texts = []
    for rate in DRY_RUN_RATES:
        wide = f"±{format_percent(expected_half_width(draws, rate))}"
        if rows > draws:
            wide += f" to ±{format_percent(expected_half_width(rows, rate))}"
        texts.append(f"{wide} at a rate of {100 * rate:g} %")
    note = ""
    if rows > draws:
        note = "; the wider one if the replicates of a draw end alike, the narrower one if they are independent"
    elif unit.is_even:
        note = "; less if success depends smoothly on the axes, over which this design spreads its draws evenly"
    where = " of each condition" if any(not axis.distribution for axis in study.axes) else ""
    return f"expected 95 % interval{where}, {draws:,} {'draws' if is_drawn else unit.plural}: {', '.join(texts)}{note}"
