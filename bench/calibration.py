"""Calibration in physics: what robots with wrong sizes learn when they really go through the poses.

    python bench/calibration.py [key=value ...]     # overrides of the configuration, such as noise=sensors

Robots up to 2 % off in all lengths calibrate themselves on level ground: computed, as `control.calibrate=sizes` does,
and simulated, on soft drives and on the drives as they are. Errors are root mean squares over the robots, of the sizes
in %.
"""

import dataclasses
import sys

import numpy as np
import pandas as pd

from sweep.controllers.calibration import names
from sweep.engines import devices, make
from sweep.metrics.outcome import classify
from sweep.models.case import Case
from sweep.study.config import compose

ROBOTS, SPREAD = 16, 0.02
STAND = ("scenario=walk_tripod", "manoeuvre=stand", "manoeuvre.duration=0.1")
WAYS = {
    "computed": ("control=calibrate",),
    "simulated, `mjx`": ("control=calibrate_simulated",),
    "simulated, `native`": ("control=calibrate_simulated", "engine=native"),
    "the same, drives as they are": (
        "control=calibrate_simulated",
        "engine=native",
        "control.stiffness=${drive.stiffness}",
        "control.damping=${drive.damping}",
    ),
}


def row(overrides: list[str], world_of: Case) -> dict[str, float]:
    """Errors of what is learned, the largest slip in the poses (mm), and the share that went through them (%)."""
    exp = compose([*STAND, *overrides])
    world = dataclasses.replace(exp.case, robot=world_of.robot)
    engine = make(dataclasses.replace(exp.settings, width=ROBOTS), exp.case, exp.case, exp.thresholds)
    figures = engine.run(world, exp.case, np.arange(ROBOTS))
    cause = classify(figures, exp.thresholds, engine.stages)["cause"]
    errors = {
        f"{name}_%": 100 * rms(figures[f"learned_{name}_m"] / getattr(world.robot, name) - 1)
        for name in names(world.robot)
    }
    if "calibration_slip_max_m" not in figures:
        return errors
    slip, done = figures["calibration_slip_max_m"], cause != "uncalibrated"
    return {**errors, "slip_max_mm": 1e3 * float(slip.max()), "calibrated_%": 100 * float(np.mean(done))}


def rms(values: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def main(overrides: list[str]) -> None:
    """Print the table."""
    case, random = compose([*STAND]).case, np.random.default_rng(0)
    true = {n: getattr(case.robot, n) * random.uniform(1 - SPREAD, 1 + SPREAD, ROBOTS) for n in names(case.robot)}
    world = dataclasses.replace(case, robot=dataclasses.replace(case.robot, **true))
    before = {f"{name}_%": 100 * rms(getattr(case.robot, name) / value - 1) for name, value in true.items()}
    rows = {"before": before} | {way: row([*words, *overrides], world) for way, words in WAYS.items()}
    print(pd.DataFrame(rows).T.to_markdown(floatfmt=".3g"))


if __name__ == "__main__":
    devices.configure()
    main(sys.argv[1:])
