"""Draws docs/figures/ball_*.png: figs. 3.1.4 to 3.1.6 and 3.3.8 of the monograph from our own runs (speed of the ball,
and the robot over it), and how likely the robot stays on, from the rows of study=ball_noise.

python docs/ball_figures.py [NAME ...]
python docs/ball_figures.py ball_noise=results/ball_noise
"""

import sys
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sweep import load
from sweep.analysis.intervals import wilson
from sweep.core.rotations import matrix
from sweep.engines.base import Trace
from sweep.models.obstacles.ball import Ball
from sweep.runs.batches import Batch, make_engine
from sweep.study.config import compose
from sweep.trace.plots import PLOTS, save

FIGURES = Path(__file__).parent / "figures"
RUNS = {
    "ball_speed": ["scenario=ball_balance", "manoeuvre.stages=4", "manoeuvre.offset=0", "obstacle.speed=-0.1"],
    "ball_offset": ["scenario=ball_balance", "manoeuvre.stages=4", "manoeuvre.offset=0.1"],
    "ball_each_step": ["scenario=ball_drive", "manoeuvre.steps=40"],
    "ball_every_fourth": ["scenario=ball_drive", "manoeuvre.steps=40", "manoeuvre.push_every=4"],
    "ball_climb": ["scenario=ball_climb", "manoeuvre.calm=4"],
}


def draw(name: str) -> Path:
    """The plot of one run on the native engine."""
    exp = compose([*RUNS[name], "engine=native"])
    one = Batch(replace(exp.settings, width=1), exp.case, exp.case, np.zeros(1, int))
    trace = make_engine(exp, one).trace(exp.case, exp.case, one.streams, 0)
    path = FIGURES / f"{name}.png"
    save(draw_way(trace) if name == "ball_climb" else PLOTS["ball"](trace), path)
    wanted = ("obstacle_x_m", "obstacle_speed_mps", "obstacle_aside_max_m", "slip_max_m")
    print(path, {key: round(float(trace.figures[key]), 4) for key in wanted})
    return path


def draw_way(trace: Trace) -> Figure:
    """Fig. 3.3.8: heights of feet and of the base's ends, speed of the ball; where the base is on it; normal forces."""
    robot, radius = trace.world.robot, trace.world.on(Ball).radius
    position, quat, ball = trace.qpos[:, :3], trace.qpos[:, 3:7], trace.qpos[:, -7:-4]
    nose = 0.5 * robot.body_length * np.asarray(matrix(jnp.asarray(quat)))[:, 2, 0]
    off, out = position - ball, trace.foot_position - ball[:, None]
    apart = np.linalg.norm(out, axis=-1, keepdims=True)
    on_ball = apart - radius < trace.foot_position[..., 2:]
    normal = np.sum(np.where(on_ball, out / apart, [0.0, 0.0, 1.0]) * trace.foot_force, axis=-1)
    figure, (heights, place, forces) = plt.subplots(3, 1, figsize=(9, 8), sharex=True, layout="constrained")
    for foot in (1, 3, 5):
        heights.plot(trace.time, trace.foot_position[:, foot - 1, 2], lw=1, label=f"foot {foot}")
        forces.plot(trace.time, normal[:, foot - 1], lw=1, label=f"foot {foot}")
    heights.plot(trace.time, position[:, 2] + nose, "k", lw=1, label="front of the base")
    heights.plot(trace.time, position[:, 2] - nose, "k--", lw=1, label="rear of the base")
    heights.plot(trace.time, trace.qvel[:, -6], "r", label="speed of the ball (m/s)")
    heights.set(ylabel="height (m)")
    place.plot(trace.time, np.degrees(np.arctan2(off[:, 2], -off[:, 0])), label="place of the base")
    place.plot(trace.time, 90 - np.degrees(np.arcsin(nose / (0.5 * robot.body_length))), label="tangent of the base")
    place.set(ylabel="elevation (degrees)")
    forces.set(ylabel="normal force (N)", xlabel="t (s)")
    for axes in (heights, place, forces):
        axes.legend(fontsize=8)
    return figure


def draw_noise(rows: pd.DataFrame) -> Path:
    """Share of rollouts that stay on, with 95 % intervals, against the error of the observed pose and the push."""
    rows = rows[rows.outcome != "invalid"].assign(
        error=1e3 * rows["noise.body_orientation_noise"],
        delay=(4 * rows["noise.body_delay"]).astype(int).astype(str) + " ms late",
        push=rows["execution.push_impulse"],
        seen=(1e3 * rows["noise.body_orientation_noise"]).map("{:g} mrad off".format),
    )
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), sharey=True, layout="constrained")
    _shares(left, rows[rows.push == 0], "error", "delay")
    left.set(xlabel="error of attitude and place (mrad, mm)", ylabel="stay on for 30 s", title="not pushed")
    _shares(right, rows[rows.error.isin([0, 20, 30, 40]) & (rows["noise.body_delay"] == 0)], "push", "seen")
    right.set(xlabel="push from any side (N s)", title="no delay")
    path = FIGURES / "ball_noise.png"
    figure.savefig(path, dpi=110)
    return path


def _shares(axes: Axes, rows: pd.DataFrame, along: str, curve: str) -> None:
    """One curve per value of `curve`, a little aside of each other."""
    apart = 0.006 * np.ptp(rows[along])
    for k, (label, some) in enumerate(rows.groupby(curve, sort=False)):
        cell = (some.outcome == "success").groupby(some[along]).agg(["sum", "size"])
        share, (low, high) = cell["sum"] / cell["size"], wilson(cell["sum"], cell["size"])
        spread = np.clip([share - low, high - share], 0, None)
        axes.errorbar(cell.index + k * apart, share, spread, marker="o", ms=4, capsize=2, lw=1, label=label)
    axes.legend(fontsize=8)


if __name__ == "__main__":
    for run in sys.argv[1:] or RUNS:
        name, _, folder = run.partition("=")
        if folder:
            print(draw_noise(load(folder)))
        else:
            draw(name)
