"""`sweep bench`: speed of the walking map by engine and dynamics, and of C MuJoCo, in one run.

The time before the second batch is measured separately, without the compilation cache: compiling, and on a GPU the
driver's translation at the first launch.
"""

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from sweep.cli.command import Command, Section
from sweep.cli.exits import DONE
from sweep.core.arguments import Arguments
from sweep.core.errors import InputError

if TYPE_CHECKING:
    from sweep.contract.engine_settings import EngineSettings
    from sweep.models.case import Case

COMMAND = Command(Section.SIMULATE, "measure the simulation speed of this machine by engine and dynamics")
ROW_NAMES = ("arrowhead", "mjx", "native")
MAX_NATIVE_ROLLOUTS = 128  # rollouts for the row of C MuJoCo, the slowest
MEASUREMENT_DESCRIPTION = (
    "walk_tripod over walk_map: controller, physics and metrics of whole rollouts; env-steps are physics steps"
)


def add_arguments(parser: Arguments) -> None:
    """Add the arguments of `sweep bench`: rollouts, batch width, and which engines are measured."""
    parser.add_argument("--rollouts", type=int, default=0, help="rollouts for each row of the table; 0: one batch")
    parser.add_argument("--width", type=int, default=0, help="rollouts in a batch; 0: best for the device")
    parser.add_argument("--rows", nargs="+", choices=ROW_NAMES, default=list(ROW_NAMES), help="which of them")


def run(args: argparse.Namespace) -> int:
    """Measure the speed of engines, and print each line as soon as it is measured, then a table."""
    from tabulate import tabulate

    from sweep.config.experiment import compose

    for name in ("rollouts", "width"):
        if getattr(args, name) < 0:
            raise InputError(f"--{name} = {getattr(args, name)} is not allowed: at least 0")
    lines = []
    for line in measure_engine_speeds(
        compose(["scenario=walk_tripod"]).case, args.rollouts, args.width, tuple(args.rows)
    ):
        print(f"{line['engine']} {line['dynamics']}: {line['env-steps/s']:.4g} env-steps/s", file=sys.stderr)
        lines.append(line)
    print(MEASUREMENT_DESCRIPTION)
    print(tabulate(lines, headers="keys", tablefmt="github", floatfmt=".4g", missingval=""))
    return DONE


def measure_engine_speeds(
    nominal: "Case", rollouts: int, width: int, rows: tuple[str, ...]
) -> Iterator[dict[str, Any]]:
    """Yield the measured speed of each engine in `rows`; width 0 is the best for the device, rollouts 0 one batch."""
    from sweep.backends import program_cache
    from sweep.contract.engine_settings import EngineSettings

    for name in rows:
        settings = EngineSettings(
            width=width if name != "native" else 0,
            dynamics="mjx" if name == "mjx" else "auto",
            name="native" if name == "native" else "mjx",
        )
        with program_cache.disable_compilation_caches():
            line = _engine(settings, nominal, rollouts)
        yield line


def make_walk_map_batches(nominal: "Case", rollouts: int, width: int) -> "list[tuple[Case, Case]]":
    """Make batches of `width` (world and belief parameters) over the grid of the study walk_map, for at least
    `rollouts` points."""
    import numpy as np

    from sweep.systems.hexapod import replace_parameter

    rows = max(1, round((rollouts * 17 / 33) ** 0.5))
    friction, ratio = np.meshgrid(np.linspace(0.05, 1.2, -(-rollouts // rows)), np.linspace(0.03, 0.2, rows))
    slots = np.minimum(np.arange(-(-rollouts // width) * width), rollouts - 1).reshape(-1, width)
    batches = []
    for batch in slots:
        belief = replace_parameter(nominal, "manoeuvre.half_step_ratio", ratio.ravel()[batch])
        world = replace_parameter(belief, "contact.friction", friction.ravel()[batch])
        batches.append((world, belief))
    return batches


def _engine(settings: "EngineSettings", nominal: "Case", rollouts: int) -> dict[str, Any]:
    """Make a function that measures whole rollouts on one engine."""
    import jax
    import numpy as np

    from sweep.engines import make_engine
    from sweep.metrics.outcome import OutcomeThresholds

    engine = make_engine(settings, nominal, nominal, OutcomeThresholds())
    rollouts = rollouts or engine.width
    if settings.name == "native":
        rollouts = min(rollouts, MAX_NATIVE_ROLLOUTS)
    batches = make_walk_map_batches(nominal, rollouts, engine.width)
    streams = np.zeros(engine.width, int)

    def simulate(batch: "tuple[Case, Case]") -> float:
        return float(np.max(engine.run(*batch, streams)["duration_s"]))

    first = measure_wall_time(lambda: simulate(batches[0]))
    start = time.perf_counter()
    seconds = sum(simulate(batch) for batch in batches)
    wall = time.perf_counter() - start
    compile_s = first - wall / len(batches)
    device, native = jax.devices()[0], settings.name == "native"
    peak = (device.memory_stats() or {}).get("peak_bytes_in_use")
    share = 1 if native else jax.device_count()
    return {
        "engine": settings.name,
        "dynamics": engine.dynamics,
        "device": f"{share} x {device.device_kind}",
        "width": engine.width,
        "env-steps/s": engine.width * seconds / settings.time_step_s / wall,
        "rollouts/s": rollouts / wall,
        # lost beside a long run whose speed is not even
        "compile and first launch s": compile_s if compile_s > 0 else None,
        "KiB/rollout": peak / (engine.width / share) / 1024 if peak and not native else None,
    }


def measure_wall_time(work: Callable[[], object]) -> float:
    """Measure the wall time of `work` (s)."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start
