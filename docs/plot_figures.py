"""Draws what goes with a nominal run on `native` over time, as `sweep replay --plot` does: torques and forces.

python docs/plot_figures.py [NAME ...]
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from sweep.core.letters import save
from sweep.runs.batches import Batch, make_engine
from sweep.study.config import compose
from sweep.trace.plots import PLOTS

FIGURES = Path(__file__).parent / "figures"
RUNS = {
    "pole_climb_torques": ("torques", "pole_climb"),
    "pole_ledge_below_torques": ("torques", "pole_ledge_below"),
    "pole_ledge_above_torques": ("torques", "pole_ledge_above"),
    "corner_forces": ("forces", "corner_climb"),
    "beam_flywheel": ("flywheel", "beam_cross"),
}


def drawn(name: str) -> Path:
    """The plot of a run."""
    plot, scenario = RUNS[name]
    exp = compose([f"scenario={scenario}", "engine=native"])
    one = Batch(replace(exp.settings, width=1), exp.case, exp.case, np.zeros(1, int))
    trace = make_engine(exp, one).trace(exp.case, exp.case, one.streams, 0)
    save(PLOTS[plot](trace), path := FIGURES / f"{name}.png")
    return path


if __name__ == "__main__":
    for name in sys.argv[1:] or RUNS:
        print(drawn(name), flush=True)
