"""Draw research/figures/ball_*.png: figs. 3.1.4 to 3.1.6, 3.3.8, 3.4.8 of the monograph from our own runs (speed of the
ball, and the robot over it; the way up and down), the ball driven aside as (3.3.7) has it, and how likely the robot
stays on, from the rows of ball_noise.

python research/ball_figures.py [NAME ...]
python research/ball_figures.py ball_noise=results/ball_noise
"""

import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from one_run import traced

from sweep import load
from sweep.analysis.intervals import wilson
from sweep.contract.engine import Trace
from sweep.contract.trace_frames import base_pose, centres_of_mass
from sweep.core.plot_style import LEG_COLORS, add_legend_below, new_figure, plot_style, save_figure
from sweep.core.rotations import matrix, rotate
from sweep.formulas.ball import GRAVITY, ROLLING_INERTIA, lateral_mu
from sweep.manoeuvres.balancing.ball_aside import BallAside, lateral_lean_gain
from sweep.manoeuvres.balancing.ball_climb import BallClimb
from sweep.manoeuvres.balancing.ball_descend import BallDescend
from sweep.manoeuvres.balancing.ball_over import BallCrossing
from sweep.models.case import Case
from sweep.models.obstacles.ball import Ball
from sweep.models.robot import total_mass
from sweep.systems.hexapod.plots import ACTUAL_COLOUR, PLOTS, REFERENCE_COLOUR, SECOND_COLOUR

FIGURES = Path(__file__).parent / "figures"
FEET = (1, 3, 5)  # the left ones go alongside
RUNS = {
    "ball_speed": ["scenario=ball_balance", "manoeuvre.stages=4", "manoeuvre.offset=0", "obstacle.speed=-0.1"],
    "ball_offset": ["scenario=ball_balance", "manoeuvre.stages=4", "manoeuvre.offset=0.1"],
    "ball_each_step": ["scenario=ball_drive", "manoeuvre.steps=40"],
    "ball_every_fourth": ["scenario=ball_drive", "manoeuvre.steps=40", "manoeuvre.push_every=4"],
    "ball_descend": ["scenario=ball_descend"],
    "ball_over": ["scenario=ball_over"],
    "ball_aside": ["scenario=ball_aside", "manoeuvre.stops=3"],
    "ball_climb": ["scenario=ball_climb", "manoeuvre.calm=4"],
}


def draw(name: str) -> Path:
    """The plot of one run on the native engine."""
    exp, trace = traced(*RUNS[name], "engine=native")
    path = FIGURES / f"{name}.png"
    match exp.case.manoeuvre:
        case BallDescend() | BallCrossing():
            figure = descent(trace)
        case BallClimb():
            figure = draw_way(trace)
        case BallAside() as aside:
            figure = driven_aside(trace, exp.case, aside)
        case _:
            figure = PLOTS["ball"](trace)
    save_figure(figure, path)
    wanted = ("obstacle_x_m", "obstacle_speed_mps", "obstacle_aside_max_m", "slip_max_m")
    print(path, {key: round(float(trace.metrics[key]), 4) for key in wanted})
    return path


def descent(trace: Trace) -> Figure:
    """The curves of fig. 3.4.8, the mass centre's elevation phi seen from the ball's, and how feet are loaded."""
    figure = new_figure(6.0)
    axes = figure.subplots(4, 1, sharex=True)
    time, base, ball = trace.time, base_pose(trace), trace.qpos[:, -7:]
    half = 0.5 * float(np.asarray(trace.world.robot.body_length))
    for leg in FEET:
        axes[0].plot(time, trace.foot_position[:, leg - 1, 2], color=LEG_COLORS[leg - 1], label=f"foot {leg}")
        axes[3].plot(time, np.linalg.norm(trace.foot_force[:, leg - 1], axis=-1), color=LEG_COLORS[leg - 1], lw=0.8)
    for end, style in ((1, "k-"), (-1, "k--")):
        ahead = np.asarray(rotate(jnp.asarray(base[:, 3:7]), jnp.array([end * half, 0.0, 0.0])))
        axes[0].plot(time, base[:, 2] + ahead[:, 2], style, label="base, front" if end > 0 else "base, rear")
    axes[1].plot(time, trace.qvel[:, -6], "k")
    over = centres_of_mass(trace, slice(None)) - ball[:, :3]
    phi = np.degrees(np.arctan2(over[:, 2], over[:, 0]))
    axes[2].plot(time, np.mod(phi + 90, 360) - 90, "k")  # no jump on the ball's near side
    for ax, label in zip(
        axes, ("height (m)", "speed of\nthe ball (m/s)", "φ (deg)", "force on\nthe foot (N)"), strict=True
    ):
        ax.set_ylabel(label)
        ax.grid(alpha=0.3)
    axes[3].set_xlabel("time (s)")
    add_legend_below(figure, axes[0].get_legend_handles_labels()[0])
    return figure


def driven_aside(trace: Trace, case: Case, aside: BallAside) -> Figure:
    """Speed of the ball to the left, by momentum and rolling friction, and where the mass centre is over it."""
    figure = new_figure(3.6)
    axes = figure.subplots(2, 1, sharex=True)
    time = trace.time
    over = (centres_of_mass(trace, slice(None)) - trace.qpos[:, -7:-4])[:, 1]
    speeds = promised(time, case, aside)
    axes[0].plot(time, 1e3 * trace.qvel[:, -5], color=ACTUAL_COLOUR, label="ball")
    axes[0].plot(time, 1e3 * speeds, color=REFERENCE_COLOUR, ls="--", label="(3.3.7), with rolling friction")
    axes[0].set_ylabel("speed to the\nleft (mm/s)")
    axes[1].plot(time, 1e3 * over, color=ACTUAL_COLOUR)
    axes[1].set(ylabel="mass centre (mm)", xlabel="time (s)")
    for ax in axes:
        ax.grid(alpha=0.3)
    add_legend_below(figure, axes[0].get_legend_handles_labels()[0])
    return figure


def promised(time: np.ndarray, case: Case, aside: BallAside) -> np.ndarray:
    """Speed of the ball (m/s) in the first stage: angular momentum about its lowest point, by weight and friction.

    The mass centre goes by (3.3.7), and its height is the base's; friction against rolling turns with the speed.
    """
    ball, mass = case.obstacle_of_type(Ball), float(total_mass(case.robot))
    plan = aside.plan(case)
    over = (
        float(lateral_lean_gain(case, plan, aside.period))
        * aside.speed
        * np.asarray(lateral_mu(aside.period, jnp.asarray(time)).mu)
    )
    height = ball.radius + float(plan.position[0, 2])
    inertia = ROLLING_INERTIA * ball.mass * ball.radius + mass * height
    own = mass * height * np.gradient(over, time)
    friction = ball.rolling_friction * (ball.mass + mass) * GRAVITY
    speeds, momentum = np.zeros(len(time)), 0.0
    for k in range(1, len(time)):
        momentum += (time[k] - time[k - 1]) * (mass * GRAVITY * over[k] - friction * np.sign(speeds[k - 1]))
        speeds[k] = (momentum - own[k]) / inertia
    return np.where(time < aside.period, speeds, np.nan)


def draw_way(trace: Trace) -> Figure:
    """Fig. 3.3.8: heights of feet and of the base's ends, speed of the ball; where the base is on it; normal forces."""
    robot, radius = trace.world.robot, trace.world.obstacle_of_type(Ball).radius
    position, quat, ball = trace.qpos[:, :3], trace.qpos[:, 3:7], trace.qpos[:, -7:-4]
    nose = 0.5 * robot.body_length * np.asarray(matrix(jnp.asarray(quat)))[:, 2, 0]
    off, out = position - ball, trace.foot_position - ball[:, None]
    apart = np.linalg.norm(out, axis=-1, keepdims=True)
    on_ball = apart - radius < trace.foot_position[..., 2:]
    normal = np.sum(np.where(on_ball, out / apart, [0.0, 0.0, 1.0]) * trace.foot_force, axis=-1)
    figure = new_figure(6.4)
    heights, place, forces = figure.subplots(3, 1, sharex=True, height_ratios=[3, 2, 2])
    for foot in FEET:
        heights.plot(trace.time, trace.foot_position[:, foot - 1, 2], color=LEG_COLORS[foot - 1], label=f"foot {foot}")
        forces.plot(trace.time, normal[:, foot - 1], color=LEG_COLORS[foot - 1], lw=0.8)
    heights.plot(trace.time, position[:, 2] + nose, "k", label="front of the base")
    heights.plot(trace.time, position[:, 2] - nose, "k--", label="rear of the base")
    heights.plot(trace.time, trace.qvel[:, -6], color=REFERENCE_COLOUR, ls=":", label="speed of the ball (m/s)")
    heights.set(ylabel="height (m)")
    tangent = 90 - np.degrees(np.arcsin(nose / (0.5 * robot.body_length)))
    place.plot(
        trace.time, np.degrees(np.arctan2(off[:, 2], -off[:, 0])), color=ACTUAL_COLOUR, label="place of the base"
    )
    place.plot(trace.time, tangent, color=SECOND_COLOUR, label="tangent of the base")
    place.set(ylabel="elevation (deg)")
    forces.set(ylabel="normal force (N)", xlabel="time (s)")
    for axes in (heights, place, forces):
        axes.grid(alpha=0.3)
    add_legend_below(figure, [one for axes in (heights, place) for one in axes.get_legend_handles_labels()[0]])
    return figure


def draw_noise(rows: pd.DataFrame) -> Path:
    """Share of rollouts that stay on, with 95 % intervals, against the error of the observed pose and the push."""
    rows = rows[rows.outcome != "invalid"].assign(
        error=1e3 * rows["noise.body_orientation_noise"],
        delay=(4 * rows["noise.body_delay"]).astype(int).astype(str) + " ms late",
        push=rows["execution.push_impulse"],
        seen=(1e3 * rows["noise.body_orientation_noise"]).map("{:g} mrad off".format),
    )
    figure = new_figure(2.8)
    left, right = figure.subplots(1, 2, sharey=True)
    _shares(left, rows[rows.push == 0], "error", "delay")
    left.set(xlabel="error of attitude and place (mrad, mm)", ylabel="stay on for 30 s", title="not pushed")
    _shares(right, rows[rows.error.isin([0, 20, 30, 40]) & (rows["noise.body_delay"] == 0)], "push", "seen")
    right.set(xlabel="push from any side (N s)", title="no delay")
    save_figure(figure, path := FIGURES / "ball_noise.png")
    return path


def _shares(axes: Axes, rows: pd.DataFrame, along: str, curve: str) -> None:
    """One curve per value of `curve`, a little aside of each other."""
    apart = 0.006 * np.ptp(rows[along])
    for k, (label, some) in enumerate(rows.groupby(curve, sort=False)):
        cell = (some.outcome == "success").groupby(some[along]).agg(["sum", "size"])
        share, (low, high) = cell["sum"] / cell["size"], wilson(cell["sum"], cell["size"])
        spread = np.clip([share - low, high - share], 0, None)
        axes.errorbar(cell.index + k * apart, share, spread, marker="o", ms=3, capsize=2, lw=1, label=label)
    axes.grid(alpha=0.3)
    axes.legend()


if __name__ == "__main__":
    with plot_style():
        for run in sys.argv[1:] or RUNS:
            name, _, folder = run.partition("=")
            if folder:
                print(draw_noise(load(folder)))
            else:
                draw(name)
