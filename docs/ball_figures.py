"""Draws docs/figures/ball_*.png, figs. 3.1.4 to 3.1.6 of the monograph from our own runs: speed of the ball, and the
robot over it.

python docs/ball_figures.py [NAME ...]
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from sweep.batches import Batch, make_engine
from sweep.config import compose
from sweep.trace.plots import PLOTS, save

FIGURES = Path(__file__).parent / "figures"
RUNS = {
    "ball_speed": ["scenario=ball_balance", "manoeuvre.stages=4", "manoeuvre.offset=0", "obstacle.speed=-0.1"],
    "ball_offset": ["scenario=ball_balance", "manoeuvre.stages=4", "manoeuvre.offset=0.1"],
    "ball_each_step": ["scenario=ball_drive", "manoeuvre.steps=40"],
    "ball_every_fourth": ["scenario=ball_drive", "manoeuvre.steps=40", "manoeuvre.push_every=4"],
}


def draw(name: str) -> Path:
    """The plot of one run on the native engine."""
    exp = compose([*RUNS[name], "engine=native"])
    one = Batch(replace(exp.settings, width=1), exp.case, exp.case, np.zeros(1, int))
    trace = make_engine(exp, one).trace(exp.case, exp.case, one.streams, 0)
    path = FIGURES / f"{name}.png"
    save(PLOTS["ball"](trace), path)
    wanted = ("obstacle_x_m", "obstacle_speed_mps", "obstacle_aside_max_m", "slip_max_m")
    print(path, {key: round(float(trace.figures[key]), 4) for key in wanted})
    return path


if __name__ == "__main__":
    for run in sys.argv[1:] or RUNS:
        draw(run)
