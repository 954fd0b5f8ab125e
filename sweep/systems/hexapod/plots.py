"""Plots of a trace over time. Legs are arranged as seen from above: left legs on the left, the front pair on top."""

from collections.abc import Callable
from functools import partial, wraps
from typing import Any, Literal

import mujoco
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sweep.contract.engine import Trace
from sweep.contract.trace_frames import base_pose, centres_of_mass, joint_positions
from sweep.core.parameters import InputError
from sweep.core.plot_style import (
    FONT_SIZE_PT,
    LEG_COLORS,
    PAGE_WIDTH_IN,
    add_legend_below,
    new_figure,
    plot_style,
    wrap_text,
)
from sweep.engines.contact_forces import measured_contact_forces, planned_contact_forces
from sweep.formulas import stepping
from sweep.models.legs import JOINT_KINDS, N_LEGS

LEG_ROWS = ((6, 5), (4, 3), (2, 1))
JOINT_SYMBOLS = dict(zip(JOINT_KINDS, ("α", "β", "γ"), strict=True))
ACTUAL_COLOUR, SECOND_COLOUR, REFERENCE_COLOUR = "#0072b2", "#d55e00", "0.25"
SPEED_WINDOW = 25  # ticks over which the speed of a body is averaged
SLANTED_STAGES = 10  # most stage names that are written slanted; more are upright
NAME_SPACING = 1.2 * FONT_SIZE_PT  # points between stage names that are written
AXIS_WIDTH = 0.6  # in, of a panel's width that its axis takes
BOOK_TORQUE = 75.2  # N·m, unit of the monograph's figures 2.3.5 and 2.3.6: about the body's moment of gravity on a pole


def plot_torques(trace: Trace) -> Figure:
    """Plot the joint torques of each leg over time, in N·m and in the torque unit of the monograph's figures."""
    values = trace.joint_torque.reshape(-1, 6, 3)
    title = (
        f"Joint torque (largest magnitude of each tick); right: over {BOOK_TORQUE} N·m, the unit of the monograph's "
        "figures 2.3.5 and 2.3.6"
    )
    figure = _per_leg(trace, title, "torque (N·m)", values, limit=float(trace.world.drive.torque_limit))
    for ax in figure.axes[1::2]:
        ax.secondary_yaxis(
            "right", functions=(partial(np.multiply, 1 / BOOK_TORQUE), partial(np.multiply, BOOK_TORQUE))
        )
    return figure


def plot_joints(trace: Trace) -> Figure:
    """Plot the joint angles of each leg, degrees; targets are dashed."""
    angle, target = (np.degrees(a).reshape(-1, 6, 3) for a in (joint_positions(trace), trace.joint_target))
    return _per_leg(trace, "Joint angle (dashed: target)", "angle (deg)", angle, target)


def plot_base(trace: Trace) -> Figure:
    """Plot position (m) and tilt (deg) of the base against its reference."""
    pose = base_pose(trace)
    figure, axes = _column("Base (dashed: reference)", "x (m)", "y (m)", "z (m)", "tilt (deg)")
    for poses, color, style, width in (
        (trace.base_target, REFERENCE_COLOUR, "--", 1.0),
        (pose, ACTUAL_COLOUR, "-", 1.2),
    ):
        for ax, values in zip(axes[:, 0], [*poses[:, :3].T, tilt_deg(poses)], strict=True):
            ax.plot(trace.time, values, color=color, ls=style, lw=width)
    return _finish(figure, axes, trace)


def plot_feet(trace: Trace) -> Figure:
    """Plot the height (m) of each foot against its reference, and the force on it (N)."""
    figure, axes = _grid(6, 2, "Feet (dashed: planned height)", share="col")
    for leg, (left, right) in enumerate(axes):
        left.plot(trace.time, trace.foot_target[:, leg, 2], color=REFERENCE_COLOUR, ls="--", lw=1.0)
        left.plot(trace.time, trace.foot_position[:, leg, 2], color=LEG_COLORS[leg], lw=1.2)
        left.set_ylabel(f"leg {leg + 1}\nheight (m)")
        force = trace.foot_force[:, leg]
        right.plot(trace.time, force[:, 2], color=ACTUAL_COLOUR, lw=1.2, label="vertical")
        right.plot(trace.time, np.linalg.norm(force[:, :2], axis=1), color=SECOND_COLOUR, lw=1.0, label="horizontal")
        right.set_ylabel("force (N)")
    return _finish(figure, axes, trace)


def plot_failure_margin(trace: Trace) -> Figure:
    """Plot the margin to the nearest failure threshold over time, with a colour for each threshold."""
    figure, axes = _column("Margin to the nearest limit, in units of it", "margin")
    for k, name in enumerate(dict.fromkeys(trace.margin_of)):
        nearest = np.where(trace.margin_of == name, trace.margin, np.nan)
        axes[0, 0].plot(trace.time, nearest, color=f"C{k}", lw=1.4, label=name)
    axes[0, 0].axhline(0, color=REFERENCE_COLOUR, lw=0.9)
    return _finish(figure, axes, trace)


def plot_base_and_foot_paths(trace: Trace) -> Figure:
    """Plot the paths of base and feet in the horizontal plane and from the side, m; references are dashed."""
    figure = new_figure(5.2)
    figure.suptitle("Paths (dashed: reference)")
    axes = figure.subplots(2, 1)
    pose = base_pose(trace)
    for ax, k, name in zip(axes, (1, 2), "yz", strict=True):
        ax.plot(trace.base_target[:, 0], trace.base_target[:, k], color=REFERENCE_COLOUR, ls="--", lw=1.0)
        ax.plot(pose[:, 0], pose[:, k], color="k", lw=1.4, label="base")
        for leg, color in enumerate(LEG_COLORS):
            target, actual = trace.foot_target[:, leg], trace.foot_position[:, leg]
            ax.plot(target[:, 0], target[:, k], color=REFERENCE_COLOUR, ls="--", lw=0.8)
            ax.plot(actual[:, 0], actual[:, k], color=color, lw=1.1, label=f"foot {leg + 1}")
        ax.set_xlabel("x (m)")
        ax.set_ylabel(f"{name} (m)")
        ax.set_aspect("equal", adjustable="datalim")
        ax.grid(alpha=0.3)
    add_legend_below(figure, axes[0].get_legend_handles_labels()[0])
    return figure


def plot_ball(trace: Trace) -> Figure:
    """Plot speed and displacement of the obstacle's first free body, and positions of base and mass centre over it.

    Compare monograph figs. 3.1.4 to 3.1.6; the motions of the base are those of figs. 3.1.2 and 3.1.3.

    Raises:
        InputError: The obstacle has no free body.
    """
    starts = trace.model.jnt_qposadr[trace.model.jnt_type == mujoco.mjtJoint.mjJNT_FREE]
    if len(starts) < 2:
        raise InputError("--plot ball is not allowed: this obstacle has no free body")
    place = trace.qpos[:, starts[1] : starts[1] + 3]
    average = np.ones(SPEED_WINDOW) / SPEED_WINDOW
    rates = np.gradient(place[:, :2], trace.time, axis=0).T
    speed = [np.convolve(np.pad(rate, SPEED_WINDOW // 2, mode="edge"), average, "valid") for rate in rates]
    few = slice(None, None, max(1, len(place) // 2000))
    over_ball = centres_of_mass(trace, few)[:, :2] - place[few, :2]
    labels = ("speed (mm/s)", "way (m)", "base (mm)", "mass centre (mm)")
    figure, axes = _column("Ball: speed and path; base and centre of mass over its centre", *labels)
    for k, (name, color) in enumerate((("ahead", ACTUAL_COLOUR), ("left", SECOND_COLOUR))):
        axes[0, 0].plot(trace.time, 1e3 * speed[k], color=color, lw=1.2, label=name)
        axes[1, 0].plot(trace.time, place[:, k] - place[0, k], color=color, lw=1.2)
        axes[2, 0].plot(trace.time, 1e3 * (base_pose(trace)[:, k] - place[:, k]), color=color, lw=1.2)
        axes[3, 0].plot(trace.time[few], 1e3 * over_ball[:, k], color=color, lw=1.2)
    return _finish(figure, axes, trace)


def plot_flywheel(trace: Trace) -> Figure:
    """Plot angle (rad) and torques of the middle legs that balance the robot, and its deviation from upright.

    Compare monograph fig. 2.6.4.
    """
    angle = joint_positions(trace).reshape(-1, 6, 3)
    torque = trace.joint_torque.reshape(-1, 6, 3)
    labels = ("β (rad)", "largest torque\nof β (N·m)", "centre of mass\nto the left (mm)", "tilt (deg)")
    figure, axes = _column("Middle legs as a flywheel", *labels)
    for leg, color in ((3, ACTUAL_COLOUR), (4, SECOND_COLOUR)):
        wrapped = np.mod(angle[:, leg - 1, 1], 2 * np.pi)
        axes[0, 0].plot(trace.time, wrapped, color=color, lw=1.2, label=f"leg {leg}")
        axes[1, 0].plot(trace.time, torque[:, leg - 1, 1], color=color, lw=1.0)
    aside = 1e3 * component_left_of_base(trace, centres_of_mass(trace, slice(None)) - trace.base_target[:, :3])
    axes[2, 0].plot(trace.time, aside, color="k", lw=1.0)
    axes[3, 0].plot(trace.time, tilt_deg(base_pose(trace)), color="k", lw=1.0)
    axes[0, 0].axhline(np.pi / 2, color=REFERENCE_COLOUR, ls="--", lw=0.8)
    return _finish(figure, axes, trace)


def plot_forces(trace: Trace) -> Figure:
    """Plot the normal forces of the right feet, the friction ratio of all feet, and the margin to the friction cone.

    Compare monograph fig. 2.4.14. Planned forces are dashed. Dotted lines are t* apart if the manoeuvre has a step
    cycle.
    """
    measured, planned = measured_contact_forces(trace), planned_contact_forces(trace)
    friction = float(trace.world.contact.friction)
    title = "Forces of the feet on the surfaces under them (dashed: planned)"
    figure, axes = _column(title, "N/P", "friction used", "margin to\nthe cone")
    for leg in range(N_LEGS):
        color, label = LEG_COLORS[leg], f"leg {leg + 1}"
        axes[1, 0].plot(trace.time, measured.friction[:, leg], color=color, lw=0.9, label=label)
        if leg % 2 == 0:
            axes[0, 0].plot(trace.time, measured.normal[:, leg], color=color, lw=1.2)
            if planned is not None:
                axes[0, 0].plot(trace.time, planned.normal[:, leg], color=color, ls="--", lw=0.9)
    axes[1, 0].axhline(friction, color=REFERENCE_COLOUR, lw=0.9)
    for forces, color, style in ((measured, "k", "-"), (planned, REFERENCE_COLOUR, "--")):
        if forces is not None:
            left = friction - np.nanmax(np.nan_to_num(forces.friction), axis=1)
            axes[2, 0].plot(trace.time, left, color=color, ls=style, lw=1.0)
    axes[2, 0].axhline(0, color=REFERENCE_COLOUR, lw=0.8)
    if rate := getattr(trace.belief.manoeuvre, "rate", None):
        step = float(stepping.swing_time(rate))
        for t in np.arange(step, trace.time[-1], step):
            axes[0, 0].axvline(t, color="0.75", lw=0.6, ls=":", zorder=0)
    return _finish(figure, axes, trace)


def _with_plot_style(draw: Callable[[Trace], Figure]) -> Callable[[Trace], Figure]:
    @wraps(draw)
    def draw_with_style(trace: Trace) -> Figure:
        with plot_style():
            return draw(trace)

    return draw_with_style


# names as in `sweep replay --plot NAME`
PLOTS: dict[str, Callable[[Trace], Figure]] = {
    "torques": _with_plot_style(plot_torques),
    "joints": _with_plot_style(plot_joints),
    "base": _with_plot_style(plot_base),
    "feet": _with_plot_style(plot_feet),
    "margin": _with_plot_style(plot_failure_margin),
    "paths": _with_plot_style(plot_base_and_foot_paths),
    "ball": _with_plot_style(plot_ball),
    "flywheel": _with_plot_style(plot_flywheel),
    "forces": _with_plot_style(plot_forces),
}


def tilt_deg(pose: np.ndarray) -> np.ndarray:
    """Return the angle (F,), deg, between the base's z axis and the vertical, from poses (F, 7)."""
    _, x, y, _ = pose[:, 3:].T
    return np.degrees(2 * np.arcsin(np.clip(np.hypot(x, y), 0, 1)))


def component_left_of_base(trace: Trace, vectors: np.ndarray) -> np.ndarray:
    """Return the component (F,) of `vectors` (F, 3), world axes, to the left of the base's reference."""
    w, x, y, z = trace.base_target[:, 3:].T
    left = np.stack([2 * (x * y - w * z), 1 - 2 * (x**2 + z**2), 2 * (y * z + w * x)], axis=1)
    return np.sum(vectors * left, axis=1)


def _per_leg(
    trace: Trace,
    title: str,
    label: str,
    values: np.ndarray,
    target: np.ndarray | None = None,
    limit: float | None = None,
) -> Figure:
    """One panel for each leg with `values` (F, 6, 3) of its three joints; `target` is dashed, `limit` dotted."""
    figure, axes = _grid(3, 2, title, share="all")
    for row, legs in zip(axes, LEG_ROWS, strict=True):
        for ax, leg in zip(row, legs, strict=True):
            for kind, color in zip(range(3), (ACTUAL_COLOUR, SECOND_COLOUR, "#009e73"), strict=True):
                ax.plot(
                    trace.time, values[:, leg - 1, kind], color=color, lw=1.1, label=JOINT_SYMBOLS[JOINT_KINDS[kind]]
                )
                if target is not None:
                    ax.plot(trace.time, target[:, leg - 1, kind], color=color, ls="--", lw=0.8)
            if limit is not None:
                ax.axhline(limit, color=REFERENCE_COLOUR, ls=":", lw=0.9, label="torque limit")
            ax.set_ylabel(f"leg {leg}\n{label}")
    return _finish(figure, axes, trace)


def _grid(rows: int, columns: int, title: str, share: Literal["none", "col", "all"] = "none") -> tuple[Figure, Any]:
    """Figure and its axes (rows, columns) with one time axis; `share` says which panels share a y axis."""
    figure = new_figure(1.6 + 1.1 * rows)
    figure.suptitle(wrap_text(title, 72 * PAGE_WIDTH_IN - 2 * FONT_SIZE_PT))
    return figure, figure.subplots(rows, columns, sharex=True, sharey=share, squeeze=False)


def _column(title: str, *labels: str) -> tuple[Figure, Any]:
    """Figure and its axes (labels, 1), one below the other, with labels of their y axes."""
    figure, axes = _grid(len(labels), 1, title)
    for ax, label in zip(axes[:, 0], labels, strict=True):
        ax.set_ylabel(label)
    return figure, axes


def _finish(figure: Figure, axes: np.ndarray, trace: Trace) -> Figure:
    """Add time axis, lines where stages begin, stage names above the top row, and a legend."""
    add_legend_below(figure, [one for ax in axes.flat for one in ax.get_legend_handles_labels()[0]])
    starts = np.flatnonzero(np.diff(trace.stage, prepend=-1))
    room = NAME_SPACING / (72 * (PAGE_WIDTH_IN / axes.shape[1] - AXIS_WIDTH)) * (trace.time[-1] - trace.time[0])
    for ax in axes.flat:
        ax.grid(alpha=0.3)
        ax.margins(x=0.01)
        for k in starts[1:]:
            ax.axvline(trace.time[k], color="0.6", lw=0.4, zorder=0)
    for ax in axes[-1]:
        ax.set_xlabel("time (s)")
    for ax in axes[0]:
        _name_stages(ax, trace, starts, room)
    return figure


def _name_stages(ax: Axes, trace: Trace, starts: np.ndarray, room: float) -> None:
    """Write the names of stages that begin at least `room` (s) after the one that was named before."""
    marks, named = ax.secondary_xaxis("top"), [starts[0]]
    for k in starts[1:]:
        if trace.time[k] - trace.time[named[-1]] >= room:
            named.append(k)
    names = [trace.stages[trace.stage[k]] for k in named]
    slanted = len(named) <= SLANTED_STAGES
    marks.set_xticks(trace.time[named], names, rotation=25 if slanted else 90, ha="left" if slanted else "center")
    marks.tick_params(length=2)
