"""Figures of studies, with captions and the numbers that they show."""

from collections.abc import Callable
from dataclasses import dataclass

import pandas as pd
from matplotlib.figure import Figure


@dataclass(frozen=True)
class StudyFigure:
    """A plot of a study with its caption and the numbers that it shows, drawn when page or paper needs it."""

    key: str  # for file names and anchors
    title: str
    caption: str
    data: pd.DataFrame
    draw: Callable[[], Figure]
