"""Draw research/figures/raft_crossing.png: fig. 4.4.1 of the monograph from our own run, pushed 0.1 m off the middle.

python research/raft_figures.py
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from one_run import traced

from sweep.contract.engine import Trace
from sweep.contract.trace_frames import base_pose
from sweep.core.plot_style import LEG_COLORS, add_legend_below, new_figure, plot_style, save_figure
from sweep.systems.hexapod.plots import ACTUAL_COLOUR

PATH = Path(__file__).parent / "figures" / "raft_crossing.png"
LINES = {"I": "board", "II": "push", "III": "aboard", "IV": "wait", "V": "squat", "VI": "land"}  # stages begin so


def crossing(trace: Trace) -> Figure:
    """Ways of raft, base and front feet, and the headings of base and raft, between the book's lines."""
    raft, base, time = trace.qpos[:, -7:], base_pose(trace), trace.time
    figure = new_figure(5.6)
    way, aside, heading = figure.subplots(3, 1, sharex=True)
    for axes, k in ((way, 0), (aside, 1)):
        axes.plot(time, raft[:, k], color=ACTUAL_COLOUR, label="raft")
        axes.plot(time, base[:, k], "k", label="base")
        for leg, side in ((5, "right"), (6, "left")):
            axes.plot(time, trace.foot_position[:, leg - 1, k], color=LEG_COLORS[leg - 1], label=f"front {side} foot")
    for pose, colour in ((raft, ACTUAL_COLOUR), (base, "k")):
        w, x, y, z = pose[:, 3:7].T
        heading.plot(time, np.arctan2(2 * (w * z + x * y), 1 - 2 * (y**2 + z**2)), color=colour)
    for axes, label in ((way, "across (m)"), (aside, "along the bank (m)"), (heading, "heading (rad)")):
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
        for numeral, word in LINES.items():
            k = next(k for k, stage in enumerate(trace.stage) if trace.stages[stage].startswith(word))
            axes.axvline(time[k], color="0.6", lw=0.8)
            axes.text(time[k], 0.97, f" {numeral}", transform=axes.get_xaxis_transform(), va="top")
    heading.set_xlabel("time (s)")
    add_legend_below(figure, way.get_legend_handles_labels()[0])
    return figure


if __name__ == "__main__":
    _, trace = traced("scenario=raft_cross", "manoeuvre.offset=0.1", "engine=native")
    with plot_style():
        save_figure(crossing(trace), PATH)
    print(PATH)
