"""First and second start of scenarios with an empty program cache: CPU seconds of all threads, and wall time.

To run: `python bench/cold_start.py [NAME...] [--parts]`, from a checkout; it measures the code in the current folder.
Overrides follow a name's comma: `ladder_climb,control=learn`. The names of `DELAYS` are delays and batches. On a busy
machine, CPU seconds are still valid to some tenths. The start is everything before the batch: imports, configuration,
and programs compiled or loaded. The rollout includes its plan and the first launch. `--parts` shows when calls of
`PARTS` begin and end, threads side by side.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from threading import get_ident
from types import CodeType
from typing import Any

WATCHED = "--watched"  # flag with which this file starts itself once
SCENARIOS = Path(__file__).parent.parent / "conf" / "scenario"
# functions that are timed, by file and name
PARTS = {  # by file and name
    ("sweep/cli/main.py", "main"): "command",
    ("sweep/config/experiment.py", "compose"): "configuration",
    ("sweep/core/provenance.py", "_version"): "sources",
    ("sweep/backends/devices.py", "search_devices_in_background.<locals>.found"): "device",
    ("sweep/engines/batching.py", "_compute_nominal_plan"): "nominal plan",
    ("sweep/backends/devices.py", "noise_keys"): "noise keys",
    ("sweep/backends/program_cache.py", "_load"): "kept programs",
    ("sweep/fused/eager.py", "trace"): "traced for NumPy",
    ("sweep/fused/trace.py", "trace_program"): "kernel traced",
    ("sweep/fused/cuda.py", "GpuKernelPrinter.__init__"): "kernel printed",
    ("sweep/fused/cuda.py", "ptx_compiler.<locals>.compiled"): "kernel by LLVM",
    ("sweep/fused/llvm.py", "compile_llvm_assembly"): "kernel by LLVM",
    ("sweep/fused/driver.py", "_translate"): "kernel by the driver",
    ("jax/_src/stages.py", "Lowered.compile"): "XLA",
    ("sweep/engines/mjx.py", "MjxEngine._prepare"): "programs",
    ("sweep/engines/planning.py", "Planning.__call__"): "plan",
    ("sweep/engines/mjx.py", "MjxEngine._simulate"): "batch",
}
MASSES = "mass:{path:robot.body_mass,side:world,from:10,to:18,num:24}"
DELAYS = {  # scenario and overrides by name: late observations, loads and free bodies, and batches of 48 rows
    "delay_5": ("walk_tripod", "noise.delay=5"),
    "delay_50": ("walk_tripod", "noise.delay=50"),
    "load_delay_50": ("walk_tripod", "noise.load_delay=50"),
    "body_delay_50": ("ball_balance", "noise.body_delay=50"),
    "no_delay_48": ("walk_tripod", f"+study.axes={{{MASSES},friction:{{path:contact.friction,values:[0.7,0.8]}}}}"),
    "delay_axis_48": ("walk_tripod", f"+study.axes={{{MASSES},delay:{{path:noise.delay,values:[0,20]}}}}"),
}
Spans = list[tuple[str, float, float]]  # name of a part, and its begin and end (s after the start of the process)


def watch_parts(began: float) -> Spans:
    """Return the list of parts of this process, which grows as they end."""
    events, spans, begun = sys.monitoring.events, [], defaultdict(list)

    def part(code: CodeType) -> str | None:
        return next((PARTS[of] for of in PARTS if code.co_qualname == of[1] and code.co_filename.endswith(of[0])), None)

    def enters(code: CodeType, _: int) -> Any:
        if (name := part(code)) is None:
            return sys.monitoring.DISABLE  # for this code alone: what is not a part takes no time
        begun[name, get_ident()].append(time.monotonic() - began)
        return None

    def leaves(code: CodeType, *_: Any) -> Any:
        if (name := part(code)) is None:
            return sys.monitoring.DISABLE
        spans.append((name, begun[name, get_ident()].pop(), time.monotonic() - began))
        return None

    sys.monitoring.use_tool_id(sys.monitoring.PROFILER_ID, "parts")
    for event, told in ((events.PY_START, enters), (events.PY_RETURN, leaves)):
        sys.monitoring.register_callback(sys.monitoring.PROFILER_ID, event, told)
    sys.monitoring.set_events(sys.monitoring.PROFILER_ID, events.PY_START | events.PY_RETURN)
    return spans


def run_watched(began: str, out: str, *given: str) -> int:
    """Run `sweep` with its parts written to the file `out`."""
    spans = watch_parts(float(began))
    from sweep.cli.main import main as sweep

    code = sweep(list(given))
    Path(out).write_text(json.dumps(spans), encoding="utf-8")
    return code


def time_start(name: str, cache: str) -> dict[str, Any]:
    """Return CPU and wall time (s) of `sweep run` of one rollout, and its parts; `cache` is the folder of programs."""
    scenario, *overrides = DELAYS.get(name) or name.split(",")
    told = Path(cache, "parts.json")
    kept = {"XDG_CACHE_HOME": cache, "JAX_COMPILATION_CACHE_DIR": f"{cache}/programs"}
    kept |= {"CUDA_CACHE_DISABLE": "1", "PYTHONDONTWRITEBYTECODE": ""}  # an installed package has its bytecode
    kept["PYTHONPATH"] = os.pathsep.join((os.getcwd(), os.environ.get("PYTHONPATH", "")))
    Path(cache, "programs").mkdir(mode=0o700, exist_ok=True)
    began, before = time.monotonic(), os.times()
    asked = [sys.executable, __file__, WATCHED, str(began), str(told), "run", f"scenario={scenario}", *overrides]
    if any("study.axes" in one for one in overrides):
        asked += [f"study.name={name}", f"out={tempfile.mkdtemp(dir=cache)}/rows"]
    done = subprocess.run(asked, env={**os.environ, **kept}, capture_output=True, text=True, check=False)
    wall, after = time.monotonic() - began, os.times()
    if done.returncode not in (0, 4):  # a rollout that fails has started too
        raise SystemExit(f"{name}: {done.stderr.strip()}")
    cpu = sum(getattr(after, kind) - getattr(before, kind) for kind in ("children_user", "children_system"))
    return {"cpu": cpu, "wall": wall, "parts": sorted(json.loads(told.read_text()), key=lambda part: part[1])}


def table_cells(took: dict[str, Any]) -> list[str]:
    """Return CPU and wall time (s), and the latter split into start, rollout and what follows."""
    (prepared,) = (to for name, _, to in took["parts"] if name == "programs")
    (over,) = (to for name, _, to in took["parts"] if name == "batch")
    return [f"{x:.1f}" for x in (took["cpu"], took["wall"], prepared, over - prepared, took["wall"] - over)]


def format_parts(took: dict[str, Any]) -> str:
    """Format the parts of a start that take at least a tenth of a second, in order."""
    told = (f"{name} {begun:.1f} to {ended:.1f}" for name, begun, ended in took["parts"] if ended - begun >= 0.1)
    return ", ".join(told)


def main(*given: str) -> None:
    """Print two lines for each scenario, and below them the parts of its starts."""
    asked = argparse.ArgumentParser()
    asked.add_argument("names", nargs="*", default=[*sorted(path.stem for path in SCENARIOS.glob("*.yaml")), *DELAYS])
    asked.add_argument("--parts", action="store_true", help="tell as well what a start consists of")
    options = asked.parse_args(given)
    print("| scenario | | CPU s | wall s | start s | rollout s | after it s |\n|---|---|---|---|---|---|---|")
    parts = []
    for name in options.names:
        with tempfile.TemporaryDirectory() as cache:
            for which in ("first", "again"):
                took = time_start(name, cache)
                print(f"| `{name}` | {which} | {' | '.join(table_cells(took))} |", flush=True)
                parts.append(f"{name}, {which}: {format_parts(took)}")
    if options.parts:
        print("\n" + "\n".join(parts))


if __name__ == "__main__":
    sys.exit(run_watched(*sys.argv[2:])) if sys.argv[1:2] == [WATCHED] else main(*sys.argv[1:])
