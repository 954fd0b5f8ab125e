"""Simulation speed of scenarios: simulated seconds in the middle of a batch.

To run: `python bench/scenarios.py [WIDTH [NAME...]]`, from a checkout. Friction varies over the batch. Overrides follow
a name's comma: `walk_tripod,engine.compiler=xla`.
"""

import sys
import time
from dataclasses import replace

import jax
import numpy as np

from sweep.backends import devices, program_cache
from sweep.config.experiment import compose
from sweep.engines.mjx import MjxEngine

NAMES = ("walk_tripod", "pole_climb", "ball_balance", "ball_to_ball")
SECONDS = 5  # simulated seconds, of which the first is not timed


def speed(name: str, width: int) -> str:
    """Return the physics steps a second of a batch of `width` rollouts (0: the device's best)."""
    scenario, *overrides = name.split(",")
    exp = compose([f"scenario={scenario}", *overrides])
    settings = replace(exp.settings, width=width or devices.default_batch_width())
    engine = MjxEngine(settings, exp.case, exp.case, exp.thresholds)
    world = replace(exp.case, contact=replace(exp.case.contact, friction=np.linspace(0.6, 1.0, settings.width)))
    with program_cache.disable_compilation_caches():
        start = time.perf_counter()
        (world, belief, keys), programs, *_ = engine._prepare(
            world, exp.case, np.zeros(settings.width, int), None, 1, None
        )
        compiled = time.perf_counter() - start
    plans, carry = programs.make_initial_batch(world, belief, keys)
    walls = []
    for k in range(SECONDS):
        start = time.perf_counter()
        carry, _ = programs.simulate_chunk(world, belief, plans, carry, k * engine._chunk_ticks, None)
        jax.block_until_ready(carry)
        walls.append(time.perf_counter() - start)
    rate = settings.width / settings.time_step / np.median(walls[1:])
    return f"{name}: {rate / 1e6:.3g} M env-steps/s, {settings.iterations} iterations, compile {compiled:.0f} s"


def main(width: str = "0", *names: str) -> None:
    """Print one line for each scenario."""
    devices.configure_jax()
    for name in names or NAMES:
        print(speed(name, int(width)), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
