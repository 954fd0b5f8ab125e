"""Count and rank the distinct values of a column without building a table of all values."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pandas as pd

HEAD = 4096  # values that are looked at first


def has_several_values(values: "pd.Series") -> bool:
    """Return whether a column holds at least two distinct values; missing ones do not count."""
    if values.dtype.kind in "fiu":  # a hash table of a million numbers takes twenty times as long
        return bool(values.min() < values.max())
    return values.nunique() > 1


def count_distinct(values: "pd.Series", most: int) -> int:
    """Count the distinct values of a column; stop counting above `most`.

    Args:
        values: Values (n,); missing ones do not count.
        most: Number beyond which the exact count does not matter.

    Returns:
        The count; `most + 1` where it is larger than `most`.
    """
    few = values.iloc[:HEAD].nunique()
    return min(few if few > most else values.nunique(), most + 1)


def are_all_different(values: np.ndarray) -> bool:
    """Return whether no two of some numbers (n,) are equal."""
    ordered = np.sort(values)
    return not (ordered[1:] == ordered[:-1]).any()


def rank_distinct_values(values: np.ndarray) -> np.ndarray:
    """Return the rank (n,) of each integer of an array (n,) among its distinct values in ascending order."""
    low, high = (int(end) for end in (values.min(initial=0), values.max(initial=0)))
    if high - low > 4 * len(values):  # a table of all that lie between would be large
        return np.unique(values, return_inverse=True)[1]
    there = np.zeros(high - low + 1, dtype=bool)
    there[values - low] = True
    return (np.cumsum(there) - 1)[values - low]
