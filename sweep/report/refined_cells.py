"""The cells that refinement ended with, drawn over a map."""

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

from sweep.report.cells import Cells, places
from sweep.runs import refine
from sweep.study.config import Experiment


def draw(ax: Axes, exp: Experiment, painted: pd.DataFrame, x: str, y: str, cells: Cells) -> None:
    """Outline the cells over a map of `painted` rows (see `refine.painted`), with those that were run as dots."""
    rows = painted[painted["known"]]
    for panel in refine.refined(exp, rows):
        columns = [a.column for a in panel.grid.axes]
        for power, corners in enumerate(panel.cells if panel.rollouts else ()):
            (left, right), (low, high) = (
                [places(panel.grid.values[k][corners[:, k] + step], values) for step in (0, 2**power)]
                for k, values in zip(map(columns.index, (x, y)), cells, strict=True)
            )
            outlines = np.stack([[left, low], [right, low], [right, high], [left, high]]).transpose(2, 0, 1)
            ax.add_collection(PolyCollection(list(outlines), facecolor="none", edgecolor="0.35", linewidth=0.3))
    dots = [places(rows[c].to_numpy(), values) for c, values in zip((x, y), cells, strict=True)]
    ax.plot(*dots, ".", markersize=1.5, color="black")
