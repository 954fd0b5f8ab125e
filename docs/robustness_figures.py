"""Draws docs/figures/robustness_*.png and prints the tables of docs/robustness.md from the folders of both studies.

python docs/robustness_figures.py results/robustness_walk results/robustness_pole
"""

import sys
from pathlib import Path

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
    "world.execution.torque_scale": ("torque limit, % of the believed one", 100),
}


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


if __name__ == "__main__":
    for folder in sys.argv[1:]:
        study = results.read(Path(folder))
        (exhibit,) = effects(study)
        exhibit.draw().savefig(FIGURES / f"{study.name}.png", dpi=110)
        print(f"{study.name}: {len(study.rows)} rollouts at commit {study.stored['commit']}\n\n{table(study)}\n")
