"""Draw the pictures of research/hexagon.md: `python research/hexagon_figures.py`. The last one takes a minute."""

from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from one_run import traced

from sweep.config.experiment import compose
from sweep.controllers.plan import Plan, reference_stance
from sweep.core.plot_style import DPI, add_legend_below, new_figure, plot_style
from sweep.formulas.leg import SIDE_BY_LEG
from sweep.formulas.thesis import thesis_workspace
from sweep.manoeuvres.walking.waypoints import CIRCLE, TRIPODS, WAYPOINTS, Waypoints
from sweep.models.case import Case
from sweep.models.posture import joint_targets
from sweep.systems.hexapod.plots import ACTUAL_COLOUR, REFERENCE_COLOUR, SECOND_COLOUR

FIGURES = Path(__file__).parent / "figures"
SCENARIO = "scenario=hexagon_waypoints"
AS_PRINTED = ["manoeuvre.phase_time=1", "manoeuvre.deepening=0"]  # the thesis knows neither drives nor ground
FIRST_CYCLE = (1, 2)  # stages
GREEN, RED = "#1a9850", "#d73027"  # first and second tripod, as in the thesis


class Motion(NamedTuple):
    """A plan played by an ideal robot, F frames."""

    time: np.ndarray  # (F,) s
    feet: np.ndarray  # (F, 6, 3) m, world
    position: np.ndarray  # (F, 3) m, of the centre
    joints: np.ndarray  # (F, 6, 3) rad: alpha, beta, gamma


def play(case: Case, plan: Plan, stages: range, frames: int = 101) -> Motion:
    """Some stages of `plan`, each from where the one before it ends."""
    feet, position, begin, parts = plan.start.feet, plan.start.position, 0.0, []
    u = jnp.linspace(0, 1, frames)
    for k in range(stages.stop):
        stance = jax.vmap(reference_stance, (None, None, 0, None, None))(plan, jnp.int32(k), u, feet, position)
        if k in stages:
            joints = jax.vmap(lambda s: joint_targets(case.robot, s)[0])(stance)
            parts.append((begin + u * plan.duration[k], stance.feet, stance.position, joints))
            begin += float(plan.duration[k])
        feet, position = stance.feet[-1], stance.position[-1]
    return Motion(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def thesis_angles(joints: np.ndarray) -> np.ndarray:
    """phi, psi, gamma of the thesis (rad) from our alpha, beta, gamma (..., 6, 3) of each leg.

    Both sides describe one foot: outward l1 + l2 cos psi + l3 cos(psi + gam), upward l2 sin psi + l3 sin(psi + gam).
    Comparing with (1.1.4) of the monograph term by term gives psi = beta - pi/2, psi + gam = beta + gamma - 3 pi/2 on
    the left and psi = pi/2 - beta, psi + gam = pi/2 - beta - gamma on the right. Both count the first angle
    counter-clockwise from the radius.
    """
    alpha, beta, gamma = np.moveaxis(joints, -1, 0)
    return np.stack(
        [alpha, SIDE_BY_LEG * (beta - np.pi / 2), np.where(SIDE_BY_LEG > 0, gamma - np.pi, -gamma)], axis=-1
    )


def way_points(_: str) -> str:
    """The steps between way points as printed, in Markdown: the largest one, which legs ask for it, and those gone."""
    lines = ["| from, to | largest step | asked for by the thesis' legs | steps |", "|:--|:--|:--|:--|"]
    with jax.enable_x64(True):
        case = compose([SCENARIO, *AS_PRINTED]).case
        assert isinstance(case.manoeuvre, Waypoints)
        gone = np.linalg.norm(case.manoeuvre.gait_cycle_steps(case.robot), axis=1)
        begins = np.cumsum([0.0, *2 * gone])[:-1]  # m along the way, a cycle being two steps
        far = 0.0
        for start, end in pairwise(WAYPOINTS):
            left = np.subtract(end, start)
            length = float(np.linalg.norm(left))
            largest = np.asarray(case.manoeuvre.largest_step_by_leg(case.robot, jnp.asarray(left / length)))
            legs = sorted(CIRCLE.index(int(leg) + 1) + 1 for leg in np.flatnonzero(largest < largest.min() + 1e-6))
            within = gone[(begins > far - 1e-6) & (begins < far + length - 1e-6) & (gone > 0)]
            told = f"{largest.min():.4f} | {' and '.join(map(str, legs))} | {', '.join(f'{one:.4f}' for one in within)}"
            lines.append(f"| ({start[0]:g}, {start[1]:g}), ({end[0]:g}, {end[1]:g}) | {told} |")
            far += length
    return "\n".join(lines)


def colour(leg: int) -> str:
    """Of the leg's tripod."""
    return GREEN if leg in TRIPODS[0] else RED


def from_above(panel: Axes) -> None:
    """Way points, axes of equal scale."""
    panel.plot(*np.transpose(WAYPOINTS), "k*", ms=8, zorder=5)
    panel.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    panel.grid(alpha=0.3)


def save(figure: Figure, name: str) -> None:
    """Write research/figures/hexagon_NAME.png."""
    figure.savefig(FIGURES / f"hexagon_{name}.png", dpi=DPI)


def paths(case: Case) -> None:
    """Thesis, figure 8: feet of the first tripod green, of the second red, the centre dashed."""
    plan = case.manoeuvre.plan(case)
    motion = play(case, plan, range(len(plan.names)))
    figure = new_figure(4.6)
    panel = figure.subplots()
    for leg in CIRCLE:
        foot = motion.feet[:, leg - 1]
        panel.plot(foot[:, 0], foot[:, 1], color=colour(leg), lw=1)
        panel.plot(*np.unique(np.round(foot[foot[:, 2] < 1e-9, :2], 6), axis=0).T, ".", color=colour(leg), ms=4)
        panel.annotate(
            f"{CIRCLE.index(leg) + 1}", (foot[0, 0], foot[0, 1]), textcoords="offset points", xytext=(-9, -9)
        )
    panel.plot(motion.position[:, 0], motion.position[:, 1], "k--", lw=1)
    from_above(panel)
    save(figure, "paths")


def angles(case: Case) -> None:
    """Thesis, figures 9-14: angles of its legs 1 to 6 over the first cycle; grey is the swing."""
    plan = case.manoeuvre.plan(case)
    motion = play(case, plan, range(FIRST_CYCLE[0], FIRST_CYCLE[-1] + 1))
    values = thesis_angles(motion.joints)
    robot = case.robot
    assert isinstance(case.manoeuvre, Waypoints)
    height = case.manoeuvre.neutral_foot_position(robot)[1]
    widest = float(thesis_workspace(-height, robot.coxa, robot.thigh, robot.shin, robot.mount_radius).phimax)
    ranges = ((-widest, widest), (0, np.pi / 2), (-np.pi, -1.4))  # γ is printed up to -pi/2, but goes beyond it
    figure = new_figure(7.0)
    axes = figure.subplots(6, 3, sharex=True, sharey="col")
    for number, (row, leg) in enumerate(zip(axes, CIRCLE, strict=True), start=1):
        swing = 0 if leg in TRIPODS[0] else 1
        for panel, angle, limits in zip(row, values[:, leg - 1].T, ranges, strict=True):
            panel.axvspan(swing, swing + 1, color="0.93")
            panel.plot(motion.time, angle, color=colour(leg))
            panel.set_ylim(*limits)
            panel.grid(alpha=0.3)
        row[0].set_ylabel(f"leg {number}\n(rad)")
    for panel, name in zip(axes[0], ("φ", "ψ", "γ"), strict=True):
        panel.set_title(name)
    for panel in axes[-1]:
        panel.set_xlabel("t (s)")
    save(figure, "angles")


def physics() -> None:
    """Planned and actual paths in simulation, and how far the base is from its plan."""
    _, trace = traced(SCENARIO)
    figure = new_figure(6.4)
    above, error = figure.subplots(2, 1, height_ratios=[3, 1])
    for leg in CIRCLE:
        above.plot(*trace.foot_position[:, leg - 1, :2].T, color=colour(leg), lw=1.2)
        above.plot(*trace.foot_target[:, leg - 1, :2].T, "k:", lw=0.9)
    above.plot(*trace.qpos[:, :2].T, color=ACTUAL_COLOUR, lw=1.6, label="centre")
    above.plot(*trace.base_target[:, :2].T, "k:", lw=0.9, label="planned")
    from_above(above)
    off = 1e3 * (trace.qpos[:, :3] - trace.base_target[:, :3]).T
    for name, deviation, shade in zip("xyz", off, (ACTUAL_COLOUR, SECOND_COLOUR, REFERENCE_COLOUR), strict=True):
        error.plot(trace.time, deviation, color=shade, label=name)
    error.set(xlabel="time (s)", ylabel="centre, actual\n- planned (mm)")
    error.grid(alpha=0.3)
    add_legend_below(figure, [line for panel in (above, error) for line in panel.get_legend_handles_labels()[0]])
    save(figure, "physics")


if __name__ == "__main__":
    FIGURES.mkdir(exist_ok=True)
    with plot_style():
        with jax.enable_x64(True):
            printed = compose([SCENARIO, *AS_PRINTED]).case
            paths(printed)
            angles(printed)
        physics()
