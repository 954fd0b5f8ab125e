"""What research/validity.md shows, measured: `python bench/validity PART ...` writes research/data/validity_PART.json,
or on a machine with a GPU research/data/validity_PART_gpu.json.

    python bench/validity                       # all parts, one after the other
    python bench/validity scenes                # scenes with known answers, by every engine
    python bench/validity faults                # wrong steps, and which bounds each breaks
    python bench/validity order                 # errors over time step and iterations
    python bench/validity peers                 # C MuJoCo's over time step
    python bench/validity manoeuvres            # whole ones, over time step and iterations
    python bench/validity chaos                 # how fast runs part that differ by 1e-9
    python bench/validity precision             # speed over error, beside MuJoCo

Rows that a file has of the same code stay: what is interrupted goes on. Without its file a part is measured anew.
Processes side by side, such as one for each GPU, take jobs of a part by their names: `precision --jobs 'Warp, *'`.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import filelock

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "bench"))

from sweep.backends.run_id import describe_device  # noqa: E402
from sweep.contract.engine_settings import EngineSettings  # noqa: E402
from sweep.core.files import write_atomically  # noqa: E402
from sweep.core.provenance import code_version, version_record  # noqa: E402
from validity import chaos, faults, manoeuvres, order, precision, tables  # noqa: E402

Jobs = Iterator[tuple[str, Callable[[], list[dict[str, Any]]]]]  # names of jobs, and functions that measure their rows
# engines and jobs of each part
PARTS: dict[str, tuple[str, Callable[[], Jobs]]] = {  # with the engines
    "scenes": ("mjx, native, C MuJoCo, MJX; on a GPU mjx and Warp", tables.jobs),
    "faults": ("mjx", faults.jobs),
    "order": ("mjx, double", order.jobs),
    "peers": ("C MuJoCo", order.peer_jobs),
    "manoeuvres": ("mjx", manoeuvres.jobs),
    "chaos": ("mjx, double; native", chaos.jobs),
    "precision": ("mjx, C MuJoCo, MJX; on a GPU Warp", precision.jobs),
}


def main(argv: list[str] | None = None) -> None:
    """Measure the chosen parts, or all."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)} (all)")
    parser.add_argument("--jobs", default="*", metavar="PATTERN", help="of names of jobs (all)")
    given = parser.parse_args(argv)
    if unknown := [name for name in given.parts if name not in PARTS]:
        parser.error(f"{unknown[0]} is not a part: {', '.join(PARTS)}")
    for name in given.parts or PARTS:
        measure(name, given.jobs)


def measure(part: str, pattern: str) -> None:
    """Measure what is missing of a part, and write its data after every job."""
    machine = "_gpu" if precision.on_gpu() else ""
    path = ROOT / "research" / "data" / f"validity_{part}{machine}.json"
    engine, jobs = PARTS[part]
    every = dict(jobs())
    for name, work in every.items():
        if not fnmatchcase(name, pattern) or any(row["job"] == name for row in read_rows(path).get("rows", [])):
            continue
        start = time.perf_counter()
        rows = [{"job": name, **row} for row in work()]
        about = {
            "command": f"python bench/validity {part}",
            "engine": engine,
            "devices": [describe_device(EngineSettings())],
        }
        with filelock.FileLock(path.with_suffix(".lock")):  # others may add to it
            before = read_rows(path)
            rows = sorted(before.get("rows", []) + rows, key=lambda row: [*every].index(row["job"]))
            seconds = before.get("seconds", 0) + round(time.perf_counter() - start)
            write_rows(path, about | version_record() | {"rows": rows, "seconds": seconds})
        print(f"{part}, {name}: {seconds} s", flush=True)


def read_rows(path: Path) -> dict[str, Any]:
    """Return the content of a file that was made by this code."""
    before = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    return before if before.get("code") == code_version() else {}


def write_rows(path: Path, content: dict[str, Any]) -> None:
    """Write data, one line for each row."""
    lines = []
    for key, value in content.items():
        text = json.dumps(value, ensure_ascii=False)
        if key == "rows":
            text = "[\n  " + ",\n  ".join(json.dumps(row, ensure_ascii=False) for row in value) + "\n ]"
        lines.append(f" {json.dumps(key)}: {text}")
    write_atomically(path, ("{\n" + ",\n".join(lines) + "\n}\n").encode())


if __name__ == "__main__":
    main()
