"""Importance sampling of failures: each round draws from a mixture of normals fitted to earlier failures.

Every drawn axis is the quantile of a standard normal number u, so nominal draws have the density phi(u). The first
round draws normals that are `wide` times as wide. Each later round draws from a mixture: normals fitted to all failures
so far, wide normals, and nominal ones, so that no weight phi / q exceeds 1 / `PLAIN_SHARE`. The fit treats all rounds
as one sample from the mean of their densities (the balance heuristic), whose weights are less uneven than those of
single rounds. A round's proposal depends on earlier rounds only, so the mean of weight times failure over the round is
an unbiased estimate of the failure probability.
"""

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from sweep.study.adaptive_sampling import PROPOSAL_DECIMALS, RoundDraws, SearchGenerator

FITTED_SHARE, WIDE_SHARE, PLAIN_SHARE = 0.7, 0.15, 0.15  # shares of a round's draws
MAX_COMPONENTS = 3  # normals that are fitted, at most
ROWS_PER_COMPONENT_AXIS = 5  # effective failures that a part needs for each axis
PRIOR_ROWS_PER_AXIS = (
    3  # effective rows for each axis, of a unit normal, that each part's covariance has beside its own
)
WEIGHT_EXPONENTS = (
    1.0,
    0.5,
    0.25,
)  # powers of the weights: the fit takes the first that leaves it enough failures, or none
EM_STEPS = 50  # of expectation and maximisation
DENSITY_DIP = (
    0.5  # of the density at the lower of two middles: parts between which it falls below that are modes of their own
)


class Mixture(NamedTuple):
    """A mixture of k normal distributions in d dimensions."""

    weights: Float[np.ndarray, " k"]
    means: Float[np.ndarray, "k d"]
    covariance_root: Float[np.ndarray, "k d d"]  # lower, root root' being the covariance

    def log_density(self, u: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n k"]:
        """Return the log of weight times density of each mixture component at points `u` (n, d)."""
        away = np.stack([np.linalg.solve(r, (u - m).T) for m, r in zip(self.means, self.covariance_root, strict=True)])
        size = np.log(np.diagonal(self.covariance_root, axis1=1, axis2=2)).sum(axis=1)
        return (np.log(self.weights) - size)[None] - 0.5 * ((away**2).sum(axis=1).T + u.shape[1] * np.log(2 * np.pi))

    def draw(self, num: int, rng: np.random.Generator) -> Float[np.ndarray, "n d"]:
        """Draw points from the mixture, with a stratified number of points from each component.

        Args:
            num: Number of points, n.
            rng: Random generator.

        Returns:
            Points (n, d).
        """
        part = np.searchsorted(np.cumsum(self.weights)[:-1], (np.arange(num) + rng.random()) / num)
        normal = rng.standard_normal((num, self.means.shape[1]))
        return self.means[part] + np.einsum("nij,nj->ni", self.covariance_root[part], normal)


def isotropic_normal(d: int, width: float, share: float = 1.0) -> Mixture:
    """Make a mixture of a single isotropic normal distribution about zero, with standard deviation `width`.

    Args:
        d: Number of dimensions.
        width: Standard deviation.
        share: Share of the component.
    """
    return Mixture(np.array([share]), np.zeros((1, d)), width * np.eye(d)[None])


def start_search(d: int, num: int, wide: float, rounds: int, seed: int) -> SearchGenerator:
    """Start importance sampling: a generator that yields rounds of draws and receives their outcomes.

    Args:
        d: Number of drawn axes.
        num: Draws of a round.
        wide: Standard deviation of the first round, in standard deviations of the axes.
        rounds: Number of rounds after the first.
        seed: Seed of the draws.

    Returns:
        The search; its result is None.
    """
    from scipy.special import ndtr  # slow to import

    mixtures, normals, failures = [isotropic_normal(d, wide)], [], []
    for number in range(rounds + 1):
        normals.append(u := mixtures[-1].draw(num, np.random.default_rng([seed, number])))
        columns = {"weight": importance_weights(u, mixtures[-1:]), "round": np.full(num, float(number))}
        shown = yield RoundDraws(ndtr(u), number * num + np.arange(num), columns)
        if number < rounds:
            failures.append(shown.failed)
            mixtures.append(fit_next_proposal(np.concatenate(normals)[np.concatenate(failures)], mixtures, wide))


def importance_weights(u: Float[np.ndarray, "n d"], rounds: Sequence[Mixture]) -> Float[np.ndarray, " n"]:
    """Return the importance weights of points `u`: nominal density over the mean density of all rounds' proposals.

    Args:
        u: Draws as standard-normal numbers, (n, d).
        rounds: Proposals of the rounds, which have equally many draws.

    Returns:
        Weights (n,).
    """
    from scipy.special import logsumexp  # slow to import

    logs = [logsumexp(mixture.log_density(u), axis=1) for mixture in rounds]
    plain = isotropic_normal(u.shape[1], 1.0).log_density(u)[:, 0]
    return np.exp(plain + np.log(len(rounds)) - logsumexp(logs, axis=0))


def fit_next_proposal(u: Float[np.ndarray, "n d"], rounds: Sequence[Mixture], wide: float) -> Mixture:
    """Fit the next round's proposal distribution to the failures of earlier rounds.

    Args:
        u: All failures so far as standard-normal numbers, (n, d).
        rounds: Proposals of earlier rounds.
        wide: Standard deviation of the wide component of the proposal.

    Returns:
        The proposal.
    """
    d = u.shape[1]
    parts = [
        isotropic_normal(d, wide, WIDE_SHARE if len(u) else 1 - PLAIN_SHARE),
        isotropic_normal(d, 1.0, PLAIN_SHARE),
    ]
    if len(u):
        found = fit_mixture(u, importance_weights(u, rounds))
        parts = [found._replace(weights=FITTED_SHARE * found.weights), *parts]
    return Mixture(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def effective_sample_size(weights: Float[np.ndarray, " n"]) -> float:
    """Return the effective sample size (Kish) of weights whose sum is 1: equal weights of so many are as accurate."""
    return float(1 / np.sum(weights**2))


def fit_mixture(u: Float[np.ndarray, "n d"], weight: Float[np.ndarray, " n"]) -> Mixture:
    """Fit up to `MAX_COMPONENTS` normals to weighted points, by expectation maximization.

    The fit starts at the heaviest point and those farthest from it. Each covariance has a prior of
    `PRIOR_ROWS_PER_AXIS` effective rows per axis of a unit normal about its mean, because in most directions failures
    are distributed like nominal draws. If the weights leave too few effective points, less uneven ones are used.

    Args:
        u: Points (n, d).
        weight: Weights (n,), unnormalized.

    Returns:
        The mixture, rounded so that machines with other last bits draw alike.
    """
    d = u.shape[1]
    powers = (weight**power / np.sum(weight**power) for power in WEIGHT_EXPONENTS)
    w = next((w for w in powers if np.sum(w**2) * ROWS_PER_COMPONENT_AXIS * d <= 1), np.full(len(u), 1 / len(u)))
    effective = effective_sample_size(w)
    w = effective * w
    count, prior = int(np.clip(effective // (ROWS_PER_COMPONENT_AXIS * d), 1, MAX_COMPONENTS)), PRIOR_ROWS_PER_AXIS * d
    chosen = [int(np.argmax(w))]
    while len(chosen) < count:
        away = np.min([((u - u[k]) ** 2).sum(axis=1) for k in chosen], axis=0)
        chosen.append(int(np.argmax(away * w)))
    found = Mixture(np.full(count, 1 / count), u[chosen], np.broadcast_to(np.eye(d), (count, d, d)))
    for _ in range(EM_STEPS if count > 1 else 1):
        logs = found.log_density(u)
        belongs = w[:, None] * np.exp(logs - np.logaddexp.reduce(logs, axis=1, keepdims=True))
        size = belongs.sum(axis=0)
        mean = belongs.T @ u / np.maximum(size, 1e-9)[:, None]
        apart = u[:, None] - mean
        spread = np.einsum("nk,nki,nkj->kij", belongs, apart, apart) + prior * np.eye(d)
        root = np.linalg.cholesky(spread / (size + prior)[:, None, None])
        found = Mixture(np.maximum(size, 1e-9) / np.maximum(size, 1e-9).sum(), mean, root)
    return Mixture(
        found.weights, np.round(found.means, PROPOSAL_DECIMALS), np.round(found.covariance_root, PROPOSAL_DECIMALS)
    )


def assign_components_to_modes(mixture: Mixture) -> Int[np.ndarray, " k"]:
    """Return the failure mode of each mixture component; two share a mode if the density has no dip between them.

    Args:
        mixture: A mixture of k normals.

    Returns:
        Number of the mode of each component, (k,).
    """
    number, way = np.arange(len(mixture.weights)), np.linspace(0, 1, 21)[:, None]
    for a, b in combinations(range(len(number)), 2):
        density = np.logaddexp.reduce(
            mixture.log_density(mixture.means[a] + way * (mixture.means[b] - mixture.means[a])), axis=1
        )
        if density.min() >= min(density[0], density[-1]) + np.log(DENSITY_DIP):
            number[number == number[b]] = number[a]
    return number
