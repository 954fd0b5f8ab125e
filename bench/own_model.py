"""Speed of a user's MuJoCo model against MuJoCo's own loops: `python bench/own_model.py [ENGINES [WIDTH [SECONDS]]]`.

The quadruped of `sweep init --model` and its trot, ENGINES as `native,mjx,warp`. `native` is compared with
`mujoco.rollout` of the same model, with the controls that the policy gave and the same number of threads. `mjx` is
compared with steps in a scan, with those controls and standing, and with `mjx-testspeed`. `warp` is compared with
MuJoCo Warp's own step, likewise, in a CUDA graph if there is one. Each engine also runs a controller that plays those
controls back, which separates the cost of the policy from that of the loop and the metrics, and only its work on the
host before the first tick.

Model, width and number of steps are the same. The variants run in turn several times; the least wall time and the least
CPU time count, of which the latter depends less on other programs. Engines that cannot run are reported and left out.
The output is a table, and one line of JSON.
"""

import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from copy import copy
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco.rollout import Rollout

from sweep.cli.main import main as sweep
from sweep.config.experiment import compose
from sweep.contract.engine_settings import EngineSettings
from sweep.systems.mujoco_model import MujocoModel, batch

REPETITIONS = 5
THREADS = len(os.sched_getaffinity(0))
Times = tuple[float, float]  # s, wall time and CPU time of all cores
Ways = Mapping[str, Callable[[], Any]]
Found = dict[str, Times]  # the engine's first
Task = tuple[Any, Any, np.ndarray]  # world, belief, streams
PLAYED = """import jax.numpy as jnp, numpy as np
FILES = ["played.npy"]
CONTROLS = np.load(FILES[0])
def begin(belief, key): return None, jnp.int32(0), None
def policy(belief, seen, state, key): return jnp.asarray(CONTROLS, float)[state], state + 1
"""


def time_call(call: Callable[[], Any]) -> Times:
    """Return wall and CPU time of a call that waits for its results."""
    wall, cpu = time.perf_counter(), time.process_time()
    call()
    return time.perf_counter() - wall, time.process_time() - cpu


def shortest_times(ways: Ways) -> Found:
    """Return the least times of each variant, run in turns after a first call that compiles."""
    for name, call in ways.items():
        first, again = time_call(call), time_call(call)
        print(f"{name}: {again[0]:.3f} s, {first[0]:.1f} s at first", flush=True)
    rounds = [{name: time_call(call) for name, call in ways.items()} for _ in range(REPETITIONS)]
    return {name: (min(one[name][0] for one in rounds), min(one[name][1] for one in rounds)) for name in ways}


def native(own: MujocoModel, controls: np.ndarray, n: int) -> Ways:
    """Return `mujoco.rollout`, which records the state but no metrics."""
    model = own.model
    ctrl = np.repeat(controls, count_steps(own) // len(controls), axis=0)
    data = [mujoco.MjData(model) for _ in range(THREADS)]
    mujoco.mj_resetDataKeyframe(model, data[0], own.keyframe_index)
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    start = np.zeros(mujoco.mj_stateSize(model, full))
    mujoco.mj_getState(model, data[0], start, full)
    pool = Rollout(nthread=THREADS)
    return {"mujoco.rollout": lambda: pool.rollout(model, data, np.tile(start, (n, 1)), np.tile(ctrl, (n, 1, 1)))}


def on_mjx(own: MujocoModel, controls: np.ndarray, n: int) -> Ways:
    """Return MJX loops of as many steps from the keyframe, with the policy's controls and with standing ones."""
    from mujoco import mjx

    steps, walk = count_steps(own), jnp.asarray(controls, float)
    model, start = mjx.put_model(own.model), keyframe_data(own)
    each = jax.tree.map(lambda x: jnp.broadcast_to(x, (n, *x.shape)), mjx.put_data(own.model, start))

    def step(data: Any, _: None) -> tuple[Any, None]:
        return mjx.step(model, data), None

    def tick(data: Any, ctrl: Any) -> tuple[Any, None]:
        return jax.lax.scan(step, data.replace(ctrl=ctrl), length=steps // len(walk))[0], None

    @jax.jit
    @partial(jax.vmap, in_axes=(0, None))
    def unroll(one: Any, controls: Any) -> Any:
        return jax.lax.scan(tick, one, controls)[0]

    def stepped(controls: Any) -> Callable[[], Any]:
        return lambda: jax.block_until_ready(unroll(each, controls))

    still = jnp.broadcast_to(jnp.asarray(start.ctrl, float), walk.shape)
    return {"mjx.step": stepped(walk), "mjx.step, standing": stepped(still)}


def run_testspeed(own: MujocoModel, n: int) -> Found:
    """Return the times of `mjx-testspeed`, which starts from the model's default pose."""
    from mujoco import mjx

    option = own.model.opt
    solver = {int(mujoco.mjtSolver.mjSOL_CG): "cg", int(mujoco.mjtSolver.mjSOL_NEWTON): "newton"}[int(option.solver)]
    asked = copy(own.model), count_steps(own), n, 1, solver, option.iterations, option.ls_iterations
    found = min(mjx.benchmark(*asked)[1] for _ in range(2))  # it compiles each time
    print(f"mjx-testspeed: {found:.3f} s", flush=True)
    return {"mjx-testspeed": (found, np.nan)}


def on_warp(own: MujocoModel, controls: np.ndarray, n: int) -> Ways:
    """Return MuJoCo Warp loops without JAX, as `on_mjx`, with as much memory for contacts as the engine has."""
    import warp  # pyright: ignore[reportMissingImports]
    from mujoco.mjx.third_party import mujoco_warp

    from sweep.systems.mujoco_model.mjx import warp_buffer_sizes

    model, start = mujoco_warp.put_model(own.model), keyframe_data(own)
    data = mujoco_warp.put_data(own.model, start, nworld=n, **warp_buffer_sizes(own.model, n))
    qpos, qvel = warp.clone(data.qpos), warp.clone(data.qvel)
    once: Callable[[], Any] = partial(mujoco_warp.step, model, data)
    once()  # compiles
    if warp.get_device().is_cuda:
        with warp.ScopedCapture() as capture:  # of one step, as `mjwarp-testspeed` has it
            once()
        once = partial(warp.capture_launch, capture.graph)

    def stepped(controls: np.ndarray) -> Callable[[], Any]:
        each = [warp.array(np.tile(one, (n, 1)), dtype=float) for one in controls]

        def all_of_it() -> None:
            warp.copy(data.qpos, qpos)
            warp.copy(data.qvel, qvel)
            for ctrl in each:
                warp.copy(data.ctrl, ctrl)
                for _ in range(count_steps(own) // len(each)):
                    once()
            warp.synchronize()

        return all_of_it

    still = np.tile(start.ctrl, (len(controls), 1))
    return {"mujoco_warp.step": stepped(controls), "mujoco_warp.step, standing": stepped(still)}


def count_steps(own: MujocoModel) -> int:
    """Return the number of physics steps of a rollout."""
    return round(own.config.duration / own.model.opt.timestep)


def keyframe_data(own: MujocoModel) -> mujoco.MjData:
    """Return the model's data at the keyframe."""
    data = mujoco.MjData(own.model)
    mujoco.mj_resetDataKeyframe(own.model, data, own.keyframe_index)
    data.ctrl[:] = data.qpos[7:]  # servos hold it
    return data


def rows(engine: str, times: Found, steps: int) -> Iterator[dict[str, Any]]:
    """Yield rows of a table: times, and those of the engine over each."""
    (wall, cpu), *_ = times.values()
    for name, (one, of_cores) in times.items():
        yield {
            "engine": engine,
            "loop": name,
            "wall_s": one,
            "cpu_s": of_cores,
            "steps_per_s": steps / one,
            "engine_by_wall": wall / one,
            "engine_by_cpu": cpu / of_cores,
        }


def make_task(name: str, width: int, seconds: str, *more: str) -> tuple[MujocoModel, Any, Task]:
    """Return a system, its engine, and the rollouts to run."""
    exp = compose(["scenario=own", f"engine.name={name}", f"model.duration={seconds}", *more])
    own = exp.system
    assert isinstance(own, MujocoModel)
    task = (*own.make_world_and_belief({}), np.zeros(width, np.int64))
    return own, own.make_engine(replace(exp.settings, width=width), *task[:2], None), task


def measure_engine(name: str, width: int, seconds: str) -> Iterator[dict[str, Any]]:
    """Yield the rows of an engine.

    Raises:
        InputError: the engine cannot run here.
    """
    own, engine, task = make_task(name, width, seconds)
    controls = engine.trace(*task, 0).joint_target
    np.save("played.npy", controls)
    Path("played.py").write_text(PLAYED)
    _, played, _ = make_task(name, width, seconds, "model.controller=played:policy")
    found = shortest_times({
        name: lambda: engine.run(*task),
        f"{name}, its start": lambda: batch.make_initial_batch(own, EngineSettings(), *task).energy(),
        **{"native": native, "mjx": on_mjx, "warp": on_warp}[name](own, controls, width),
        f"{name}, played": lambda: played.run(*task),
    })  # fmt: skip
    if name == "mjx":
        found |= run_testspeed(own, width)
    return rows(name, found, count_steps(own) * width)


def main(engines: str = "native", width: str = "256", seconds: str = "4") -> None:
    """Print a line for each loop as soon as its engine is done, and all as JSON."""
    table: list[dict[str, Any]] = []
    device = jax.devices()[0].device_kind
    with tempfile.TemporaryDirectory() as folder:
        sweep(["init", "--model", f"{folder}/quad"])
        os.chdir(Path(folder, "quad"))
        print(f"rollouts {width}, seconds {seconds}, cores {THREADS}, device {device}")
        for engine in engines.split(","):
            try:
                table += (found := [*measure_engine(engine, int(width), seconds)])
            except Exception as error:  # the others are measured all the same
                print(f"{engine}: {type(error).__name__}: {error}", flush=True)
                continue
            print(f"{'loop':28}{'wall, s':>9}{'CPU, s':>9}{'steps/s':>12}{'engine over it: wall':>22}{'CPU':>6}")
            for one in found:
                print(f"{one['loop']:28}{one['wall_s']:9.3f}{one['cpu_s']:9.3f}{one['steps_per_s']:12.3g}"
                      f"{one['engine_by_wall']:22.2f}{one['engine_by_cpu']:6.2f}", flush=True)  # fmt: skip
    plain = [{key: None if value != value else value for key, value in one.items()} for one in table]
    told = {"rollouts": int(width), "seconds": float(seconds), "cores": THREADS, "device": device}
    print(json.dumps({**told, "jax": jax.__version__, "mujoco": mujoco.__version__, "loops": plain}))


if __name__ == "__main__":
    main(*sys.argv[1:])
