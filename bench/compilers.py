"""Outcomes and causes of random draws by XLA and by the fused compiler, on the device at hand.

To run: `python bench/compilers.py [NUM [NAME...]]`, from a checkout. Friction and the mass of the body vary, unknown to
the planner. Overrides follow a name's comma: `walk_tripod,noise.position_noise=0.001`.
"""

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from sweep.backends import devices
from sweep.config.experiment import compose
from sweep.engines.mjx import MjxEngine
from sweep.metrics.outcome import classify

SCENARIOS = Path(__file__).parent.parent / "conf" / "scenario"


def flips(name: str, num: int) -> str:
    """Return a table row: how many draws differ in outcome, and in cause."""
    exp = compose([f"scenario={name.split(',')[0]}", *name.split(",")[1:]])
    rng = np.random.default_rng(1)
    contact = replace(exp.case.contact, friction=exp.case.contact.friction * rng.uniform(0.7, 1.1, num))
    robot = replace(exp.case.robot, body_mass=exp.case.robot.body_mass * rng.uniform(0.93, 1.07, num))
    world, rows, walls = replace(exp.case, contact=contact, robot=robot), {}, {}
    for compiler in ("xla", "fused"):
        start = time.perf_counter()
        engine = MjxEngine(replace(exp.settings, width=num, compiler=compiler), exp.case, exp.case, exp.thresholds)
        rows[compiler] = classify(engine.run(world, exp.case, np.arange(num)), exp.thresholds, engine.stages)
        walls[compiler] = time.perf_counter() - start
    differ = [int(np.sum(rows["xla"][key] != rows["fused"][key])) for key in ("outcome", "cause")]
    succeed = int(np.sum(rows["xla"]["outcome"] == "success"))
    return f"| {name} | {succeed} of {num} | {differ[0]} | {differ[1]} | {walls['xla']:.0f} | {walls['fused']:.0f} |"


def main(num: str = "64", *names: str) -> None:
    """Print one line for each scenario."""
    devices.configure_jax()
    print("| scenario | succeed | other outcome | other cause | XLA s | fused s |\n|---|---|---|---|---|---|")
    for name in names or sorted(path.stem for path in SCENARIOS.glob("*.yaml")):
        print(flips(name, int(num)), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
