"""What a first start of scenarios takes, with nothing kept, and another one: CPU seconds of all threads, and wall time.

To run: `python bench/cold_start.py [NAME...]`, from a checkout; the code is the one in the current folder. Overrides
follow a name's comma: `ladder_climb,control=learn`. CPU seconds tell of a busy machine as well, to some tenths.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SCENARIOS = Path(__file__).parent.parent / "conf" / "scenario"


def start(name: str, cache: str) -> tuple[float, float]:
    """CPU and wall time (s) of `sweep run` of one rollout; programs are kept in the folder `cache`."""
    scenario, *overrides = name.split(",")
    command = [sys.executable, "-m", "sweep.cli", "run", f"scenario={scenario}", *overrides]
    kept = {"XDG_CACHE_HOME": cache, "JAX_COMPILATION_CACHE_DIR": f"{cache}/programs"}
    kept["PYTHONDONTWRITEBYTECODE"] = ""  # an installed package has its bytecode
    Path(cache, "programs").mkdir(mode=0o700, exist_ok=True)
    began, before = time.perf_counter(), os.times()
    done = subprocess.run(command, env={**os.environ, **kept}, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 4):  # a rollout that fails has started too
        raise SystemExit(f"{name}: {done.stderr.strip()}")
    after = os.times()
    cpu = sum(getattr(after, kind) - getattr(before, kind) for kind in ("children_user", "children_system"))
    return cpu, time.perf_counter() - began


def main(*names: str) -> None:
    """One line for each scenario."""
    print("| scenario | first: CPU s | wall s | again: CPU s | wall s |\n|---|---|---|---|---|")
    for name in names or sorted(path.stem for path in SCENARIOS.glob("*.yaml")):
        with tempfile.TemporaryDirectory() as cache:
            figures = [f"{x:.1f}" for _ in range(2) for x in start(name, cache)]
        print(f"| `{name}` | {' | '.join(figures)} |", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
