"""An own model's speed beside MuJoCo's own loops: `python bench/own_model.py [ENGINES [WIDTH [SECONDS]]]`.

The quadruped of `sweep init --model` and its trot, ENGINES as `native,mjx,warp`. `native` beside `mujoco.rollout` of
the same model with the very controls that the policy gave, on as many threads; `mjx` beside steps as in a scan, with
those controls and standing, and beside what `mjx-testspeed` runs; `warp` beside MuJoCo Warp's own step, a graph of
CUDA's where there is one. The same model, width and number of steps, in one run, one after the other several times; the
least of each counts, by the wall and by CPU time, which other programs disturb less. What is printed is a table, and
one line of JSON.
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
from sweep.study.config import compose
from sweep.systems.own import Own

REPETITIONS = 5
THREADS = len(os.sched_getaffinity(0))
Times = tuple[float, float]  # s, by the wall and of all cores
Found = dict[str, Times]  # the engine's first


def timed(call: Callable[[], Any]) -> Times:
    """Of a call that waits for what it begins."""
    wall, cpu = time.perf_counter(), time.process_time()
    call()
    return time.perf_counter() - wall, time.process_time() - cpu


def least(ways: Mapping[str, Callable[[], Any]]) -> Found:
    """Of each way, in turns; compiled before."""
    rounds = [{name: timed(call) for name, call in ways.items()} for _ in range(REPETITIONS)]
    return {name: (min(one[name][0] for one in rounds), min(one[name][1] for one in rounds)) for name in ways}


def native(own: Own, engine: Any, task: tuple[Any, Any, np.ndarray]) -> Found:
    """Beside `mujoco.rollout`, which records the state, and nothing of figures."""
    model, n = own.model, len(task[2])
    ctrl = np.stack([one.joint_target for one in engine.traces(*task, 1)])
    substeps = round(own.about.period / model.opt.timestep)
    ctrl = np.repeat(ctrl, substeps, axis=1)
    data = [mujoco.MjData(model) for _ in range(THREADS)]
    mujoco.mj_resetDataKeyframe(model, data[0], own.keyframe)
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    start = np.zeros(mujoco.mj_stateSize(model, full))
    mujoco.mj_getState(model, data[0], start, full)
    with Rollout(nthread=THREADS) as pool:
        return least({"native": lambda: engine.run(*task),
                      "mujoco.rollout": lambda: pool.rollout(model, data, np.tile(start, (n, 1)), ctrl)})  # fmt: skip


def on_mjx(own: Own, engine: Any, task: tuple[Any, Any, np.ndarray]) -> Found:
    """Beside `mjx-testspeed`, which starts from the model's own pose, and beside as many steps from the keyframe.

    Those are of the very controls that the policy gave, the same for all rollouts, and of such that hold the keyframe.
    """
    from mujoco import mjx

    steps, n = count(own), len(task[2])
    walk = jnp.asarray(engine.trace(*task, 0).joint_target, float)
    model, start = mjx.put_model(own.model), standing(own)
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
    ways = {"mjx": lambda: engine.run(*task), "mjx.step": stepped(walk), "mjx.step, standing": stepped(still)}
    for call in ways.values():
        call()  # compiles
    found, option = least(ways), own.model.opt
    solver = {int(mujoco.mjtSolver.mjSOL_CG): "cg", int(mujoco.mjtSolver.mjSOL_NEWTON): "newton"}[int(option.solver)]
    asked = copy(own.model), steps, n, 1, solver, option.iterations, option.ls_iterations
    tested = (mjx.benchmark(*asked)[1] for _ in range(2))  # it compiles each time
    return found | {"mjx-testspeed": (min(tested), np.nan)}


def on_warp(own: Own, engine: Any, task: tuple[Any, Any, np.ndarray]) -> Found:
    """Beside MuJoCo Warp without JAX, with as much room for contacts."""
    import warp  # pyright: ignore[reportMissingImports]
    from mujoco.mjx.third_party import mujoco_warp

    from sweep.systems.own.mjx import room

    n = len(task[2])
    model = mujoco_warp.put_model(own.model)
    data = mujoco_warp.put_data(own.model, standing(own), nworld=n, **room(own.model, n))
    substeps = round(own.about.period / own.model.opt.timestep)

    def tick() -> None:
        for _ in range(substeps):
            mujoco_warp.step(model, data)

    tick()  # compiles
    once: Callable[[], Any] = tick
    if warp.get_device().is_cuda:
        with warp.ScopedCapture() as capture:
            tick()
        once = lambda: warp.capture_launch(capture.graph)  # noqa: E731

    def all_of_it() -> None:
        for _ in range(count(own) // substeps):
            once()
        warp.synchronize()

    engine.run(*task)
    return least({"warp": lambda: engine.run(*task), "mujoco_warp.step": all_of_it})


def count(own: Own) -> int:
    """Physics steps of a rollout."""
    return round(own.about.duration / own.model.opt.timestep)


def standing(own: Own) -> mujoco.MjData:
    """At the keyframe."""
    data = mujoco.MjData(own.model)
    mujoco.mj_resetDataKeyframe(own.model, data, own.keyframe)
    data.ctrl[:] = data.qpos[7:]  # servos hold it
    return data


def rows(engine: str, found: Found, steps: int) -> Iterator[dict[str, Any]]:
    """Of a table: times, and those of the engine over each."""
    (wall, cpu), *_ = found.values()
    for name, (one, of_cores) in found.items():
        yield {
            "engine": engine,
            "loop": name,
            "wall_s": one,
            "cpu_s": of_cores,
            "steps_per_s": steps / one,
            "engine_by_wall": wall / one,
            "engine_by_cpu": cpu / of_cores,
        }


def main(engines: str = "native", width: str = "256", seconds: str = "4") -> None:
    """A line for each loop, and all as JSON."""
    table: list[dict[str, Any]] = []
    told: dict[str, Any] = {"rollouts": int(width), "seconds": float(seconds), "cores": THREADS}
    with tempfile.TemporaryDirectory() as folder:
        sweep(["init", "--model", f"{folder}/quad"])
        os.chdir(Path(folder, "quad"))
        for engine in engines.split(","):
            exp = compose(["scenario=own", f"engine.name={engine}", f"model.duration={seconds}"])
            own = exp.system
            assert isinstance(own, Own)
            task = (*own.sides({}), np.zeros(int(width), np.int64))
            made = own.engine(replace(exp.settings, width=int(width)), *task[:2], None)
            told["device"] = own.device(exp.settings)  # which mjx-testspeed gives other flags
            found = {"native": native, "mjx": on_mjx, "warp": on_warp}[engine](own, made, task)
            table += rows(engine, found, count(own) * int(width))
    print(", ".join(f"{name} {value}" for name, value in told.items()))
    print(f"{'loop':20}{'wall, s':>9}{'CPU, s':>9}{'steps/s':>12}{'engine over it: wall':>22}{'CPU':>6}")
    for one in table:
        print(f"{one['loop']:20}{one['wall_s']:9.3f}{one['cpu_s']:9.3f}{one['steps_per_s']:12.3g}"
              f"{one['engine_by_wall']:22.2f}{one['engine_by_cpu']:6.2f}")  # fmt: skip
    plain = [{key: None if value != value else value for key, value in one.items()} for one in table]
    print(json.dumps({**told, "jax": jax.__version__, "mujoco": mujoco.__version__, "loops": plain}))


if __name__ == "__main__":
    main(*sys.argv[1:])
