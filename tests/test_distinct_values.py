"""Questions about distinct values: equal to pandas' and NumPy's answers, without a table of all values."""

import numpy as np
import pandas as pd
import pytest

from sweep.core.distinct_values import are_all_different, count_distinct, has_several_values, rank_distinct_values

COLUMNS = {
    "one": [2.0, 2.0], "two": [2.0, 3.0], "missing": [np.nan, 2.0, np.nan], "all_missing": [np.nan, np.nan],
    "zeros": [0.0, -0.0], "words": ["a", "b", "a"], "one_word": ["a", "a"], "whole": [3, 3, 1], "truth": [True, False],
    "none": [], "many": np.arange(10_000.0) % 5000,
}  # fmt: skip


@pytest.mark.parametrize("name", COLUMNS)
def test_columns_have_as_many_values_as_pandas_counts(name):
    values = pd.Series(COLUMNS[name])
    assert has_several_values(values) == (values.nunique() > 1)
    for most in (0, 1, 2, 4999, 5000, 20_000):
        assert count_distinct(values, most) == min(values.nunique(), most + 1)


@pytest.mark.parametrize("numbers", [[], [5], [7, 5, 7], [-3, 10**12, -3], np.arange(1000)[::-1]])
def test_whole_numbers_are_numbered_as_numpy_does(numbers):
    numbers = np.asarray(numbers, dtype=np.int64)
    distinct, places = np.unique(numbers, return_inverse=True)
    assert rank_distinct_values(numbers).tolist() == places.tolist()
    assert are_all_different(numbers) == (len(distinct) == len(numbers))


def test_many_different_numbers_are_told_from_the_first(monkeypatch):
    counted, real = [], pd.Series.nunique
    monkeypatch.setattr(pd.Series, "nunique", lambda self: counted.append(len(self)) or real(self))
    values = pd.Series(np.random.default_rng(0).random(100_000))
    assert has_several_values(values)
    assert count_distinct(values, 40) == 41
    assert sum(counted) < 10_000
