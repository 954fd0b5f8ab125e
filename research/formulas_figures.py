"""Draws the pictures of research/formulas.md: `python research/formulas_figures.py`."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sweep.core.plot_style import COLUMN_WIDTH_IN, DPI, PAGE_WIDTH_IN, add_legend_below, new_figure, plot_style
from sweep.formulas.ball import ball_climb, lateral_mu, stabilise_delta
from sweep.formulas.ball_reach import max_ball
from sweep.formulas.corner import corner_balanced, corner_equalN, corner_least_friction, corner_min_squeeze
from sweep.formulas.raft_statics import raft_equilibrium, raft_offset_limit
from sweep.formulas.thesis import thesis_step, thesis_workspace
from sweep.systems.hexapod.plots import ACTUAL_COLOUR, REFERENCE_COLOUR, SECOND_COLOUR

FIGURES = Path(__file__).parent / "figures"
LEG = {"l1": 1.0, "l2": 1.0, "l3": 2.0}
MOUNTS = 2.0  # between the thesis' legs
STANDING = -(2 - np.sqrt(0.5))  # height of its feet
THIRD = "#009e73"
RAFT = {"a": 1.575, "b": 1.05, "d": 0.105, "gamma": 9810.0}


def save(figure: Figure, name: str) -> None:
    """Write research/figures/formulas_NAME.png, with a legend below where lines have names."""
    add_legend_below(figure, [line for panel in figure.axes for line in panel.get_legend_handles_labels()[0]])
    figure.savefig(FIGURES / f"formulas_{name}.png", dpi=DPI)


def panels(count: int, height: float = 2.6) -> tuple[Figure, list[Axes]]:
    """An empty figure with `count` panels side by side, one as wide as a column."""
    figure = new_figure(height, COLUMN_WIDTH_IN if count == 1 else PAGE_WIDTH_IN)
    axes = list(figure.subplots(1, count, squeeze=False)[0])
    for panel in axes:
        panel.grid(alpha=0.3)
    return figure, axes


def corner() -> None:
    """Least friction and squeeze on a corner and a pole against the lean of the robot."""
    eps = jnp.linspace(0.01, 1.2, 240)
    figure, (friction, squeeze) = panels(2)
    for limit, line in ((1, ":"), (2, "--"), (4, "-")):
        for psi, colour, name in ((np.pi / 4, ACTUAL_COLOUR, "corner"), (0.0, SECOND_COLOUR, "pole")):
            least = corner_least_friction(psi, eps, limit).k
            friction.plot(eps, least, color=colour, ls=line, label=f"{name}, N ≤ {limit} P")
    friction.set(xlabel="ϰ = η_c / (ζ₂ - ζ₁)", ylabel="least friction", ylim=(0, 2.8), title="balanced scheme")
    for psi, k, colour, name in (
        (np.pi / 4, 1.1, ACTUAL_COLOUR, "corner, k = 1.1"),
        (0.0, 1.0, SECOND_COLOUR, "pole, k = 1"),
    ):
        squeeze.plot(eps, corner_balanced(psi, eps, k).N_u, color=colour, ls="--", label=f"{name}: balanced")
        squeeze.plot(eps, corner_equalN(psi, eps, k).N, color=colour, ls=":", label=f"{name}: equal N")
        squeeze.plot(eps, corner_min_squeeze(psi, eps, k).Nhat, color=colour, label=f"{name}: least of all")
    squeeze.set(
        xlabel="ϰ = η_c / (ζ₂ - ζ₁)", ylabel="largest normal force / P", ylim=(0, 8), title="corner of 90° and pole"
    )
    save(figure, "corner")


def largest_ball() -> None:
    """Largest ball against friction."""
    friction = jnp.linspace(0, 1, 201)
    figure, (panel,) = panels(1)
    for height, colour in ((1.71, ACTUAL_COLOUR), (1.2, SECOND_COLOUR), (0.8, THIRD)):
        for b, line in ((0.0, "--"), (0.5, "-")):
            radius = max_ball(0.52, 0.335, height, b, friction).R
            panel.plot(friction, radius, color=colour, ls=line, label=f"hips at {height:g} m, {b:g} m apart")
    panel.set(xlabel="friction between the foot and the ball", ylabel="radius of the largest ball (m)")
    save(figure, "largest_ball")


def climb() -> None:
    """Least starting speed of the ball against its mass."""
    ratio = jnp.geomspace(0.1, 30, 200)
    figure, (panel,) = panels(1)
    for degrees, colour in zip((0, 20, 40, 60), (ACTUAL_COLOUR, SECOND_COLOUR, THIRD, REFERENCE_COLOUR), strict=True):
        speed = ball_climb(16.0, 16.0 * ratio, 0.84, 1.1, np.deg2rad(degrees)).v0_min
        panel.loglog(ratio, speed, color=colour, label=f"from φ₀ = {degrees}°")
    panel.set(xlabel="mass of the ball / mass of the robot", ylabel="least speed of the ball (m/s)", title="R = 0.84 m")
    save(figure, "climb")


def shapes() -> None:
    """The body's moves over a ball."""
    tau = jnp.linspace(0, 1, 401)
    figure, (panel,) = panels(1)
    moves = stabilise_delta(1.0, 0.1, tau)
    panel.plot(tau, moves.delta, color=ACTUAL_COLOUR, label="δ, to a new place")
    panel.plot(tau, moves.pulse, color=SECOND_COLOUR, label="δ', there and back")
    panel.plot(tau, lateral_mu(1.0, tau).mu, color=THIRD, label="μ, sideways")
    panel.set(xlabel="τ / T (Δ = 0.1 T)", ylabel="share of the displacement")
    save(figure, "ball_shapes")


def raft_tilt() -> None:
    """Tilt of the raft against the offset of its load, exact and for small angles."""
    offset = jnp.linspace(0, 0.5, 200)
    draught = 0.1
    weight = 4 * RAFT["gamma"] * RAFT["a"] * RAFT["b"] * draught
    figure, (panel,) = panels(1)
    for axis, name, colour in ((0, "fore and aft", ACTUAL_COLOUR), (1, "sideways", SECOND_COLOUR)):
        place = np.zeros((offset.size, 3))
        place[:, axis] = offset
        place[:, 2] = 0.05
        vertical = raft_equilibrium(weight, jnp.asarray(place), **RAFT)
        panel.plot(offset, np.rad2deg(np.arccos(vertical.a33)), color=colour, label=f"{name}, exact")
        limit = raft_offset_limit(1.0, weight, weight, 0.05, **RAFT)[axis]
        panel.plot(offset, np.rad2deg(offset / limit), color=colour, ls="--", label=f"{name}, (4.1.25)")
        edge = np.rad2deg(np.arctan(min(draught, 2 * RAFT["d"] - draught) / RAFT["ab"[axis]]))
        panel.axhline(edge, color=colour, lw=0.8, ls=":", label=f"{name}: an edge is bared")
    panel.set(xlabel="offset of the whole load (m)", ylabel="tilt (°)", ylim=(0, 8))
    save(figure, "raft_tilt")


def workspace() -> None:
    """The thesis' workspace: vertical section, horizontal section, and the solid."""
    figure = new_figure(2.6)
    z = jnp.linspace(-3, 3, 1201)
    zone = thesis_workspace(z, **LEG, R=MOUNTS)
    side = figure.add_subplot(1, 3, 1, aspect="equal", xlabel="distance from the mount", ylabel="height z")
    side.fill_betweenx(z, zone.OA, zone.OB, color=ACTUAL_COLOUR, alpha=0.4, lw=0)
    side.axhline(STANDING, color="k", lw=0.8, ls=":")
    top = figure.add_subplot(1, 3, 2, aspect="equal", xlabel="x", ylabel="y, outward")
    here = thesis_workspace(STANDING, **LEG, R=MOUNTS)
    angle = np.linspace(-here.phimax, here.phimax, 101)
    around = np.concatenate([angle, angle[::-1]])
    radius = np.repeat([float(here.OA), float(here.OB)], 101)
    top.fill(radius * np.sin(around), radius * np.cos(around), color=ACTUAL_COLOUR, alpha=0.4, lw=0)
    top.plot(0, 0, "k.")
    solid = figure.add_subplot(1, 3, 3, projection="3d")
    for radii in (zone.OA, zone.OB):
        reach, turn = np.meshgrid(np.asarray(radii)[::40], angle[::5], indexing="ij")
        height = np.broadcast_to(z[::40, None], reach.shape)
        solid.plot_surface(reach * np.sin(turn), reach * np.cos(turn), height, color=ACTUAL_COLOUR, alpha=0.5)  # pyright: ignore
    solid.set(xlabel="x", ylabel="y", zlabel="z")
    save(figure, "workspace")


def largest_step() -> None:
    """Largest step of a leg of the thesis against its direction."""
    heading = jnp.linspace(0, 2 * np.pi, 1441)
    direction = jnp.stack([np.cos(heading), np.sin(heading)], axis=-1)
    here = thesis_workspace(STANDING, **LEG, R=MOUNTS)
    figure = new_figure(3.2)
    for i, (name, foot) in enumerate((("foot at rest", (0.0, 1 + np.sqrt(0.5))), ("foot near a corner", (0.72, 0.78)))):
        panel = figure.add_subplot(1, 2, i + 1, projection="polar")
        panel.set_title(name)
        panel.set_yticks([1, 2, 3])
        step = thesis_step(jnp.array(foot), direction, here.OA, here.OB, here.phimax)
        panel.plot(heading, step.transfer, color=ACTUAL_COLOUR, label="transfer")
        panel.plot(heading, step.support, color=SECOND_COLOUR, label="support")
    save(figure, "largest_step")


if __name__ == "__main__":
    FIGURES.mkdir(exist_ok=True)
    with jax.enable_x64(True), plot_style():
        for draw in (corner, largest_ball, climb, shapes, raft_tilt, workspace, largest_step):
            draw()
