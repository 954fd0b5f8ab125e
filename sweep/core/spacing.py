"""Evenly spaced samples of a sequence."""

import numpy as np


def evenly_spaced_indices(number: int, limit: int) -> np.ndarray:
    """Choose evenly spaced indices of a sequence, including its first and last element.

    Args:
        number: Length of the sequence.
        most: Largest number of indices.

    Returns:
        Increasing indices from 0 to `number - 1`, at most `most`.
    """
    return np.unique(np.linspace(0, number - 1, min(limit, number)).round().astype(int))
