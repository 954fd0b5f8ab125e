"""Accuracy of calibration in simulated physics, for robots with wrong sizes: `python bench/calibration.py`.

Robots with lengths up to 2 % off calibrate on level ground: computed, as by `control.calibrate=sizes`, and simulated,
with soft drives and with the drives as they are. Errors are root mean squares of the sizes over the robots, in %. It
writes research/data/calibration.json, cited by research/learning.md.
"""

import dataclasses
import time

import numpy as np
import shared

from sweep.backends import devices
from sweep.config.experiment import compose
from sweep.engines import make_engine
from sweep.estimation.calibration import learnable_sizes
from sweep.metrics.outcome import classify
from sweep.models.case import Case

ROBOTS, SPREAD = 16, 0.02
STAND = ("scenario=walk_tripod", "manoeuvre=stand", "manoeuvre.duration=0.1")
COMPUTED, SIMULATED = ("control=calibrate",), ("control=calibrate_simulated",)
STIFF = ("control.stiffness=${drive.stiffness}", "control.damping=${drive.damping}")
EXACT, SENSORS = (), ("noise=sensors",)
OFF = (*SENSORS, "noise.position_bias=0.005", "noise.orientation_bias=0.005")
RUNS = (
    ("exact", EXACT, "computed", COMPUTED),
    ("exact", EXACT, "simulated, `mjx`", SIMULATED),
    ("`sensors`", SENSORS, "computed", COMPUTED),
    ("`sensors`", SENSORS, "simulated, `mjx`", SIMULATED),
    ("`sensors`", SENSORS, "simulated, `native`", (*SIMULATED, "engine=native")),
    ("`sensors`", SENSORS, "the same, drives as they are", (*SIMULATED, "engine=native", *STIFF)),
    ("`sensors`, base 5 mm and 5 mrad off", OFF, "computed", COMPUTED),
)


def row(overrides: tuple[str, ...], world_of: Case) -> list[str]:
    """Return errors of the learned sizes (%), the largest slip in the poses (mm), and how many robots finished."""
    exp = compose([*STAND, *overrides])
    world = dataclasses.replace(exp.case, robot=world_of.robot)
    engine = make_engine(dataclasses.replace(exp.settings, width=ROBOTS), exp.case, exp.case, exp.thresholds)
    figures = engine.run(world, exp.case, np.arange(ROBOTS))
    cause = classify(figures, exp.thresholds, engine.stages)["cause"]
    errors = [
        rms(figures[f"learned_{name}_m"] / getattr(world.robot, name) - 1) for name in learnable_sizes(world.robot)
    ]
    if "calibration_slip_max_m" not in figures:
        return [*errors, "", ""]
    slip, done = figures["calibration_slip_max_m"], cause != "uncalibrated"
    return [*errors, f"{1e3 * float(slip.max()):.3g}", f"{int(np.sum(done))} of {ROBOTS}"]


def rms(errors: np.ndarray) -> str:
    """Format the root mean square, in %."""
    return f"{100 * float(np.sqrt(np.mean(np.square(errors)))):.2g}"


def main() -> None:
    """Compute, print and write the table."""
    start = time.perf_counter()
    case, random = compose([*STAND]).case, np.random.default_rng(0)
    sizes = learnable_sizes(case.robot)
    true = {n: getattr(case.robot, n) * random.uniform(1 - SPREAD, 1 + SPREAD, ROBOTS) for n in sizes}
    world = dataclasses.replace(case, robot=dataclasses.replace(case.robot, **true))
    before = [rms(getattr(case.robot, name) / value - 1) for name, value in true.items()]
    rows = [["", "before", *before, "", ""]]
    for sensors, noise, way, control in RUNS:
        rows.append([sensors, way, *row((*control, *noise), world)])
        print(*rows[-1], flush=True)
    heads = [
        "sensors",
        "sizes",
        *(f"{name.replace('_', ' ')}, %" for name in sizes),
        "slip, mm",
        "go through the poses",
    ]
    shared.write_tables("calibration", ("mjx", "native"), start, {"errors": [heads, *rows]})


if __name__ == "__main__":
    devices.configure_jax()
    main()
