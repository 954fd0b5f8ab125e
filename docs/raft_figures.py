"""Draws docs/figures/raft_crossing.png: fig. 4.4.1 of the monograph from our own run, pushed 0.1 m beside the middle.

python docs/raft_figures.py
"""

from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from sweep.engines.base import Trace
from sweep.runs.batches import Batch, make_engine
from sweep.study.config import compose
from sweep.trace.plots import save
from sweep.trace.sampling import base_pose

PATH = Path(__file__).parent / "figures" / "raft_crossing.png"
LINES = {"I": "board", "II": "push", "III": "aboard", "IV": "wait", "V": "squat", "VI": "land"}  # stages begin so


def crossing(trace: Trace) -> Figure:
    """Ways of raft, base and front feet, and the headings of base and raft, between the book's lines."""
    raft, base, time = trace.qpos[:, -7:], base_pose(trace), trace.time
    figure, (way, aside, heading) = plt.subplots(3, 1, figsize=(9, 9), sharex=True, layout="constrained")
    for axes, k in ((way, 0), (aside, 1)):
        axes.plot(time, raft[:, k], "C0", label="raft")
        axes.plot(time, base[:, k], "k", label="base")
        axes.plot(time, trace.foot_position[:, 4, k], "C1", lw=1, label="front right foot")
        axes.plot(time, trace.foot_position[:, 5, k], "C2", lw=1, label="front left foot")
    for pose, colour in ((raft, "C0"), (base, "k")):
        w, x, y, z = pose[:, 3:7].T
        heading.plot(time, np.arctan2(2 * (w * z + x * y), 1 - 2 * (y**2 + z**2)), colour)
    for axes, label in ((way, "across (m)"), (aside, "along the bank (m)"), (heading, "heading (rad)")):
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
        for numeral, word in LINES.items():
            k = next(k for k, stage in enumerate(trace.stage) if trace.stages[stage].startswith(word))
            axes.axvline(time[k], color="0.6", lw=0.8)
            axes.text(time[k], 1.0, f" {numeral}", transform=axes.get_xaxis_transform(), va="top", fontsize=8)
    way.legend(fontsize=8, loc="lower right")
    heading.set_xlabel("time (s)")
    return figure


if __name__ == "__main__":
    exp = compose(["scenario=raft_cross", "manoeuvre.offset=0.1", "engine=native"])
    one = Batch(replace(exp.settings, width=1), exp.case, exp.case, np.zeros(1, int))
    save(crossing(make_engine(exp, one).trace(exp.case, exp.case, one.streams, 0)), PATH)
    print(PATH)
