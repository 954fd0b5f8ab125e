"""Speed and agreement of the engine `kernel`: `python bench/own_kernel.py [WIDTH [AGAIN]]`, on a CPU or an NVIDIA GPU.

Rollouts of a second of several robots, with all metrics, of different masses and frictions. Results that
research/own_models.md cites are written to research/data/own_kernel.json: the time of physics, controllers and metrics
without that of the start; accelerations beside C MuJoCo's; and metrics beside those of `native` of AGAIN rollouts.
"""

import contextlib
import json
import sys
import tempfile
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

from sweep.backends import devices
from sweep.cli.main import main as sweep
from sweep.core import provenance
from sweep.core.files import write_atomically
from sweep.systems.mujoco_model import build_nominal, kernel_engine
from sweep.systems.mujoco_model.model_spec import SideValues

DATA = Path(__file__).parents[1] / "research/data/own_kernel.json"
TROT = {"controller": "trot:policy", "observe": ["turn", "spin"], "keyframe": "home", "sensors": "current"}
FEET = ["lf_touch", "rf_touch", "lh_touch", "rh_touch"]
RUB = ('damping="0.2"', 'damping="0.2" frictionloss="0.3"')
CONE = ('iterations="10" ls_iterations="20"', 'iterations="100" ls_iterations="50" cone="elliptic" impratio="10"')
ROBOTS: dict[str, tuple[tuple[tuple[str, str], ...], list[str]]] = {  # changes of the template's quadruped; its feet
    "quadruped": ((), FEET),
    "quadruped, metrics of feet left out": ((), []),
    "quadruped, friction of joints": ((RUB,), FEET),
    "quadruped, friction of joints, elliptic cones": ((RUB, CONE), FEET),
}


def make_engine(name: str, model: dict[str, Any], width: int) -> Any:
    """Make an engine of a model."""
    settings = {"name": name, "width": width, "cross_check": False}
    about = {"period": 0.02, "duration": 1.0, **model}
    system, settings, *_ = build_nominal(
        {"model": about, "engine": settings, "outcome": {"fell": "tilt_max_deg > 60"}}, {}
    )
    return system.make_engine(settings, *system.make_world_and_belief({}), limits=None)


def vary_robot(n: int) -> SideValues:
    """Return worlds whose loads and grounds differ."""
    load, grip = np.linspace(6.0, 10.0, n), np.linspace(0.5, 1.0, n)
    return SideValues((("model.body.trunk.mass", load), ("model.geom.floor.friction.slide", grip)))


def measure_speed(engine: Any, world: SideValues, n: int) -> tuple[float, float]:
    """Return physics steps a second of a second launch of 25 ticks, and the seconds to compile and run the first."""
    with engine._within():
        _, _, varied, inputs, carry, _, _ = engine._start(world, SideValues(), np.arange(n))
        kind = kernel_engine._CpuRunner if jax.default_backend() == "cpu" else kernel_engine._GpuRunner
        walls, begin = [], time.perf_counter()
        runner = kind(partial(engine._compile, varied), inputs, carry, n, np.zeros(0, int))
        for first in (0, 25):
            runner.advance(first, 25)
            runner.observable()
            walls.append(time.perf_counter() - begin)
            begin = time.perf_counter()
    return n * 25 * engine._substeps / walls[1], walls[0]


def compare_robots(width: int, again: int) -> Iterator[list[str]]:
    """Yield a table line for each robot."""
    yield ["robot", "joints", "accelerations beside C MuJoCo", "M steps/s", "first launch, s",
           "way beside `native`, mm: median, 90 % within", "on `native`"]  # fmt: skip
    text = Path("quadruped.xml").read_text(encoding="utf-8")
    for k, (robot, (changes, feet)) in enumerate(ROBOTS.items()):
        changed = text
        for old, new in changes:
            changed = changed.replace(old, new)
        Path(f"robot{k}.xml").write_text(changed, encoding="utf-8")
        model = {"mjcf": f"robot{k}.xml", "feet": feet, **TROT}
        world, few = vary_robot(width), vary_robot(again)
        engine = make_engine("kernel", model, width)
        speed, first = measure_speed(engine, world, width)
        streams = np.arange(again)
        here = make_engine("kernel", model, again).run(few, SideValues(), streams)
        there = make_engine("native", model, again).run(few, SideValues(), streams)
        apart = 1e3 * np.abs(here["travelled_m"] - there["travelled_m"])
        yield [
            robot,
            str(engine._model.njnt - 1),
            f"{engine.c_mujoco_agreement.largest:.0e}",
            f"{speed / 1e6:.0f}" if speed > 1e7 else f"{speed / 1e6:.2f}",
            f"{first:.1f}",
            f"{np.median(apart):.1g}, {np.quantile(apart, 0.9):.1g}",
            f"{int(here['on_native'].sum())} of {again}",
        ]


def main(width: str = "0", again: str = "256") -> None:
    """Measure all robots, and write the table."""
    n = int(width) or (131072 if jax.default_backend() == "gpu" else 1024)
    with tempfile.TemporaryDirectory() as place:
        sweep(["init", "--model", f"{place}/quad"])
        with contextlib.chdir(f"{place}/quad"):
            lines = [*compare_robots(n, int(again))]
    device = jax.devices()[0].device_kind if jax.default_backend() == "gpu" else f"CPU, {devices.count_cores()} cores"
    about = {"command": f"python bench/own_kernel.py {n} {again}", "engine": "kernel", "devices": [f"1 x {device}"]}
    about |= {**provenance.version_record(), "seconds": "", "tables": {"robots": lines}}
    write_atomically(DATA, (json.dumps(about, indent=1, ensure_ascii=False) + "\n").encode())


if __name__ == "__main__":
    main(*sys.argv[1:])
