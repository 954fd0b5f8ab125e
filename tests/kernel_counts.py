"""How large GPU kernels of scenarios and MuJoCo models are, which tells of lost speed without a GPU.

    python tests/kernel_counts.py          # renews tests/data/kernel_counts.json
    python tests/kernel_counts.py biped    # renews one of its kernels
    python tests/kernel_counts.py --show   # prints a table of it

Counts are of the text that the fused compiler prints for a batch of 131,072 rollouts, before LLVM, so that they depend
on this repository and JAX alone. Registers and spilled bytes are those of NVIDIA's `ptxas` for a Hopper GPU, where it
is installed; other releases of `ptxas` allocate registers otherwise, so they are compared with those of the same
release only.
"""

import contextlib
import json
import operator
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path

import jax
import numpy as np

import sweep
from sweep.backends import devices
from sweep.config.experiment import compose
from sweep.engines.closed_loop import required_sensing_mode
from sweep.engines.mjx import MjxEngine
from sweep.fused import cuda, launch
from sweep.systems.mujoco_model import build_nominal_system
from sweep.systems.mujoco_model.kernel_engine import KernelModelEngine
from sweep.systems.mujoco_model.model_spec import ParameterOverrides

DATA = Path(__file__).with_name("data")
PATH = DATA / "kernel_counts.json"
SCENARIOS = ("walk_tripod", "pole_climb", "ball_balance", "ball_drive", "raft_stand", "corner_full", "ladder_climb")
FEET = ["lf_touch", "rf_touch", "lh_touch", "rh_touch"]
QUADRUPED = {"mjcf": "quadruped.xml", "controller": "trot:policy", "keyframe": "home", "observe": ["turn", "spin"],
             "sensors": "current", "feet": FEET}  # fmt: skip
MODELS = {  # folder, model and its varied numbers, of kernels of MuJoCo models
    "template_quadruped": (
        Path(sweep.__file__).parent / "cli" / "template_model",
        QUADRUPED,
        ("model.body.trunk.mass", "model.geom.floor.friction.slide"),
    ),
    "biped": (DATA / "biped", {"mjcf": "biped.xml", "controller": "stand:policy"}, ("model.body.trunk.mass",)),
}
WIDTH, TICKS = 131072, 250
TOLERANCE = 0.02  # relative change of a count that passes
ARCHITECTURE = "sm_90"  # H100 and H200

Counts = dict[str, int]


def kernel_printer(name: str) -> tuple[launch.TracedProgram, cuda.GpuKernelPrinter]:
    """The program of a scenario's closed loop, and its text for a GPU; nothing is simulated."""
    exp = compose([f"scenario={name}"])
    engine = MjxEngine(replace(exp.settings, width=WIDTH), exp.case, exp.case, exp.thresholds)
    cases = jax.tree.map(lambda x: jax.ShapeDtypeStruct((), x.dtype), devices.to_jax_arrays((exp.case, exp.case)))
    key = jax.eval_shape(partial(jax.random.key, 0))
    plan, carry = jax.eval_shape(partial(engine._start, required_sensing_mode(exp.case.noise)), *cases, key)
    return launch.print_llvm_program(engine._tick, (*cases, plan), carry, lambda carry: carry.is_over, TICKS, 0, WIDTH)


def model_printer(name: str) -> tuple[launch.TracedProgram, cuda.GpuKernelPrinter]:
    """The program of a MuJoCo model's closed loop by `engine=kernel`, and its text for a GPU; nothing is simulated."""
    folder, model, varied = MODELS[name]
    with contextlib.chdir(folder):
        values = {
            "model": model | {"period": 0.02},
            "engine": {"name": "kernel", "width": WIDTH},
            "outcome": {"fell": "tilt_max_deg > 60"},
        }
        system, settings, *_ = build_nominal_system(values, {})
        engine = system.make_engine(settings, *system.make_world_and_belief({}), limits=None)
        assert isinstance(engine, KernelModelEngine)
        world = ParameterOverrides(tuple((path, np.ones(2)) for path in varied))
        with engine._within():
            _, _, varied, inputs, carry, *_ = engine._start(world, ParameterOverrides(), np.arange(2))
            inputs, carry = (
                jax.tree.map(lambda one: jax.ShapeDtypeStruct(one.shape[1:], one.dtype), tree)
                for tree in (inputs, carry)
            )
            tick, is_over = partial(engine._tick, varied), operator.attrgetter("over")
            return launch.print_llvm_program(tick, inputs, carry, is_over, TICKS, 0, WIDTH, engine._layout.group)


def text_counts(program: launch.TracedProgram, printer: cuda.GpuKernelPrinter) -> Counts:
    """Sizes of a kernel from its text.

    Returns:
        `operations`, `loads` and `stores` of a tick, each part of the kernel once; numbers that a rollout `carries`
        from tick to tick, and those beside them that one part of the kernel hands on to the next.
    """
    lines = printer.lines
    loads, stores = (sum(bool(re.search(word, line)) for line in lines) for word in (r"= load ", r"^store "))
    carried = sum(leaf.size for leaf in program.carry_leaves)
    return {
        "operations": sum("=" in line for line in lines) - loads,
        "loads": loads,
        "stores": stores,
        "carried": carried,
        "handed_on": printer.words - carried,
    }


def ptxas_release() -> str | None:
    """The release of the installed `ptxas`, or None."""
    if not shutil.which("ptxas"):
        return None
    told = subprocess.run(["ptxas", "--version"], capture_output=True, text=True, check=True).stdout
    return re.search(r"release ([\d.]+)", told)[1]


def register_counts(printer: cuda.GpuKernelPrinter) -> Counts:
    """Registers of a thread, and bytes that it spills and loads again, by `ptxas`."""
    with cuda.ptx_compiler() as compiler, tempfile.NamedTemporaryFile("w", suffix=".ptx") as file:
        file.write(compiler(printer.module_text()))
        file.flush()
        command = ["ptxas", "-v", f"-arch={ARCHITECTURE}", file.name, "-o", "/dev/null"]
        told = subprocess.run(command, capture_output=True, text=True, check=True).stderr
    patterns = {
        "registers": r"Used (\d+) registers",
        "spill_stores_b": r"(\d+) bytes spill stores",
        "spill_loads_b": r"(\d+) bytes spill loads",
    }
    return {name: int(re.search(pattern, told)[1]) for name, pattern in patterns.items()}


def scenario_counts(name: str) -> Counts:
    """All counts of the kernel of a scenario or model; without those of `ptxas` where it is not installed."""
    program, printer = model_printer(name) if name in MODELS else kernel_printer(name)
    counts = text_counts(program, printer)
    return counts | (register_counts(printer) if ptxas_release() else {})


def changed_counts(name: str, counts: Counts) -> list[str]:
    """A line for each count that is more than `TOLERANCE` off the stored one."""
    stored = json.loads(PATH.read_text())
    known = stored["scenarios"][name]
    if "registers" not in counts or ptxas_release() != stored["ptxas"]:
        known = {key: value for key, value in known.items() if key in text_keys(known)}
    return [
        f"{name}: {key} {known[key]} -> {counts[key]} ({counts[key] / max(known[key], 1) - 1:+.1%})"
        for key in known
        if abs(counts[key] - known[key]) > TOLERANCE * known[key]
    ]


def text_keys(counts: Counts) -> list[str]:
    """The counts that need no `ptxas`."""
    return [key for key in counts if key != "registers" and not key.startswith("spill")]


def table() -> str:
    """The stored counts as a table in Markdown."""
    scenarios = json.loads(PATH.read_text())["scenarios"]
    keys = [*next(iter(scenarios.values()))]
    rows = [[f"`{name}`", *(f"{counts[key]:,}" for key in keys)] for name, counts in scenarios.items()]
    lines = [["kernel of", *keys], ["---", *["--:"] * len(keys)], *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def main(*args: str) -> None:
    """Renew the stored counts of all kernels, or of those that are named; or show them."""
    if args != ("--show",):
        if not ptxas_release():
            raise SystemExit("kernel_counts: ptxas is not installed (CUDA's compiler): its counts would be lost")
        found = {name: scenario_counts(name) for name in args or (*SCENARIOS, *MODELS)}
        known = json.loads(PATH.read_text())["scenarios"] if args else {}
        PATH.write_text(json.dumps({"ptxas": ptxas_release(), "scenarios": known | found}, indent=1) + "\n")
    print(table())


if __name__ == "__main__":
    main(*sys.argv[1:])
