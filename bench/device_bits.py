"""Rows of a CPU and a GPU that are equal to the last bit: `python bench/device_bits.py [SCENARIO...]`.

It writes research/data/device_bits.json, which research/reliability.md cites. Each scenario is simulated with random
errors on both devices, in three ways. As it is, a GPU also computes plans, start states and final metrics, with XLA.
With plans on the host, NumPy computes them for both devices. Without fused multiply-add, both compilers round each
product before a sum takes it. The columns over time of the first rollouts show in which tick, and in which quantity, a
difference arises.
"""

import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd
import shared

from sweep.runs import store
from sweep.study.columns import LABEL_COLUMNS, PLACEMENT_COLUMNS, TIMING_COLUMNS

Table = list[list[str]]  # columns, then rows

SCENARIOS = ("walk_tripod", "pole_climb", "ball_balance")
ROWS, WATCHED, RATE = (
    int(os.environ.get("BITS_ROWS", "4096")),
    64,
    250,
)  # rollouts, those with histories, samples a second
PLATFORMS = {"cpu": "cpu", "gpu": "cuda"}
WAYS = {  # by name: ways of the CPU and the GPU
    "as it is": ("as_is", "as_is"),
    "plans on the host": ("as_is", "host"),
    "plans on the host, no fused multiply-add": ("no_fma", "host_no_fma"),
}
RUNS = [("cpu", "as_is"), ("cpu", "no_fma"), ("gpu", "as_is"), ("gpu", "host"), ("gpu", "host_no_fma")]
WIDTHS = {"cpu": 1024, "gpu": int(os.environ.get("BITS_WIDTH", "131072"))}  # rollouts of a batch that is timed
SAMPLE = re.compile(r"^(qpos|qvel|torque_peak|force|load|base|tilt)")  # columns of histories, by quantity


def change_way(way: str) -> None:
    """Change this process's compiler or planner, as a way asks."""
    from sweep.backends import devices
    from sweep.fused import text

    if "host" in way:
        devices.NUMPY_WIDTH = 10**9  # pyright: ignore[reportAttributeAccessIssue]
    if "no_fma" in way:
        for op in ("add", "sub", "mul"):
            text.FLOAT_INSTRUCTIONS[op] = f"f{op}"


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


def bit_equal(a: pd.DataFrame, b: pd.DataFrame) -> np.ndarray:
    """Return which numbers (n, k) of two tables with equal columns are equal to the last bit; NaN equals NaN."""
    return ((a == b) | (a.isna() & b.isna())).to_numpy()


def compare_rows(a: Path, b: Path) -> tuple[int, int, int]:
    """Count bit-equal rows and equal outcomes of two folders, and all rows."""
    first, second = (store.read_rows(folder).set_index("point_id").sort_index() for folder in (a, b))
    left_out = (*PLACEMENT_COLUMNS, *LABEL_COLUMNS, *TIMING_COLUMNS)
    names = [c for c in first.columns if c not in left_out and "." not in c]
    equal = bit_equal(first[names], second[names]).all(axis=1)
    return int(equal.sum()), int((first["outcome"] == second["outcome"]).sum()), len(first)


def read_histories(folder: Path) -> pd.DataFrame:
    """Read the columns over time of the first rollouts."""
    listed = store.list_recordings(folder, store.HISTORIES_FOLDER)
    return pd.concat([pd.read_parquet(folder / entry.file) for entry in listed])


def first_differences(a: Path, b: Path) -> tuple[str, str, str]:
    """Describe where histories differ first: rollouts that ever differ, the median time, and the quantities then."""
    first, second = (read_histories(folder).set_index(["point_id", "time_s"]).sort_index() for folder in (a, b))
    both = first.index.intersection(second.index)
    names = [c for c in first.columns if SAMPLE.match(c)]
    differs = ~bit_equal(first.loc[both, names], second.loc[both, names])
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


def main(*scenarios: str) -> None:
    """Simulate the scenarios in all ways, and write the tables."""
    start = time.perf_counter()
    rows: Table = [["scenario", "way", "rows bit-equal", "outcomes equal", "rollouts that ever differ",
                    "first difference (median)", "quantities that differ then (rollouts)"]]  # fmt: skip
    speed: Table = [["scenario", "device", "as it is", "no fused multiply-add"]]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for scenario in scenarios or SCENARIOS:
            started = [
                start_process(folder, device, way, "--simulate",
                              study_arguments(folder / f"{scenario}-{device}-{way}", scenario))
                for device, way in RUNS
            ]  # fmt: skip
            for process in started:
                process.communicate()
                if process.returncode not in (0, 3, 4):
                    raise SystemExit(f"{scenario} failed; set BITS_LOUD=1")
            for way, (on_cpu, on_gpu) in WAYS.items():
                a, b = folder / f"{scenario}-cpu-{on_cpu}", folder / f"{scenario}-gpu-{on_gpu}"
                equal, outcomes, every = compare_rows(a, b)
                told = first_differences(a, b)
                rows.append([f"`{scenario}`", way, f"{equal} of {every}", f"{outcomes} of {every}", *told])
                print(rows[-1], flush=True)
            for device, width in WIDTHS.items():
                told = []
                for way in ("as_is", "no_fma"):
                    text, _ = start_process(folder, device, way, "--speed", [scenario, str(width)]).communicate()
                    told.append(text.strip().partition(": ")[2].partition(",")[0])
                speed.append([f"`{scenario}`", device, *told])
                print(speed[-1], flush=True)
    shared.write_tables("device_bits", ("mjx",), start, {"rows": rows, "speed": speed})


if __name__ == "__main__":
    if sys.argv[1:2] in (["--simulate"], ["--speed"]):
        change_way(sys.argv[2])
        sys.exit(simulate(sys.argv[3:]) if sys.argv[1] == "--simulate" else print_speed(*sys.argv[3:]))
    main(*sys.argv[1:])
