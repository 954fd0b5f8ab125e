"""A probability of rare failures from plain draws of larger errors: near laws whose answer is known."""

import numpy as np
import pytest
from rare import extrapolated
from scipy.optimize import brentq
from scipy.stats import chi2, norm

LAWS = {
    "plane": lambda s: norm.cdf(-3 / s),
    "corner": lambda s: norm.cdf(-2 / s) ** 2,
    "ring": lambda s: chi2.sf((5 / s) ** 2, 8),
}
TARGETS, OF, REPEATS = (1e-2, 1e-3, 1e-4), np.array([20_000, 200_000, 700_000]), 200


def scale(law, p):
    """At which so much fails."""
    return brentq(lambda s: np.log(law(s) / p), 0.3, 10)


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_it_tells_laws_whose_answer_is_known_and_its_intervals_hold(law):
    scales, at = np.array([scale(law, p) for p in TARGETS]), scale(law, 1e-6)
    told, *_ = extrapolated(scales, OF * law(scales), OF, at)
    assert told == pytest.approx(1e-6, rel=0.1)  # the law itself is off by a few percent
    counts = np.random.default_rng(1).binomial(OF, law(scales), (REPEATS, len(OF)))
    ends = np.array([extrapolated(scales, failed, OF, at)[1:] for failed in counts])
    assert 0.91 <= np.mean((ends[:, 0] < 1e-6) & (ends[:, 1] > 1e-6)) <= 0.985
