"""Plans and their tracking are as they are recorded; those meant to change are recorded anew by `tests/recorded.py`."""

import numpy as np
import pytest
from recorded import planned, read, read_tracked, scenarios, tracked

ROUNDING = 1e-11  # of sums in double precision
DRIFT = 1e-9  # of the same, of what a tracker says that has followed itself for `TICKS`


FEW = 1  # draws, in the fast test


@pytest.mark.parametrize("name", scenarios())
def test_plans_are_as_recorded(name):
    compare(planned(name, FEW), read(name))


@pytest.mark.slow
@pytest.mark.parametrize("name", scenarios())
def test_plans_of_all_draws_are_as_recorded(name):
    compare(planned(name), read(name))


@pytest.mark.slow
@pytest.mark.parametrize("name", read_tracked())
def test_plans_are_tracked_as_recorded(name):
    np.testing.assert_allclose(tracked(name), read_tracked()[name], rtol=DRIFT, atol=DRIFT)


def compare(now, then):
    assert now["names"].tolist() == then["names"].tolist()
    assert now.keys() == then.keys()
    for key in now.keys() - {"names", "sums"}:  # says where
        np.testing.assert_allclose(now[key], then[key], atol=2e-6, err_msg=key)
    np.testing.assert_allclose(now["sums"], then["sums"][: len(now["sums"])], rtol=ROUNDING, atol=ROUNDING)
