"""GPU kernels for few and for many rollouts: compile time of the driver, speed, and bit equality.

To run: `python bench/kernels.py NAME WIDTH...`, on one GPU. Friction varies evenly from 0.9 to 1.2. NumPy makes the
plans at any width; they are not included in the times.
"""

import sys
import time
from dataclasses import replace
from typing import Any

import jax
import numpy as np

from sweep.backends import devices, program_cache
from sweep.config.experiment import Experiment, compose
from sweep.engines.mjx import MjxEngine
from sweep.fused import driver, launch
from sweep.systems.hexapod import replace_parameter

COMPILED, TRANSLATED = launch.compile_to_ptx, driver._translate
Figures = dict[str, np.ndarray]


def with_timer(function: Any, took: list[float]) -> Any:
    """Wrap a function so that it appends its seconds, until its results are ready, to `took`."""

    def wrapped(*given: Any) -> Any:
        began = time.perf_counter()
        result = jax.block_until_ready(function(*given))
        took.append(time.perf_counter() - began)
        return result

    return wrapped


def measure_kernel(exp: Experiment, width: int, few: bool) -> tuple[Figures, list[str]]:
    """Return metrics, and cells: MB of PTX, seconds of driver and rollouts, millions of steps a second."""
    driven, planned, texts = [], [], []
    driver._machine_code.clear()
    driver._translate = with_timer(lambda text: texts.append(text) or TRANSLATED(text), driven)
    launch.compile_to_ptx = lambda *given, **named: COMPILED(*given, **{**named, "small_batch": few})
    world, streams = replace_parameter(exp.case, "contact.friction", np.linspace(0.9, 1.2, width)), np.arange(width)
    engine = MjxEngine(replace(exp.settings, width=width), exp.case, exp.case, exp.thresholds)
    with program_cache.disable_compilation_caches():
        engine.run(world, exp.case, streams)
        ((form, programs),) = engine._programs.items()
        engine._programs[form] = programs._replace(start=with_timer(programs.start, planned))
        began = time.perf_counter()
        figures = engine.run(world, exp.case, streams)
        seconds = time.perf_counter() - began - planned[0]
    steps = width * float(np.max(figures["duration_s"])) / exp.settings.time_step
    cells = len(texts[0]) / 1e6, driven[0], seconds, steps / seconds / 1e6
    return figures, [f"{x:.3g}" for x in cells]


def main(name: str, *widths: str) -> None:
    """Print two lines for each width."""
    devices.NUMPY_WIDTH = 1 << 30
    exp = compose([f"scenario={name}"])
    print("| scenario | rollouts | kernel for | PTX MB | driver s | rollouts s | M env-steps/s | figures unlike |")
    print("|---|--:|---|--:|--:|--:|--:|--:|")
    for width in map(int, widths):
        of: dict[str, Figures] = {}
        for kind in ("many", "few"):
            of[kind], cells = measure_kernel(exp, width, kind == "few")
            unlike = sum(
                int(np.sum(~np.isclose(x, of["many"][key], 0, 0, equal_nan=True))) for key, x in of[kind].items()
            )
            print(f"| `{name}` | {width:,} | {kind} | {' | '.join(cells)} | {unlike} |", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
