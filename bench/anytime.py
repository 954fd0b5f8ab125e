"""What a comparison that stops by itself saves and costs, on simulated pairs: `python bench/anytime.py`.

The two arms succeed with stated probabilities and a stated correlation, as common draws bring about. Beside the
e-process of `sweep compare --anytime`: McNemar's exact test looked at after every ten pairs (which is wrong), and the
size of a test that is looked at once.
"""

import numpy as np
from scipy.stats import binom

from sweep.analysis.sequential import fixed_size, log_evidence

ALPHA, REPETITIONS, MOST = 0.05, 2000, 4000
SETTINGS = ((0.9, 0.8, 0.5), (0.9, 0.85, 0.5), (0.99, 0.95, 0.2), (0.7, 0.5, 0.3), (0.95, 0.9, 0.0))
EQUAL = ((0.85, 0.85, 0.5), (0.5, 0.5, 0.2), (0.97, 0.97, 0.0))


def flips(a: float, b: float, correlation: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Discordant pairs (repetitions, pairs) of either direction after each pair."""
    both = a * b + correlation * np.sqrt(a * (1 - a) * b * (1 - b))
    kind = np.digitize(rng.random((REPETITIONS, MOST)), np.cumsum([both, a - both, b - both]))
    return np.cumsum(kind == 1, axis=1), np.cumsum(kind == 2, axis=1)


def main() -> None:
    """Two tables in Markdown."""
    rng = np.random.default_rng(0)
    print("| both succeed | correlation | e-process finds a difference | repeated McNemar does |\n|--:|--:|--:|--:|")
    for a, b, correlation in EQUAL:
        lost, gained = flips(a, b, correlation, rng)
        wrong = (log_evidence(lost, gained) >= -np.log(ALPHA)).any(axis=1).mean()
        b_, c_ = lost[:, 9::10], gained[:, 9::10]
        p = 2 * binom.cdf(np.minimum(b_, c_), b_ + c_, 0.5)
        print(f"| {a} | {correlation} | {100 * wrong:.1f} % | {100 * (p <= ALPHA).any(axis=1).mean():.0f} % |")
    print(
        "\n| A | B | correlation | looked at once | mean | median | 95 of 100 within |\n|--:|--:|--:|--:|--:|--:|--:|"
    )
    for a, b, correlation in SETTINGS:
        lost, gained = flips(a, b, correlation, rng)
        over = log_evidence(lost, gained) >= -np.log(ALPHA)
        pairs = np.where(over.any(axis=1), over.argmax(axis=1) + 1, MOST)
        once = fixed_size(a - (both := a * b + correlation * np.sqrt(a * (1 - a) * b * (1 - b))), b - both)
        found = (pairs.mean(), np.median(pairs), np.percentile(pairs, 95))
        print(f"| {a} | {b} | {correlation} | {once:.0f} | " + " | ".join(f"{v:.0f}" for v in found) + " |")


if __name__ == "__main__":
    main()
