"""Figures of studies, with captions and the numbers that they show."""

from collections.abc import Callable
from dataclasses import dataclass

import pandas as pd
from matplotlib.figure import Figure


@dataclass(frozen=True)
class StudyFigure:
    """A plot with its caption and data; the page and the paper draw it when they need it."""

    key: str  # for file names and anchors
    title: str
    caption: str
    data: pd.DataFrame
    draw: Callable[[], Figure]
