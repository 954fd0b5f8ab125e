"""Plans and their tracking are as they are recorded; those meant to change are recorded anew by `tests/recorded.py`."""

import importlib
import pkgutil

import jax
import numpy as np
import pytest
from recorded import read_plan, read_tracked, record_plan, record_tracking, scenarios

import sweep.controllers
import sweep.formulas
import sweep.models

ROUNDING = 1e-11  # of sums in double precision
DRIFT = 1e-9  # of the same, of what a tracker says that has followed itself for `TICKS`


FEW = 1  # draws, in the fast test


@pytest.mark.parametrize("name", scenarios())
def test_plans_are_as_recorded(name):
    compare(record_plan(name, FEW), read_plan(name))


def test_no_constant_has_double_precision():
    """JAX may keep an array's type from the precision in which it first meets it: such constants are tuples."""
    found = set()
    for room in (sweep.controllers, sweep.formulas, sweep.models):
        for one in pkgutil.walk_packages(room.__path__, f"{room.__name__}."):
            for name, value in vars(importlib.import_module(one.name)).items():
                leaves = jax.tree.leaves(value) if isinstance(value, tuple | list | dict) else [value]
                if any(isinstance(x, np.ndarray) and x.dtype == np.float64 for x in leaves):
                    found.add((one.name, name))
    assert found == set()


@pytest.mark.slow
@pytest.mark.parametrize("name", scenarios())
def test_plans_of_all_draws_are_as_recorded(name):
    compare(record_plan(name), read_plan(name))


@pytest.mark.slow
@pytest.mark.parametrize("name", read_tracked())
def test_plans_are_tracked_as_recorded(name):
    np.testing.assert_allclose(record_tracking(name), read_tracked()[name], rtol=DRIFT, atol=DRIFT)


def compare(now, then):
    assert now["names"].tolist() == then["names"].tolist()
    assert now.keys() == then.keys()
    for key in now.keys() - {"names", "sums"}:  # says where
        np.testing.assert_allclose(now[key], then[key], atol=2e-6, err_msg=key)
    np.testing.assert_allclose(now["sums"], then["sums"][: len(now["sums"])], rtol=ROUNDING, atol=ROUNDING)
