"""Coverage by simulation: shares of intervals that contain the true probability."""

import numpy as np
import pytest
from scipy.stats import binom, binomtest

from sweep.analysis.intervals import clopper_pearson, confidence_sequence, wilson

PROBABILITIES = np.array([0.01, 0.05, 0.1, 0.3, 0.5, 0.8, 0.97])


def coverage(interval, n, p):
    """Exact: over all counts, by their probabilities."""
    k = np.arange(n + 1)
    low, high = interval(k, n)
    return binom.pmf(k, n, p)[(low <= p) & (p <= high)].sum()


@pytest.mark.parametrize("n", [1, 5, 16, 64, 400])
def test_the_exact_interval_covers_at_every_probability(n):
    assert min(coverage(clopper_pearson, n, p) for p in PROBABILITIES) >= 0.95


@pytest.mark.parametrize("n", [16, 64, 400])
def test_wilson_covers_on_average_and_is_narrower(n):
    grid = np.linspace(0.005, 0.995, 199)
    assert np.mean([coverage(wilson, n, p) for p in grid]) == pytest.approx(0.95, abs=0.01)
    k = np.arange(n + 1)
    assert np.mean(np.diff(wilson(k, n), axis=0)) < np.mean(np.diff(clopper_pearson(k, n), axis=0))


@pytest.mark.parametrize(("interval", "method"), [(wilson, "wilson"), (clopper_pearson, "exact")])
def test_intervals_are_those_of_scipy(interval, method):
    for k, n in ((0, 7), (3, 7), (7, 7), (150, 400)):
        np.testing.assert_allclose(interval(k, n), binomtest(k, n).proportion_ci(0.95, method), atol=1e-12)


@pytest.fixture(scope="module", params=[confidence_sequence, wilson])
def ends(request):
    """Ends of the intervals for all counts up to 400: (400 trials, 401 counts) each."""
    n, k = np.mgrid[1:401, 0:401]
    return request.param, *request.param(np.minimum(k, n), n)


@pytest.mark.parametrize("p", [0.05, 0.5, 0.9])
def test_the_sequence_covers_however_one_stops_and_wilson_does_not(ends, p):
    interval, low, high = ends
    counts = np.cumsum(np.random.default_rng(0).random((4000, 400)) < p, axis=1)
    at = np.arange(400), counts
    lies = ((p < low[at]) | (p > high[at])).any(axis=1).mean()  # at some time, when it suits to stop
    if interval is confidence_sequence:
        assert lies <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / 4000)
    else:
        assert lies > 0.2


def test_the_sequence_closes_in_on_the_rate():
    low, high = confidence_sequence([0, 50, 500, 10], [0, 100, 1000, 10])
    assert (low[0], high[0], high[3]) == (0, 1, 1)
    assert low[1] < low[2] < 0.5 < high[2] < high[1]
    assert high[2] - low[2] < 0.13
