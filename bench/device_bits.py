"""Rows of a CPU and a GPU that are equal to the last bit: `python bench/device_bits.py [SCENARIO...]`.

It writes research/data/device_bits.json, which research/decisions.md cites; scenarios of another call stay in it.
First, single functions of a kernel are evaluated on both devices, and results that differ are counted. Then each
scenario is simulated with random errors on both devices, in several ways, of which each removes a difference between
their programs: plans on the host (else XLA computes plans, start states and final metrics of a GPU), no fused
multiply-add, sums over the legs in one order, quotients and roots by the GPU's own IEEE instructions. The columns over
time of the first rollouts show in which tick, and in which quantity, a difference arises.
"""

import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import shared
from reproducibility import bit_equal

from sweep.analysis import compare
from sweep.backends.run_id import describe_device
from sweep.contract.engine_settings import EngineSettings
from sweep.core.provenance import version_record
from sweep.fused import lanes
from sweep.runs import store

SCENARIOS = ("walk_tripod", "pole_climb", "ball_balance")
ROWS, WATCHED = int(os.environ.get("BITS_ROWS", "4096")), 64  # rollouts, and those with histories
RATE = 250  # samples of a history a second
PLATFORMS = {"cpu": "cpu", "gpu": "cuda"}
ALIKE = "host,no_fma,in_order,ieee"  # a GPU without any known difference
WAYS = {  # by name: ways of the CPU and the GPU
    "as it is": ("", ""),
    "plans on the host": ("", "host"),
    "and no fused multiply-add": ("no_fma", "host,no_fma"),
    "and sums over legs in one order": ("no_fma", "host,no_fma,in_order"),
    "and IEEE quotients and roots": ("no_fma", ALIKE),
}
RUNS = [*dict.fromkeys(("cpu", cpu) for cpu, _ in WAYS.values()), *(("gpu", gpu) for _, gpu in WAYS.values())]
SPEEDS = {"as it is": ("", ""), "no fused multiply-add": ("no_fma", "no_fma"),
          "nothing that differs": ("no_fma", ALIKE)}  # fmt: skip
ONE_THREAD = lanes.RolloutPerThreadSection._item  # as it is
FILE = shared.DATA / "device_bits.json"
INPUTS = int(os.environ.get("BITS_INPUTS", "1000000"))  # of each function
WIDTHS = {"cpu": 1024, "gpu": int(os.environ.get("BITS_WIDTH", "131072"))}  # rollouts of a batch that is timed
SAMPLE = re.compile(r"^(qpos|qvel|torque_peak|force|load|base|tilt)")  # columns of histories, by quantity


def change_way(way: str) -> None:
    """Change this process's compiler or planner, as a way asks."""
    from sweep.backends import devices
    from sweep.fused import cuda, text

    if "host" in way:
        devices.NUMPY_WIDTH = 10**9  # pyright: ignore[reportAttributeAccessIssue]
    if "no_fma" in way:
        for op in ("add", "sub", "mul"):
            text.FLOAT_INSTRUCTIONS[op] = f"f{op}"
    if "in_order" in way:
        cuda.GpuKernelPrinter._over_legs = sum_lanes_in_order  # pyright: ignore[reportAttributeAccessIssue]
        lanes.RolloutPerThreadSection._item = sum_legs_in_order  # pyright: ignore[reportAttributeAccessIssue]
    if "ieee" in way:
        printer, common = cuda.GpuKernelPrinter, text.LlvmFunctionPrinter
        printer._quotient = lambda self, a, b: self.emit(f"fdiv float {a}, {b}")
        printer._root = lambda self, x: self.call_intrinsic("sqrt", "float32", [x])
        printer.print_max_or_min = common.print_max_or_min  # of zeros with two signs, a CPU's is the second


def sum_lanes_in_order(printer: Any, node: Any) -> str:
    """Print a reduction over the legs of a warp's lanes in the order of a CPU."""
    value, op, dtype = printer.value_name(node.args[0]), node.extra.op, node.dtype
    total = printer._shuffle(value, dtype, printer._lane(0))
    for k in range(1, printer.group):
        one = printer._shuffle(value, dtype, printer._lane(k))
        total = printer.print_arithmetic(op, dtype, [total, one], [dtype] * 2)
    return total


def sum_legs_in_order(section: Any, item: Any, needed: set[int]) -> list[Any]:
    """Make the operations of one thread for an item, with reductions over the legs in the order of a CPU."""
    if getattr(item, "op", None) != "over_legs":
        return ONE_THREAD(section, item, needed)
    legs, made = section.nodes_by_leg(item.args[0]), []
    for k in range(1, section.group):
        made.append(section._node(item, item.extra.op, (made[-1] if made else legs[0], legs[k]), None, k))
    section.made[item.number] = made[-1:]
    return made


def function_values(a: Any, b: Any, angle: Any, share: Any, legs: Any) -> dict[str, Any]:
    """Return what single functions give: of two numbers, an angle, a number from -1 to 1, and six numbers."""
    return {
        "a / b": a / b, "sqrt(a)": jnp.sqrt(jnp.abs(a)), "a * b": a * b, "a * b + a": a * b + a,
        "a * b + angle * share": a * b + angle * share, "sum over six legs": jnp.sum(legs),
        "largest of six legs": jnp.max(legs), "sin": jnp.sin(angle), "cos": jnp.cos(angle), "tan": jnp.tan(angle),
        "atan2": jnp.arctan2(a, b), "acos": jnp.arccos(share), "asin": jnp.arcsin(share), "exp": jnp.exp(angle),
        "log": jnp.log(jnp.abs(a)), "erf_inv": jax.lax.erf_inv(share), "remainder": jax.lax.rem(a, b),
    }  # fmt: skip


def evaluate_functions(file: str) -> int:
    """Evaluate the functions on this process's device: by a kernel, and outside of it by XLA or NumPy; store both."""
    from sweep.backends import devices
    from sweep.fused import eager, kernel, launch

    devices.configure_jax()
    rng = np.random.default_rng(0)
    numbers = (rng.lognormal(0, 3, (2, INPUTS)) * rng.choice([-1, 1], (2, INPUTS))).astype(np.float32)
    legs = rng.lognormal(0, 3, (INPUTS, 6)) * rng.choice([-1, 1], (INPUTS, 6))
    rest = rng.uniform(-60, 60, INPUTS), rng.uniform(-1, 1, INPUTS), legs
    given = [*numbers, *(x.astype(np.float32) for x in rest)]
    one: Any = [jax.ShapeDtypeStruct(x.shape[1:], x.dtype) for x in given]
    start = {"over": np.zeros(INPUTS, bool)}
    start |= {name: np.zeros(INPUTS, np.float32) for name in jax.eval_shape(function_values, *one)}
    like = jax.tree.map(lambda x: jax.ShapeDtypeStruct((), x.dtype), start)

    def tick(given: Any, carry: Any, _: Any) -> Any:
        return {"over": carry["over"], **function_values(*given)}, {}

    if jax.default_backend() == "cpu":
        tiles = kernel.Kernel(kernel.compile_function(tick, one, like)).load_batch(given, start, INPUTS)
        tiles.advance_ticks(0, 1)
        within = tiles.read_full_state()
        outside = eager.trace_numpy_program(function_values, *one)(INPUTS, *given)
    else:
        code = launch.compile_to_ptx(tick, one, like, lambda carry: carry["over"], 1, 0, INPUTS)
        run = jax.jit(lambda given, carry: launch.run_kernel(code, given, carry, jnp.int32(0), None))
        within, _ = run(given, start)
        outside = jax.jit(jax.vmap(function_values))(*given)
    both: Any = {}
    for name in outside:
        both |= {f"kernel {name}": np.asarray(within[name]), f"outside {name}": np.asarray(outside[name])}
    np.savez(file, **both)
    return 0


def count_different_values(folder: Path) -> shared.Table:
    """Evaluate single functions on both devices; return how many of their results differ, by function."""
    ways = {"as it is": ("", ""), "no fused multiply-add": ("no_fma", "no_fma"), "all alike": ("no_fma", ALIKE)}
    files = {}
    for device, way in dict.fromkeys((d, pair[k]) for pair in ways.values() for k, d in enumerate(PLATFORMS)):
        files[device, way] = folder / f"{device}-{way}.npz"
        wait_for(start_process(folder, device, way, "--functions", [str(files[device, way])]))
    stored = {key: dict(np.load(file)) for key, file in files.items()}

    def count(name: str, on_cpu: str, on_gpu: str) -> str:
        a, b = stored["cpu", on_cpu][name], stored["gpu", on_gpu][name]
        return f"{int(((a != b) & ~(np.isnan(a) & np.isnan(b))).sum()):,}"

    table = [["function", *(f"kernels, {way}" for way in ways), "NumPy and the GPU's XLA"]]
    names = [name.removeprefix("kernel ") for name in stored["cpu", ""] if name.startswith("kernel ")]
    for name in names:
        counts = [count(f"kernel {name}", *pair) for pair in ways.values()]
        table.append([f"`{name}`", *counts, count(f"outside {name}", "", "")])
    return table


def simulate(arguments: list[str]) -> int:
    """Run `sweep run` in this process; return its exit code."""
    from sweep.cli.main import main as run_command

    return run_command(["run", *arguments])


def print_speed(scenario: str, width: str) -> int:
    """Print the physics steps a second of a scenario, compiled in this process."""
    import scenarios

    from sweep.backends import devices

    devices.configure_jax()
    print(scenarios.speed(scenario, int(width)))
    return 0


def start_process(folder: Path, device: str, way: str, what: str, arguments: list[str]) -> subprocess.Popen:
    """Start this script in a process with one kind of device and a program cache of its own."""
    environment = {"JAX_PLATFORMS": PLATFORMS[device], "XDG_CACHE_HOME": str(folder / f"cache-{device}-{way}"),
                   "XLA_PYTHON_CLIENT_PREALLOCATE": "false"}  # fmt: skip
    return subprocess.Popen(
        [sys.executable, __file__, what, way, *arguments],
        env=os.environ | environment,
        stdout=subprocess.PIPE,
        stderr=None if "BITS_LOUD" in os.environ else subprocess.DEVNULL,
        text=True,
    )


def study_arguments(folder: Path, scenario: str) -> list[str]:
    """Return the arguments of `sweep run` for a scenario with random errors and histories."""
    columns = ",".join(recorded_columns(scenario))
    study = [f"scenario={scenario}", "study=any_errors", f"study.design.num={ROWS}", "study.replays=0"]
    return [*study, f"study.keep=[{columns}]", f"study.keep_rate={RATE}", f"study.keep_rows={WATCHED}", f"out={folder}"]


def recorded_columns(scenario: str) -> list[str]:
    """Return the columns over time that a scenario can record."""
    from sweep.config.experiment import compose

    return [*compose([f"scenario={scenario}"]).system.recordable_columns]


def compare_rows(a: Path, b: Path) -> tuple[int, int, int]:
    """Count bit-equal rows and equal outcomes of two folders, and all rows."""
    pairs = compare.pair_rows(store.read_rows(a), store.read_rows(b))
    alike = ~compare.outcome_change_mask(pairs)
    return int((compare.bit_equal_mask(pairs) & alike).sum()), int(alike.sum()), len(pairs)


def read_histories(folder: Path) -> pd.DataFrame:
    """Read the columns over time of the first rollouts."""
    listed = store.list_recordings(folder, store.HISTORIES_FOLDER)
    return pd.concat([pd.read_parquet(folder / entry.file) for entry in listed])


def first_differences(a: Path, b: Path) -> tuple[str, str, str]:
    """Describe where histories differ first: rollouts that ever differ, the median time, and the quantities then."""
    first, second = (read_histories(folder).set_index(["point_id", "time_s"]).sort_index() for folder in (a, b))
    both = first.index.intersection(second.index)
    names = [c for c in first.columns if SAMPLE.match(c)]
    differs = ~bit_equal(first.loc[both, names], second.loc[both, names]).to_numpy()
    place = pd.DataFrame(
        {"id": both.get_level_values(0), "time": both.get_level_values(1), "row": np.arange(len(both))}
    )
    earliest = place[differs.any(axis=1)].groupby("id", sort=False).first()
    rollouts = place["id"].nunique()
    if earliest.empty:
        return f"0 of {rollouts}", "", ""
    quantity = pd.Series([SAMPLE.match(name)[1] for name in names])  # pyright: ignore[reportOptionalSubscript]
    found = pd.DataFrame(differs[earliest["row"]].T).groupby(quantity).any().sum(axis=1)
    told = ", ".join(f"{name} {number}" for name, number in found[found > 0].sort_values(ascending=False).items())
    return f"{len(earliest)} of {rollouts}", f"{earliest['time'].median():.3f} s", told


def wait_for(process: subprocess.Popen, scenario: str = "a function") -> str:
    """Wait for a process; return what it printed."""
    told, _ = process.communicate()
    if process.returncode not in (0, 3, 4):
        raise SystemExit(f"{scenario} failed; set BITS_LOUD=1")
    return told


def measure_scenario(scenario: str, folder: Path) -> dict[str, shared.Table]:
    """Simulate a scenario in all ways; return lines of the tables of rows and of speeds."""
    started = [
        start_process(folder, device, way, "--simulate",
                      study_arguments(folder / f"{scenario}-{device}-{way}", scenario))
        for device, way in RUNS
    ]  # fmt: skip
    for process in started:
        wait_for(process, scenario)
    rows: shared.Table = []
    speed: shared.Table = []
    for way, (on_cpu, on_gpu) in WAYS.items():
        a, b = folder / f"{scenario}-cpu-{on_cpu}", folder / f"{scenario}-gpu-{on_gpu}"
        equal, outcomes, every = compare_rows(a, b)
        rows.append([f"`{scenario}`", way, f"{equal} of {every}", f"{outcomes} of {every}", *first_differences(a, b)])
        print(rows[-1], flush=True)
    for k, (device, width) in enumerate(WIDTHS.items()):
        told = []
        for pair in SPEEDS.values():
            text = wait_for(start_process(folder, device, pair[k], "--speed", [scenario, str(width)]), scenario)
            told.append(text.strip().partition(": ")[2].partition(",")[0])
        speed.append([f"`{scenario}`", device, *told])
        print(speed[-1], flush=True)
    return {"rows": rows, "speed": speed}


def join_tables(every: shared.Scenarios) -> dict[str, shared.Table]:
    """Return the tables of all scenarios and of the functions, with their heads."""
    heads = {
        "rows": ["scenario", "way", "rows bit-equal", "outcomes equal", "rollouts that ever differ",
                 "first difference (median)", "quantities that differ then (rollouts)"],
        "speed": ["scenario", "device", *SPEEDS],
    }  # fmt: skip
    tables = {name: [head, *(row for one in every.values() for row in one.get(name, ()))]
              for name, head in heads.items()}  # fmt: skip
    return tables | {"functions": every.get("functions", {}).get("table", [])}


def main(*scenarios: str) -> None:
    """Compare functions and scenarios, by default all, and add them to the tables."""
    with tempfile.TemporaryDirectory() as name:
        for scenario in scenarios or ("functions", *SCENARIOS):
            start = time.perf_counter()
            if scenario == "functions":
                found = {"table": count_different_values(Path(name))}
                print(*found["table"], sep="\n", flush=True)
            else:
                found = measure_scenario(scenario, Path(name))
            content = {"device": describe_device(EngineSettings()), **version_record(),
                       "seconds": time.perf_counter() - start, **found}  # fmt: skip
            shared.add_scenario(FILE, scenario, content, "python bench/device_bits.py", join_tables)


if __name__ == "__main__":
    if sys.argv[1:2] in (["--simulate"], ["--speed"], ["--functions"]):
        change_way(sys.argv[2])
        told = {"--simulate": lambda *words: simulate(list(words)), "--speed": print_speed,
                "--functions": evaluate_functions}[sys.argv[1]](*sys.argv[3:])  # fmt: skip
        sys.exit(told)
    main(*sys.argv[1:])
