"""Bit equality of rows and metrics that are simulated in other ways, compared with what `run_id` promises.

    python bench/reproducibility.py        # some minutes: a walking study, one step long, once for each line

It writes research/data/reproducibility.json, which research/reliability.md cites. Loops are XLA's; those that `fused`
makes have the same bits whatever the batch. Each run is a process of its own. Rows are paired by `point_id`; the place
in a batch and the wall time are left out.
"""

import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pandas as pd
import shared

from sweep.runs import store
from sweep.study.columns import metric_columns

STUDY = [
    "study=walk_map",
    "study.axes.friction.num=4",
    "study.axes.step.num=4",
    "study.expect=[]",
    "manoeuvre.steps=1",
    "study.invalid_max=1",
    "engine.compiler=xla",
]
WIDTH = "engine.width=8"
WAYS: dict[str, tuple[list[str], dict[str, str], int]] = {  # settings, environment, processor cores; 0: all
    "the same command again": ([WIDTH], {}, 0),
    "alone: width 1": (["engine.width=1"], {}, 0),
    "width 4": (["engine.width=4"], {}, 0),
    "width 16": (["engine.width=16"], {}, 0),
    "one device instead of two": ([WIDTH], {}, 1),
    "two Dask workers": ([WIDTH, "cluster=dask_local", "cluster.workers=2"], {}, 0),
    "another instruction set": ([WIDTH], {"XLA_FLAGS": "--xla_cpu_max_isa=SSE4_2"}, 0),
}
Line = tuple[str, str, str, str, str]


def start_study(out: Path, settings: list[str], environment: dict[str, str], cores: int) -> subprocess.Popen:
    """Start the study in a process of its own."""
    command = [sys.executable, "-m", "sweep.cli", "run", *STUDY, *settings, f"out={out}"]
    pinned = ["taskset", "-c", ",".join(map(str, range(cores)))] if cores else []
    return subprocess.Popen([*pinned, *command], env=os.environ | environment, stdout=subprocess.DEVNULL)


def bit_equal(a: pd.DataFrame, b: pd.DataFrame) -> pd.DataFrame:
    """Return which numbers of two tables with equal columns are equal to the last bit; NaN equals NaN."""
    return (a == b) | (a.isna() & b.isna())


def compare_folders(way: str, base: Path, other: Path) -> Line:
    """Return a line: bit-equal rows and metrics, equal outcomes, and whether `run_id` is equal."""
    a, b = (store.read_rows(path).set_index("point_id").sort_index() for path in (base, other))
    names = metric_columns(a)
    equal = bit_equal(a[names], b[names])
    same = "the same" if set(a["run_id"]) == set(b["run_id"]) else "another"
    outcomes = f"{(a['outcome'] == b['outcome']).sum()} of {len(a)}"
    return way, f"{equal.all(axis=1).sum()} of {len(a)}", f"{equal.all().sum()} of {len(names)}", outcomes, same


def run_interrupted(out: Path) -> None:
    """Run the study, killed after its first part and started again."""
    process = start_study(out, [WIDTH], {}, 0)
    while not (out / store.STUDY_FILE).exists() or not store.finished_batches(out):
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    process.wait()
    start_study(out, [WIDTH], {}, 0).wait()


def compare_replays(base: Path, rows: tuple[int, ...]) -> Line:
    """Return a line for some rows, simulated again with a trace."""
    shown = [
        subprocess.run(
            [sys.executable, "-m", "sweep.cli", "replay", str(base), str(row)], capture_output=True, text=True
        )
        for row in rows
    ]
    found = [re.search(r"(\d+) of (\d+) metrics are equal", one.stdout) for one in shown]
    counts = [(int(one[1]), int(one[2])) for one in found if one]
    other = any("bits may differ" in one.stdout for one in shown)
    bits = f"{sum(a == b for a, b in counts)} of {len(rows)}"
    figures = f"{min(a for a, _ in counts)} of {counts[0][1]}"
    return f"`sweep replay` of rows {', '.join(map(str, rows))}", bits, figures, "", "another" if other else "the same"


def table(place: Path) -> list[Line]:
    """Return the lines of all ways."""
    base, killed = place / "base", place / "killed"
    start_study(base, [WIDTH], {}, 0).wait()
    lines = []
    for number, (way, how) in enumerate(WAYS.items()):
        start_study(place / str(number), *how).wait()
        lines.append(compare_folders(way, base, place / str(number)))
        print(*lines[-1], sep="; ", flush=True)
    run_interrupted(killed)
    return [*lines, compare_folders("after `kill -9`", base, killed), compare_replays(base, (0, 15))]


def main() -> None:
    """Measure and write the table."""
    start = time.perf_counter()
    heads = ["compared with width 8", "rows bit-equal", "figures bit-equal", "outcomes equal", "run_id"]
    with tempfile.TemporaryDirectory() as folder:
        lines = table(Path(folder))
    shared.write_tables("reproducibility", ("mjx",), start, {"ways": [heads, *map(list, lines)]})


if __name__ == "__main__":
    main()
