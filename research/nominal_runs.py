"""Run each nominal scenario once, write its metrics to research/data/nominal.json: `python research/nominal_runs.py`.

Three dozen rollouts, each by a program of its own that has to be compiled: an hour on two cores. Four cores each
make one at a time.
"""

import json
import multiprocessing
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from sweep.config.experiment import compose
from sweep.core.files import write_atomically
from sweep.core.provenance import version_record
from sweep.runs import runner
from sweep.study.columns import metric_columns

PATH = Path(__file__).parent / "data" / "nominal.json"
ONE = ("walk_tripod", "walk_gallop", "walk_slope", "walk_kerb", "stand_push", "pole_climb_held")
BOTH = ("hexagon_waypoints", "pole_climb", "pole_descent_above", "pole_descent_below", "corner_climb", "corner_full",
        "ladder_climb", "raft_cross", "beam_cross", "ball_climb", "ball_descend", "ball_drive",
        "ball_balance")  # fmt: skip
RUNS = {  # what a table calls them
    **{name: [f"scenario={name}"] for name in (*ONE, *BOTH)},
    **{f"{name}:native": [f"scenario={name}", "engine=native"] for name in BOTH},
    "pole_climb_held:torque": ["scenario=pole_climb_held", "manoeuvre.effort=torque", "manoeuvre.friction_share=0.85"],
    "raft_cross:native": ["scenario=raft_cross", "engine=native", "engine.solid=true"],
}


def figures(words: list[str]) -> tuple[dict[str, Any], str]:
    """Outcome, cause and figures of one nominal rollout, and the device."""
    exp = compose(words)
    row = runner.run_single_batch(exp).iloc[0]
    measured = {name: float(f"{row[name]:.4g}") for name in metric_columns(row.to_frame().T) if is_number(row[name])}
    return {"outcome": str(row["outcome"]), "cause": str(row["cause"]), **measured}, exp.system.device(exp.settings)


def is_number(value: Any) -> bool:
    """Whether a figure is a finite number."""
    return isinstance(value, float) and abs(value) < float("inf")


if __name__ == "__main__":
    start, runs, devices = time.monotonic(), {}, set()
    at_once = max(1, (os.cpu_count() or 1) // 4)
    # each process a fresh one: a fork would share what JAX has started
    with ProcessPoolExecutor(at_once, mp_context=multiprocessing.get_context("spawn")) as processes:
        for name, (run, device) in zip(RUNS, processes.map(figures, RUNS.values()), strict=True):
            runs[name] = run
            devices.add(device)
            print(f"{time.monotonic() - start:.0f} s: {name}, {run['outcome']} {run['cause']}")
            sys.stdout.flush()
    data = {
        "command": "python research/nominal_runs.py",
        "engine": "mjx and native",
        **version_record(),
        "devices": sorted(devices),
        "seconds": round(time.monotonic() - start),
        "runs": runs,
    }
    lines = ",\n".join(f" {json.dumps(key)}: {json.dumps(value)}" for key, value in data.items() if key != "runs")
    rows = ",\n".join(f"  {json.dumps(name)}: {json.dumps(row)}" for name, row in runs.items())
    write_atomically(PATH, f'{{\n{lines},\n "runs": {{\n{rows}\n }}\n}}\n'.encode())
