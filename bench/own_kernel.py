"""Speed and agreement of the engine `kernel` on a CPU or an NVIDIA GPU.

    python bench/own_kernel.py [WIDTH [AGAIN [WORD ...]]]

Rollouts of a second of several robots, with all metrics, of different masses and frictions; the template's quadruped on
`mjx` and `warp` as well, where these run. Results that research/own_models.md cites are written to
research/data/own_kernel.json: physics steps a second, with controllers and metrics; accelerations beside C MuJoCo's;
and metrics beside those of `native` of AGAIN rollouts.

With words it measures the rows whose names contain one of them, such as `humanoid` or `mjx`. Rows that the same code
measured before on the same machine stay in the table, and those that it lacks come first, in the order of the words.
"""

import contextlib
import json
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import jax
import mujoco
import numpy as np
import yaml

from sweep.backends import devices
from sweep.cli.main import main as sweep
from sweep.contract.engine import Metrics
from sweep.core import provenance
from sweep.core.files import write_atomically
from sweep.systems.mujoco_model import build_nominal_system, kernel_engine
from sweep.systems.mujoco_model.model_spec import ParameterOverrides

DATA = Path(__file__).parents[1] / "research/data/own_kernel.json"
BIPED = Path(__file__).parents[1] / "tests/data/biped/biped.xml"
TROT = {"controller": "trot:policy", "observe": ["turn", "spin"], "keyframe": "home", "sensors": "current"}
FEET = ["lf_touch", "rf_touch", "lh_touch", "rh_touch"]
RUB = ('damping="0.2"', 'damping="0.2" frictionloss="0.3"')
CONE = ('iterations="10" ls_iterations="20"', 'iterations="100" ls_iterations="50" cone="elliptic" impratio="10"')
TOUCH = ('mass="0.15"', 'mass="0.15" contype="2" conaffinity="2"')
LOAD, GRIP = "model.body.trunk.mass", "model.geom.floor.friction.slide"
LAYERS = (48, 512, 256, 128, 12)  # of the learned policy, whose observation is that of Isaac Lab's velocity tasks
CHUNK = 25  # control ticks of a launch
HEAD = ["robot", "joints", "accelerations beside C MuJoCo", "M steps/s", "first launch, s",
        "way beside `native`, mm: median, 90 % within", "on `native`"]  # fmt: skip
FAILED = "none"  # speed of a row that could not be measured
OTHERS = {"mjx": 4096, "warp": 8192}  # engines beside the kernel, with the rollouts that fill them on a GPU


class Robot(NamedTuple):
    """A robot in the current folder, and what differs between its rollouts."""

    model: dict[str, Any]  # section `model` of its scenario
    varied: dict[str, tuple[float, float]]  # ranges by path
    period: float = 0.02  # s


def make_quadruped(changes: tuple[tuple[str, str], ...] = (), feet: list[str] = FEET) -> Robot:
    """Write the template's quadruped with changes of its text; return it with its trot."""
    text = Path("quadruped.xml").read_text(encoding="utf-8")
    for old, new in changes:
        text = text.replace(old, new)
    Path("robot.xml").write_text(text, encoding="utf-8")
    return Robot({"mjcf": "robot.xml", "feet": feet, **TROT}, {LOAD: (6.0, 10.0), GRIP: (0.5, 1.0)})


def make_learned() -> Robot:
    """Write a perceptron of random weights, whose output is small enough for the template's quadruped to stand."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    rng, last, nodes, weights = np.random.default_rng(0), "obs", [], []
    for k, (n, m) in enumerate(pairwise(LAYERS)):
        size = 0.1 if m == LAYERS[-1] else 1.0
        weights.append(
            numpy_helper.from_array((size * rng.normal(size=(n, m)) / np.sqrt(n)).astype(np.float32), f"w{k}")
        )
        nodes.append(helper.make_node("MatMul", [last, f"w{k}"], [f"sum{k}"]))
        last = "actions" if m == LAYERS[-1] else f"out{k}"
        nodes.append(helper.make_node("Tanh", [f"sum{k}"], [last]))
    shapes = (("obs", LAYERS[0]), ("actions", LAYERS[-1]))
    ends = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, n]) for name, n in shapes]
    graph = helper.make_graph(nodes, "policy", ends[:1], ends[1:], weights)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9), "walk.onnx")
    Path("walk.policy.yaml").write_text("preset: isaaclab\n", encoding="utf-8")
    model = {"mjcf": "quadruped.xml", "controller": "walk.onnx", "keyframe": "home", "feet": FEET}
    return Robot(model, {LOAD: (6.0, 10.0), GRIP: (0.5, 1.0)})


def make_joint_holding_robot(text: str, load: tuple[float, float]) -> Robot:
    """Write a robot and a controller that holds its joints at 0; return them."""
    Path("robot.xml").write_text(text, encoding="utf-8")
    lines = "import jax.numpy as jnp", "def policy(belief, observation, state, key):"
    count = mujoco.MjModel.from_xml_string(text).nu
    Path(f"hold{count}.py").write_text(
        "\n".join([*lines, f"    return jnp.zeros({count}), state", ""]), encoding="utf-8"
    )
    return Robot({"mjcf": "robot.xml", "controller": f"hold{count}:policy"}, {LOAD: load, GRIP: (0.5, 1.0)})


def describe_humanoid() -> str:
    """Return a humanoid of 29 joints: legs of six, a waist of three, arms of seven, four spheres under each foot."""
    actuators = []

    def limb(name: str, place: str, joints: str, lengths: tuple[float, ...], mass: float, tip: str) -> str:
        text, offset = "", place
        for k, axis in enumerate(joints):
            length, turn = lengths[k], {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}[axis]
            shape = f'type="capsule" fromto="0 0 0 0 0 {-length}"' if length else 'type="sphere"'
            text += f'<body pos="{offset}"><joint name="{name}{k}" axis="{turn}"/><geom {shape} mass="{mass}"/>'
            offset = f"0 0 {-length}"
            actuators.append(f'<position joint="{name}{k}"/>')
        return text + tip + "</body>" * len(joints)

    sole = "".join(
        f'<geom type="sphere" size="0.01" pos="{x} {y} -0.04" mass="0.01" conaffinity="1"/>'
        for x in (0.12, -0.05)
        for y in (0.03, -0.03)
    )
    legs = "".join(
        limb(name, f"0 {y} -0.05", "yxzyyx", (0, 0, 0.35, 0.35, 0, 0), 1.2, sole)
        for name, y in (("left_leg", 0.1), ("right_leg", -0.1))
    )
    arms = "".join(
        limb(name, f"0 {y} 0.3", "yxzyxyz", (0, 0, 0.25, 0.2, 0, 0, 0.05), 0.5, "")
        for name, y in (("left_arm", 0.2), ("right_arm", -0.2))
    )
    waist = limb("waist", "0 0 0.05", "zxy", (0, 0, 0), 0.5, f'<geom type="box" size="0.08 0.15 0.2" mass="8"/>{arms}')
    return (
        '<mujoco model="humanoid"><option timestep="0.002" integrator="implicitfast"/><default>'
        '<joint damping="1" armature="0.02" frictionloss="0.1"/><geom contype="0" conaffinity="0" size="0.03"/>'
        '<position kp="200" kv="5" forcerange="-100 100"/></default><worldbody><geom name="floor" type="plane" '
        'size="0 0 1" contype="1" friction="0.8"/><body name="trunk" pos="0 0 0.8"><freejoint/><geom type="box" '
        f'size="0.08 0.1 0.05" mass="4"/>{legs}{waist}</body></worldbody><actuator>{"".join(actuators)}</actuator>'
        "</mujoco>"
    )


def make_hexapod() -> Robot:
    """Export the built-in hexapod with its walk."""
    sweep(["export-model", "scenario=walk_tripod", "out=hexapod"])
    for file in Path("hexapod").iterdir():
        if file.is_file():
            file.rename(file.name)
    model = yaml.safe_load(Path("hexapod/scenarios/own.yaml").read_text(encoding="utf-8"))["model"]
    period = model.pop("period")
    grip = "model.geom.ground_contact.friction.slide"
    return Robot(model, {"model.body.base.mass": (9.0, 11.0), grip: (0.5, 1.0)}, period)


ROBOTS: dict[str, Callable[[], Robot]] = {
    "quadruped": make_quadruped,
    "quadruped, metrics of feet left out": partial(make_quadruped, feet=[]),
    "quadruped, friction of joints": partial(make_quadruped, (RUB,)),
    "quadruped, friction of joints, elliptic cones": partial(make_quadruped, (RUB, CONE)),
    "quadruped, shanks that may touch one another": partial(make_quadruped, (TOUCH,)),
    f"quadruped, learned policy {'-'.join(map(str, LAYERS))}": make_learned,
    "biped with waist, arms and box feet": lambda: make_joint_holding_robot(
        BIPED.read_text(encoding="utf-8"), (4.0, 6.0)
    ),
    "humanoid, four spheres a foot": lambda: make_joint_holding_robot(describe_humanoid(), (3.0, 5.0)),
    "hexapod, exported, with its walk": make_hexapod,
}


def make_engine(name: str, robot: Robot, width: int) -> Any:
    """Make an engine of a robot."""
    settings = {"name": name, "width": width, "cross_check": False}
    about = {**robot.model, "period": robot.period, "duration": 1.0}
    system, settings, *_ = build_nominal_system(
        {"model": about, "engine": settings, "outcome": {"fell": "tilt_max_deg > 60"}}, {}
    )
    return system.make_engine(settings, *system.make_world_and_belief({}), limits=None)


def vary_robot(robot: Robot, n: int) -> ParameterOverrides:
    """Return worlds whose loads and grounds differ."""
    return ParameterOverrides(tuple((path, np.linspace(*ends, n)) for path, ends in robot.varied.items()))


def measure_launches(engine: Any, world: ParameterOverrides, n: int) -> tuple[float, float]:
    """Return physics steps a second of a second launch, and the seconds to compile and run the first."""
    with engine._within():
        _, outside, varied, inputs, carry, _, _ = engine._start(world, ParameterOverrides(), np.arange(n))
        kind = kernel_engine._CpuRunner if jax.default_backend() == "cpu" else kernel_engine._GpuRunner
        walls, begin = [], time.perf_counter()
        runner = kind(partial(engine._compile, varied), inputs, carry, n, np.zeros(0, int))
        for first in (0, CHUNK):
            if outside is None:
                runner.simulate_ticks(first, CHUNK)
            else:
                for tick in range(first, first + CHUNK):
                    runner.set_commands(outside.next_controls(runner.read_observables()))
                    runner.simulate_ticks(tick, 1)
            jax.block_until_ready(runner.read_observables())
            walls.append(time.perf_counter() - begin)
            begin = time.perf_counter()
    return n * CHUNK * engine._substeps / walls[1], walls[0]


def measure_rollouts(engine: Any, world: ParameterOverrides, n: int) -> tuple[float, float, Metrics]:
    """Return physics steps a second of whole rollouts simulated again, the seconds of the first time, and metrics."""
    walls, found = [], {}
    for _ in range(2):
        begin = time.perf_counter()
        found = engine.run(world, ParameterOverrides(), np.arange(n))
        walls.append(time.perf_counter() - begin)
    return n * round(1.0 / engine._model.opt.timestep) / walls[1], walls[0], found


def list_rows() -> dict[str, tuple[str, Callable[[], Robot]]]:
    """Return engine and robot of each row of the table by its name: other engines have the first robot."""
    rows = {name: ("kernel", make) for name, make in ROBOTS.items()}
    first, make = next(iter(ROBOTS.items()))
    others = OTHERS if jax.default_backend() == "gpu" else {}
    return rows | {f"{first}, on `{engine}`": (engine, make) for engine in others}


def measure_row(engine_name: str, make: Callable[[], Robot], width: int, again: int) -> list[str]:
    """Return the cells of a row after its name; an error in place of the speed, as of a missing package."""
    try:
        return measure_robot(engine_name, make(), width, again)
    except Exception as error:  # of any class: other rows count all the same
        return ["", "", FAILED, "", f"{type(error).__name__}: {error}".replace("\n", " ")[:120], ""]


def measure_robot(engine_name: str, robot: Robot, width: int, again: int) -> list[str]:
    """Return the cells of a robot's row after its name. `native` simulates `again` of its rollouts."""
    is_kernel = engine_name == "kernel"
    n = width if is_kernel else OTHERS[engine_name]
    engine, world = make_engine(engine_name, robot, n), vary_robot(robot, n)
    if is_kernel:
        speed, first = measure_launches(engine, world, n)
        found = engine.run(world, ParameterOverrides(), np.arange(n))  # by the same program
    else:
        speed, first, found = measure_rollouts(engine, world, n)
    some = np.linspace(0, n - 1, again).astype(int)
    few = ParameterOverrides(tuple((path, values[some]) for path, values in world.values))
    native = make_engine("native", robot, again).run(few, ParameterOverrides(), some)
    apart = 1e3 * np.abs(np.asarray(found["travelled_m"])[some] - np.asarray(native["travelled_m"]))
    return [
        str(engine._model.njnt - 1),
        f"{engine.c_mujoco_agreement.largest:.0e}" if is_kernel else "",
        f"{speed / 1e6:.0f}" if speed > 1e7 else f"{speed / 1e6:.2f}",
        f"{first:.1f}",
        f"{np.median(apart):.1g}, {np.quantile(apart, 0.9):.1g}",
        f"{int(np.sum(found['on_native']))} of {n}" if is_kernel else "",
    ]


def main(width: str = "0", again: str = "256", *words: str) -> None:
    """Measure the rows whose names contain a word, or all; write the table after each."""
    n = int(width) or (131072 if jax.default_backend() == "gpu" else 1024)
    device = jax.devices()[0].device_kind if jax.default_backend() == "gpu" else f"CPU, {devices.count_cores()} cores"
    about = {"command": f"python bench/own_kernel.py {n} {again}", "engine": "kernel", "devices": [f"1 x {device}"]}
    about |= provenance.version_record()
    before = json.loads(DATA.read_text(encoding="utf-8")) if DATA.is_file() else {}
    is_same = all(before.get(key) == value for key, value in about.items())
    done = {line[0]: line[1:] for line in before["tables"]["robots"][1:]} if is_same else {}
    kernel_engine.TICKS_PER_CALL = CHUNK  # of whole rollouts as well: a large kernel takes a minute to compile
    rows = list_rows()
    chosen = list(dict.fromkeys(name for word in words or [""] for name in rows if word in name))
    with tempfile.TemporaryDirectory() as place:
        sweep(["init", "--model", f"{place}/quad"])
        with contextlib.chdir(f"{place}/quad"):
            for name in sorted(chosen, key=lambda name: done.get(name, ["", "", FAILED])[2] != FAILED):
                done[name] = measure_row(*rows[name], n, int(again))
                print(name, done[name], flush=True)
                lines = [HEAD, *([name, *done[name]] for name in rows if name in done)]
                written = about | {"seconds": "", "tables": {"robots": lines}}
                write_atomically(DATA, (json.dumps(written, indent=1, ensure_ascii=False) + "\n").encode())


if __name__ == "__main__":
    main(*sys.argv[1:])
