"""Draw research/figures/robustness_*.png from research/data/rates_*.json, and write research/robustness_rates.md.

python research/robustness_figures.py
"""

import json
import math
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

import pandas as pd
from PIL import Image

from sweep.analysis.intervals import wilson
from sweep.core.plot_style import DPI, FONT_SIZE_PT, add_legend_below, new_figure, plot_style, wrap_text
from sweep.core.plot_style import PAGE_WIDTH_IN as PAGE_WIDTH

RESEARCH = Path(__file__).parent
ERRORS = {  # what a line of the table is called, and how its numbers are told
    "axis.size_error": ("sizes and masses, each wrong by up to, %", 100),
    "axis.radius": ("radius of the pole believed too small (-) or too large, %", 100),
    "noise.position_noise": ("noise of the measured position, mm", 1000),
    "noise.position_bias": ("bias of it, mm", 1000),
    "noise.orientation_noise": ("noise of the measured attitude, mrad", 1000),
    "noise.orientation_bias": ("bias of it, mrad", 1000),
    "noise.joint_bias": ("bias of every joint angle, mrad", 1000),
    "noise.delay": ("delay, ms", 4),
    "noise.load_noise": ("noise of the measured load on feet, N", 1),
    "noise.load_delay": ("delay of it, beyond the rest, ms", 4),
    "world.contact.friction": ("friction, believed to be 1", 1),
    "axis.friction": ("friction, beside what is believed, %", 100),
    "world.execution.torque_scale": ("torque limit, % of the believed one", 100),
}
BOUNDS = {  # columns of the table of bounds: title, title alone, unit in which an error is told, value without it
    "axis.size_error": ("sizes, masses, %", "sizes, masses, %", 100, 0.0),
    "axis.ground_error": ("ground, %", "ground, %", 100, 0.0),
    "noise.position_noise": ("position, noise, mm", "position, noise, mm", 1000, 0.0),
    "noise.position_bias": ("bias, mm", "position, bias, mm", 1000, 0.0),
    "noise.orientation_noise": ("attitude, noise, mrad", "attitude, noise, mrad", 1000, 0.0),
    "noise.orientation_bias": ("bias, mrad", "attitude, bias, mrad", 1000, 0.0),
    "noise.joint_bias": ("joints, bias, mrad", "joints, bias, mrad", 1000, 0.0),
    "noise.delay": ("delay, ms", "delay, ms", 4, 0.0),
    "noise.load_noise": ("load, noise, N", "load, noise, N", 1, 0.0),
    "noise.load_delay": ("delay, ms", "load, delay, ms", 4, 0.0),
    "axis.friction": ("friction less by, %", "friction less by, %", 100, 0.0),
    "world.execution.torque_scale": ("torque limit less by, %", "torque limit less by, %", 100, 1.0),
}
SEEN = {  # columns of the second part of the table
    "noise.joint_noise": ("joints, noise, mrad", "joints, noise, mrad", 1000, 0.0),
    "noise.velocity_noise": ("velocity, mm/s", "velocity, noise, mm/s", 1000, 0.0),
    "noise.spin_noise": ("spin, mrad/s", "spin, noise, mrad/s", 1000, 0.0),
    "noise.joint_rate_noise": ("joint rates, mrad/s", "joint rates, noise, mrad/s", 1000, 0.0),
    "noise.body_position_noise": ("bodies' place, noise, mm", "bodies' place, noise, mm", 1000, 0.0),
    "noise.body_position_bias": ("bias, mm", "bodies' place, bias, mm", 1000, 0.0),
    "noise.body_orientation_noise": ("attitude, noise, mrad", "bodies' attitude, noise, mrad", 1000, 0.0),
    "noise.body_orientation_bias": ("bias, mrad", "bodies' attitude, bias, mrad", 1000, 0.0),
    "noise.body_velocity_noise": ("velocity, mm/s", "bodies' velocity, noise, mm/s", 1000, 0.0),
    "noise.body_turn_noise": ("turning, mrad/s", "bodies' turning, noise, mrad/s", 1000, 0.0),
    "noise.body_delay": ("delay, ms", "bodies, delay, ms", 4, 0.0),
}
ROBOTS = {"believes": "#7F7F7F", "calibrates": "#009E73", "learns": "#0072B2"}
ACROSS = 4  # panels
APART = 0.15  # of a panel's width, between labels below it
WANTED = 0.9  # share of rollouts that are to succeed
PAGE = """# Robustness, manoeuvre by manoeuvre

<!-- data rates: age -->
filled by research/cited.py
<!-- end -->

    python jobs/paper.py 'rates*'

What share succeeds with one kind of error at a time, 128 draws a value, with 95 % Wilson intervals: the rates behind
the first table of [robustness](robustness.md), which says what was run. Dotted: nine of ten.
"""
SOURCES = """## What the data are of

<!-- data: sources -->
filled by research/cited.py
<!-- end -->
"""


def errors_of(rates: pd.DataFrame) -> str:
    """Rates along each error in Markdown; columns axis, value, share, low, high, invalid."""
    lines = ["| error | succeed, % |", "|:--|:--|"]
    for axis, (words, scale) in ERRORS.items():
        cells = []
        for one in rates[rates["axis"] == axis].to_dict("records"):
            share, low, high = (100 * one[key] for key in ("share", "low", "high"))
            broken = f", {one['invalid']} invalid" if one["invalid"] else ""
            cells.append(f"{scale * one['value']:.4g}: {share:.0f} ({low:.0f}-{high:.0f}){broken}")
        if cells:
            lines.append(f"| {words} | {'; '.join(cells)} |")
    return "\n".join(lines)


def bound(rates: pd.DataFrame, scale: float, nominal: float) -> str:
    """How large an error may be for `WANTED`: surely so much, surely not so much, by the Wilson intervals.

    Errors in between are not told apart from it by the draws.
    """
    rates = rates.assign(error=(scale * (rates["value"] - nominal)).abs().round(6)).sort_values("error")
    surely = rates["low"].ge(WANTED).cummin()
    never = rates["high"].lt(WANTED)
    least = rates["error"][surely].max() if surely.any() else 0.0
    most = rates["error"][never & (rates["error"] > least)]
    return f"{least:.4g} … {most.min():.4g}" if len(most) else f"{least:.4g} …"


def rates(data: Path) -> pd.DataFrame:
    """A row for each value of each error of each manoeuvre and robot, by the targets of jobs/robustness.yaml.

    Columns scenario, robot, axis, value, success, valid, and share with its 95 % Wilson interval, low and high.
    """
    lines = []
    for path in sorted(data.glob("rates_*.json")):
        found = json.loads(path.read_text(encoding="utf-8"))
        robot = path.stem.removeprefix(f"rates_{found['scenario']}_").removesuffix("_seen")
        counts = ((axis, *line[:3]) for axis, along in found["along"].items() for line in along)
        lines += [(found["scenario"], robot, *one) for one in counts]
    table = pd.DataFrame(lines, columns=["scenario", "robot", "axis", "value", "success", "valid"])
    low, high = wilson(table["success"], table["valid"])
    return table.assign(share=table["success"] / table["valid"], low=low, high=high)


def bounds_of(rates: pd.DataFrame) -> Iterator[str]:
    """The tables of bounds in Markdown: errors of the first, then those of `SEEN`."""
    for columns in (BOUNDS, SEEN):
        lines = ["| | robot | " + " | ".join(title for title, *_ in columns.values()) + " |"]
        lines.append("|:--|:--|" + ":--|" * len(columns))
        for (scenario, robot), of_one in rates[rates["axis"].isin(columns)].groupby(["scenario", "robot"]):
            along = dict(list(of_one.groupby("axis")))
            cells = [bound(along[axis], *how) if axis in along else "" for axis, (_, _, *how) in columns.items()]
            lines.append(f"| `{scenario}` | {robot} | " + " | ".join(cells) + " |")
        yield "\n".join(lines)


def page() -> None:
    """All rates as research/robustness_rates.md, a figure for each manoeuvre."""
    parts = [PAGE]
    for scenario, of_one in rates(RESEARCH / "data").groupby("scenario"):
        with plot_style():
            draw_rates(of_one, f"robustness_{scenario}")
        parts.append(f"## {scenario}\n\n![rates of {scenario}](figures/robustness_{scenario}.png)\n")
    (RESEARCH / "robustness_rates.md").write_text("\n".join([*parts, SOURCES]), encoding="utf-8")


def labelled(errors: list[float]) -> list[str]:
    """What is written below each of several errors on a logarithmic axis: nothing below one that is too near."""
    apart, last, labels = APART * math.log(errors[-1] / errors[0]), -math.inf, []
    for error in errors:
        labels.append(f"{error:g}" if math.log(error) - last >= apart else "")
        last = math.log(error) if labels[-1] else last
    return labels


def draw_rates(rates: pd.DataFrame, name: str) -> None:
    """A panel for each error: what shares succeed with it, with their 95 % intervals, of every robot."""
    drawn = {axis: how for axis, how in (BOUNDS | SEEN).items() if axis in set(rates["axis"])}
    lines = -(-len(drawn) // ACROSS)
    figure = new_figure(0.4 + 1.35 * lines)
    panels = figure.subplots(lines, ACROSS, sharey=True, squeeze=False)
    for panel in panels.flat[len(drawn) :]:
        panel.axis("off")
    for panel, (axis, (_, title, scale, nominal)) in zip(panels.flat, drawn.items(), strict=False):
        along = rates[rates["axis"] == axis]
        errors = (scale * (along["value"] - nominal)).abs().round(6)
        for robot, of_one in along.assign(error=errors).sort_values("error").groupby("robot"):
            colour = ROBOTS[str(robot)]
            panel.fill_between(
                of_one["error"], 100 * of_one["low"], 100 * of_one["high"], color=colour, alpha=0.2, lw=0
            )
            panel.plot(of_one["error"], 100 * of_one["share"], "o-", ms=2.5, color=colour, label=robot)
        panel.axhline(100 * WANTED, color="0.6", lw=0.6, ls=":")
        panel.set_xscale("log")
        told = sorted(errors.unique())
        panel.set_xticks(told, labelled(told))
        panel.minorticks_off()
        panel.set_title(wrap_text(title, 72 * PAGE_WIDTH / ACROSS - 2 * FONT_SIZE_PT))
    panels[0, 0].set_ylim(-3, 103)
    for panel in panels[:, 0]:
        panel.set_ylabel("succeed, %")
    add_legend_below(figure, panels[0, 0].get_legend_handles_labels()[0])
    figure.savefig(picture := BytesIO(), dpi=DPI)
    Image.open(picture).convert("RGB").quantize(32).save(RESEARCH / "figures" / f"{name}.png", optimize=True)


if __name__ == "__main__":
    page()
