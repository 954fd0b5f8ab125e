"""Draws docs/figures/robustness_*.png and prints the tables of docs/robustness.md from the folders of its studies.

python docs/robustness_figures.py results/robustness_walk results/robustness_pole
python docs/robustness_figures.py --bounds results/*_robustness results/*_robustness_learn
"""

import sys
from pathlib import Path

import pandas as pd

from sweep.analysis import sensitivity
from sweep.report.exhibits import effects
from sweep.runs import results
from sweep.runs.results import Results

FIGURES = Path(__file__).parent / "figures"
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
BOUNDS = {  # columns of the table of bounds: title, unit in which an error is told, value without it
    "axis.size_error": ("sizes, masses, %", 100, 0.0),
    "axis.ground_error": ("ground, %", 100, 0.0),
    "noise.position_noise": ("position, noise, mm", 1000, 0.0),
    "noise.position_bias": ("bias, mm", 1000, 0.0),
    "noise.orientation_noise": ("attitude, noise, mrad", 1000, 0.0),
    "noise.orientation_bias": ("bias, mrad", 1000, 0.0),
    "noise.joint_bias": ("joints, bias, mrad", 1000, 0.0),
    "noise.delay": ("delay, ms", 4, 0.0),
    "noise.load_noise": ("load, noise, N", 1, 0.0),
    "noise.load_delay": ("delay, ms", 4, 0.0),
    "axis.friction": ("friction less by, %", 100, 0.0),
    "world.execution.torque_scale": ("torque limit less by, %", 100, 1.0),
}
WANTED = 0.9  # share of rollouts that are to succeed
RATES = Path(__file__).parent / "examples" / "robustness_rates.csv"


def table(found: Results) -> str:
    """Rates along each error in Markdown."""
    lines = ["| error | succeed, % |", "|:--|:--|"]
    rates = sensitivity.along(found.rows, found.exp)
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


def bounds(folders: list[str]) -> None:
    """Put these studies in `RATES`, in the place of the same errors of a scenario and robot; print all bounds."""
    rates = pd.read_csv(RATES)
    for folder in folders:
        found = results.read(Path(folder))
        control = found.exp.case.control
        learns = "learns" if control.touch != "none" else "calibrates" if control.calibrate != "none" else "believes"
        new = sensitivity.along(found.rows, found.exp)
        same = (rates["scenario"] == found.exp.scenario) & (rates["robot"] == learns) & rates["axis"].isin(new["axis"])
        new = new.assign(scenario=found.exp.scenario, robot=learns, commit=found.stored["commit"])
        rates = pd.concat([rates[~same], new[rates.columns]])
    rates.sort_values(["scenario", "robot"], kind="stable").to_csv(RATES, index=False, float_format="%.4g")
    print("| | robot | " + " | ".join(title for title, *_ in BOUNDS.values()) + " |")
    print("|:--|:--|" + ":--|" * len(BOUNDS))
    for (scenario, robot), of_one in rates.groupby(["scenario", "robot"]):
        along = dict(list(of_one.groupby("axis")))
        cells = [bound(along[axis], *how) if axis in along else "" for axis, (_, *how) in BOUNDS.items()]
        print(f"| `{scenario}` | {robot} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    if sys.argv[1] == "--bounds":
        bounds(sys.argv[2:])
        sys.exit()
    for folder in sys.argv[1:]:
        study = results.read(Path(folder))
        (exhibit,) = effects(study)
        exhibit.draw().savefig(FIGURES / f"{study.name}.png", dpi=110)
        print(f"{study.name}: {len(study.rows)} rollouts at commit {study.stored['commit']}\n\n{table(study)}\n")
