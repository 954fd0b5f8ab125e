"""Draws figures of going between ledges and balls from our own runs: figs. 3.2.1, 3.2.2 and 3.2.5 of the monograph as
research/figures/ball_ledges.png, fig. 3.5.10 as ball_to_ball.png; and the map of ball_to_ball_grip with how far the
balls roll by statics, ball_to_ball_grip.png.

python research/between_figures.py [ball_ledges] [ball_to_ball] [ball_to_ball_grip=results/ball_to_ball_grip]
"""

import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from one_run import traced

from sweep.contract.engine import Trace
from sweep.contract.trace_frames import base_pose, centres_of_mass
from sweep.core.plot_style import LEG_COLORS, add_legend_below, new_figure, plot_style, save_figure
from sweep.core.rotations import rotate
from sweep.formulas.ball import GRAVITY, ROLLING_INERTIA
from sweep.models.obstacles.ball import Ball
from sweep.models.obstacles.ledges import Ledges
from sweep.models.robot import total_mass
from sweep.report import maps
from sweep.report.outcome_style import DARK_INK
from sweep.runs import results
from sweep.runs.results import Results
from sweep.systems.hexapod.plots import ACTUAL_COLOUR, REFERENCE_COLOUR, SECOND_COLOUR

FIGURES = Path(__file__).parent / "figures"
RUNS = {
    "ball_ledges": ["scenario=ball_ledges"],
    "ball_to_ball": ["scenario=ball_to_ball", "manoeuvre.finish=floor"],
    "ball_to_ball_grip": ["scenario=ball_to_ball", "obstacle.gap=0"],
}
FEET = (1, 3, 5)  # of a gallop the others go alongside
LINES = {"II": "over.squat", "III": "over.ahead", "IV": "over.middle5", "V": "lower"}  # stages that begin there
TITLE = "Where going from ball to ball needs friction between these"
WAYS = (0.1, 0.3, 1.0)  # of the radius, that are drawn over the map


def begins(trace: Trace, word: str) -> float:
    """When the first stage whose name starts so begins (s)."""
    return trace.time[next(k for k, stage in enumerate(trace.stage) if trace.stages[stage].startswith(word))]


def ledges(trace: Trace) -> Figure:
    """Feet and mass centre along the way, from ledge to ball and from ball to ledge; the speed of the ball."""
    obstacle = trace.world.obstacle_of_type(Ledges)
    figure = new_figure(4.6)
    axes = figure.subplot_mosaic("ab;cc", height_ratios=[3, 2])
    centre, ball, time = centres_of_mass(trace, slice(None)), trace.qpos[:, -7:-4], trace.time
    rolls, off = begins(trace, "roll"), begins(trace, "off.")
    for ax, now, edge in ((axes["a"], time < rolls, 0.0), (axes["b"], time >= off, obstacle.width)):
        for leg in FEET:
            ax.plot(time[now], trace.foot_position[now, leg - 1, 0], color=LEG_COLORS[leg - 1], label=f"foot {leg}")
        ax.plot(time[now], centre[now, 0], "k", label="mass centre")
        ax.plot(time[now], ball[now, 0], "k:", label="the ball's centre")
        ax.axhline(edge, color="0.6", lw=0.8, label="edge")
        ax.set(xlabel="time (s)", ylabel="across (m)")
    height = axes["b"].twinx()
    height.plot(
        time[time >= off], base_pose(trace)[time >= off, 2], color=REFERENCE_COLOUR, ls="--", label="height of the base"
    )
    height.set_ylabel("height (m)")
    axes["c"].plot(time, trace.qvel[:, -6], "k")
    axes["c"].set(xlabel="time (s)", ylabel="speed of the ball (m/s)")
    for ax in axes.values():
        ax.grid(alpha=0.3)
    add_legend_below(figure, [one for ax in (axes["a"], height) for one in ax.get_legend_handles_labels()[0]])
    return figure


def balls(trace: Trace) -> Figure:
    """Heights of feet and of the base's ends, speeds of the balls, between the book's lines."""
    figure = new_figure(4.4)
    heights, speeds = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
    time, base = trace.time, base_pose(trace)
    half = 0.5 * float(np.asarray(trace.world.robot.body_length))
    for leg in FEET:
        heights.plot(time, trace.foot_position[:, leg - 1, 2], color=LEG_COLORS[leg - 1], label=f"foot {leg}")
    for end, style in ((1, "k-"), (-1, "k--")):
        ahead = np.asarray(rotate(jnp.asarray(base[:, 3:7]), jnp.array([end * half, 0.0, 0.0])))
        heights.plot(time, base[:, 2] + ahead[:, 2], style, label="base, front" if end > 0 else "base, rear")
    for k, colour in ((-12, ACTUAL_COLOUR), (-6, SECOND_COLOUR)):
        speeds.plot(time, trace.qvel[:, k], color=colour, label="first ball" if k == -12 else "second ball")
    for axes, label in ((heights, "height (m)"), (speeds, "speed (m/s)")):
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
        for numeral, word in LINES.items():
            axes.axvline(begins(trace, word), color="0.6", lw=0.8)
            axes.text(begins(trace, word), 0.97, f" {numeral}", transform=axes.get_xaxis_transform(), va="top")
    speeds.set_xlabel("time (s)")
    add_legend_below(figure, [one for axes in (heights, speeds) for one in axes.get_legend_handles_labels()[0]])
    return figure


def moments(trace: Trace) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of feet about the lowest points of the two balls, forward (N m), while the robot goes over, and the times (s)."""
    radius, found = trace.world.obstacle_of_type(Ball).radius, []
    for k in (0, 1):
        ball = trace.qpos[:, [-14 + 7 * k, -12 + 7 * k]]
        arm = trace.foot_position[:, :, ::2] - ball[:, None]
        on = (
            np.linalg.norm(trace.foot_position - trace.qpos[:, None, -14 + 7 * k : -11 + 7 * k], axis=-1)
            < radius + 0.01
        )
        push = -trace.foot_force[:, :, ::2]
        moment = (arm[..., 1] + radius) * push[..., 0] - arm[..., 0] * push[..., 1]
        found.append(np.sum(np.where(on, moment, 0.0), axis=1))
    over = [trace.stages[stage].startswith("over.") for stage in trace.stage]
    return found[0][over], found[1][over], trace.time[over]


def rolled(trace: Trace, grip: np.ndarray, mass: np.ndarray) -> np.ndarray:
    """How far (m) balls that touch, of a friction and a mass, go at most under the moments of `trace`.

    Pressed together by N = (T_1 - T_2)/(2 R), they roll as one: 14/5 M R v' = T_1 + T_2 less what resists it, which is
    friction between them, mu (T_1 - T_2), and that of rolling.
    """
    first, second, time = moments(trace)
    ball, load = trace.world.obstacle_of_type(Ball), total_mass(trace.world.robot)
    speed, way, far = np.zeros_like(grip), np.zeros_like(grip), np.zeros_like(grip)
    for one, two, step in zip(first, second, np.diff(time, prepend=time[0]), strict=True):
        resists = grip * max(one - two, 0.0) + ball.rolling_friction * (2 * mass + load) * GRAVITY
        inertia = 2 * ROLLING_INERTIA * mass * ball.radius
        pushed = speed + step * (one + two) / inertia
        speed = np.sign(pushed) * np.maximum(np.abs(pushed) - step * resists / inertia, 0.0)
        way = way + step * speed
        far = np.maximum(far, np.abs(way))
    return far


def grip_map(found: Results, trace: Trace) -> Figure:
    """What comes of friction between the balls and their mass, with lines of how far these go by `rolled`."""
    names = "obstacle.ball_grip", "obstacle.mass"
    with plot_style():
        figure = maps.success_map(found.rows, found.stored, names, TITLE)
        axes = figure.axes[0]
    grip, mass = (np.sort(found.rows[name].unique()) for name in names)
    far = rolled(trace, *np.meshgrid(grip, mass)) / trace.world.obstacle_of_type(Ball).radius
    axes.clabel(axes.contour(grip, mass, far, levels=WAYS, colors=DARK_INK, linewidths=1), fmt="{:g} R".format)
    axes.set(xlabel="friction between the balls, of that of the contact", ylabel="mass of each [kg]")
    return figure


if __name__ == "__main__":
    with plot_style():
        for word in sys.argv[1:] or ("ball_ledges", "ball_to_ball"):
            name, _, folder = word.partition("=")
            path = FIGURES / f"{name}.png"
            _, trace = traced(*RUNS[name], "engine=native")
            draw = ledges if name == "ball_ledges" else balls
            save_figure(grip_map(results.read_results(Path(folder)), trace) if folder else draw(trace), path)
            print(path)
