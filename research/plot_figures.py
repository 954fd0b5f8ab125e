"""Draws what goes with a nominal run on `native` over time, as `sweep replay --plot` does: torques and forces.

python research/plot_figures.py [NAME ...]
"""

import sys
from pathlib import Path

from one_run import traced

from sweep.core.plot_style import save_figure
from sweep.systems.hexapod.plots import PLOTS

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
    _, trace = traced(f"scenario={scenario}", "engine=native")
    save_figure(PLOTS[plot](trace), path := FIGURES / f"{name}.png")
    return path


if __name__ == "__main__":
    for name in sys.argv[1:] or RUNS:
        print(drawn(name), flush=True)
