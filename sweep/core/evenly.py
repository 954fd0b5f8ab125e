"""Some of many things, spread evenly over them."""

import numpy as np


def evenly(number: int, most: int) -> np.ndarray:
    """Places of at most so many among `number`, evenly spaced, the first and the last among them."""
    return np.unique(np.linspace(0, number - 1, min(most, number)).round().astype(int))
