"""Exhibits: figures with captions and their numbers."""

from collections.abc import Callable
from dataclasses import dataclass

import pandas as pd
from matplotlib.figure import Figure


@dataclass(frozen=True)
class Exhibit:
    """A figure, what it shows in words, and the numbers it is drawn from."""

    key: str  # for file names and anchors
    title: str
    caption: str
    data: pd.DataFrame
    draw: Callable[[], Figure]
